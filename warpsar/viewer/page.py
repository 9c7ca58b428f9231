"""The page of `warpsar view`: one HTML file with mesh, images, script and three.js inside."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpsar.evaluation.report_parts import RESIDUAL_COLOURS, reach_db, shown_as
from warpsar.io.grey_scale import GREYS, GreyScale
from warpsar.io.html import data_uri
from warpsar.viewer.drapes import Drape
from warpsar.viewer.surface import Drawn
from warpsar.world.library.names import surface_named

ASSETS = Path(__file__).parent / "assets"
SURFACE_COLOURS, IMAGE_COLOURS = "viridis", "gray"


@dataclass(frozen=True)
class State:
    """A scene as it is shown: "before" beside "after", or one alone."""

    name: str
    surface: Drawn
    drapes: list[Drape]
    shape: tuple[int, int]
    spacing_m: tuple[float, float]


def page(title: str, summary: str, states: Sequence[State]) -> str:
    """The document. `title` and `summary` are plain text."""
    style, script, three = ((ASSETS / name).read_text("utf-8") for name in ("viewer.css", "viewer.js", "three.min.js"))
    names = {"title": title, "lead": summary}
    body = (ASSETS / "viewer.html").read_text("utf-8")
    for name, text in names.items():
        body = body.replace(f"{{{{{name}}}}}", escape(text))
    library = data_uri(three.encode(), "text/javascript")
    data = json.dumps(_content(states), separators=(",", ":")).replace("</", "<\\/")
    return (
        body.replace("{{style}}", style)
        .replace("{{imports}}", json.dumps({"imports": {"three": library}}))
        .replace("{{data}}", data)
        .replace("{{script}}", script)
    )


def _content(states: Sequence[State]) -> dict[str, Any]:
    scales = _scales(states)
    return {
        "maps": {name: _base64(_table(name)) for name in (SURFACE_COLOURS, IMAGE_COLOURS, RESIDUAL_COLOURS)},
        "states": [_state(one, scales) for one in states],
    }


@dataclass(frozen=True)
class ColourScale:
    """`levels_db` rise along the colour map `colours`, each at its `share` of it, 0 to 1; linear between them."""

    levels_db: Sequence[float]
    shares: Sequence[float]
    colours: str


def _scales(states: Sequence[State]) -> dict[str, ColourScale]:
    """By quantity and polarization: one scale for all views and states, and measured and modelled images share
    theirs. What a model has beyond the mesh does not count: it is noise alone."""
    images: dict[str, list[NDArray[np.float64]]] = {}
    for drape in (drape for state in states for drape in state.drapes):
        for name, image in drape.images_db.items():
            counts = np.isfinite(image) & (drape.covered | (not name.startswith("modelled")))
            images.setdefault(name, []).append(image[counts])
    found = {}
    for name in images:
        quantity, polarization = name.split()
        if quantity == "residual":
            reach = reach_db(images[name], 90.0)
            found[name] = ColourScale((-reach, reach), (0.0, 1.0), RESIDUAL_COLOURS)
            continue
        both = [v for q in ("measured", "modelled") for v in images.get(f"{q} {polarization}", [])]
        found[name] = ColourScale(GreyScale.of([10.0 ** (v / 10.0) for v in both]).levels_db, GREYS, IMAGE_COLOURS)
    return found


def _state(state: State, scales: dict[str, ColourScale]) -> dict[str, Any]:
    drawn = state.surface
    return {
        "name": state.name,
        "corners": _base64(drawn.corners.astype("<f4")),
        "triangles": _base64(drawn.triangles.astype("<u4")),
        "groups": [
            _group("material", drawn.materials, by_meaning(drawn.materials), drawn.material),
            _group("object", drawn.owners, strong(len(drawn.owners)), drawn.owner),
        ],
        "parameters": [_parameter(key, values) for key, values in drawn.parameters.items()] + _levelled(drawn),
        "views": [_view(drape, state, scales) for drape in state.drapes],
    }


def _group(label: str, names: Sequence[str], colours: NDArray[np.uint8], index: NDArray[Any]) -> dict[str, Any]:
    return {"label": label, "names": names, "colours": _base64(colours), "index": _base64(index.astype("<u2"))}


def _parameter(key: str, values: NDArray[np.float64]) -> dict[str, Any]:
    label, factor = shown_as(key)
    return {"label": label, "log": key != "specular_fraction", "values": _base64((values * factor).astype("<f4"))}


def _levelled(drawn: Drawn) -> list[dict[str, Any]]:
    if not drawn.levels_db:
        return []
    every = np.stack(list(drawn.levels_db.values()))
    ends = [float(every.min()), float(every.max())]
    return [
        {"label": label, "log": False, "values": _base64(values.astype("<f4")), "ends": ends}
        for label, values in drawn.levels_db.items()
    ]


def _view(drape: Drape, state: State, scales: dict[str, ColourScale]) -> dict[str, Any]:
    view = drape.view
    return {
        "name": view.name,
        "role": view.role,
        "azimuth_deg": view.azimuth_deg,
        "incidence_deg": view.incidence_deg,
        "axes": drape.axes.tolist(),
        "slant_range_m": drape.slant_range_m or 0.0,
        "shift_px": drape.shift_px.tolist(),
        "shape": state.shape,
        "spacing_m": state.spacing_m,
        "layover": _levels(drape.layover, 0.0, 1.0),
        "images": {
            name: {
                "png": _levels(np.interp(image, scales[name].levels_db, scales[name].shares), 0.0, 1.0),
                "scale": asdict(scales[name]),
            }
            for name, image in drape.images_db.items()
        },
    }


def _levels(image: ArrayLike, low: float, high: float) -> str:
    """A grey PNG with 255 steps from `low` to `high`, transparent where the image is NaN, as a data URI."""
    from PIL import Image

    values = np.asarray(image, float)
    there = np.isfinite(values)
    level = np.round(255.0 * np.clip((np.nan_to_num(values) - low) / (high - low), 0.0, 1.0))
    planes = np.stack([level, 255.0 * there], axis=2).astype(np.uint8)
    stream = BytesIO()
    Image.fromarray(planes).save(stream, format="png", optimize=True)
    return data_uri(stream.getvalue(), "image/png")


def _table(name: str) -> NDArray[np.uint8]:
    from matplotlib import colormaps

    return np.asarray(colormaps[name](np.arange(256), bytes=True))


def _base64(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")


# ---- colours of materials by what they are


COLOURS = {
    "asphalt": "#6f7378",
    "concrete": "#b3ada3",
    "brick": "#b2573c",
    "roof_tiles": "#8c3b2e",
    "gravel": "#a0937f",
    "stone": "#c9c2b0",
    "wood": "#a5733f",
    "glass": "#8fc7d9",
    "metal": "#7d93a8",
    "painted_steel": "#3f76b5",
    "soil_dry": "#c19a6b",
    "soil_wet": "#7a5a3c",
    "grass": "#6da34d",
    "water_calm": "#4a90c2",
    "water_rough": "#2f6f9f",
    "snow_dry": "#eef3f7",
    "snow_wet": "#d3e0ea",
}
"""By surface of the library."""
STRONG = "tab20"
LIGHTER = 0.35  # of the way to white, for each further material of the same surface


def by_meaning(names: Sequence[str]) -> NDArray[np.uint8]:
    """A colour for each material, shape (n, 4), RGBA. A second material of one surface is lighter than the first."""
    found = strong(len(names))
    seen: dict[str, int] = {}
    for index, name in enumerate(names):
        surface = surface_named(name)
        if surface in COLOURS:
            again = seen[surface] = seen.get(surface, -1) + 1
            colour = np.frombuffer(bytes.fromhex(COLOURS[surface][1:]), np.uint8)
            found[index, :3] = 255.0 - (255.0 - colour) * (1.0 - LIGHTER) ** again
    return found


def strong(count: int) -> NDArray[np.uint8]:
    """Colours for names without a meaning, shape (count, 4): strong ones first, then their pale sisters, then again."""
    from matplotlib import colormaps

    table = colormaps[STRONG](np.arange(20), bytes=True)
    return np.concatenate([table[::2], table[1::2]])[np.arange(count) % 20]
