"""Check a TIFF file before OpenImageIO reads it.

libtiff makes room for what directories claim before it reads them. And of some files OpenImageIO returns what happened
to stand in memory, without a word: of a deflated strip that is broken, and of tiles of 64-bit numbers.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import BinaryIO

from warpsar.errors import InputError

MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
MOST_DIRECTORIES = 1000
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
_INTEGERS = {1: "B", 3: "H", 4: "I", 16: "Q"}
_DEFLATE = (8, 32946)  # values of the tag Compression
_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _SAMPLES, _ROWS, _PLANES = 256, 257, 258, 259, 277, 278, 284
_STRIPS, _TILES, _TILE_SHAPE = (273, 279), (324, 325), (322, 323)
_DIRECTORIES = (330, 34665, 34853, 40965)  # tags that point to others: SubIFDs, EXIF, GPS, interoperability


def check(path: Path) -> None:
    """Raise InputError where a directory (TIFF 6.0, section 2; BigTIFF) claims more bytes than the file has."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(16)
        if head[:4] not in MAGIC or len(head) < 16:
            raise InputError(f"{path}: cannot be read as TIFF (its first bytes are of none)")
        first, number, count_format, entry = _formats(head)
        waiting, seen = [first], set[int]()
        while waiting:
            place = waiting.pop()
            if place == 0 or place in seen:  # no more, or a circle: libtiff finds those itself
                continue
            if place + struct.calcsize(count_format) > size:
                raise InputError(f"{path}: a TIFF directory at byte {place} of {size}: broken or truncated")
            seen.add(place)
            if len(seen) > MOST_DIRECTORIES:
                raise InputError(f"{path}: found more than {MOST_DIRECTORIES} TIFF directories; must be fewer")
            file.seek(place)
            (entries,) = struct.unpack(count_format, file.read(struct.calcsize(count_format)))
            step = struct.calcsize(entry)
            if entries * step > size:
                raise InputError(f"{path}: a TIFF directory claims {entries} entries in {size} bytes: broken")
            table = file.read(entries * step)
            for at in range(0, len(table) - step + 1, step):
                tag, kind, count, value = struct.unpack_from(entry, table, at)
                room = count * _SIZES.get(kind, 1)
                start = struct.unpack_from(number, value)[0] if room > len(value) else 0
                if start + room > size:
                    raise InputError(
                        f"{path}: TIFF tag {tag} claims {count} values at byte {start} of {size}: broken or truncated"
                    )
                if tag in _DIRECTORIES and count == 1:
                    waiting.append(struct.unpack_from(number, value)[0])
            following = file.read(struct.calcsize(number))
            if len(following) == struct.calcsize(number):
                waiting.append(struct.unpack(number, following)[0])


def _formats(head: bytes) -> tuple[int, str, str, str]:
    """By a file's first 16 bytes: where its first directory begins, and the formats of struct for an offset, for a
    directory's count and for an entry of it. The first letter of each is the order of bytes."""
    order, big = "<" if head[:2] == b"II" else ">", 43 in head[2:4]
    number = f"{order}Q" if big else f"{order}I"
    (first,) = struct.unpack_from(number, head, 8 if big else 4)
    return (first, number, f"{order}Q", f"{order}HHQ8s") if big else (first, number, f"{order}H", f"{order}HHI4s")


def check_pixels(path: Path) -> None:
    """Raise InputError where the pixels of the first image would be read wrongly.

    That is: a strip or tile that was never written (byte 0, where libtiff finds the file's head), tiles of 64-bit
    numbers of all channels together, and a deflated strip or tile that does not hold all its pixels. The file has
    passed `check`.
    """
    with path.open("rb") as file:
        try:
            tags = _first_directory(file)
            offsets = tags.get(_TILES[0], tags.get(_STRIPS[0], []))
            if 0 in offsets:
                raise InputError(f"{path}: strip or tile {offsets.index(0)} was never written; must hold pixels")
            if _TILES[0] in tags and tags.get(_BITS, [1])[0] == 64 and tags.get(_PLANES, [1])[0] == 1:
                raise InputError(f"{path}: found tiles of 64-bit numbers; allowed are strips, or 32 bits")
            if tags.get(_COMPRESSION, [1])[0] not in _DEFLATE:
                return
            offsets, counts, sizes = _chunks(tags)
        except (ArithmeticError, LookupError, ValueError, struct.error) as error:
            raise InputError(f"{path}: its TIFF directory is broken ({type(error).__name__}: {error})") from error
        if not len(offsets) == len(counts) == len(sizes):
            raise InputError(f"{path}: found {len(offsets)} strips or tiles; must be {len(sizes)}, by its size: broken")
        whole = max(sizes, default=0)
        for number, (offset, count, size) in enumerate(zip(offsets, counts, sizes, strict=True)):
            if offset + count > path.stat().st_size:
                raise InputError(f"{path}: strip or tile {number} claims {count} bytes at byte {offset}: truncated")
            file.seek(offset)
            try:
                # a last strip may be as long as the others; one byte more is too many
                found = len(zlib.decompressobj().decompress(file.read(count), whole + 1))
            except zlib.error as error:
                raise InputError(f"{path}: strip or tile {number} is broken ({error})") from error
            if not size <= found <= whole:
                raise InputError(f"{path}: strip or tile {number} holds {found} bytes; must be {size}: broken")


def _first_directory(file: BinaryIO) -> dict[int, list[int]]:
    """The whole numbers of each tag of the first image."""
    first, number, count_format, entry = _formats(file.read(16))
    file.seek(first)
    (entries,) = struct.unpack(count_format, file.read(struct.calcsize(count_format)))
    table = file.read(entries * struct.calcsize(entry))
    tags = {}
    for tag, kind, count, value in struct.iter_unpack(entry, table):
        if kind not in _INTEGERS:
            continue
        room = count * _SIZES[kind]
        if room > len(value):
            file.seek(struct.unpack_from(number, value)[0])
            value = file.read(room)
        tags[tag] = list(struct.unpack(f"{number[0]}{count}{_INTEGERS[kind]}", value[:room]))
    return tags


def _chunks(tags: dict[int, list[int]]) -> tuple[list[int], list[int], list[int]]:
    """Of every strip or tile: where it begins, its bytes in the file, and the bytes of its pixels."""
    width, height, samples = (tags.get(tag, [1])[0] for tag in (_WIDTH, _HEIGHT, _SAMPLES))
    apart = tags.get(_PLANES, [1])[0] == 2
    bits = tags.get(_BITS, [1])[0] * (1 if apart else samples)
    planes = samples if apart else 1
    if _TILES[0] in tags:
        across, down = (tags[tag][0] for tag in _TILE_SHAPE)
        sizes = [-(-across * bits // 8) * down] * (-(-width // across) * -(-height // down))
        places = _TILES
    else:
        rows = min(tags.get(_ROWS, [height])[0], height)
        line = -(-width * bits // 8)
        sizes = [line * min(rows, height - first) for first in range(0, height, rows)]
        places = _STRIPS
    return tags.get(places[0], []), tags.get(places[1], []), sizes * planes
