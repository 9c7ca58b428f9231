"""Files that a user names and that are read whole: scenes, tables, metadata. Each kind has a largest size."""

from __future__ import annotations

from pathlib import Path

from warpsar.errors import InputError


def read_bytes(path: Path, what: str, most: int) -> bytes:
    """All of a file, which is `what` ("a scene file") and has `most` bytes at the most.

    Raises InputError for one that is larger, that cannot be read, or that is no plain file: a pipe waits for ever, and
    a device never ends.
    """
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: cannot be read as {what} (a directory, pipe or device)")
        with path.open("rb") as stream:
            data = stream.read(most + 1)
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read as {what} ({reason})") from error
    if len(data) > most:
        raise InputError(f"{path}: found more than {most} bytes; {what} has at most {most}")
    return data


def read_text(path: Path, what: str, most: int) -> str:
    """As `read_bytes`, of a text in UTF-8, with or without a byte order mark; line ends stay as they are."""
    data = read_bytes(path, what, most)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        byte = f"byte {error.start} is 0x{data[error.start]:02x}"
        raise InputError(f"{path}: not UTF-8 text ({byte}); must be {what}") from error
