"""The tables of docs/measured-btr70.md, from what btr70.py found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import tables
from btr70_model import SPACING_M
from btr70_parts import LAYER_NAMES, LENGTHS
from btr70_shape import CAD_M

SETS = ("sector", "sector_15", "depression", "between")
PREDICTIONS = ("declared", "final", "nearest", "mirrored", "mean", "other_depression")


def summary(views: Sequence[Mapping[str, Any]]) -> list[list[Any]]:
    """Rows of set, views, prediction and means of its measures."""
    rows = []
    for name in SETS:
        mine = [view for view in views if view["set"] == name]
        for prediction in PREDICTIONS:
            found = [view["measures"][prediction] for view in mine if prediction in view["measures"]]
            if found:
                means = [np.mean([one[key] for one in found]) for key in ("correlation", "best_shift", "one_pixel")]
                deviance = np.mean([one["deviance"] for one in found])
                rows.append([name, len(found), prediction, *(f"{x:.3f}" for x in (*means, deviance))])
    return rows


def by_region(views: Sequence[Mapping[str, Any]]) -> list[list[Any]]:
    rows = []
    for prediction in ("declared", "final"):
        for name in ("body", "shadow", "ground"):
            mine = [view["measures"] for view in views if view["set"].startswith("sector")]
            found = [measures[prediction][name] for measures in mine if prediction in measures]
            if not found:
                continue
            both = [np.nanmean([one[key] for one in found]) for key in ("correlation", "deviance")]
            rows.append([prediction, name, *(f"{x:.3f}" for x in both)])
        seen = [view["measures"][prediction] for view in views if prediction in view["measures"]]
        edges = [abs(one["lit_edge_rows"]) * SPACING_M[0] for one in seen]
        if edges:
            rows.append([prediction, "lit edge, median error [m]", f"{np.nanmedian(edges):.2f}", ""])
    return rows


def checked(known: Mapping[str, Any]) -> list[list[Any]]:
    """Rows of what is known: what, found, stated elsewhere."""
    rows: list[list[Any]] = []
    shape, again = known["shape"], known["coverage"]
    stated = {"height": "2.24 to 2.32", "width": "2.80", "length": "7.53"}
    for name, metres in CAD_M.items():
        value, half = (metres * shape[name][key] for key in ("value", "half"))
        rows.append([f"{name} [m], the CAD to 10 %", f"{value:.2f} +- {half:.2f}", f"{stated[name]}, published"])
    turned = f"{shape['turned']['value']:+.3f} +- {shape['turned']['sd']:.3f}"
    rows.append(["front at +X: what the score of the train chips left out loses", turned, "turret at -X"])
    header = {"roll_deg": -1.18, "pitch_deg": -1.42}
    for name, of in (("roll_deg", "of the vehicle, on its ground"), ("pitch_deg", "of the vehicle, on its ground")):
        found = f"{shape[name]['value']:+.2f} +- {shape[name]['half']:.2f}"
        rows.append([f"{name.removesuffix('_deg')} {of} [deg]", found, f"{header[name]:+.2f}, header"])
    for name, key in (("roll_deg", "ground_roll_deg"), ("pitch_deg", "ground_pitch_deg")):
        found = f"{shape[key]['value']:+.2f} +- {shape[key]['half']:.2f}"
        rows.append(
            [f"{name.removesuffix('_deg')} of the ground [deg]", found, f"{header[name]:+.2f}, header's vehicle"]
        )
    for key, width in known["widths"]["header"].items():
        name = key.removesuffix("_fwhm_m")
        mean, sd = known["widths"]["speckle"][key]
        rows.append([f"{name} width [m], from the grass's speckle", f"{mean:.3f} +- {sd:.3f}", f"{width:.3f}, header"])
    for key, width in known["widths"]["header"].items():
        name = key.removesuffix("_fwhm_m")
        freed = f"{known['widths']['freed'][key]:.3f}"
        rows.append([f"{name} width [m], freed in the model's fit", freed, f"{width:.3f}, header"])
    for name, one in again.items():
        share = f"{one['inside']} of {one['replicates']}, bias {one['bias']:+.3f} ({one['sd_of_found']:.3f})"
        rows.append([f"{name} on chips that the model made: truth inside the 95 % interval", share, "19 of 20"])
    levels = known["levels"]
    low, high = (100.0 * share for share in levels["clipped_range"])
    rows.append(["pixels at the top of the scale", f"{low:.1f} to {high:.1f} %", "0.1 to 0.6 %"])
    if levels["floor_below_grass_db"] is not None:
        rows.append(["noise floor under the grass [dB]", f"{levels['floor_below_grass_db']:.1f}", "6 to 15"])
    said = known["rounding"]
    found = f"{said['share']:g} of it, held-out gain {said['gain']:+.4f} +- {said['error']:.4f}"
    rows.append(["JPEG's error beside the floor, 9.75 levels rms at most", found, "7 to 9 levels"])
    return rows


def by_part(shares: Mapping[str, float]) -> list[list[Any]]:
    """Rows of a layer and its shares from the front to the rear; nothing where the vehicle has no such part."""
    return [
        [layer, *(f"{shares[name]:.2f}" if (name := f"part{k}{layer}") in shares else "" for k in range(LENGTHS))]
        for layer in reversed(LAYER_NAMES)
    ]


def tables_of(content: Mapping[str, Any]) -> dict[str, str]:
    """The tables of the page, by name."""
    head = ("set", "views", "prediction", "correlation", "at best shift", "smoothed by 1", "deviance")
    found = {
        "btr70.sets": tables.markdown(head, summary(content["views"])),
        "btr70.regions": tables.markdown(
            ("prediction", "region", "correlation", "deviance"), by_region(content["views"])
        ),
    }
    if content["steps"]:
        rows = [
            [
                s["tried"],
                f"{s['gain']:+.4f}",
                *(f"{s[key]:.4f}" for key in ("error", "noise")),
                "yes" if s["stays"] else "",
            ]
            for s in content["steps"]
        ]
        found["btr70.steps"] = tables.markdown(("tried", "held-out gain", "standard error", "noise", "stays"), rows)
        found["btr70.checks"] = tables.markdown(("what", "found", "elsewhere"), checked(content["checks"]))
        bounces = [
            [b["ground"], f"{b['power']:.1f}", b["strength"], f"{b['correlation']:.3f}"]
            for b in content["checks"]["bounces"]["found"]
        ]
        head = ("ground", "power of bounces over all other, strength 1", "strength", "correlation")
        found["btr70.bounces"] = tables.markdown(head, bounces)
        orders = [
            [name, f"{one['order']:.2f}", f"{one['gain_per_pixel']:+.3f}", one["pixels"]]
            for name, one in content["checks"]["orders"].items()
            if name != "cpu_s"
        ]
        head = ("region", "order", "held-out log score per pixel over plain speckle", "pixels")
        found["btr70.orders"] = tables.markdown(head, orders)
    if shares := content["effects"].get("unresolved_detail", {}).get("share"):
        head = ("layer", *(f"{k + 1}" for k in range(LENGTHS)))
        found["btr70.parts"] = tables.markdown(head, by_part(shares))
    return found
