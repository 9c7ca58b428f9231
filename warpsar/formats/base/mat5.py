"""Check that a MATLAB 5 file is sound: SciPy believes every count in it, and crashes on deep nesting."""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path

from warpsar.errors import InputError
from warpsar.formats.base.data import reading

DEEPEST = 16
"""Levels of cells and structures inside each other."""
LARGEST_RATIO = 100
"""Bytes of an unpacked element to those of its file: deflate packs measured numbers 2 or 3 to 1, zeros 1000 to 1."""
_HEADER = 128
_MATRIX, _PACKED = 14, 15
_CELL, _STRUCT, _OBJECT, _SPARSE, _OPAQUE = 1, 2, 3, 5, 17


def check(path: Path) -> None:
    """Raise InputError for a file that is not sound (MAT-File Format, R2024b, chapter 1).

    An element may not end after the one that holds it, an array may not have more values than bytes, and levels are
    bounded.
    """
    with reading(path, "MATLAB file"):
        content = path.read_bytes()
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None:
        raise InputError(f"{path}: found byte order {content[126:128]!r} in the MATLAB header; must be 'IM' or 'MI'")
    budget = LARGEST_RATIO * len(content)
    at = _HEADER
    while at + 8 <= len(content):
        kind, size = struct.unpack_from(f"{order}II", content, at)
        body = content[at + 8 : at + 8 + size]
        if len(body) < size:
            raise InputError(f"{path}: an element of {size} bytes at {at}, but the file has {len(content)}: truncated")
        if kind == _PACKED:
            body = _unpacked(path, body, budget)
            budget -= len(body)
            _check_elements(path, body, order)
        elif kind == _MATRIX:
            _check_matrices(path, body, order)
        at += 8 + size


def _unpacked(path: Path, body: bytes, budget: int) -> bytes:
    """A packed element's content, of at most `budget` bytes."""
    try:
        unpacked = zlib.decompressobj().decompress(body, budget + 1)
    except zlib.error as error:
        raise InputError(f"{path}: not a readable MATLAB file ({error})") from error
    if len(unpacked) > budget:
        raise InputError(f"{path}: unpacks to more than {LARGEST_RATIO} times its size; must be less")
    return unpacked


def _check_elements(path: Path, content: bytes, order: str) -> None:
    """Check the one matrix in a packed element."""
    if len(content) < 8:
        raise InputError(f"{path}: a packed element of {len(content)} bytes; must hold a matrix")
    kind, size = struct.unpack_from(f"{order}II", content)
    if kind != _MATRIX or size > len(content) - 8:
        raise InputError(f"{path}: a packed element of type {kind} and {size} bytes in {len(content)}: broken")
    _check_matrices(path, content[8 : 8 + size], order)


def _check_matrices(path: Path, content: bytes, order: str) -> None:
    """Check a matrix by its body, and all matrices in it."""
    waiting = [(0, len(content), 1)]
    while waiting:
        start, end, depth = waiting.pop()
        if depth > DEEPEST:
            raise InputError(f"{path}: cells and structures nested deeper than {DEEPEST} levels; must be less")
        elements = _elements(path, content, start, end, order)
        _check_count(path, content, elements, end - start, order)
        waiting += [(at, at + size, depth + 1) for kind, at, size in elements if kind == _MATRIX]


def _elements(path: Path, content: bytes, start: int, end: int, order: str) -> list[tuple[int, int, int]]:
    """Type, place and size of the elements between two places, each of which must end before `end`."""
    found = []
    at = start
    while at + 8 <= end:
        kind, size = struct.unpack_from(f"{order}II", content, at)
        if kind >> 16:  # a small element: its size in the upper half, its data in place of the size
            found.append((kind & 0xFFFF, at + 4, kind >> 16))
            if kind >> 16 > 4:
                raise InputError(f"{path}: a small element of {kind >> 16} bytes; must be up to 4")
            at += 8
            continue
        if at + 8 + size > end:
            raise InputError(f"{path}: an element of {size} bytes where {end - at - 8} are left: broken or truncated")
        found.append((kind, at + 8, size))
        at += 8 + -(-size // 8) * 8
    return found


def _check_count(path: Path, content: bytes, elements: list[tuple[int, int, int]], room: int, order: str) -> None:
    """Check an array's shape: a value takes a byte at least, and a cell its tag of 8 bytes."""
    if not elements:  # an empty matrix
        return
    _, at, size = elements[0]
    kind = struct.unpack_from(f"{order}I", content, at)[0] & 0xFF if size >= 4 else 0
    if kind in (_SPARSE, _OPAQUE) or len(elements) < 2:
        return
    _, at, size = elements[1]
    shape = struct.unpack_from(f"{order}{size // 4}i", content, at)
    if min(shape, default=0) < 0 or math.prod(shape) > room // (8 if kind in (_CELL, _STRUCT, _OBJECT) else 1):
        raise InputError(f"{path}: an array of shape {shape} in {room} bytes: broken")
