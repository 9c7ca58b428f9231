"""What diagnosis.json and the written scene say of objects that were found, beside their values: how well they are
known."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from warpsar.diagnosis.found import Diagnosis
from warpsar.diagnosis.geometry.registry import body_changes
from warpsar.learning.identify import Identified
from warpsar.learning.pose_search import sd_key
from warpsar.surface.surface import kinds_of


def own_materials(diagnosis: Diagnosis, identified: Identified) -> dict[str, dict[str, dict[str, float]]]:
    """Materials that only the final scene has, by name and learned key, as `materials` in diagnosis.json has them.

    `identified` is that of the final model.
    """
    sds = dict(zip(identified.labels, identified.sd.tolist(), strict=True))
    content: dict[str, dict[str, dict[str, float]]] = {}
    parameters = diagnosis.final.scene.parameters
    for name, material in diagnosis.final.scene.materials.items():
        if name in diagnosis.scene.materials:
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
    commented = {key: sd_key(key) for change in body_changes() for key in change.commented}
    for table in document.get("objects", []):
        values = objects.get(str(table.get("name", table.get("group", ""))), {})
        for key, sd in commented.items():
            if key in table and sd in values:
                sds = values[sd] if isinstance(values[sd], list) else [values[sd]]
                table[key].comment("standard deviation " + ", ".join(f"{each:.2g}" for each in sds))
    path.write_text(tomlkit.dumps(document), encoding="utf-8", newline="\n")
