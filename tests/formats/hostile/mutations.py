"""Strategies of spoiled files: of bytes, of numbers in text, and of the trees of TOML, JSON and archives."""

from __future__ import annotations

import copy
import io
import json
import math
import re
import struct
import tomllib
import zipfile
from collections.abc import Iterator
from typing import Any

from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy

from .sound import FIFO, LOOP, checked_png, files, glb, zipped

EXTREMES = (0, -1, 1, 127, 255, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1, -(2**31), -(2**63))
ODD = (
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
)
WORDS = (*(b"%d" % value for value in EXTREMES), *ODD)
NUMBER = re.compile(rb"-?\d+(\.\d*)?([eE][-+]?\d+)?")
NAMES = ("/dev/zero", "/dev/stdin", ".", "..", FIFO, LOOP, "missing.exr", "/etc/passwd", "x" * 5000, "a/b/c", "~", "",
         "scene.toml", "scene.obj", "vv.tif", "hh.exr", "mask.png", "eps.exr", "//", "\x00", "\x1b[2J",
         "file:///etc/passwd")  # fmt: skip
TREES = (True, [], {}, [1], [1, 2], [1.0, -1.0], [[[]]], {"a": {"b": 1}}, "HH", "texture", "vertex", "eps", "train")
KEYS = ("unknown", "", "a.b", "ü", "x" * 3000, "name", "images", "\x1b")
VALUES = st.sampled_from((*NAMES, *EXTREMES, 10**30, *TREES)) | st.floats()


def _places(size: int) -> SearchStrategy[int]:
    """Offsets, half of them near the start, where headers are."""
    return st.integers(0, min(size, 1024)) | st.integers(0, size)


@st.composite
def _elsewhere(draw: DrawFn) -> bytes:
    """A piece of a sound file."""
    data = draw(st.sampled_from(list(files().values())))
    start = draw(_places(len(data)))
    return data[start : start + draw(st.integers(1, 1024))]


PIECES = st.one_of(
    st.binary(max_size=16),
    st.builds(
        lambda value, width, order: (value % 2 ** (8 * width)).to_bytes(width, order),
        st.sampled_from(EXTREMES),
        st.sampled_from((1, 2, 4, 8)),
        st.sampled_from(("little", "big")),
    ),
    st.builds(
        struct.pack,
        st.sampled_from(("<f", ">f", "<d", ">d")),
        st.sampled_from((math.nan, math.inf, -math.inf, 3e38, 1e-40, -0.0)),
    ),
    st.builds(lambda byte, size: bytes([byte]) * size, st.sampled_from((0, 32, 65, 255)), st.integers(1, 512)),
    _elsewhere(),
)


@st.composite
def spoiled(draw: DrawFn, data: bytes) -> bytes:
    """One to three pieces put over, between or in place of what is there, or another number where one is written."""
    for _ in range(draw(st.integers(1, 3))):
        at = draw(_places(len(data)))
        number = NUMBER.search(data, at)
        if number is not None and draw(st.booleans()):
            at, end = number.span()
            piece = draw(st.sampled_from(WORDS))
            if draw(st.booleans()):  # headers count letters
                piece = piece[: end - at].rjust(end - at, b"0")
        else:
            piece = draw(PIECES)
            end = at + draw(st.just(len(piece)) | st.integers(0, 256) | st.just(len(data)))
        data = data[:at] + piece + data[end:]
    return data


def _nodes(document: Any) -> Iterator[tuple[Any, Any]]:
    """Every container with every key in it."""
    for key in list(document) if isinstance(document, dict) else range(len(document)):
        yield document, key
        if isinstance(document[key], dict | list):
            yield from _nodes(document[key])


@st.composite
def _spoiled_tree(draw: DrawFn, document: Any) -> Any:
    """Once to three times a value deleted, replaced or added under an odd key: an odd one, or what stands elsewhere."""
    document = copy.deepcopy(document)
    for _ in range(draw(st.integers(1, 3))):
        places = list(_nodes(document))
        if not places:
            break
        (node, key), (other, at) = draw(st.sampled_from(places)), draw(st.sampled_from(places))
        value = copy.deepcopy(draw(VALUES | st.just(other[at])))
        what = draw(st.sampled_from(("replace", "add", "delete")))
        if what == "delete":
            del node[key]
        else:
            node[draw(st.sampled_from(KEYS)) if what == "add" and isinstance(node, dict) else key] = value
    return document


def _toml(document: Any) -> bytes | None:
    """None for a number that TOML cannot hold, and for a mixture that tomlkit does not write."""
    import tomlkit

    try:
        return tomlkit.dumps(document).encode()
    except (ValueError, TypeError):
        return None


def spoiled_toml(data: bytes) -> SearchStrategy[bytes]:
    return spoiled(data) | _spoiled_tree(tomllib.loads(data.decode())).map(_toml).filter(lambda made: made is not None)


def spoiled_json(data: bytes) -> SearchStrategy[bytes]:
    return spoiled(data) | _spoiled_tree(json.loads(data)).map(lambda document: json.dumps(document).encode())


def spoiled_glb(data: bytes) -> SearchStrategy[bytes]:
    """The bytes; or the JSON chunk's tree, with lengths that fit again."""
    end = 20 + int.from_bytes(data[12:16], "little")
    return spoiled(data) | spoiled_json(data[20:end]).map(lambda document: glb(document, data[end + 8 :]))


def spoiled_png(data: bytes) -> SearchStrategy[bytes]:
    """The bytes, or those with check sums made right again."""
    return spoiled(data) | spoiled(data).map(checked_png)


def spoiled_zip(data: bytes) -> SearchStrategy[bytes]:
    """The archive's bytes, or those of a member, packed again."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}

    def with_one(name: str) -> SearchStrategy[bytes]:
        return spoiled(members[name]).map(lambda content: zipped({**members, name: content}))

    return spoiled(data) | st.sampled_from(sorted(members)).flatmap(with_one)
