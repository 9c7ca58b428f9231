"""Sound files of every kind, small, and pieces of formats to make broken ones from."""

from __future__ import annotations

import base64
import io
import json
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

CANARY = "unpickled"  # the file that a pickle would make
FIFO, LOOP = "fifo", "loop"  # beside every sound file, for names to point at
TAG = "the run's own"

VIEW = '[[views]]\nname = "v"\nazimuth_deg = 0.0\nincidence_deg = 40.0\n'


# ---- pieces of formats ----


def glb(document: bytes, binary: bytes) -> bytes:
    document += b" " * (-len(document) % 4)
    chunks = (
        struct.pack("<I4s", len(document), b"JSON") + document + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def checked_png(data: bytes) -> bytes:
    out, at = bytearray(data[:8]), 8
    while at + 12 <= len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        body = data[at + 4 : at + 8 + size]
        if len(body) < 4 + size:
            break
        out += data[at : at + 4] + body + struct.pack(">I", zlib.crc32(body))
        at += 12 + size
    return bytes(out) + data[at:]


def png(width: int, height: int, body: bytes) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(body, 9)) + chunk(b"IEND", b"")


def zipped(members: dict[str, bytes], packing: int = zipfile.ZIP_STORED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", packing) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def npy_header(shape: tuple[int, ...], kind: str = "<f4") -> bytes:
    text = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


class Bait:
    """What unpickles into a file named `CANARY` in the working folder."""

    def __reduce__(self) -> Any:
        return (open, (CANARY, "w"))


def pickled() -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.array([Bait(), Bait()], object), allow_pickle=True)
    return buffer.getvalue()


def made(make: Callable[[Path], Any]) -> Callable[[], bytes]:
    """Bytes of what `make` writes at a path."""

    def content() -> bytes:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "made"
            written = make(path)
            return (written if isinstance(written, Path) else path).read_bytes()

    return content


def tiff(entries: dict[int, tuple[int, int]]) -> bytes:
    """A little-endian TIFF of one directory: tag to (type, value)."""
    rows = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, (kind, value) in sorted(entries.items()))
    return b"II*\x00\x08\x00\x00\x00" + struct.pack("<H", len(entries)) + rows + b"\0\0\0\0" + b"\0" * 64


def huge_tiff(width: int, height: int, strip: int) -> bytes:
    tags = {256: (4, width), 257: (4, height), 258: (3, 32), 259: (3, 1), 262: (3, 1), 273: (4, 8), 277: (3, 1)}
    return tiff({**tags, 278: (4, strip), 279: (4, 64), 339: (3, 3)})


def gltf(**changed: Any) -> bytes:
    points = np.array([[0, 0, 0], [9, 0, 0], [9, 0, -9]], "<f4").tobytes()
    document: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"name": "default", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 12}],
        "buffers": [
            {
                "byteLength": 48,
                "uri": "data:application/octet-stream;base64,"
                + base64.b64encode(points + np.arange(3, dtype="<u4").tobytes()).decode(),
            }
        ],
    }
    return json.dumps({**document, **changed}).encode()


# ---- the sound files ----


def scene_text(mesh: str = "scene.obj", texture: str = "eps.exr", hh: str = "hh.exr", *, plain: bool = False) -> str:
    surface = "rms_height_m = 0.0012\ncorrelation_length_m = 0.01\n"
    head = f"""# The user's own words.
[scene]
mesh = "{mesh}"
reference_point_m = [4.0, 4.0, 0.0]
[radar]
frequency_hz = 9.6e9
polarizations = ["HH", "VV"]
[image]
shape = [8, 10]
spacing_m = [0.5, 0.5]
calibrated = true
[sampling]
rays_per_pixel = 16.0
seed = 1
"""
    if plain:
        return head + f"[materials.default]\neps_r = 6.0\n{surface}{VIEW}"
    return (
        head
        + f"""[materials.ground]
eps_r = "{texture}"
{surface}layout = "texture"
learn = ["eps_r"]
[materials.roof]
eps_r = [9.0, -0.5]
rms_height_m = 0.001
correlation_length_m = [0.01, 0.02]
spectrum = "separable"
[effects.noise_floor]
level = 0.002
[effects.point_spread]
range_fwhm_m = 0.6
[[views]]
name = "first"
azimuth_deg = 0.0
incidence_deg = 40.0
images = {{ HH = "{hh}", VV = "vv.tif" }}
mask = "mask.png"
looks = 4.0
[[views]]
name = "second"
azimuth_deg = 90.0
depression_deg = 50.0
frequency_hz = 1e10
slant_range_m = 350.0
role = "test"
"""
    )


_OBJ = "vt 0 0\nvt 1 0\nvt 1 1\nv 0 0 0\nv 9 0 0\nv 9 9 0\nv 0 9 0\n"
_OBJ += "usemtl ground\nf 1/1 2/2 3/3\nusemtl roof\nf -4 -2 -1\n"


@cache
def files() -> dict[str, bytes]:
    """The sound files, by name; measurements by their format."""
    import trimesh
    from test_measured_readers import MADE

    from warpsar.io import checkpoint, geotiff
    from warpsar.io.images import write_exr, write_tiff

    power = np.random.default_rng(0).exponential(0.1, (8, 10))
    files: dict[str, bytes] = {"scene.toml": scene_text().encode(), "scene.obj": _OBJ.encode()}
    # rasterio is set up by the program, not by what writes its input.
    with geotiff.projecting(Path()), tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_exr(folder / "hh.exr", {"HH": power, "VV": power})
        write_tiff(folder / "vv.tif", power)
        write_exr(folder / "eps.exr", {"eps_r": 5.0 + power})
        np.save(folder / "hh.npy", power)
        _heights_file(folder / "dem.tif")
        box = trimesh.creation.box((8, 8, 3))
        scalars = {"vertex": {"eps": np.linspace(5, 6, 8)}}
        for suffix, kind, how in (
            ("binary.ply", "ply", {"encoding": "binary"}),
            ("ascii.ply", "ply", {"encoding": "ascii"}),
            ("binary.stl", "stl", {}),
            ("ascii.stl", "stl_ascii", {}),
        ):
            box.vertex_attributes = scalars["vertex"] if kind == "ply" else {}
            made = box.export(file_type=kind, **how)
            files[suffix] = made if isinstance(made, bytes) else made.encode()
        checkpoint.write(folder, {"x": np.arange(5.0), "history": np.array("[]"), "loss": np.array(1.0)}, TAG)
        for path in folder.iterdir():
            files[path.name] = path.read_bytes()
        for kind, make in MADE.items():
            files[kind] = make(folder).read_bytes()
    files["mask.png"] = png(10, 8, b"".join(b"\0" + b"\1" * 10 for _ in range(8)))
    files["mesh.gltf"] = gltf()
    document = json.loads(gltf())
    binary = base64.b64decode(document["buffers"][0].pop("uri").split(",")[1])
    files["mesh.glb"] = glb(json.dumps(document).encode(), binary)
    files["learn.json"] = json.dumps({"fields": {"ground.eps_r": {"determined": 1, "nodes": 80, "seen": 80}}}).encode()
    files["history.csv"] = b"iteration,start,loss,train_deviance\n1,0,5.0,1.2\n2,0,4.0,1.1\n"
    return files


def _heights_file(path: Path) -> None:
    import rasterio

    heights = np.random.default_rng(1).uniform(0, 3, (6, 7)).astype(np.float32)
    where = rasterio.Affine(1.0, 0.0, 600000.0, 0.0, -1.0, 5500000.0)
    with rasterio.open(
        path, "w", driver="GTiff", width=7, height=6, count=1, dtype="float32", crs="EPSG:32614", transform=where
    ) as file:
        file.write(heights, 1)


def sound(name: str) -> bytes:
    return files()[name]
