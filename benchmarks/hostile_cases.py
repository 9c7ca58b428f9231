"""Hostile files: for every reader a small sound folder, crafted attacks on it, and seeded mutations of its file.

A case is (reader, index): the first indices are the reader's crafted attacks, then what is no file at all, the rest
mutations, each made by random numbers of its own, so that any case can be made again alone.
"""

from __future__ import annotations

import os
import shutil
import struct
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from random import Random

import hostile_attacks as attacks_on
import hostile_measured as measured_attacks
from hostile_attacks import PLACES, Attack, attack
from hostile_files import FIFO, LOOP, TAG, VIEW, glb, scene_text, sound
from hostile_mutations import mutate_bytes, mutate_glb, mutate_json, mutate_png, mutate_toml, mutate_zip


@dataclass(frozen=True)
class Reader:
    """A folder to read (`base`: bytes by name), the file in it that is attacked, and the way through the program."""

    name: str
    base: dict[str, bytes]
    target: str
    read: Callable[[Path], None]
    command: Callable[[Path], list[str]] | None
    attacks: tuple[Attack, ...] = ()
    optional: bool = False  # what is not there, or no file, is left out
    mutate: Callable[[Random, bytes], bytes] = field(default=lambda rng, data: mutate_bytes(rng, data))

    def lay_out(self, folder: Path) -> None:
        """The sound folder, with a FIFO and a symlink to itself for names to point at."""
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for name, data in self.base.items():
            (folder / name).write_bytes(data)
        os.mkfifo(folder / FIFO)
        (folder / LOOP).symlink_to(LOOP)

    def spoil(self, folder: Path, index: int, seed: int) -> Attack | None:
        """Make the case `index` in a folder that is laid out; the attack, None for a mutation."""
        attacks = (*self.attacks, *(replace(place, accepted=self.optional) for place in PLACES))
        if index < len(attacks):
            attacks[index].make(folder / self.target)
            return attacks[index]
        (folder / self.target).write_bytes(self.mutated(Random(f"{seed} {self.name} {index}")))
        return None

    def mutated(self, rng: Random) -> bytes:
        """The attacked file with a mutation."""
        data = self.base[self.target]
        for _ in range(20):
            changed = self.mutate(rng, data)
            if changed != data:
                break
        return changed


def _load(folder: Path) -> None:
    """Read, write and read again: what is accepted must survive."""
    from warpsar.scene.scene import Scene

    scene = Scene.load(folder / "scene.toml")
    scene.save(folder / "saved.toml")
    Scene.load(folder / "saved.toml")


def _simulate(folder: Path) -> list[str]:
    return ["simulate", str(folder / "scene.toml"), "-o", str(folder / "out"), "--device", "cpu"]


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

    def command(folder: Path) -> list[str]:
        words = ["import", str(folder / name), "--scene", str(folder / "scene.toml"), "--view", "v", "--device", "cpu"]
        words += ["--format", kind]
        words += ["--quantity", "power", "--polarization", "HH"] if picture else []
        return words + (["--origin", *map(str, _ORIGIN)] if on_earth else [])

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
    return Reader(f"import {kind}", base, name, read, command, attacks)


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
    """Every reader by its name: one long list."""
    full = {name: sound(name) for name in ("scene.toml", "scene.obj", "hh.exr", "vv.tif", "eps.exr", "mask.png")}
    found = [
        Reader("scene.toml", full, "scene.toml", _load, _simulate, attacks_on.SCENE_ATTACKS, False, mutate_toml),
        Reader("mesh OBJ", full, "scene.obj", _load, _simulate, attacks_on.OBJ_ATTACKS),
        Reader("image EXR", full, "hh.exr", _load, _simulate, attacks_on.EXR_ATTACKS),
        Reader("image TIFF", full, "vv.tif", _load, _simulate, attacks_on.TIFF_ATTACKS),
        Reader("texture EXR", full, "eps.exr", _load, _simulate, attacks_on.EXR_ATTACKS),
        Reader("mask PNG", full, "mask.png", _load, _simulate, attacks_on.PNG_ATTACKS, False, mutate_png),
        Reader(
            "image NPY",
            {**full, "scene.toml": scene_text(hh="hh.npy").encode(), "hh.npy": sound("hh.npy")},
            "hh.npy",
            _load,
            _simulate,
            attacks_on.NPY_ATTACKS,
        ),
    ]
    gltf = tuple(attack(name, content, accepted=accepted) for name, content, accepted in attacks_on.GLTF_ATTACKS)

    def packed(content: bytes) -> Callable[[], bytes]:
        return lambda: glb(content, b"")

    packed_ones = tuple(
        attack(name, packed(content), accepted=accepted) for name, content, accepted in attacks_on.GLTF_ATTACKS
    )
    packed_ones += (
        attack("a JSON chunk of 4 GiB", struct.pack("<4sIII4s", b"glTF", 2, 2**32 - 1, 2**32 - 1, b"JSON") + b"{}"),
        attack("version 1", struct.pack("<4sII", b"glTF", 1, 40) + b"\0" * 28),
    )
    for label, name, attacks, mutate in (
        ("mesh PLY, ASCII", "ascii.ply", attacks_on.PLY_ATTACKS, mutate_bytes),
        ("mesh PLY, binary", "binary.ply", attacks_on.PLY_ATTACKS, mutate_bytes),
        ("mesh STL, ASCII", "ascii.stl", attacks_on.STL_ATTACKS, mutate_bytes),
        ("mesh STL, binary", "binary.stl", attacks_on.STL_ATTACKS, mutate_bytes),
        ("mesh glTF", "mesh.gltf", gltf, mutate_json),
        ("mesh GLB", "mesh.glb", packed_ones, mutate_glb),
        ("mesh GeoTIFF", "dem.tif", attacks_on.DEM_ATTACKS, mutate_bytes),
    ):
        base = {"scene.toml": scene_text(name, plain=True).encode(), name: sound(name)}
        found.append(Reader(label, base, name, _load, _simulate, attacks, False, mutate))
    suffixes = {"gotcha": "m_HH.mat", "cphd": "m.cphd", "sicd": "m.nitf", "mstar": "m.015", "nisar": "m.h5"}
    suffixes |= {"geotiff": "map.tif", "npy": "m.npy", "exr": "m.exr", "tiff": "m.tif"}
    found += [_measured(kind, name) for kind, name in suffixes.items()]
    saved = {"checkpoint.npz": sound("checkpoint.npz")}
    found.append(
        Reader(
            "checkpoint",
            saved,
            "checkpoint.npz",
            _checkpoint,
            None,
            measured_attacks.CHECKPOINT_ATTACKS,
            True,
            mutate_zip,
        )
    )
    beside = {name: sound(name) for name in ("learn.json", "history.csv")}
    found.append(
        Reader(
            "learn.json",
            beside,
            "learn.json",
            _fields,
            None,
            (attack("100,000 brackets", b"[" * 100_000),),
            True,
            mutate_json,
        )
    )
    found.append(Reader("history.csv", beside, "history.csv", _history, None, (), True))
    return {reader.name: reader for reader in found}
