"""Files made by hand to break a reader of scenes: bombs, circles, pickles, links, and what must be no file at all."""

from __future__ import annotations

import os
import pickle
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .sound import FIFO, LOOP, VIEW, Bait, gltf, huge_tiff, made, npy_header, pickled, png, sound, zipped


@dataclass(frozen=True)
class Attack:
    """A file made by hand; `accepted` where it is odd and yet sound."""

    name: str
    make: Callable[[Path], None]
    accepted: bool = False


def attack(name: str, content: bytes | Callable[[], bytes], *, accepted: bool = False) -> Attack:
    return Attack(
        name, lambda path: path.write_bytes(content if isinstance(content, bytes) else content()) and None, accepted
    )


def _replaced(make: Callable[[Path], Any]) -> Callable[[Path], None]:
    def attack(path: Path) -> None:
        path.unlink()
        make(path)

    return attack


PLACES = (
    Attack("a FIFO", _replaced(os.mkfifo)),
    Attack("a folder", _replaced(Path.mkdir)),
    Attack("a link to itself", _replaced(lambda path: path.symlink_to(path.name))),
    Attack("a link to /dev/zero", _replaced(lambda path: path.symlink_to("/dev/zero"))),
    Attack("a link to a process's memory", _replaced(lambda path: path.symlink_to("/proc/self/mem"))),
    Attack("missing", Path.unlink),
    attack("empty", b""),
    attack("ones", b"\xff" * 70000),
)


# ---- attacks on pictures ----


def _huge_exr(width: int, height: int) -> Callable[[], bytes]:
    def content() -> bytes:
        data = sound("hh.exr")
        box = struct.pack("<iiii", 0, 0, width - 1, height - 1)
        for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
            at = data.index(name) + len(name) + 4
            data = data[:at] + box + data[at + 16 :]
        return data

    return content


def _zero_exr(path: Path) -> Path:
    """4096 x 4096 pixels of nothing, packed into little."""
    from warpsar.io.images import write_exr

    write_exr(path.with_suffix(".exr"), {"HH": np.zeros((4096, 4096), np.float32)})
    return path.with_suffix(".exr")


EXR_ATTACKS = (
    attack("2^31 x 2^31 pixels", _huge_exr(2**31 - 1, 2**31 - 1)),
    attack("30000 x 30000 pixels", _huge_exr(30000, 30000)),
    attack("16384 x 16384 pixels", _huge_exr(16384, 16384)),
    attack("4096 x 4096 zeros", made(_zero_exr)),
    attack("a window of negative size", _huge_exr(-5, -5)),
    attack("a pickle", pickled),
    attack("text", b"not an image\n" * 100),
)
TIFF_ATTACKS = (
    attack("2^31 x 2^31 pixels", huge_tiff(2**31 - 1, 2**31 - 1, 1)),
    attack("2^31 pixels in a strip", huge_tiff(2**31 - 1, 1, 1)),
    attack("30000 x 30000 pixels in a strip", huge_tiff(30000, 30000, 30000)),
    attack("16384 x 16384 pixels in a strip", huge_tiff(16384, 16384, 16384)),
    attack("2^32 values of a tag", huge_tiff(4, 4, 4)[:14] + b"\xff" * 4 + huge_tiff(4, 4, 4)[18:]),
    attack("a directory at 2^48", b"II+\0\x08\0\0\0" + struct.pack("<Q", 2**48) + b"\0" * 64),
    attack("no directory", b"II*\x00\xff\xff\xff\x7f"),
    attack(
        "a directory that is its own next",
        lambda: huge_tiff(4, 4, 4)[:130] + struct.pack("<I", 8) + b"\0" * 64,
        accepted=True,
    ),
    attack(
        "a virtual raster",
        b'<VRTDataset rasterXSize="4" rasterYSize="4"><VRTRasterBand dataType="Float32" band="1">'
        b"<SimpleSource><SourceFilename>/dev/zero</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>",
    ),
)
NPY_ATTACKS = (
    attack("a pickle", pickled),
    attack("a bare pickle", lambda: pickle.dumps(Bait())),
    attack("10^9 x 10^9 numbers", npy_header((10**9, 10**9)) + b"\0" * 64),
    attack("10^5 x 10^5 numbers", npy_header((10**5, 10**5)) + b"\0" * 64),
    attack("2^64 numbers", npy_header((2**32, 2**32)) + b"\0" * 64),
    attack("a negative shape", npy_header((-8, -10)) + b"\0" * 400),
    attack("strings", npy_header((8, 10), "<U1000000") + b"\0" * 64),
    attack("a type of its own", npy_header((8, 10), "O") + b"\x80\x04."),
    attack("an archive", lambda: zipped({"a.npy": npy_header((2, 2)) + b"\0" * 16})),
    attack("an archive of pickles", lambda: zipped({"a.npy": pickled()})),
    attack("deep header", b"\x93NUMPY\x01\x00\xf0\x22" + b"(" * 8944),
)
PNG_ATTACKS = (
    attack("2^31 x 2^31 pixels", lambda: png(2**31 - 1, 2**31 - 1, b"\0" * 100)),
    attack("30000 x 30000 pixels", lambda: png(30000, 30000, b"\0" * 30001 * 300)),
    attack("16384 x 16384 pixels", lambda: png(16384, 16384, b"\0" * 16385 * 16384)),
)


# ---- attacks on scene files ----


def _with(old: str, new: str) -> Callable[[], bytes]:
    def content() -> bytes:
        text = sound("scene.toml").decode()
        assert old in text
        return text.replace(old, new).encode()

    return content


SCENE_ATTACKS = (
    attack("100,000 brackets", b"a = " + b"[" * 100000),
    attack("900 brackets", b"a = " + b"[" * 900 + b"]" * 900),
    attack(
        "900 brackets in an effect",
        lambda: sound("scene.toml") + b"[effects.view_gain]\ngain = " + b"[" * 900 + b"]" * 900,
    ),
    attack(
        "300 brackets in an effect",
        lambda: sound("scene.toml") + b"[effects.view_gain]\ngain = " + b"[" * 90 + b"]" * 90,
    ),
    attack("a key of 50,000 parts", b"a" + b".a" * 50000 + b" = 1"),
    attack("50,000 nested inline tables", b"a = " + b"{a=" * 50000),
    attack("a number of 10,000 digits", _with("frequency_hz = 9.6e9", "frequency_hz = " + "9" * 10000)),
    attack("a number of 4,000 digits", _with("frequency_hz = 9.6e9", "frequency_hz = " + "9" * 4000)),
    attack("a number of 4,000 digits in an effect", _with("level = 0.002", "level = " + "9" * 4000)),
    attack("a hexadecimal number of 5,000 digits", _with("level = 0.002", "level = 0x" + "f" * 5000)),
    attack("a hexadecimal number for rows", _with("shape = [8, 10]", "shape = [0x" + "f" * 5000 + ", 10]")),
    attack("2^31 x 2^31 pixels", _with("shape = [8, 10]", "shape = [2147483647, 2147483647]")),
    attack("2^14 x 2^14 pixels", _with("shape = [8, 10]", "shape = [16384, 16384]")),
    attack("20 MB of comment", lambda: b"#" * 20_000_000),
    attack("20,000 views of one name", lambda: sound("scene.toml") + VIEW.encode() * 20000),
    attack("not UTF-8", lambda: sound("scene.toml") + b"# \xff\xfe"),
    attack("a byte of zero", lambda: sound("scene.toml") + b"\0"),
    attack("images are a FIFO", _with('"hh.exr"', f'"{FIFO}"')),
    attack("the mask is /dev/zero", _with('"mask.png"', '"/dev/zero"')),
    attack("the mask is a FIFO", _with('"mask.png"', f'"{FIFO}"')),
    attack("the mesh is a FIFO", _with('"scene.obj"', f'"{FIFO}"')),
    attack("the mesh is a link to itself", _with('"scene.obj"', f'"{LOOP}"')),
    attack("the texture is /dev/zero", _with('"eps.exr"', '"/dev/zero"')),
    attack("the mesh is the scene file", _with('"scene.obj"', '"scene.toml"')),
    attack("a file name with an escape", _with('"hh.exr"', r'"\u001b[2J.exr"')),
    attack("an unknown key with an escape", lambda: b'"\\u001b[2J" = 1\n' + sound("scene.toml")),
    attack("a surrogate", _with('"hh.exr"', r'"\ud800.exr"')),
)


# ---- attacks on meshes ----

_BOX = "v 0 0 0\nv 9 0 0\nv 9 9 0\nv 0 9 0\n"
OBJ_ATTACKS = (
    attack("index 10^18", (_BOX + "f 1 2 1000000000000000000\n").encode()),
    attack("index 2^31", (_BOX + "f 1 2 2147483647\nf 1 2 3\n").encode()),
    attack("index 10^30", (_BOX + "f 1 2 " + "9" * 30 + "\n").encode()),
    attack("index of 10,000 digits", (_BOX + "f 1 2 -" + "9" * 10000 + "\n").encode()),
    attack("index -1 of nothing", b"f -1 -2 -3\n"),
    attack("half an index", (_BOX + "f 1 2 -1.5\n").encode()),
    attack("texture index out of range", (_BOX + "vt 0 0\nf 1/9 2/9 3/9\n").encode()),
    attack("a face of 100,000 corners", (_BOX + "f" + " 1 2 3" * 33333 + "\n").encode(), accepted=True),
    attack("lines without an end", b"v " + b"1 " * 500_000),
    attack("2,000 materials", (_BOX + "".join(f"usemtl m{i}\nf 1 2 3\n" for i in range(2000))).encode()),
    attack("a material with an escape", (_BOX + "usemtl \x1b[2J\nf 1 2 3\n").encode()),
    attack("a material that is not UTF-8", _BOX.encode() + b"usemtl \xff\xfe\nf 1 2 3\n"),
    attack("a library elsewhere", ("mtllib /dev/zero\n" + _BOX + "f 1 2 3\n").encode(), accepted=True),
    attack("vertices with a corner missing", b"v 0 0\nv 1 0\nv 1 1\nf 1 2 3\n"),
    attack("coordinates of 1e308", b"v 1e308 0 0\nv -1e308 0 0\nv 0 1e308 0\nf 1 2 3\n"),
    attack("nothing but continuations", b"\\\n" * 300_000),
    attack("nothing but blanks", b" \t" * 1_000_000),
)


def _ply(vertices: int, faces: int, body: bytes, kind: str = "ascii", more: str = "") -> bytes:
    head = f"ply\nformat {kind} 1.0\n{more}element vertex {vertices}\n"
    head += "property float x\nproperty float y\nproperty float z\n"
    return (head + f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n").encode() + body


_SQUARE = b"0 0 0\n9 0 0\n9 9 0\n0 9 0\n"
PLY_ATTACKS = (
    attack("10^12 vertices", _ply(10**12, 1, _SQUARE)),
    attack("10^12 vertices, binary", _ply(10**12, 1, b"\0" * 400, "binary_little_endian")),
    attack("2^31 faces, binary", _ply(4, 2**31 - 1, b"\0" * 400, "binary_little_endian")),
    attack("10^30 faces, binary", _ply(4, 10**30, b"\0" * 400, "binary_big_endian")),
    attack("-1 vertices", _ply(-1, 1, _SQUARE)),
    attack("-1 faces, binary", _ply(4, -1, b"\0" * 400, "binary_little_endian")),
    attack("a face of 255 corners", _ply(4, 1, b"\0" * 48 + b"\xff" + b"\0" * 40, "binary_little_endian")),
    attack("a list of 10^9", _ply(4, 1, _SQUARE + b"1000000000 0 1 2\n"), accepted=True),  # the line ends after 3
    attack("index 2^31", _ply(4, 1, _SQUARE + b"3 0 1 2147483648\n")),
    attack("index 10^20", _ply(4, 1, _SQUARE + b"3 0 1 100000000000000000000\n")),
    attack(
        "another element of 10^12",
        _ply(4, 1, _SQUARE + b"3 0 1 2\n", more="element junk 1000000000000\nproperty int a\n"),
    ),
    attack(
        "a texture file elsewhere",
        _ply(4, 1, _SQUARE + b"3 0 1 2\n", more="comment TextureFile /dev/zero\n"),
        accepted=True,
    ),
    attack(
        "a texture that is a FIFO",
        _ply(4, 1, _SQUARE + b"3 0 1 2\n", more=f"comment TextureFile {FIFO}\n"),
        accepted=True,
    ),
    attack("no end of the header", b"ply\nformat ascii 1.0\n" + b"comment x\n" * 100_000),
    attack("a property without an element", b"ply\nformat ascii 1.0\nproperty float x\nend_header\n"),
    attack("an unknown type", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n0\n"),
    attack(
        "100,000 properties",
        b"ply\nformat ascii 1.0\nelement vertex 1\n" + b"property float a\n" * 100_000 + b"end_header\n0\n",
    ),
    attack(
        "vertices of lists", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar float x\nend_header\n1 0\n"
    ),
    attack(
        "text that is not UTF-8",
        _ply(4, 1, _SQUARE + b"3 0 1 2\n", more="comment ").replace(b"comment ", b"comment \xff\n"),
    ),
)
STL_ATTACKS = (
    attack("2^32 triangles", b"\0" * 80 + b"\xff\xff\xff\xff" + b"\0" * 500),
    attack("0 triangles", b"\0" * 84),
    attack("a solid without an end", b"solid x\n" + b"facet normal 0 0 1\nouter loop\n" * 20000),
    attack(
        "two corners",
        b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nendloop\nendfacet\nendsolid x\n",
    ),
    attack(
        "corners of 10,000 digits",
        b"solid x\nfacet normal 0 0 1\nouter loop\nvertex " + b"9" * 10000 + b" 0 0\nvertex 1 0 0\n"
        b"vertex 0 1 0\nendloop\nendfacet\nendsolid x\n",
    ),
    attack("20,000 solids", b"solid x\nendsolid x\n" * 20000),
)


def _accessor(**changed: Any) -> dict[str, Any]:
    first = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", **changed}
    return {"accessors": [first, {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"}]}


GLTF_ATTACKS: tuple[tuple[str, bytes, bool], ...] = (
    ("10^9 corners in 36 bytes", gltf(**_accessor(count=10**9)), False),
    ("10^9 corners of zero", gltf(**_accessor(count=10**9, bufferView=None)), False),
    (
        "2^40 corners of no buffer",
        gltf(accessors=[{"componentType": 5126, "count": 2**40, "type": "VEC3"}] * 2),
        False,
    ),
    ("-1 corners", gltf(**_accessor(count=-1)), False),
    ("an offset of 2^63", gltf(**_accessor(byteOffset=2**63)), False),
    ("a stride of 0", gltf(bufferViews=[{"buffer": 0, "byteLength": 36, "byteStride": 0}] * 2), False),
    ("a stride of 10^9", gltf(bufferViews=[{"buffer": 0, "byteLength": 36, "byteStride": 10**9}] * 2), False),
    ("sparse corners", gltf(**_accessor(sparse={"count": 2**31, "indices": {}, "values": {}})), False),
    ("a node that is its own child", gltf(nodes=[{"mesh": 0, "children": [0]}]), True),
    (
        "two nodes that are each other's",
        gltf(nodes=[{"mesh": 0, "children": [1]}, {"mesh": 0, "children": [0]}]),
        False,
    ),
    ("a child that is not there", gltf(nodes=[{"mesh": 0, "children": [7]}]), False),
    ("2^30 nodes by doubling", gltf(nodes=[*({"children": [i + 1, i + 1]} for i in range(30)), {"mesh": 0}]), True),
    ("2^24 nodes by doubling", gltf(nodes=[*({"children": [i + 1, i + 1]} for i in range(24)), {"mesh": 0}]), True),
    ("5,000 nodes in a row", gltf(nodes=[*({"children": [i + 1]} for i in range(5000)), {"mesh": 0}]), True),
    ("a matrix of NaN", gltf(nodes=[{"mesh": 0, "matrix": [float("nan")] * 16}]), False),
    ("a matrix of 3 numbers", gltf(nodes=[{"mesh": 0, "matrix": [1, 2, 3]}]), False),
    ("a buffer that is /dev/zero", gltf(buffers=[{"byteLength": 48, "uri": "/dev/zero"}]), False),
    ("a buffer that is a FIFO", gltf(buffers=[{"byteLength": 48, "uri": FIFO}]), False),
    ("a buffer above the folder", gltf(buffers=[{"byteLength": 48, "uri": "../../../../etc/passwd"}]), False),
    ("a buffer in the network", gltf(buffers=[{"byteLength": 48, "uri": "http://127.0.0.1:9/x"}]), False),
    (
        "an image that is a FIFO",
        gltf(
            images=[{"uri": FIFO}],
            textures=[{"source": 0}],
            materials=[{"name": "default", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        ),
        True,
    ),
    ("an image in the network", gltf(images=[{"uri": "http://127.0.0.1:9/x.png"}]), True),
    (
        "Draco",
        gltf(
            extensionsRequired=["KHR_draco_mesh_compression"],
            meshes=[
                {
                    "primitives": [
                        {"attributes": {"POSITION": 0}, "extensions": {"KHR_draco_mesh_compression": {"bufferView": 0}}}
                    ]
                }
            ],
        ),
        False,
    ),
    ("100,000 brackets", b"[" * 100_000, False),
    ("a list", b"[]", False),
)


def _heights(**how: Any) -> Callable[[Path], Path]:
    """A sparse GeoTIFF: any number of pixels in a few bytes."""

    def make(path: Path) -> Path:
        import rasterio

        with rasterio.open(
            path.with_suffix(".tif"), "w", driver="GTiff", count=1, dtype="float32", sparse_ok=True, **how
        ):
            pass
        return path.with_suffix(".tif")

    return make


_TILED = {"tiled": True, "blockxsize": 4096, "blockysize": 4096}
DEM_ATTACKS = (
    *TIFF_ATTACKS,
    attack("30000 x 30000 sparse heights", made(_heights(width=30000, height=30000, **_TILED))),
    attack("10^6 x 10^6 sparse heights", made(_heights(width=10**6, height=10**6, **_TILED))),
    attack("one row", made(_heights(width=4, height=1))),
)
