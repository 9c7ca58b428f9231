"""Files that users name are read whole, and what is none, or too large, is refused in one line."""

import os
from pathlib import Path

import pytest

from warpsar.errors import InputError
from warpsar.io import input_file

pytestmark = pytest.mark.unit


def test_a_file_may_be_as_large_as_its_kind(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(b"12345")
    assert input_file.read_bytes(path, "a table", 5) == b"12345"
    with pytest.raises(InputError, match=r"a\.csv: found more than 4 bytes; a table has at most 4$"):
        input_file.read_bytes(path, "a table", 4)


def test_a_mark_of_byte_order_is_no_text_and_line_ends_stay(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes("\ufeffgrün\r\n".encode())
    assert input_file.read_text(path, "a table", 100) == "grün\r\n"
    path.write_bytes(b"gr\xfcn")
    with pytest.raises(InputError, match=r"a\.csv: not UTF-8 text \(byte 2 is 0xfc\); must be a table"):
        input_file.read_text(path, "a table", 100)


@pytest.mark.parametrize("kind", ["missing", "folder", "pipe", "device", "long", "null"])
def test_what_is_no_plain_file_is_refused(kind: str, tmp_path: Path) -> None:
    """At once: a pipe that nobody writes to would be waited for, and /dev/zero never ends."""
    path = {"device": Path("/dev/zero"), "long": tmp_path / ("a" * 300), "null": tmp_path / "\0"}.get(
        kind, tmp_path / kind
    )
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    with pytest.raises(InputError, match="cannot be read as a table") as refused:
        input_file.read_bytes(path, "a table", 100)
    assert "\n" not in str(refused.value)
