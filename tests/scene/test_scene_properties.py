"""Any mutation of a valid scene file is accepted or refused with `InputError`; nothing else is ever raised."""

import copy
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from warpsar.errors import InputError
from warpsar.io.images import write_tiff
from warpsar.scene.scene import Scene

TABLES: dict[str, Any] = {
    "scene": {"mesh": "scene.obj", "reference_point_m": [0.0, 0.0, 0.0]},
    "radar": {"frequency_hz": 9.6e9, "polarizations": ["HH"], "slant_range_m": 350.0, "polarization_basis": "radar"},
    "image": {"shape": [3, 3], "spacing_m": [0.5, 0.5], "calibrated": True},
    "sampling": {"rays_per_pixel": 4.0, "seed": 1, "deposit": "nearest"},
    "materials": {
        "a": {
            "eps_r": [6.0, -0.5],
            "rms_height_m": 0.001,
            "correlation_length_m": 0.01,
            "specular_fraction": 0.0,
            "spectrum": "gaussian",
            "layout": "uniform",
            "learn": ["eps_r"],
        },
        "b": {"eps_r": 6.0, "rms_height_m": 0.001, "correlation_length_m": "map.tif", "layout": "texture"},
    },
    "views": [
        {"name": "one", "azimuth_deg": 0.0, "incidence_deg": 40.0, "images": {"HH": "map.tif"}, "mask": "map.tif"},
        {"name": "two", "azimuth_deg": 10.0, "grazing_deg": 40.0, "looks": 4.0, "role": "test"},
    ],
}
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\nusemtl b\nf 1/1 2/1 3/1\n"

texts = st.sampled_from(["", ".", "..", "/", "a", "b", "one", "HH", "texture", "vertex", "scene.toml", "map.tif"])
values = st.recursive(
    st.one_of(
        st.booleans(),
        st.integers(-(2**63), 2**63 - 1),
        st.just(10**400),
        st.floats(),
        st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
        texts,
        st.datetimes(),
        st.just("x" * 5000),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(
            st.one_of(texts, st.text(st.characters(exclude_categories=["Cs"]), max_size=5)), inner, max_size=3
        ),
    ),
    max_leaves=5,
)


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as name:
        path = Path(name)
        (path / "scene.obj").write_text(OBJ)
        write_tiff(path / "map.tif", np.full((3, 3), 0.01))
        (path / "scene.toml").write_text(tomlkit.dumps(TABLES))
        Scene.load(path / "scene.toml")  # what is mutated is valid
        yield path


def places(tables: Any, above: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every key and index of a nested table."""
    found: list[tuple[Any, ...]] = []
    keys = tables if isinstance(tables, dict) else range(len(tables)) if isinstance(tables, list) else ()
    for key in keys:
        found += [(*above, key), *places(tables[key], (*above, key))]
    return found


PLACES = places(TABLES)


def load(path: Path, data: bytes) -> None:
    """Load a scene file; what is accepted can be written and is then accepted again."""
    path.write_bytes(data)
    scene, message = None, ""
    try:
        scene = Scene.load(path)
    except InputError as error:
        message = str(error)
    if scene is None:
        assert str(path) in message
        return
    again = path.with_name("again.toml")
    scene.save(again)
    saved = Scene.load(again)
    assert (saved.views, saved.materials, saved.radar, saved.grid) == (
        scene.views,
        scene.materials,
        scene.radar,
        scene.grid,
    )


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_changed_tables(folder: Path, data: st.DataObject) -> None:
    tables = copy.deepcopy(TABLES)
    for _ in range(data.draw(st.integers(1, 3))):
        *above, key = data.draw(st.sampled_from(PLACES))
        target = tables
        try:
            for part in above:
                target = target[part]
            action = data.draw(st.sampled_from(["delete", "replace", "add", "rename"]))
            if action == "delete":
                del target[key]
            elif action == "replace":
                target[key] = data.draw(values)
            elif action == "add" and isinstance(target, dict):
                target[data.draw(texts)] = data.draw(values)
            elif action == "rename" and isinstance(target, dict):
                target[data.draw(texts)] = target.pop(key)
            elif isinstance(target, list):
                target.append(copy.deepcopy(target[key]))
        except (KeyError, IndexError, TypeError):
            continue  # an earlier change took this place away
    try:
        text = tomlkit.dumps(tables)
    except ValueError:
        return  # tomlkit cannot write every value that TOML has
    load(folder / "mutated.toml", text.encode())


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_changed_bytes(folder: Path, data: st.DataObject) -> None:
    text = bytearray((folder / "scene.toml").read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(text)))
        end = data.draw(st.integers(start, min(len(text), start + 30)))
        tokens = st.sampled_from([b"nan", b"inf", b"-", b"1e999", b"[", b"]]", b'"""', b"\n", b"0x" + b"F" * 5000])
        piece = data.draw(st.one_of(st.binary(max_size=8), tokens, st.just(bytes(text[end : end + 30]))))
        text[start:end] = piece
    load(folder / "mutated.toml", bytes(text))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), name=st.sampled_from(["scene.obj", "map.tif"]))
def test_changed_files(folder: Path, data: st.DataObject, name: str) -> None:
    """The same for the mesh and the image that it refers to."""
    whole = (folder / name).read_bytes()
    broken = bytearray(whole)
    start = data.draw(st.integers(0, len(broken)))
    broken[start : start + data.draw(st.integers(0, 40))] = data.draw(st.binary(max_size=20))
    try:
        (folder / name).write_bytes(broken)
        load(folder / "mutated.toml", (folder / "scene.toml").read_bytes())
    finally:
        (folder / name).write_bytes(whole)
