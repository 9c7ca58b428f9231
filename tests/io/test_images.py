"""Images survive the way out and in; broken ones are refused; quick looks say what their greys mean."""

import struct
import zlib
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest

from warpsar.errors import InputError
from warpsar.io.images import read_channel, read_image, read_mask, replacing, write_exr, write_tiff

pytestmark = pytest.mark.unit


@pytest.fixture
def power() -> np.ndarray:
    return np.random.default_rng(1).exponential(0.1, (7, 5)).astype(np.float32)


def test_exr_channels_by_name(tmp_path: Path, power: np.ndarray) -> None:
    # VV before HH: files hold them sorted, so that taking them by position would swap them.
    write_exr(tmp_path / "a.exr", {"VV": power * 2, "HH": power})
    np.testing.assert_array_equal(read_channel(tmp_path / "a.exr", "HH"), power)
    np.testing.assert_array_equal(read_channel(tmp_path / "a.exr", "VV"), power * 2)
    assert read_image(tmp_path / "a.exr").shape == (7, 5, 2)
    with pytest.raises(InputError, match=r"HH, VV.*one named HV"):
        read_channel(tmp_path / "a.exr", "HV")


def test_tiff_and_npy(tmp_path: Path, power: np.ndarray) -> None:
    write_tiff(tmp_path / "a.tif", power)
    np.save(tmp_path / "a.npy", power.astype(np.float64))
    np.testing.assert_array_equal(read_channel(tmp_path / "a.tif", "HH"), power)
    np.testing.assert_array_equal(read_channel(tmp_path / "a.npy"), power)
    assert read_image(tmp_path / "a.npy").shape == (7, 5, 1)


def test_not_finite_values_survive(tmp_path: Path, power: np.ndarray) -> None:
    power[0, 0], power[1, 1] = np.nan, np.inf
    write_tiff(tmp_path / "a.tif", power)
    np.testing.assert_array_equal(read_channel(tmp_path / "a.tif"), power)


def _png(path: Path, pixels: np.ndarray) -> Path:
    assert oiio.ImageBuf(pixels).write(str(path), oiio.UINT8)
    return path


def test_whole_numbers_are_no_image_but_a_mask(tmp_path: Path) -> None:
    pixels = np.zeros((3, 4, 1), np.uint8)
    pixels[1, 2] = 1
    path = _png(tmp_path / "a.png", pixels)
    with pytest.raises(InputError, match="floating point"):
        read_image(path)
    np.testing.assert_array_equal(np.argwhere(read_mask(path)), [[1, 2]])


def test_an_opaque_mask_does_not_use_every_pixel(tmp_path: Path) -> None:
    pixels = np.zeros((3, 4, 4), np.uint8)
    pixels[..., 3] = 255
    pixels[1, 2, 0] = 255
    np.testing.assert_array_equal(np.argwhere(read_mask(_png(tmp_path / "a.png", pixels))), [[1, 2]])


def test_a_float_mask_leaves_nan_out(tmp_path: Path) -> None:
    write_tiff(tmp_path / "a.tif", np.array([[np.nan, 0.0, 0.5]]))
    assert read_mask(tmp_path / "a.tif").tolist() == [[False, False, True]]


@pytest.mark.parametrize("suffix", ["tif", "exr", "npy", "png"])
@pytest.mark.parametrize("kept", [0.0, 0.02, 0.5, 0.95])
def test_truncated_files_are_refused(tmp_path: Path, suffix: str, kept: float) -> None:
    whole = tmp_path / f"a.{suffix}"
    noise = np.random.default_rng(2).random((64, 48)).astype(np.float32)
    if suffix == "npy":
        np.save(whole, noise)
    elif suffix == "png":
        _png(whole, (noise[..., None] * 255).astype(np.uint8))
    else:
        write_tiff(whole, noise) if suffix == "tif" else write_exr(whole, {"HH": noise})
    data = whole.read_bytes()
    whole.write_bytes(data[: int(len(data) * kept)])
    with pytest.raises(InputError) as error:
        read_mask(whole) if suffix == "png" else read_image(whole)
    assert str(whole) in str(error.value)


def test_tiles_of_64_bit_numbers_are_refused(tmp_path: Path) -> None:
    """OpenImageIO reads them wrongly where all channels of a pixel lie together; strips, and channels apart, well."""
    pixels = np.random.default_rng(3).exponential(0.1, (37, 41, 2))
    for tile, planes, read in ((0, "contig", True), (16, "separate", True), (16, "contig", False)):
        spec = oiio.ImageSpec(41, 37, 2, oiio.DOUBLE)
        spec.attribute("planarconfig", planes)
        spec.tile_width = spec.tile_height = tile
        target = oiio.ImageOutput.create(str(tmp_path / "a.tif"))
        assert target.open(str(tmp_path / "a.tif"), spec)
        assert target.write_image(pixels)
        assert target.close()
        if read:
            np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), pixels.astype(np.float32))
        else:
            with pytest.raises(InputError, match="found tiles of 64-bit numbers; allowed are strips, or 32 bits"):
                read_image(tmp_path / "a.tif")


@pytest.mark.parametrize("compression", [1, 8])
def test_a_strip_that_was_never_written_is_refused(tmp_path: Path, compression: int) -> None:
    """Its place is byte 0 in a sparse GeoTIFF, where libtiff finds the head of the file."""
    strips = [np.full((4, 16), value, "<f4").tobytes() for value in (1.0, 2.0)]
    strips = [zlib.compress(strip) if compression == 8 else strip for strip in strips]
    places, counts = [8, 8 + len(strips[0])], [len(strip) for strip in strips]

    def written(places: list[int], counts: list[int]) -> Path:
        end = 8 + sum(len(strip) for strip in strips)
        short = {256: 16, 257: 8, 258: 32, 259: compression, 262: 1, 277: 1, 278: 4, 339: 3}
        entries = {tag: struct.pack("<HHIHH", tag, 3, 1, value, 0) for tag, value in short.items()}
        entries |= {tag: struct.pack("<HHII", tag, 4, 2, at) for tag, at in ((273, end), (279, end + 8))}
        table = struct.pack("<H", len(entries)) + b"".join(entries[tag] for tag in sorted(entries)) + bytes(4)
        body = b"".join(strips) + struct.pack("<4I", *places, *counts) + table
        (tmp_path / "a.tif").write_bytes(b"II*\0" + struct.pack("<I", end + 16) + body)
        return tmp_path / "a.tif"

    expected = np.repeat([1.0, 2.0], 4)[:, None] * np.ones(16)
    np.testing.assert_array_equal(read_image(written(places, counts))[:, :, 0], expected)
    with pytest.raises(InputError, match="strip or tile 1 was never written"):
        read_image(written([8, 0], [counts[0], 0]))


LAYOUTS = [{}, {"tile": 16}, {"planarconfig": "separate"}, {"tiff:RowsPerStrip": 5}, {"tiff:bigtiff": 1}]


def deflated(path: Path, pixels: np.ndarray, layout: dict[str, int | str]) -> None:
    """A TIFF as others may write it."""
    rows, cols, channels = pixels.shape
    spec = oiio.ImageSpec(cols, rows, channels, oiio.FLOAT)
    spec.attribute("compression", "zip")
    for key, value in layout.items():
        if key == "tile":
            spec.tile_width = spec.tile_height = value
        else:
            spec.attribute(key, value)
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec)
    assert target.write_image(pixels)
    assert target.close()


@pytest.mark.parametrize("tag", [273, 279])
def test_a_strip_beyond_the_file_is_refused(tmp_path: Path, tag: int) -> None:
    """A BigTIFF has room for a place, and for a count of bytes, that no file can have."""
    pixels = np.ones((5, 4, 1), np.float32)
    deflated(tmp_path / "a.tif", pixels, {"tiff:bigtiff": 1})
    data = bytearray((tmp_path / "a.tif").read_bytes())
    (directory,) = struct.unpack_from("<Q", data, 8)
    (entries,) = struct.unpack_from("<Q", data, directory)
    starts = [directory + 8 + 20 * k for k in range(entries)]
    (at,) = (start for start in starts if struct.unpack_from("<H", data, start)[0] == tag)
    struct.pack_into("<HQQ", data, at + 2, 16, 1, 2**64 - 1)
    (tmp_path / "b.tif").write_bytes(data)
    with pytest.raises(InputError, match=r"b\.tif"):
        read_image(tmp_path / "b.tif")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_broken_strip_is_refused(tmp_path: Path, layout: dict[str, int | str]) -> None:
    """OpenImageIO gives no error for one, but values that happened to stand in memory."""
    random = np.random.default_rng(2)
    whole = random.exponential(0.1, (37, 41, 3)).astype(np.float32)
    deflated(tmp_path / "a.tif", whole, layout)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), whole)
    data = (tmp_path / "a.tif").read_bytes()
    refused = 0
    for at in random.integers(0, len(data), 60):
        broken = data[:at] + bytes([data[at] ^ 0x55]) + data[at + 1 :]
        (tmp_path / "b.tif").write_bytes(broken)
        found = set()
        for size in random.integers(10, 3000, 3):
            random.random(size)  # what happens to stand in memory
            try:
                found.add(read_image(tmp_path / "b.tif").tobytes())
            except InputError as error:
                found.add(str(error))
        assert len(found) == 1
        refused += isinstance(found.pop(), str)
    assert refused > 30  # most of the file's bytes are pixels


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.tif", b"no image"),
        ("a.exr", b"v/1\x01" + b"\0" * 40),
        ("a.xyz", b"?"),
        ("a.npy", b"\x93NUMPY\x01\x00\x10\x00{'descr': '<f4', "),
    ],
)
def test_broken_files_are_refused(tmp_path: Path, name: str, data: bytes) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError):
        read_image(tmp_path / name)


def test_npy_of_the_wrong_kind_is_refused(tmp_path: Path) -> None:
    for index, array in enumerate((np.zeros(3), np.zeros((2, 2), complex), np.array([{}]), np.zeros((2, 2), int))):
        np.save(tmp_path / f"{index}.npy", array)
        with pytest.raises(InputError):
            read_image(tmp_path / f"{index}.npy")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such image"):
        read_channel(tmp_path / "a.tif")


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")

    def interrupted() -> None:
        with replacing(path) as temporary:
            temporary.write_text("half of the n")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
    with replacing(path) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]
