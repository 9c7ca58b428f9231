"""Write the Gotcha scene with its cars as objects: ground.toml as a mesh with the two reflectors on it, and a table
[[objects]] for each car of objects.toml and each thing of things.toml.

python data/gotcha/make_objects.py FOLDER

Every car starts as a common saloon where read_off.py put it, with a material of its own.
"""

from __future__ import annotations

import argparse
import runpy
import tomllib
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
HEIGHT_M = 1.5
SIDE_CURVATURE = 0.06
METAL = {"eps_r": 200.0, "rms_height_m": 0.0012, "correlation_length_m": 0.007, "learn": ["rms_height_m"]}
GROUND = {"eps_r": 5.0, "rms_height_m": 0.0008, "correlation_length_m": 0.006, "learn": ["rms_height_m"]}
REFERENCE = "grass"  # gains are unknown, so its brightness is held


def read(name: str) -> dict[str, Any]:
    return tomllib.loads((HERE / name).read_text(encoding="utf-8"))


def cars() -> list[dict[str, Any]]:
    """Tables [[objects]]: the middle of a car lies behind the side that faces the radar in the east."""
    size = read("rows.toml")["car"]
    length, width = size["length_m"], size["width_m"]
    found = []
    for k, one in enumerate(read("objects.toml")["cars"]):
        sideways = one["facing"] == "side"
        east, north = one["foot_m"]
        found.append(
            {
                "name": f"car{k:03d}",
                "primitive": "car",
                "size_m": [length, width, HEIGHT_M],
                "side_curvature": SIDE_CURVATURE,
                "position_m": [round(east - (width if sideways else length) / 2.0, 2), north, 0.0],
                "heading_deg": 0.0 if sideways else 90.0,
                "material": f"car{k:03d}",
            }
        )
    return found


def things() -> list[dict[str, Any]]:
    """Tables [[objects]] of what is no car."""
    return [
        {
            "name": f"thing{k:02d}",
            "primitive": "box",
            "size_m": one["size_m"],
            "position_m": [*one["middle_m"], 0.0],
            "material": f"thing{k:02d}",
        }
        for k, one in enumerate(read("things.toml")["things"])
    ]


def write(folder: Path) -> Path:
    """Write the scene; returns its scene.toml."""
    import tomlkit

    make = runpy.run_path(str(HERE / "make_scene.py"))
    content = read("ground.toml")
    trihedrals = [
        t for one in read("objects.toml")["reflectors"] for t in make["trihedral"](one["corner_m"], one["leg_m"])
    ]
    make["write_mesh"](folder, content, {"reflector": trihedrals})
    document: Any = tomlkit.parse((HERE / "scene.toml").read_text(encoding="utf-8"))
    reflector = document["materials"]["reflector"]
    document["materials"].clear()
    for name in dict.fromkeys(region["material"] for region in content["regions"]):
        document["materials"][name] = {**GROUND, "learn": [] if name == REFERENCE else ["rms_height_m"]}
    document["materials"]["reflector"] = reflector
    document["objects"] = tomlkit.aot()
    for one in (*cars(), *things()):
        document["materials"][one["material"]] = METAL
        document["objects"].append(tomlkit.item(one))
    path = folder / "scene.toml"
    path.write_text(tomlkit.dumps(document), encoding="utf-8", newline="\n")
    return path


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    print(write(parser.parse_args().folder))
