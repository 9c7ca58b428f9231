"""The first line of a text mesh that is broken: read line by line, once a file is known to be no good."""

from __future__ import annotations

import re
from collections.abc import Iterator

from warpsar.errors import shown

_NUMBERS = {"v": (3, "x, y and z"), "vt": (2, "u and v"), "vn": (3, "x, y and z")}
"""How many numbers a line of an OBJ must hold at least, and which."""


def of_obj(data: bytes) -> str | None:
    """What is wrong with the first broken line of an OBJ, which it names; None where no line is."""
    lines = list(_obj_lines(data))
    counts = {name: sum(words[0] == name for _, words in lines) for name in _NUMBERS}
    so_far = dict.fromkeys(_NUMBERS, 0)
    for number, (keyword, *words) in lines:
        wrong = None
        if keyword in _NUMBERS:
            so_far[keyword] += 1
            least, which = _NUMBERS[keyword]
            wrong = _not_numbers(words, least, which)
        elif keyword == "f":
            wrong = _no_face(words, counts, so_far)
        if wrong:
            return f"line {number}{', the last' if number == lines[-1][0] else ''}: {wrong}"
    return None


def _obj_lines(data: bytes) -> Iterator[tuple[int, list[str]]]:
    """Number and words of each line that has any; a line that ends in a backslash goes on in the next."""
    text = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").decode("utf-8", "replace")
    pieces: list[str] = []
    for number, line in enumerate(text.split("\n"), 1):
        pieces.append(line.removesuffix("\\"))
        if line.endswith("\\"):
            continue
        words = " ".join(pieces).partition("#")[0].split()
        pieces.clear()
        if words:
            yield number, words


def _not_numbers(words: list[str], least: int, which: str) -> str | None:
    if len(words) < least:
        return f"found {len(words)} numbers; must be {least} or more ({which})"
    return next((f"found {shown(word)}; must be a number" for word in words[:least] if not _is(float, word)), None)


def _no_face(corners: list[str], counts: dict[str, int], so_far: dict[str, int]) -> str | None:
    if len(corners) < 3:
        return f"found a face of {len(corners)} corners; must be 3 or more"
    for corner in corners:
        for index, name in zip(corner.split("/"), _NUMBERS, strict=False):
            if not index:
                continue
            if not _is(int, index):
                return f"a face has the index {shown(index)}; must be a whole number"
            value = int(index)
            if value == 0 or value < -so_far[name]:
                allowed = f"1 or more, or -1 to {-so_far[name]}"
                return f"a face has the index {value} after {so_far[name]} entries {name}; must be {allowed}"
            if value > counts[name]:
                return f"a face refers to entry {value} of {name}, which is not there; the file has {counts[name]}"
    return None


def of_ply(data: bytes) -> str | None:
    """What is wrong with the first broken line of a PLY, which it names; None where no line is, or it is binary."""
    lines = data.decode("latin-1").split("\n")
    header = next((k for k, line in enumerate(lines) if line.split() == ["end_header"]), None)
    if lines[0].split()[:1] != ["ply"]:
        return "line 1: found no 'ply'"
    if header is None:
        return f"no line 'end_header' among its {len(lines)} lines: truncated"
    if len(lines) < 2 or "ascii" not in lines[1]:
        return None
    number = header + 1
    for name, length, lists in _ply_elements(lines[:header]):
        for row in range(length):
            while number < len(lines) and not lines[number].split():
                number += 1
            if number >= len(lines):
                return f"found {row} of {length} {name} entries: truncated"
            words = lines[number].split()
            number += 1
            bad = next((word for word in words if not _is(float, word)), None)
            if bad is not None:
                return f"line {number}: found {shown(bad)}; must be a number"
            needed = _ply_numbers(words, lists)
            if len(words) < needed:
                return f"line {number}: found {len(words)} numbers; must be {needed} ({name} {row} of {length})"
    return None


def _ply_elements(header: list[str]) -> Iterator[tuple[str, int, list[bool]]]:
    """Name and length of each element, and of each of its properties whether it is a list."""
    found: list[tuple[str, int, list[bool]]] = []
    for words in map(str.split, header):
        if words[:1] == ["element"] and len(words) == 3 and _is(int, words[2]):
            found.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"] and found:
            found[-1][2].append(words[1:2] == ["list"])
    yield from found


def _ply_numbers(words: list[str], lists: list[bool]) -> int:
    """How many numbers an entry needs: a list says first how many follow."""
    needed = 0
    for is_list in lists:
        if is_list and needed < len(words) and _is(int, words[needed]):
            needed += max(int(words[needed]), 0)
        needed += 1
    return needed


def _is(kind: type[float] | type[int], word: str) -> bool:
    """Whether a word is such a number, and no longer than a number is."""
    if len(word) > 400 or (kind is int and not re.fullmatch(r"[-+]?\d+", word)):
        return False
    try:
        kind(word)
    except ValueError:
        return False
    return True
