"""`warpsar import`: a measurement onto a view's grid, and into the scene file."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import tomlkit

from warpsar.errors import InputError
from warpsar.io.images import replacing, write_exr
from warpsar.measured import formats
from warpsar.measured.data import Facts, ImageChip, PhaseHistory, Quantity
from warpsar.measured.earth import EarthFrame, Origin
from warpsar.measured.focus import cell_m, focus
from warpsar.measured.ground import mesh_points, pixel_centres, plane_points
from warpsar.measured.placed import frame_of
from warpsar.measured.resample import averaged, sample_power
from warpsar.scene import file as scenefile
from warpsar.scene.scene import Scene
from warpsar.speckle.looks import equivalent_looks
from warpsar.world.tables import View
from warpsar.world.world import geometry_of

ANGLE_TOLERANCE_DEG = 0.5
FREQUENCY_TOLERANCE = 0.01
RANGE_TOLERANCE = 0.01
_POLARIZATIONS = ("HH", "HV", "VH", "VV")
_MOST_LOOKS = 64
_NEW_VIEW: dict[str, Any] = {"azimuth_deg": 0.0, "incidence_deg": 45.0}  # until the file has spoken


@dataclass(frozen=True)
class Imported:
    """What an import did: `power`, shape (rows, cols), float32, NaN where nothing was measured, is in `image_path`."""

    image_path: Path
    power: np.ndarray
    polarization: str
    looks: float | None
    facts: Facts
    samples_per_pixel: tuple[int, int]
    messages: tuple[str, ...]


def import_measured(
    sources: Sequence[str | Path],
    scene_path: str | Path,
    view_name: str,
    *,
    file_format: str = "auto",
    quantity: Quantity | None = None,
    polarization: str | None = None,
    window_range: str = "none",
    window_azimuth: str = "none",
    subapertures: int = 1,
    samples: tuple[int | None, int | None] = (None, None),
    surface: Literal["reference", "mesh"] = "reference",
    origin: tuple[float, float, float] | None = None,
    device: str | None = None,
) -> Imported:
    """Bring a measurement onto the slant-plane grid of a view and declare it in the scene file.

    The image, float32 linear power, is written beside the scene file as `<view>_<polarization>.exr`; the view gets
    `images` and `looks` (equivalent number, estimated), and is made, with the file's own geometry, where it is missing.
    Phase history is focused (`warpsar.focus`) with the windows and sub-apertures given; images are resampled. `samples`
    (range, azimuth) per pixel are averaged in power: by default as many as the resolution asks for. Pixels lie at the
    reference point's height, or on the mesh. `origin` (latitude, longitude [deg], height [m]) says where the world lies
    on the earth for formats in earth coordinates.

    Raises InputError for files that cannot be read, and where the scene file contradicts them: angles by more than 0.5
    degrees, frequency or slant range by more than 1 %, polarization at all.
    """
    scene_path = Path(scene_path)
    scene, exists = _load(scene_path, view_name)
    view = next(v for v in scene.views if v.name == view_name)
    frame = _frame(scene, origin)
    measured = formats.read(sources, file_format=file_format, quantity=quantity, polarization=polarization, frame=frame)
    reference = np.asarray(scene.reference_point_m, np.float64)
    with np.errstate(all="ignore"):  # nonsense shows in the facts
        facts = measured.facts(reference).checked(measured.source)
    pol = _polarization(measured.source, facts.polarization, polarization, scene)
    if exists:
        _refuse_contradictions(measured.source, facts, scene, view)
    else:
        view = _new_view(measured.source, facts, scene, view)
    messages = []
    if scene.grid.calibrated and not getattr(measured, "calibrated", False):
        messages.append(
            f"{scene_path}: image.calibrated is true, but {measured.source} gives no beta0: its gain is unknown; "
            "set calibrated = false"
        )

    geometry = geometry_of(scene, view)
    looks = _samples_per_pixel(measured, scene, reference, samples)
    range_m, azimuth_m = pixel_centres(scene.grid.shape, scene.grid.spacing_m, looks)
    slant_plane = isinstance(measured, ImageChip) and measured.locate is None
    if slant_plane:
        fine = _from_slant_plane(cast(ImageChip, measured), scene, range_m, azimuth_m, looks)
    else:
        if surface == "mesh":
            points, missed = mesh_points(geometry, reference, range_m, azimuth_m, scene.mesh, device)
            if missed:
                messages.append(
                    f"{missed} of {points[..., 0].size} samples meet no mesh; taken at the reference height"
                )
        else:
            points = plane_points(geometry, reference, range_m, azimuth_m)
        if isinstance(measured, PhaseHistory):
            fine = _focused(measured, points, reference, window_range, window_azimuth, subapertures, device)
        else:
            fine = sample_power(measured, _located(measured, points, reference))
    with np.errstate(all="ignore"):  # beyond float32 is infinite, and no power
        power = averaged(fine, looks).astype(np.float32)
    power[~np.isfinite(power)] = np.nan
    unseen = int((~np.isfinite(power)).sum())
    if unseen == power.size:
        raise InputError(f"{measured.source}: no pixel of the view's grid lies wholly inside what was measured")
    if unseen:
        messages.append(f"{unseen} of {power.size} pixels lie outside what was measured; they are NaN, and masked")
    estimated = equivalent_looks(power)
    if estimated is None:
        messages.append("too little homogeneous ground to estimate looks from; none written")

    image_path = scene_path.parent / f"{view_name}_{pol}.exr"
    write_exr(image_path, {pol: power})
    _declare(scene_path, view, exists, pol, image_path.name, estimated, origin)
    return Imported(image_path, power, pol, estimated, facts, looks, tuple(messages))


# ---- the scene's side ----


def _load(path: Path, view_name: str) -> tuple[Scene, bool]:
    """The scene with the view asked for, made up where it is missing, and without images: they may not be there yet."""
    _, raw = scenefile.read(path)
    views = raw.setdefault("views", [])
    exists = False
    for view in views if isinstance(views, list) else []:
        if isinstance(view, dict):
            exists |= view.get("name") == view_name
            view.pop("images", None)
            view.pop("mask", None)
    if not exists and isinstance(views, list):
        views.append({"name": view_name, **_NEW_VIEW})
    with tempfile.NamedTemporaryFile("w", suffix=".toml", dir=path.parent, encoding="utf-8") as file:
        file.write(tomlkit.dumps(raw))
        file.flush()
        try:
            return Scene.load(file.name), exists
        except InputError as error:
            resolved = path.parent.resolve() / Path(file.name).name
            raise InputError(str(error).replace(str(resolved), str(path)).replace(file.name, str(path))) from None


def _frame(scene: Scene, origin: tuple[float, float, float] | None) -> EarthFrame | None:
    frame = frame_of(scene)
    if origin is None:
        return frame
    if frame is not None and scene.origin is None:
        raise InputError(f"--origin: the mesh {scene.mesh_path} is a DEM that says itself where it lies; leave it out")
    if frame is not None and frame != Origin(*origin):
        raise InputError(f"--origin {origin}: the scene file says {frame}; leave it out, or make them the same")
    if not (-90.0 <= origin[0] <= 90.0 and -360.0 <= origin[1] <= 360.0 and abs(origin[2]) < 1e5):
        raise InputError(f"--origin {origin}: latitude, longitude [degrees] and height [m] are needed")
    return Origin(*origin)


def _polarization(source: str, found: str | None, asked: str | None, scene: Scene) -> str:
    pol = found or asked
    if pol is None:
        raise InputError(f"{source}: says no polarization; use --polarization")
    if found is not None and asked is not None and found != asked:
        raise InputError(f"{source}: polarization is {found}; --polarization {asked} was asked for")
    if pol not in _POLARIZATIONS:
        raise InputError(f"{source}: polarization is {pol}; {', '.join(_POLARIZATIONS)} are known")
    if pol not in scene.radar.polarizations:
        raise InputError(
            f"{source}: polarization is {pol}; the scene file's radar.polarizations are "
            f"{', '.join(scene.radar.polarizations)}"
        )
    return pol


def _refuse_contradictions(source: str, facts: Facts, scene: Scene, view: View) -> None:
    """What the scene file says of the view against what the file says of itself."""
    wrong = []

    def angle(key: str, stated: float, found: float | None) -> None:
        if found is not None and abs((stated - found + 180.0) % 360.0 - 180.0) > ANGLE_TOLERANCE_DEG:
            wrong.append(f"{key} = {stated:g}, but the file says {found:.3f} (within {ANGLE_TOLERANCE_DEG:g})")

    angle("azimuth_deg", view.azimuth_deg, facts.azimuth_deg)
    angle("incidence_deg", view.incidence_deg, facts.incidence_deg)
    _compare(
        "frequency_hz", view.frequency_hz or scene.radar.frequency_hz, facts.frequency_hz, FREQUENCY_TOLERANCE, wrong
    )
    _compare("slant_range_m", scene.slant_range_m(view), facts.slant_range_m, RANGE_TOLERANCE, wrong)
    if wrong:
        raise InputError(f"{source}: contradicts the scene file's view {view.name!r}: {'; '.join(wrong)}")


def _compare(key: str, stated: float | None, found: float | None, tolerance: float, wrong: list[str]) -> None:
    if stated is not None and found is not None and abs(stated / found - 1.0) > tolerance:
        wrong.append(f"{key} = {stated:.10g}, but the file says {found:.6g} (within {100 * tolerance:g} %)")


def _new_view(source: str, facts: Facts, scene: Scene, view: View) -> View:
    """The view as the file says it is. Where [radar] speaks of every view, it must agree."""
    if facts.azimuth_deg is None or facts.incidence_deg is None:
        raise InputError(
            f"{source}: says nothing of azimuth and incidence; declare the view {view.name!r} in the scene file first"
        )
    if not 0.0 < facts.incidence_deg < 90.0:
        raise InputError(
            f"{source}: seen from the reference point the radar is at an incidence of {facts.incidence_deg:.3f} "
            "degrees; must be between 0 and 90"
        )
    wrong: list[str] = []
    _compare("radar.frequency_hz", scene.radar.frequency_hz, facts.frequency_hz, FREQUENCY_TOLERANCE, wrong)
    _compare("radar.slant_range_m", scene.radar.slant_range_m, facts.slant_range_m, RANGE_TOLERANCE, wrong)
    if wrong:
        raise InputError(
            f"{source}: contradicts the scene file: {'; '.join(wrong)}. A view of its own frequency or range "
            "must be declared in the scene file first"
        )
    stated: dict[str, Any] = {
        "name": view.name,
        "azimuth_deg": round(facts.azimuth_deg, 6),
        "incidence_deg": round(facts.incidence_deg, 6),
    }
    if facts.strip_map and scene.radar.slant_range_m is None:
        stated["slant_range_m"] = round(cast(float, facts.slant_range_m), 3)
    return type(view).model_validate(stated)


def _declare(
    path: Path,
    view: View,
    exists: bool,
    pol: str,
    image: str,
    looks: float | None,
    origin: tuple[float, float, float] | None,
) -> None:
    """Write `images`, `looks` and the origin given into the scene file, its comments and all else as they were."""
    document: Any = tomlkit.parse(path.read_text(encoding="utf-8-sig"))
    if origin is not None and "origin" not in document["scene"]:
        document["scene"]["origin"] = tomlkit.inline_table()
        document["scene"]["origin"].update(zip(("latitude_deg", "longitude_deg", "height_m"), origin, strict=True))
    if not exists:
        if "views" not in document:
            document.append("views", tomlkit.aot())
        made = tomlkit.item(view.model_dump(mode="json", by_alias=True, exclude_unset=True))
        made.trivia.indent = "\n"
        document["views"].append(made)
    table = next(table for table in document["views"] if table["name"] == view.name)
    if "images" not in table:
        table["images"] = tomlkit.inline_table()
    table["images"][pol] = image
    if looks is not None:
        table["looks"] = round(looks, 2)
    with replacing(path) as temporary:
        temporary.write_text(tomlkit.dumps(document), encoding="utf-8", newline="\n")


# ---- the measurement's side ----


def _samples_per_pixel(
    measured: PhaseHistory | ImageChip,
    scene: Scene,
    reference: np.ndarray,
    asked: tuple[int | None, int | None],
) -> tuple[int, int]:
    """Samples per pixel (range, azimuth): as given, else one per resolution cell, or per pixel of an image."""
    if isinstance(measured, PhaseHistory):
        step: Sequence[float] | None = cell_m(measured, reference)
    else:
        step = measured.spacing_m
    counts = []
    for axis, (name, given) in enumerate(zip(("range", "azimuth"), asked, strict=True)):
        if given is not None and not 1 <= given <= _MOST_LOOKS:
            raise InputError(f"--looks-{name} {given}: must be 1 to {_MOST_LOOKS}")
        if given is None and step is not None:
            ratio = scene.grid.spacing_m[axis] / step[axis]
            count = math.ceil(ratio - 1e-6) if isinstance(measured, PhaseHistory) else round(ratio)
            given = min(max(1, count), _MOST_LOOKS)
        elif given is None:
            given = max(1, round(measured.samples.shape[axis] / scene.grid.shape[axis]))
        counts.append(given)
    return counts[0], counts[1]


def _from_slant_plane(
    chip: ImageChip, scene: Scene, range_m: np.ndarray, azimuth_m: np.ndarray, looks: tuple[int, int]
) -> np.ndarray:
    """An image whose axes are the view's, its middle the reference point."""
    spacing = chip.spacing_m
    if spacing is None:
        wanted = tuple(size * n for size, n in zip(scene.grid.shape, looks, strict=True))
        if tuple(chip.samples.shape) != wanted:
            raise InputError(
                f"{chip.source}: {' x '.join(map(str, chip.samples.shape))} pixels, and no spacing; image.shape "
                f"{list(scene.grid.shape)} with {looks[0]} x {looks[1]} looks needs {wanted[0]} x {wanted[1]}"
            )
        spacing = cast(tuple[float, float], tuple(s / n for s, n in zip(scene.grid.spacing_m, looks, strict=True)))
    rows, cols = chip.samples.shape
    row = range_m / spacing[0] + (rows - 1) / 2.0
    col = azimuth_m / spacing[1] + (cols - 1) / 2.0
    return sample_power(chip, np.stack(np.meshgrid(row, col, indexing="ij"), axis=-1))


def _focused(
    history: PhaseHistory,
    points: np.ndarray,
    reference: np.ndarray,
    window_range: str,
    window_azimuth: str,
    subapertures: int,
    device: str | None,
) -> np.ndarray:
    """Power, mean over the sub-apertures, with the file's autofocus where it has one."""
    images = focus(
        history.with_autofocus(),
        points,
        reference_point_m=reference,
        window_range=window_range,
        window_azimuth=window_azimuth,
        subapertures=subapertures,
        device=device,
    )
    power = np.zeros(points.shape[:-1])
    for image in images:
        power += image.real.astype(np.float64) ** 2 + image.imag.astype(np.float64) ** 2
    return power / subapertures


def _located(chip: ImageChip, points: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Pixels of the chip at the points; where none is inside, the refusal says where in the world the image lies."""
    assert chip.locate is not None
    pixel = chip.locate(points)
    rows, cols = chip.samples.shape
    inside = (pixel >= 0).all(-1) & (pixel[..., 0] <= rows - 1) & (pixel[..., 1] <= cols - 1)
    if inside.any():
        return pixel
    middle = np.array([(rows - 1) / 2.0, (cols - 1) / 2.0])
    point = reference.copy()
    for _ in range(20):  # Newton's method in east and north
        steps = chip.locate(point + 10.0 * np.eye(3)[:2]) - chip.locate(point)
        try:
            point[:2] += 10.0 * np.linalg.solve(steps.T, middle - chip.locate(point))
        except np.linalg.LinAlgError:
            break
    raise InputError(
        f"{chip.source}: the view's grid lies wholly outside the image, whose middle is near the world's "
        f"({point[0]:.0f}, {point[1]:.0f}) m at the reference point's height"
    )
