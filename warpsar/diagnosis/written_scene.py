"""What diagnosis.json and the written scene say of objects that were found, beside their values: how well they are
known."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from warpsar.diagnosis.found import Diagnosis
from warpsar.learning.identify import Identified
from warpsar.surface.surface import kinds_of

SD_KEYS = {"position_m": "position_sd_m", "heading_deg": "heading_sd_deg", "size_m": "size_sd_m"}
"""Keys of an object's table, and where diagnosis.json has their standard deviations."""


def own_materials(found: Diagnosis, identified: Identified) -> dict[str, dict[str, dict[str, float]]]:
    """Materials that only the final scene has, by name and learned key, as `materials` in diagnosis.json has them.

    `identified` is that of the final model.
    """
    sds = dict(zip(identified.labels, identified.sd.tolist(), strict=True))
    content: dict[str, dict[str, dict[str, float]]] = {}
    parameters = found.final.scene.parameters
    for name, material in found.final.scene.materials.items():
        if name in found.scene.materials:
            continue
        content[name] = {
            kind.key: {
                "after": float(parameters[f"materials.{name}.{kind.key}"].value),
                "after_sd_log": sds[f"{name}.{kind.key}"],
            }
            for kind in kinds_of(material.model)
            if f"{name}.{kind.key}" in sds
        }
    return content


def annotate(path: Path, objects: Mapping[str, Mapping[str, Any]]) -> None:
    """Put standard deviations beside the values of `objects` in a written scene file, as comments.

    A tolerance would be wrong there: a fit to the same images would take them for knowledge, and count them twice.
    """
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    for table in document.get("objects", []):
        told = objects.get(str(table.get("name", table.get("group", ""))), {})
        for key, sd in SD_KEYS.items():
            if key in table and sd in told:
                values = told[sd] if isinstance(told[sd], list) else [told[sd]]
                table[key].comment("standard deviation " + ", ".join(f"{value:.2g}" for value in values))
    path.write_text(tomlkit.dumps(document), encoding="utf-8", newline="\n")
