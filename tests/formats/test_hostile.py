"""Hostile files end in one message, or are read, and in nothing else; and no code here can load a pickle.

`hostile/` has crafted attacks, and strategies of mutations, so that what goes wrong comes out as small as it can be.
`--hypothesis-profile long` tries more of them.
"""

import ast
import linecache
import pickle
import re
import struct
import subprocess
import sys
import tracemalloc
import zipfile
from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from hostile.readers import readers
from hostile.sound import gltf
from hostile.worker import Worker, contents, exhausted, judge
from hypothesis import given
from hypothesis import strategies as st

from warpsar.errors import LONGEST_MESSAGE, InputError, shown
from warpsar.formats.base import mat5
from warpsar.io import checkpoint
from warpsar.io.images import read_channel, read_npy, write_exr
from warpsar.kernels.lane_kernels import at_once
from warpsar.kernels.scatter import scatter_kernel
from warpsar.world.mesh import read_mesh


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    """A process under a limit on its memory that reads what it is given: hostile/worker.py says what is looked at."""
    for extra in ("rasterio", "sarkit", "h5py"):  # they make the sound files
        pytest.importorskip(extra, reason="needs the extras geo, sicd and hdf5")
    if not Path("/proc/self/clear_refs").exists():
        pytest.skip("memory is measured as Linux counts it")
    one = Worker()
    yield one
    one.stop()


# ---- all readers ----


def test_every_attack_ends_in_one_message(worker: Worker) -> None:
    todo = [(one.name, i) for one in readers().values() for i in range(len(one.attacks))]
    counts = Counter(worker.run(name, i) for name, i in todo)
    assert counts["refused"] > 500  # of 558: attacks that reach no reader would show here


@pytest.mark.full
def test_every_mutation_is_read_or_ends_in_one_message(worker: Worker) -> None:
    """What is read is read with all that follows: pictures, tables, a scene that is written and read again."""
    counts = Counter[str]()

    @given(data=st.data(), name=st.sampled_from(sorted(readers())))
    def mutated(data: st.DataObject, name: str) -> None:
        counts[worker.run(name, data.draw(readers()[name].mutations()))] += 1

    mutated()
    print(f"\n{counts['read']} were read, {counts['refused']} refused")
    assert min(counts["refused"], counts["read"]) > 0  # neither is the answer to all


def test_the_judge_sees_what_is_wrong(tmp_path: Path) -> None:
    """What a reader may do wrong is told from a refusal, so that the table's zeros mean something."""
    file = tmp_path / "a"
    file.write_text("a")
    before = contents(tmp_path)
    sound = InputError(f"{file}: broken")

    def outcome(error: Exception | None, said: str = "") -> str:
        return str(judge(error, said, tmp_path, before)[0])

    assert outcome(None) == "read"
    assert outcome(sound) == "refused"
    assert outcome(sound, "libpng error: broken") == "noisy"
    assert outcome(KeyError("x")) == "traceback"
    assert outcome(InputError("broken")) == "unclear"
    assert exhausted(InputError("x")) is False
    hidden = InputError("x")
    hidden.__cause__ = MemoryError()
    assert exhausted(hidden)
    (tmp_path / ".half").write_text("")
    assert outcome(sound) == "half-written"


@pytest.mark.full
@pytest.mark.parametrize(
    ("reader", "attack"),
    [("scene.toml", "a FIFO"), ("mesh glTF", "a buffer that is /dev/zero"), ("mask PNG", "2^31 x 2^31 pixels")],
)
def test_the_command_line_refuses_in_one_line(worker: Worker, tmp_path: Path, reader: str, attack: str) -> None:
    chosen = readers()[reader]
    folder = tmp_path / "case"
    chosen.lay_out(folder)
    next(one for one in chosen.attacks if one.name == attack).make(folder / chosen.target)
    words = [sys.executable, "-m", "warpsar", "simulate", str(folder / "scene.toml"), "-o", str(folder / "out")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    lines = done.stderr.splitlines()
    assert lines[0].startswith(f"Error: {folder}")
    assert all(line.startswith("  ") for line in lines[1:])  # the list of what is wrong
    assert not (folder / "out").exists()


# ---- pickles ----

FORBIDDEN_IMPORTS = {"pickle", "cPickle", "_pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "yaml"}
FORBIDDEN_CALLS = {"eval", "exec", "__import__"}
WRITES_KERNELS = ROOT / "kernels" / "lane_kernels.py"  # runs what it wrote itself, of which a test below says more
LOADERS = {"load", "read_array"}  # numpy.load, numpy.lib.format.read_array: pickles unless told otherwise


def _sources() -> list[Path]:
    return [path for folder in ("warpsar", "cli", "kernels") for path in (ROOT / folder).rglob("*.py")]


def loads_a_pickle(node: ast.AST, path: Path) -> bool:
    """Whether a piece of a source imports or calls what could load a pickle or run text."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        names = [alias.name for alias in node.names]
        names.append(getattr(node, "module", None) or "")
        return bool({name.split(".")[0] for name in names} & FORBIDDEN_IMPORTS)
    if not isinstance(node, ast.Call):
        return False
    function, said = node.func, {key.arg: key.value for key in node.keywords}
    refused = "allow_pickle" in said
    if refused and not (isinstance(said["allow_pickle"], ast.Constant) and said["allow_pickle"].value is False):
        return True
    if isinstance(function, ast.Name):
        return function.id in FORBIDDEN_CALLS and (path, function.id) != (WRITES_KERNELS, "exec")
    if not (isinstance(function, ast.Attribute) and isinstance(function.value, ast.Name)):
        return False
    owner, name = function.value.id, function.attr
    if owner in ("np", "numpy", "format") and name in LOADERS and not refused:
        return True
    # torch.distributed's *_object: pickles over the wire
    return (owner, name) == ("torch", "load") or name.endswith(("_object", "_object_list"))


def test_no_source_can_load_a_pickle() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}"  # type: ignore[attr-defined]  # an import or a call has a line
        for path in _sources()
        for node in ast.walk(ast.parse(path.read_text()))
        if loads_a_pickle(node, path)
    ]
    assert found == []


@pytest.mark.parametrize(
    ("line", "loads"),
    [
        *[("import pickle", True), ("from marshal import loads", True), ("import numpy", False)],
        *[("eval(text)", True), ("exec(text)", True), ("evaluate(text)", False)],
        *[("np.load(path)", True), ("np.load(path, allow_pickle=True)", True), ("np.load(path, allow_pickle=a)", True)],
        *[("np.load(path, allow_pickle=False)", False), ("read(path, allow_pickle=True)", True)],
        *[("torch.load(path)", True), ("dist.broadcast_object_list(some)", True), ("dist.broadcast(some)", False)],
    ],
)
def test_what_loads_a_pickle_is_found(line: str, loads: bool) -> None:
    assert any(loads_a_pickle(node, ROOT / "a.py") for node in ast.walk(ast.parse(line))) == loads


def test_what_is_written_and_run_calls_a_kernels_own_work_alone() -> None:
    """`at_once` runs text of its own: nothing but the names of a kernel of this library stands in it."""
    given = scatter_kernel("oh", True)
    made = at_once(given)
    text = "".join(linecache.getlines(made.func.__code__.co_filename))
    work, kernel = ast.parse(text).body
    assert isinstance(work, ast.FunctionDef)
    assert isinstance(kernel, ast.FunctionDef)
    called = {ast.unparse(node.func) for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)}
    assert called == {"wp.func_native", "wp.kernel", "wp.tid", work.name}
    assert ast.unparse(work.body[0]) == "..."
    loaded = {node.id for node in ast.walk(kernel) if isinstance(node, ast.Name)}
    words = {"wp", "options", work.name, *given.adj.arg_types}
    assert all(name in words or re.fullmatch(r"type_\d+", name) for name in loaded)


class Bait:
    """Makes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return open, (str(self.path), "w")


def test_the_bait_bites(tmp_path: Path) -> None:
    pickle.loads(pickle.dumps(Bait(tmp_path / "bitten"))).close()
    assert (tmp_path / "bitten").exists()


def test_a_pickle_in_a_numpy_file_is_refused_and_not_loaded(tmp_path: Path) -> None:
    bitten = tmp_path / "bitten"
    np.save(tmp_path / "a.npy", np.array([[Bait(bitten)]], object), allow_pickle=True)
    (tmp_path / "b.npy").write_bytes(pickle.dumps(Bait(bitten)))
    for name in ("a.npy", "b.npy"):
        for read in (read_npy, read_channel):
            with pytest.raises(InputError, match=name):
                read(tmp_path / name)
    assert not bitten.exists()


def test_a_pickle_in_a_checkpoint_is_refused_and_not_loaded(tmp_path: Path) -> None:
    bitten = tmp_path / "bitten"
    np.savez(tmp_path / checkpoint.NAME, x=np.array([Bait(bitten)], object), allow_pickle=True)
    with pytest.raises(InputError, match=r"checkpoint\.npz"):
        checkpoint.read(tmp_path, "tag")
    assert not bitten.exists()


# ---- what a checkpoint may be ----


def test_a_checkpoint_survives(tmp_path: Path) -> None:
    arrays = {"x": np.arange(6.0).reshape(2, 3), "i": np.array(3), "name": np.array("é"), "none": np.zeros((0, 2))}
    checkpoint.write(tmp_path, arrays, "tag")
    found = checkpoint.read(tmp_path, "tag")
    assert found is not None
    assert set(found) == set(arrays)
    for key, array in arrays.items():
        np.testing.assert_array_equal(found[key], array)
        assert found[key].dtype == array.dtype


def test_a_packed_checkpoint_is_refused_unread(tmp_path: Path) -> None:
    content = BytesIO()
    np.save(content, np.zeros(2**23))
    with zipfile.ZipFile(tmp_path / checkpoint.NAME, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("x.npy", content.getvalue())
    tracemalloc.start()
    with pytest.raises(InputError, match="packed"):
        checkpoint.read(tmp_path, "tag")
    assert tracemalloc.get_traced_memory()[1] < 2**22  # of 64 MiB
    tracemalloc.stop()


# ---- MATLAB files ----


def test_matlab_arrays_of_every_kind_pass(tmp_path: Path) -> None:
    """What SciPy writes, packed or not, in cells and structures, empty, sparse, text, and complex."""
    from scipy.io import savemat
    from scipy.sparse import eye_array

    content = {
        "data": {"fp": np.ones((5, 7), np.complex64), "af": {"r_correct": np.zeros(7)}, "empty": np.zeros((0, 3))},
        "text": "näme",
        "cells": np.array([[1, "two"], [np.ones(3), {"x": 1.0}]], object),
        "records": np.zeros(4, [("a", "f8"), ("b", "i2")]),
        "sparse": eye_array(50),
        "flag": True,
        "bytes": np.arange(3, dtype=np.uint8),
    }
    for packed in (False, True):
        savemat(tmp_path / "a.mat", content, do_compression=packed)
        mat5.check(tmp_path / "a.mat")


def test_matlab_zeros_packed_too_well_are_refused(tmp_path: Path) -> None:
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"data": np.zeros(2**22)}, do_compression=True)
    with pytest.raises(InputError, match="unpacks to more than 100 times"):
        mat5.check(tmp_path / "a.mat")


# ---- messages, and what a file refers to ----


def test_messages_steer_no_terminal_and_end() -> None:
    assert str(InputError("a\x1b[2J\x07\ud800é\nb")) == "a\\x1b[2J\\x07\\ud800é\nb"
    long = str(InputError("x" * 10**6))
    assert len(long) < LONGEST_MESSAGE + 100
    assert "990000 letters more" in long
    assert len(shown("x" * 10**6)) == 80
    assert shown(10**5000) == "a number of thousands of digits"


def test_an_image_of_another_shape_is_not_unpacked(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", {"HH": np.zeros((2048, 2048), np.float32)})
    tracemalloc.start()
    with pytest.raises(InputError, match=r"found 2048 x 2048 pixels; must be 8 x 10 \(image\.shape\)"):
        read_channel(tmp_path / "a.exr", "HH", shape=(8, 10))
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def _gltf(folder: Path, uri: str) -> Path:
    path = folder / "a.gltf"
    path.write_bytes(gltf(buffers=[{"byteLength": 48, "uri": uri}]))
    return path


def test_gltf_buffers_lie_beside_it_or_nowhere(tmp_path: Path) -> None:
    corners = np.array([[0, 0, 0], [9, 0, 0], [9, 0, -9]], "<f4").tobytes()
    (tmp_path / "scene").mkdir()
    for place in (tmp_path, tmp_path / "scene"):
        (place / "a.bin").write_bytes(corners + struct.pack("<III", 0, 1, 2))
    assert len(read_mesh(_gltf(tmp_path / "scene", "a.bin")).faces) == 1
    (tmp_path / "scene" / "link.bin").symlink_to(tmp_path / "a.bin")
    for uri in ("../a.bin", str(tmp_path / "a.bin"), "link.bin", "b.bin", "."):
        with pytest.raises(InputError, match="must be a file in the same folder"):
            read_mesh(_gltf(tmp_path / "scene", uri))


def test_a_virtual_raster_is_no_geotiff(tmp_path: Path) -> None:
    """GDAL would open it, and whatever it names, under any suffix."""
    rasterio = pytest.importorskip("rasterio", reason="needs the extra geo")
    with rasterio.open(tmp_path / "b.tif", "w", driver="GTiff", width=3, height=3, count=1, dtype="float32") as file:
        file.write(np.ones((1, 3, 3), np.float32))
    (tmp_path / "a.tif").write_text(
        '<VRTDataset rasterXSize="3" rasterYSize="3"><VRTRasterBand dataType="Float32" band="1"><SimpleSource>'
        f"<SourceFilename>{tmp_path / 'b.tif'}</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    with rasterio.open(tmp_path / "a.tif") as file:
        assert file.driver == "VRT"
    with pytest.raises(InputError, match=r"a\.tif: cannot be read as TIFF"):
        read_mesh(tmp_path / "a.tif")
