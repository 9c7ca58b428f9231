"""Mutations of files: bytes, numbers in text, and the trees of TOML, JSON and archives.

Every choice is made by a `random.Random` that is given: a seeded one in the long run (`hostile.py`), and in the tests
Hypothesis's own, which looks for the shortest row of choices that goes wrong.
"""

from __future__ import annotations

import io
import json
import math
import re
import struct
import tomllib
import zipfile
from random import Random
from typing import Any

from hostile_files import FIFO, LOOP, checked_png, files, glb, zipped

EXTREMES = (0, -1, 1, 127, 255, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1, -(2**31), -(2**63))
WORDS = (
    *(b"%d" % value for value in EXTREMES),
    *(
        b"nan",
        b"inf",
        b"-inf",
        b"1e308",
        b"-1e308",
        b"1e400",
        b"1e-320",
        b"",
        b"x",
        b"9" * 400,
        b"0x10",
        b"1_0",
        b"1e9",
    ),
)


def _place(rng: Random, size: int) -> int:
    """An offset, half of the time near the start, where headers are."""
    return rng.randrange(max(1, min(size, 1024) if rng.random() < 0.5 else size))


def _flip(rng: Random, data: bytearray, donor: bytes) -> None:
    for _ in range(rng.randrange(1, 9)):
        if data:
            data[_place(rng, len(data))] ^= 1 << int(rng.randrange(8))


def _scribble(rng: Random, data: bytearray, donor: bytes) -> None:
    at = _place(rng, len(data))
    data[at : at + 8] = rng.randbytes(rng.randrange(1, 9))


def _extreme(rng: Random, data: bytearray, donor: bytes) -> None:
    width = rng.choice([1, 2, 4, 8])
    value = rng.choice(EXTREMES) % 2 ** (8 * width)
    at = _place(rng, len(data)) // width * width
    data[at : at + width] = value.to_bytes(width, "little" if rng.random() < 0.5 else "big")


def _not_finite(rng: Random, data: bytearray, donor: bytes) -> None:
    kind = rng.choice(["<f", ">f", "<d", ">d"])
    value = rng.choice([math.nan, math.inf, -math.inf, 3e38, 1e-40, -0.0])
    at = _place(rng, len(data)) // 4 * 4
    data[at : at + struct.calcsize(kind)] = struct.pack(kind, value)


def _truncate(rng: Random, data: bytearray, donor: bytes) -> None:
    del data[_place(rng, len(data)) :]


def _delete(rng: Random, data: bytearray, donor: bytes) -> None:
    at = _place(rng, len(data))
    del data[at : at + rng.randrange(1, 257)]


def _duplicate(rng: Random, data: bytearray, donor: bytes) -> None:
    at, size = _place(rng, len(data)), rng.randrange(1, 1025)
    data[at:at] = data[at : at + size] * rng.randrange(1, 4)


def _splice(rng: Random, data: bytearray, donor: bytes) -> None:
    at, start, size = _place(rng, len(data)), _place(rng, len(donor)), rng.randrange(1, 1025)
    data[at : at + (size if rng.random() < 0.5 else 0)] = donor[start : start + size]


def _fill(rng: Random, data: bytearray, donor: bytes) -> None:
    at, size = _place(rng, len(data)), rng.randrange(1, 513)
    data[at : at + size] = bytes([rng.choice([0, 255, 32, 65])]) * size


def _append(rng: Random, data: bytearray, donor: bytes) -> None:
    data += rng.randbytes(rng.randrange(1, 513))


def _number(rng: Random, data: bytearray, donor: bytes) -> None:
    """A number written in text: another one in its place, of the same length half of the time."""
    start = _place(rng, len(data))
    found = re.compile(rb"-?\d+(\.\d*)?([eE][-+]?\d+)?").search(data, start)
    if found:
        word = rng.choice(WORDS)
        if rng.random() < 0.5:
            length = found.end() - found.start()
            word = word[:length].rjust(length, b"0") if rng.random() < 0.5 else b"9" * length
        data[found.start() : found.end()] = word


_OPERATIONS = (
    *(_flip, _scribble, _extreme, _extreme, _not_finite, _truncate, _delete, _duplicate, _splice, _fill, _append),
    *(_number, _number),
)


def mutate_bytes(rng: Random, data: bytes) -> bytes:
    """One to three operations, on the bytes or on numbers written in them."""
    changed = bytearray(data)
    for _ in range(rng.randrange(1, 4)):
        operation = rng.choice(_OPERATIONS)
        operation(rng, changed, rng.choice(_donors()))
    return bytes(changed)


def _donors() -> list[bytes]:
    return list(files().values())


_NAMES = ("/dev/zero", "/dev/stdin", ".", "..", FIFO, LOOP, "missing.exr", "/etc/passwd", "x" * 5000, "a/b/c", "~", "")
_NAMES += (
    "scene.toml",
    "scene.obj",
    "vv.tif",
    "hh.exr",
    "mask.png",
    "eps.exr",
    "//",
    "\x00",
    "\x1b[2J",
    "file:///etc/passwd",
)
_VALUES: tuple[Any, ...] = (*_NAMES, *EXTREMES, 10**30, 1e308, -1e308, 5e-324, 0.5, 45.0, float("nan"), float("inf"))
_VALUES += (True, [], {}, [1], [1, 2], [1.0, -1.0], [[[]]], {"a": {"b": 1}}, "HH", "texture", "vertex", "eps", "train")


def mutate_toml(rng: Random, data: bytes) -> bytes:
    """A third of the time the bytes; else a key deleted, renamed, added or given another value."""
    import tomlkit

    if rng.random() < 1 / 3:
        return mutate_bytes(rng, data)
    document = tomllib.loads(data.decode())
    for _ in range(rng.randrange(1, 4)):
        places: list[tuple[Any, Any]] = []

        def collect(node: Any) -> None:
            for key in node if isinstance(node, dict) else range(len(node)):
                places.append((node, key))  # noqa: B023
                if isinstance(node[key], dict | list):
                    collect(node[key])

        collect(document)
        if not places:
            break
        node, key = rng.choice(places)
        value = rng.choice(_VALUES)
        kind = rng.randrange(8)
        if kind == 0:
            del node[key]
        elif kind == 1 and isinstance(node, dict):
            node[rng.choice(["unknown", "", "a.b", "ü", "x" * 3000, "name", "images", "\x1b"])] = value
        elif kind == 2:  # what stands elsewhere
            other, at = rng.choice(places)
            node[key] = json.loads(json.dumps(other[at], default=str))
        elif kind == 3 and isinstance(node[key], int | float):
            node[key] = float(node[key]) * rng.choice([-1.0, 0.0, 1e-30, 1e30, 1e300])
        elif kind == 4 and isinstance(node, list):
            node.extend([node[key]] * rng.choice([1, 2, 100]))
        else:
            node[key] = value
    try:
        return tomlkit.dumps(document).encode()
    except (ValueError, TypeError):  # a number that TOML cannot hold, a mixture that tomlkit does not write
        return mutate_bytes(rng, data)


def mutate_json(rng: Random, data: bytes) -> bytes:
    """Half of the time the bytes; else a value anywhere in the tree replaced or deleted."""
    if rng.random() < 0.5:
        return mutate_bytes(rng, data)
    document = json.loads(data)
    for _ in range(rng.randrange(1, 4)):
        _spoil_tree(rng, document)
    return json.dumps(document).encode()


def _spoil_tree(rng: Random, document: Any) -> None:
    places: list[tuple[Any, Any]] = []
    stack = [document]
    while stack:
        node = stack.pop()
        for key in node if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                stack.append(node[key])
    if places:
        node, key = rng.choice(places)
        if rng.random() < 0.2:
            del node[key]
        else:
            node[key] = json.loads(json.dumps(rng.choice(_VALUES)))


def mutate_glb(rng: Random, data: bytes) -> bytes:
    """Half of the time the bytes; else the JSON chunk's tree, with lengths that fit again."""
    if rng.random() < 0.5:
        return mutate_bytes(rng, data)
    length = int.from_bytes(data[12:16], "little")
    return glb(mutate_json(rng, data[20 : 20 + length]), data[20 + length + 8 :])


def mutate_png(rng: Random, data: bytes) -> bytes:
    """Bytes; half of the time with check sums made right again."""
    changed = mutate_bytes(rng, data)
    return checked_png(changed) if rng.random() < 0.5 else changed


def mutate_zip(rng: Random, data: bytes) -> bytes:
    """The archive's bytes; or those of its members, packed again."""
    if rng.random() < 0.5:
        return mutate_bytes(rng, data)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice(list(members))
    if rng.random() < 0.1:
        del members[name]
    else:
        members[name] = mutate_bytes(rng, members[name])
    return zipped(members)
