"""Check that TIFF directories fit into their file: libtiff makes room for what they claim before it reads them."""

from __future__ import annotations

import struct
from pathlib import Path

from warpsar.errors import InputError

MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
MOST_DIRECTORIES = 1000
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4, 16: 8, 17: 8, 18: 8}
_DIRECTORIES = (330, 34665, 34853, 40965)  # tags that point to others: SubIFDs, EXIF, GPS, interoperability


def check(path: Path) -> None:
    """Raise InputError where a directory (TIFF 6.0, section 2; BigTIFF) claims more bytes than the file has."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(16)
        if head[:4] not in MAGIC or len(head) < 16:
            raise InputError(f"{path}: cannot be read as TIFF (its first bytes are of none)")
        order, big = "<" if head[:2] == b"II" else ">", 43 in head[2:4]
        number = f"{order}Q" if big else f"{order}I"
        count_format, entry = (f"{order}Q", f"{order}HHQ8s") if big else (f"{order}H", f"{order}HHI4s")
        waiting, seen = [struct.unpack_from(number, head, 8 if big else 4)[0]], set[int]()
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
