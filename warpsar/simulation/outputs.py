"""What every command begins with, and the JSON that it ends with, written whole or not at all."""

from __future__ import annotations

import json
import math
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from warpsar.errors import InputError
from warpsar.io.images import replacing
from warpsar.runtime import console, devices
from warpsar.scene.scene import Scene
from warpsar.version import __version__
from warpsar.world.mesh import unlikely_size
from warpsar.world.meshes.dem import SUFFIXES as DEM_SUFFIXES
from warpsar.world.objects.table import UNITS


def make_folder(out: Path) -> None:
    """Make a command's output folder, and the folders above it.

    Raises InputError where that cannot be, or where nothing can be written into it.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise InputError(
            f"--out: found {out}; nothing can be written there ({error.strerror}); allowed is a folder, there or new, "
            f"that can be written to"
        ) from error


def refuse_unwritable(out: Path) -> None:
    """Raise InputError where `make_folder` would fail, as far as that is known without a change: before long work."""
    there = next(each for each in (out, *out.absolute().parents) if each.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        raise InputError(
            f"--out: found {out}; nothing can be written to {there}; allowed is a folder, there or new, that can be "
            "written to"
        )


def refuse_unlikely_size(scene: Scene, yes: bool) -> None:
    """Raise InputError where a mesh of the scene is likely in another unit than it says, unless `yes`.

    Work grows with the square of a mesh's size. Elevation models and scenes with an `origin` are places of the earth,
    which may be large.
    """
    if yes or scene.origin is not None:
        return
    how = "--yes takes it as it is"
    assembly = scene.assembly
    own = scene.mesh if assembly is None else assembly.base
    path = scene.mesh_path
    if own is not None and path is not None and path.suffix.lower() not in DEM_SUFFIXES:
        found = unlikely_size(own.vertices)
        if found is not None:
            copy = f"`warpsar new FOLDER {path.name} --units mm` writes a copy in metres"
            raise InputError(f"{scene.name}: scene.mesh: {path}: {found}; {copy}, {how}")
    for index, one in enumerate(scene.objects):
        found = None if assembly is None or one.mesh is None else unlikely_size(assembly.vertices_of(one))
        if found is not None:
            unit = f'units = "{one.units}" may be wrong; allowed are {", ".join(UNITS)}'
            raise InputError(f"{scene.name}: objects[{index}] ({one.label}): {one.mesh}: {found}; {unit}; {how}")


def opened(scene_path: Path | str, out: Path | str, device: str | None) -> tuple[Scene, Path, wp.Device]:
    """The scene, its output folder and the device of a command that writes a new scene.toml; makes the folder.

    Raises InputError where the folder is the scene file's own, and DeviceError.
    """
    scene = Scene.load(scene_path)
    out = Path(out)
    if (out / "scene.toml").resolve() == scene.path:
        raise InputError(
            f"--out: found {out}, where the scene file itself lies and would be replaced; allowed is another"
        )
    make_folder(out)
    where = devices.resolve_device(device)
    console.say_device(where)
    console.warn(scene.warnings)
    return scene, out, where


def plain(value: Any) -> Any:
    """`value` in JSON's own types; NaN and infinity, which JSON does not have, become null."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _input(scene: Scene) -> dict[str, str]:
    return {"scene": Path(scene.path or "scene").name, "sha256": scene.input_hash}


def write_json(
    path: Path, scene: Scene | None, device: wp.Device, seed: int | None, started: float, content: dict[str, Any]
) -> dict[str, Any]:
    """Write `content` under the version, device, seed, wall time (since `started`, perf_counter) and input hash."""
    whole = plain(
        {
            "version": __version__,
            "device": f"{device.alias} ({device.name})",
            "seed": seed,
            "wall_time_s": round(time.perf_counter() - started, 3),
            **({} if scene is None else {"input": _input(scene)}),
            **content,
        }
    )
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
    return whole
