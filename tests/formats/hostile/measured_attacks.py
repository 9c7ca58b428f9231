"""Files made by hand to break a reader of measurements, or of a run's own state."""

from __future__ import annotations

import io
import pickle
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from measured_files import write_phoenix

from .attacks import attack
from .sound import FIFO, Bait, made, npy_header, pickled, sound, zipped


def _mat(content: dict[str, Any], **how: Any) -> Callable[[], bytes]:
    def write() -> bytes:
        from scipy.io import savemat

        buffer = io.BytesIO()
        savemat(buffer, content, **how)
        return buffer.getvalue()

    return write


_MAT_NUMBERS = {
    "freq": 9.5e9 + 5e6 * np.arange(4),
    "x": np.zeros(4),
    "y": np.zeros(4),
    "z": np.zeros(4),
    "r0": np.zeros(4),
}


def _mat_data(**changed: Any) -> Callable[[], bytes]:
    return _mat({"data": {"fp": np.ones((4, 4), complex), **_MAT_NUMBERS, **changed}})


def _mat_element(kind: int, size: int, body: bytes) -> bytes:
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + struct.pack("<II", kind, size) + body


def _mat_matrix(parts: list[tuple[int, bytes]], sizes: dict[int, int] | None = None, *, packed: bool = False) -> bytes:
    """One matrix of parts (type, body), the byte counts of some of them made up."""
    body = b""
    for index, (kind, part) in enumerate(parts):
        body += struct.pack("<II", kind, (sizes or {}).get(index, len(part))) + part + b"\0" * (-len(part) % 8)
    if packed:
        inner = zlib.compress(struct.pack("<II", 14, len(body)) + body, 9)
        return _mat_element(15, len(inner), inner)
    return _mat_element(14, len(body), body)


def _mat_nested(levels: int) -> bytes:
    """Cells of one cell each."""
    sizes = [40 + 48 * level + 8 for level in range(levels)]
    heads = (struct.pack("<II IIII IIii II", 14, size, 6, 8, 1, 0, 5, 8, 1, 1, 1, 0) for size in reversed(sizes))
    whole = b"".join(heads) + struct.pack("<II", 14, 0)
    return _mat_element(*struct.unpack_from("<II", whole), whole[8:])


def _mat_double(rows: int, cols: int, count: int, content: bytes = b"\0" * 8, kind: int = 6, **how: Any) -> bytes:
    flags, shape = struct.pack("<II", kind, 0), struct.pack("<ii", rows, cols)
    return _mat_matrix([(6, flags), (5, shape), (1, b"data"), (9, content)], {3: count}, **how)


MAT_ATTACKS = (
    attack("an object array", _mat({"data": np.array([[1, "a"], ["b", 2]], object)})),
    attack("20,000 cells in each other", lambda: _mat_nested(20000)),
    attack("2^31 x 2^31 cells", _mat_double(2**31 - 1, 2**31 - 1, 8, kind=1)),
    attack("2^15 x 2^15 structures", _mat_double(2**15, 2**15, 8, kind=2)),
    attack("2^15 x 2^15 letters of none", _mat_double(2**15, 2**15, 0, kind=4)),
    attack("cells in the fields", _mat_data(fp=np.array([[np.ones(3), "a"]], object))),
    attack("text in the fields", _mat_data(freq="nine")),
    attack("a structure in a field", _mat_data(x={"y": 1})),
    attack("frequencies of NaN", _mat_data(freq=np.full(4, np.nan))),
    attack("frequencies all alike", _mat_data(freq=np.full(4, 9.6e9))),
    attack("positions at infinity", _mat_data(x=np.full(4, np.inf))),
    attack("positions at 1e300", _mat_data(x=np.full(4, 1e300), y=np.full(4, 1e300), z=np.full(4, 1e300))),
    attack("autofocus without fields", _mat_data(af={"a": 1})),
    attack("autofocus of text", _mat_data(af="none")),
    attack("4 GiB in a file of bytes", _mat_double(2**14, 2**15, 2**32 - 8)),
    attack("2^31 x 2^31 numbers", _mat_double(2**31 - 1, 2**31 - 1, 2**31)),
    attack("-1 x -1 numbers", _mat_double(-1, -1, 8)),
    attack("256 MiB of zeros, packed", lambda: _mat_double(2**12, 2**13, 2**28, b"\0" * 2**28, packed=True)),
    attack("4 GiB claimed, packed", _mat_double(2**14, 2**15, 2**32 - 8, packed=True)),
    attack("an element of 4 GiB", _mat_element(14, 2**32 - 1, b"\0" * 64)),
    attack("a packed element of nothing", _mat_element(15, 8, b"\0" * 8)),
    attack("an unknown type", _mat_element(77, 8, b"\0" * 8)),
    attack("version 4", lambda: _mat({"data": np.ones((3, 3))}, format="4")()),
    attack("a header and no more", b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"),
    attack("another version", b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x09IM"),
    attack("a pickle in it", lambda: _mat_element(14, 8, b"\0" * 8) + pickled()),
)


def _xml(reader: str, old: bytes, new: bytes) -> Callable[[], bytes]:
    """Other bytes of the same length in a file whose header counts them."""

    def content() -> bytes:
        data = sound(reader)
        assert old in data, old
        return data.replace(old, new.ljust(len(old))[: len(old)], 1)

    return content


_ENTITIES = (
    b'<!DOCTYPE x [<!ENTITY a "'
    + b"A" * 40
    + b'">'
    + b"".join(b'<!ENTITY %c "%s">' % (98 + i, (b"&%c;" % (97 + i)) * 30) for i in range(8))
    + b"]>"
)


def _dtd(reader: str, dtd: bytes, use: bytes) -> Callable[[], bytes]:
    """A document type in place of as much of the XML as it needs, with `use` as the collector's name."""

    def content() -> bytes:
        data = sound(reader)
        start = data.index(b"<SICD") if b"<SICD" in data else data.index(b"<CPHD")
        end = data.rindex(b"</SICD>" if b"<SICD" in data else b"</CPHD>") + 7
        name = b"SICD" if b"<SICD" in data else b"CPHD"
        text = dtd + b"<%s><CollectionInfo><CollectorName>%s</CollectorName></CollectionInfo></%s>" % (name, use, name)
        return data[:start] + text.ljust(end - start) + data[end:]

    return content


_BANDS = 417 + 435  # where the image subheader, of no comments and of coordinates, has NBANDS
SICD_ATTACKS = (
    attack("entities that multiply", _dtd("sicd", _ENTITIES, b"&i;")),
    attack("an entity from a file", _dtd("sicd", b'<!DOCTYPE x [<!ENTITY a SYSTEM "file:///dev/zero">]>', b"&a;")),
    attack("an entity from a FIFO", _dtd("sicd", b'<!DOCTYPE x SYSTEM "fifo">', b"")),
    attack("rows of nothing", _xml("sicd", b"<NumRows>21</NumRows>", b"<NumRows>0</NumRows>")),
    attack("99 rows", _xml("sicd", b"<NumRows>21</NumRows>", b"<NumRows>99</NumRows>")),
    attack("rows in words", _xml("sicd", b"<NumRows>21</NumRows>", b"<NumRows>xx</NumRows>")),
    attack("9 x 10^7 rows", lambda: sound("sicd").replace(b"00000021", b"99999999", 1)),
    attack(
        "9 x 10^7 rows and columns",
        lambda: sound("sicd").replace(b"00000021", b"99999999").replace(b"00000031", b"99999999"),
    ),
    attack("999 images", lambda: sound("sicd")[:360] + b"999" + sound("sicd")[363:]),
    attack("a file length of 0", lambda: sound("sicd")[:342] + b"0" * 12 + sound("sicd")[354:], accepted=True),
    attack("99,999 bands", lambda: sound("sicd")[:_BANDS] + b"099999" + sound("sicd")[_BANDS + 1 :]),
    attack("no XML", lambda: sound("sicd").replace(b"<SICD", b"\0\0\0\0\0")),
)
CPHD_ATTACKS = (
    attack("entities that multiply", _dtd("cphd", _ENTITIES, b"&i;")),
    attack("an entity from a file", _dtd("cphd", b'<!DOCTYPE x [<!ENTITY a SYSTEM "file:///dev/zero">]>', b"&a;")),
    attack("99 vectors", _xml("cphd", b"<NumVectors>24</NumVectors>", b"<NumVectors>99</NumVectors>")),
    attack(
        "10^12 vectors",
        lambda: sound("cphd").replace(b"<NumVectors>24</NumVectors>", b"<NumVectors>999999999999</NumVectors>"),
    ),
    attack(
        "10^6 x 10^6 samples",
        lambda: sound("cphd").replace(b">24</NumVec", b">1000000</NumVec").replace(b">32</NumSam", b">1000000</NumSam"),
    ),
    attack(
        "an XML block of 10^15 bytes",
        lambda: re.sub(rb"XML_BLOCK_SIZE := \d+", b"XML_BLOCK_SIZE := 999999999999999", sound("cphd")),
    ),
    attack(
        "a signal block at 10^15",
        lambda: re.sub(
            rb"SIGNAL_BLOCK_BYTE_OFFSET := \d+", b"SIGNAL_BLOCK_BYTE_OFFSET := 999999999999999", sound("cphd")
        ),
    ),
    attack(
        "a signal block of -1", lambda: re.sub(rb"SIGNAL_BLOCK_SIZE := \d+", b"SIGNAL_BLOCK_SIZE := -1", sound("cphd"))
    ),
    attack("no header", b"CPHD/1.1.0\n"),
    attack("a header without an end", b"CPHD/1.1.0\n" + b"A := B\n" * 200_000),
    attack("one line", b"CPHD/" + b"1" * 2_000_000),
)


_SWATHS, _ORBIT = "science/LSAR/SLC/swaths", "science/LSAR/SLC/metadata/orbit"
_HH, _TIMES, _RANGES = f"{_SWATHS}/frequencyA/HH", f"{_SWATHS}/zeroDopplerTime", f"{_SWATHS}/frequencyA/slantRange"
_FREQUENCY = f"{_SWATHS}/frequencyA/processedCenterFrequency"


def _hdf5(new: dict[str, Any]) -> Callable[[], bytes]:
    """The sound HDF5 file with other things under some names: data sets (how to make them, a dict), links, arrays; or
    what a function makes of the file."""

    def make(path: Path) -> None:
        import h5py

        path.write_bytes(sound("nisar"))
        with h5py.File(path, "r+") as file:
            for name, what in new.items():
                del file[name]
                if isinstance(what, dict):
                    file.create_dataset(name, **what)
                elif callable(what):
                    what(file)
                else:
                    file[name] = what

    return made(make)


def _external(target: str) -> Callable[[Any], None]:
    """Another file's data for the image."""

    def change(file: Any) -> None:
        import h5py

        file[_HH] = h5py.ExternalLink(target, "x")

    return change


def _circle(file: Any) -> None:
    import h5py

    file[_HH] = h5py.SoftLink(f"/{_HH}")


def _references(file: Any) -> None:
    import h5py

    file.create_dataset(_TIMES, (201,), h5py.ref_dtype)[0] = file.ref


def _virtual(file: Any) -> None:
    import h5py

    layout = h5py.VirtualLayout((201, 161), np.complex64)
    layout[:] = h5py.VirtualSource(FIFO, "x", (201, 161))
    file.create_virtual_dataset(_HH, layout)


def _empty(shape: tuple[int, ...], kind: str, chunks: Any = True, **how: Any) -> dict[str, Any]:
    """A data set of any size in no bytes."""
    return {"shape": shape, "dtype": kind, "chunks": chunks, **how}


def _elsewhere(file: str) -> dict[str, Any]:
    return {"shape": (201, 161), "dtype": "c8", "external": [(file, 0, 201 * 161 * 8)]}


HDF5_ATTACKS = (
    attack("10^9 x 10^9 pixels", _hdf5({_HH: _empty((10**9, 10**9), "c8", (1000, 1000))})),
    attack("10^11 times", _hdf5({_TIMES: _empty((10**11,), "f8", (10**6,))})),
    attack("10^9 state vectors", _hdf5({f"{_ORBIT}/position": _empty((10**9, 3), "f8", (10**5, 3))})),
    attack(
        "10^8 x 10^8 pixels, times and ranges",
        _hdf5({_HH: _empty((10**8, 10**8), "c8"), _TIMES: _empty((10**8,), "f8"), _RANGES: _empty((10**8,), "f8")}),
    ),
    attack(
        "a chunk of 800 MB",
        _hdf5(
            {
                _HH: {"data": np.zeros((1, 1), "c8"), "maxshape": (10**4, 10**4), "chunks": (10**4, 10**4)}
                | {"compression": "gzip"}
            }
        ),
    ),
    attack("an image in another file", _hdf5({_HH: _external("other.h5")})),
    attack("an image in a FIFO", _hdf5({_HH: _external(FIFO)})),
    attack("an image that is a link to itself", _hdf5({_HH: _circle})),
    attack("pixels of /dev/zero", _hdf5({_HH: _elsewhere("/dev/zero")})),
    attack("pixels of a FIFO", _hdf5({_HH: _elsewhere(FIFO)})),
    attack("a virtual image", _hdf5({_HH: _virtual})),
    attack("references for times", _hdf5({_TIMES: _references})),
    attack("strings for times", _hdf5({_TIMES: ["x"] * 201})),
    attack("a group for times", _hdf5({_TIMES: lambda file: file.create_group(_TIMES)})),
    attack("one time for all", _hdf5({_TIMES: np.full(201, 110.0)})),
    attack("a number for times", _hdf5({_TIMES: 1.0})),
    attack("a table for times", _hdf5({_TIMES: np.zeros((201, 2))})),
    attack("times that do not rise", _hdf5({f"{_ORBIT}/time": np.array([5.0, 4.0, 3.0, 2.0, 1.0])})),
    attack(
        "one state vector",
        _hdf5({f"{_ORBIT}/time": [1.0], f"{_ORBIT}/position": [[1.0, 2, 3]], f"{_ORBIT}/velocity": [[1.0, 2, 3]]}),
    ),
    attack("no speed", _hdf5({f"{_ORBIT}/velocity": np.zeros((5, 3))})),
    attack("frequency NaN", _hdf5({_FREQUENCY: np.nan})),
    attack("frequency 0", _hdf5({_FREQUENCY: 0.0})),
    attack("frequencies", _hdf5({_FREQUENCY: np.ones(3)})),
    attack("an image of strings", _hdf5({_HH: np.full((201, 161), b"x")})),
    attack("an image of records", _hdf5({_HH: np.zeros((201, 161), [("a", "f4"), ("b", "f4"), ("c", "f4")])})),
    attack("an image of three axes", _hdf5({_HH: np.zeros((201, 161, 2))})),
)


def _phoenix(**changed: str) -> Callable[[], bytes]:
    ones = np.ones((4, 4))
    return made(lambda path: write_phoenix(path, ones, ones, **changed))


MSTAR_ATTACKS = (
    *(
        attack(f"{key} = {value}", _phoenix(**{key: value}))
        for key, values in {
            "NumberOfRows": ("nan", "inf", "-4", "1e300", "0", "4.5", "99999999999999999999"),
            "PhoenixHeaderLength": ("-1", "inf"),
            "native_header_length": ("-100000", "nan", "1e18"),
            "TargetAz": ("nan", "inf"),
            "MeasuredDepression": ("nan", "0", "90", "-inf"),
            "CenterFrequency": ("0 GHz", "nan GHz", "inf GHz", "-9.6 GHz"),
            "RangePixelSpacing": ("0", "nan", "-1", "1e-300", "1e300"),
            "CrossRangePixelSpacing": ("0", "inf"),
            "Polarization": ("\x1b[2J",),
        }.items()
        for value in values
    ),
    attack("-4 x -4 pixels", _phoenix(NumberOfRows="-4", NumberOfColumns="-4")),
    attack("10^9 x 10^9 pixels", _phoenix(NumberOfRows="1000000000", NumberOfColumns="1000000000")),
)
CHECKPOINT_ATTACKS = (
    attack("a pickle in it", lambda: zipped({"x.npy": pickled(), "digest.npy": pickled(), "tag.npy": pickled()})),
    attack("a bare pickle", lambda: pickle.dumps(Bait())),
    attack("an array of pickles", pickled),
    attack("10^9 x 10^9 numbers", lambda: zipped({"x.npy": npy_header((10**9, 10**9), "<f8") + b"\0" * 64})),
    attack("8 GiB claimed", lambda: zipped({"x.npy": npy_header((2**30,), "<f8") + b"\0" * 64})),
    attack(
        "256 MiB of zeros, packed",
        lambda: zipped({"x.npy": npy_header((2**25,), "<f8") + b"\0" * 2**28}, zipfile.ZIP_DEFLATED),
    ),
    attack("members above the folder", lambda: zipped({"../../x.npy": npy_header((1,)) + b"\0" * 4})),
    attack("no members", lambda: zipped({})),
)
