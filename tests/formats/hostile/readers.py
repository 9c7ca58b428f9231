"""Every reader of files: a small sound folder, attacks on it, mutations of its file, and the way to read it."""

from __future__ import annotations

import os
import shutil
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from hypothesis.strategies import SearchStrategy

from . import attacks as attacks_on
from . import measured_attacks
from .attacks import PLACES, Attack, attack
from .mutations import spoiled, spoiled_glb, spoiled_json, spoiled_png, spoiled_toml, spoiled_zip
from .sound import FIFO, LOOP, TAG, VIEW, glb, scene_text, sound


@dataclass(frozen=True)
class Reader:
    """A folder to read (`base`: bytes by name), the file in it that is attacked, and the way to read it."""

    name: str
    base: dict[str, bytes]
    target: str
    read: Callable[[Path], None]
    attacks: tuple[Attack, ...] = ()
    spoiled: Callable[[bytes], SearchStrategy[bytes]] = spoiled

    def mutations(self) -> SearchStrategy[bytes]:
        """Contents of the attacked file."""
        return self.spoiled(self.base[self.target])

    def lay_out(self, folder: Path) -> None:
        """The sound folder, with a FIFO and a symlink to itself for names to point at."""
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for name, data in self.base.items():
            (folder / name).write_bytes(data)
        os.mkfifo(folder / FIFO)
        (folder / LOOP).symlink_to(LOOP)


def _load(folder: Path) -> None:
    """Read, write and read again: what is accepted must survive."""
    from warpsar.scene.scene import Scene

    scene = Scene.load(folder / "scene.toml")
    scene.save(folder / "saved.toml")
    Scene.load(folder / "saved.toml")


_ORIGIN = (40.0, -84.0, 230.0)
_IMPORT_SCENE = """[scene]
mesh = "ground.obj"
[radar]
frequency_hz = 9.6e9
polarizations = ["{polarization}"]
[image]
shape = [{rows}, {cols}]
spacing_m = [0.5, 0.5]
calibrated = false
[materials.default]
eps_r = 6.0
rms_height_m = 0.0012
correlation_length_m = 0.01
"""
_GROUND = b"v -60 -60 0\nv 60 -60 0\nv 60 60 0\nv -60 60 0\nf 1 2 3\nf 1 3 4\n"


def _measured(kind: str, name: str) -> Reader:
    picture = kind in ("geotiff", "npy", "exr", "tiff")
    on_earth = kind in ("nisar", "geotiff")
    rows, cols = (20, 24) if kind in ("npy", "exr", "tiff") else (12, 16)
    text = _IMPORT_SCENE.format(polarization="VV" if kind == "sicd" else "HH", rows=rows, cols=cols)
    text += VIEW if picture else ""

    def read(folder: Path) -> None:
        from warpsar.measured.importer import import_measured

        import_measured(
            [folder / name],
            folder / "scene.toml",
            "v",
            file_format=kind,
            quantity="power" if picture else None,
            polarization="HH" if picture else None,
            origin=_ORIGIN if on_earth else None,
            device="cpu",
        )

    attacks = {
        "gotcha": measured_attacks.MAT_ATTACKS,
        "cphd": measured_attacks.CPHD_ATTACKS,
        "sicd": measured_attacks.SICD_ATTACKS,
        "mstar": measured_attacks.MSTAR_ATTACKS,
        "nisar": measured_attacks.HDF5_ATTACKS,
        "geotiff": attacks_on.DEM_ATTACKS,
        "npy": attacks_on.NPY_ATTACKS,
        "exr": attacks_on.EXR_ATTACKS,
        "tiff": attacks_on.TIFF_ATTACKS,
    }[kind]
    base = {name: sound(kind), "scene.toml": text.encode(), "ground.obj": _GROUND}
    return Reader(f"import {kind}", base, name, read, (*attacks, *PLACES))


def _checkpoint(folder: Path) -> None:
    from warpsar.io import checkpoint

    checkpoint.read(folder, TAG)


def _history(folder: Path) -> None:
    from warpsar.evaluation.report import convergence_sections

    convergence_sections(folder)


def _fields(folder: Path) -> None:
    from warpsar.evaluation.report import field_words

    field_words(folder)


@cache
def readers() -> dict[str, Reader]:
    """Every reader by its name."""
    full = {name: sound(name) for name in ("scene.toml", "scene.obj", "hh.exr", "vv.tif", "eps.exr", "mask.png")}
    arrays = {**full, "scene.toml": scene_text(hh="hh.npy").encode(), "hh.npy": sound("hh.npy")}
    gltf = tuple(attack(name, content, accepted=accepted) for name, content, accepted in attacks_on.GLTF_ATTACKS)
    packed = tuple(
        attack(name, glb(content, b""), accepted=accepted) for name, content, accepted in attacks_on.GLTF_ATTACKS
    )
    packed += (
        attack("a JSON chunk of 4 GiB", struct.pack("<4sIII4s", b"glTF", 2, 2**32 - 1, 2**32 - 1, b"JSON") + b"{}"),
        attack("version 1", struct.pack("<4sII", b"glTF", 1, 40) + b"\0" * 28),
    )
    found = [
        Reader(label, base, name, _load, (*attacks, *PLACES), strategy)
        for label, base, name, attacks, strategy in (
            ("scene.toml", full, "scene.toml", attacks_on.SCENE_ATTACKS, spoiled_toml),
            ("mesh OBJ", full, "scene.obj", attacks_on.OBJ_ATTACKS, spoiled),
            ("image EXR", full, "hh.exr", attacks_on.EXR_ATTACKS, spoiled),
            ("image TIFF", full, "vv.tif", attacks_on.TIFF_ATTACKS, spoiled),
            ("texture EXR", full, "eps.exr", attacks_on.EXR_ATTACKS, spoiled),
            ("mask PNG", full, "mask.png", attacks_on.PNG_ATTACKS, spoiled_png),
            ("image NPY", arrays, "hh.npy", attacks_on.NPY_ATTACKS, spoiled),
            *(
                (label, {"scene.toml": scene_text(name, plain=True).encode(), name: sound(name)}, name, *how)
                for label, name, *how in (
                    ("mesh PLY, ASCII", "ascii.ply", attacks_on.PLY_ATTACKS, spoiled),
                    ("mesh PLY, binary", "binary.ply", attacks_on.PLY_ATTACKS, spoiled),
                    ("mesh STL, ASCII", "ascii.stl", attacks_on.STL_ATTACKS, spoiled),
                    ("mesh STL, binary", "binary.stl", attacks_on.STL_ATTACKS, spoiled),
                    ("mesh glTF", "mesh.gltf", gltf, spoiled_json),
                    ("mesh GLB", "mesh.glb", packed, spoiled_glb),
                    ("mesh GeoTIFF", "dem.tif", attacks_on.DEM_ATTACKS, spoiled),
                )
            ),
        )
    ]
    suffixes = {"gotcha": "m_HH.mat", "cphd": "m.cphd", "sicd": "m.nitf", "mstar": "m.015", "nisar": "m.h5"}
    suffixes |= {"geotiff": "map.tif", "npy": "m.npy", "exr": "m.exr", "tiff": "m.tif"}
    found += [_measured(kind, name) for kind, name in suffixes.items()]
    beside = {name: sound(name) for name in ("learn.json", "history.csv")}
    may_lack = tuple(replace(place, accepted=True) for place in PLACES)  # what is not there, or no file, is left out
    deep = attack("100,000 brackets", b"[" * 100_000)
    found += [
        Reader(name, base, name, read, (*attacks, *may_lack), strategy)
        for name, base, read, attacks, strategy in (
            ("checkpoint.npz", {"checkpoint.npz": sound("checkpoint.npz")}, _checkpoint,
             measured_attacks.CHECKPOINT_ATTACKS, spoiled_zip),
            ("learn.json", beside, _fields, (deep,), spoiled_json),
            ("history.csv", beside, _history, (), spoiled),
        )
    ]  # fmt: skip
    return {reader.name: reader for reader in found}
