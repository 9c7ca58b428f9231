"""`warpsar import`: a measurement onto the grid of a view, and into the scene file."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import tomlkit

from warpsar.errors import InputError
from warpsar.formats import registry
from warpsar.formats.base.data import Facts, ImageChip, PhaseHistory, Quantity, RadarAt
from warpsar.io import complex_image
from warpsar.io.images import replacing, write_exr
from warpsar.io.quick_look import QuickLook, draw_together
from warpsar.measured.gridding import Gridded, Gridding, on_grid
from warpsar.measured.placed import frame_of
from warpsar.measured.response import contradicts, of_focus, point_spread
from warpsar.scene import file as scenefile
from warpsar.scene.scene import Scene
from warpsar.speckle.looks import equivalent_looks
from warpsar.world.earth import EarthFrame, LocalEarth
from warpsar.world.tables import View

ANGLE_TOLERANCE_DEG = 0.5
FREQUENCY_TOLERANCE = 0.01
RANGE_TOLERANCE = 0.01
Scale = Literal["as declared", "unknown"]
_POLARIZATIONS = ("HH", "HV", "VH", "VV")
_NOBODY = "nobody.yet"
_NEW_VIEW: dict[str, Any] = {"azimuth_deg": 0.0, "incidence_deg": 45.0}  # until the file has spoken


@dataclass(frozen=True)
class Imported:
    """What an import did: `power`, float32 (rows, cols), is in `image_path`; NaN where nothing was measured."""

    image_path: Path
    power: np.ndarray
    polarization: str
    looks: float | None
    facts: Facts
    samples_per_pixel: tuple[int, int]
    messages: tuple[str, ...]
    picture_path: Path
    slc_path: Path | None = None
    """The complex samples, where the measurement is a complex image: `warpsar.io.complex_image` reads them."""
    point_spread: Mapping[str, Any] | None = None
    """What the header declares of the response to a point."""


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
    radar_at: RadarAt = "top",
    spacing_m: tuple[float, float] | None = None,
    scale: Scale = "as declared",
    role: Literal["train", "test"] | None = None,
) -> Imported:
    """Bring a measurement onto the slant-plane grid of a view and declare it in the scene file.

    The image, float32 linear power, is written beside the scene file as `<view>_<polarization>.exr`. The view gets
    `images` and `looks` (the equivalent number, estimated). A complex image keeps its phase: its samples are written as
    `<view>_<polarization>.npz`, the view's `slc`. What the header of a SICD says of its resolution becomes
    `[effects.point_spread]`, known to a tolerance, where the scene file has none. A missing view is made from the
    file's own geometry.

    `origin` (latitude, longitude [deg], height [m]) says where the world lies on the earth, for formats in earth
    coordinates. `Gridding` describes the windows, `subapertures`, `samples` and `surface`. `radar_at` and `spacing_m`
    are for pictures (`registry.read`). `scale` "unknown" writes `calibrated = false`. A picture with a top level gives
    the view `clipped_at`, and an MSTAR header gives the scene's only object its roll and pitch. `role` says what the
    view is for; without it the scene file's word stays.

    Raises InputError for files that cannot be read. Also where the scene file contradicts them: angles by more than 0.5
    degrees, frequency or slant range by more than 1 %, or another polarization.
    """
    scene_path = Path(scene_path)
    scene, exists = opened(scene_path, view_name)
    view = next(v for v in scene.views if v.name == view_name)
    frame = _frame(scene, origin)
    measured = registry.read(
        sources,
        file_format=file_format,
        quantity=quantity,
        polarization=polarization,
        frame=frame,
        radar_at=radar_at,
        spacing_m=spacing_m,
    )
    with np.errstate(all="ignore"):  # nonsense shows in the facts
        facts = measured.facts(np.asarray(scene.reference_point_m, np.float64)).checked(measured.source)
    pol = polarization_of(measured.source, facts.polarization, polarization, scene)
    if exists:
        _refuse_contradictions(measured.source, facts, scene, view)
    else:
        view = _new_view(measured.source, facts, scene, view)
    messages = []
    if scale != "unknown" and scene.grid.calibrated and not (isinstance(measured, ImageChip) and measured.calibrated):
        messages.append(
            f"{scene_path}: image.calibrated is true, but {measured.source} gives no beta0: its gain is unknown; "
            "set calibrated = false"
        )
    how = Gridding(window_range, window_azimuth, subapertures, samples, surface, device)
    gridded = on_grid(measured, scene, view, how)
    power, per_pixel = gridded.power, gridded.samples
    messages += gridded.messages + rounding(measured)
    blur = None
    if isinstance(measured, ImageChip):
        blur, remarks = point_spread(measured, scene, view, per_pixel)
        messages += remarks
    elif gridded.slc is not None:
        blur = of_focus(measured, (window_range, window_azimuth), scene, per_pixel)
    looks = equivalent_looks(power)
    if looks is None:
        messages.append("too little homogeneous ground to estimate looks from; none written")

    image_path = scene_path.parent / f"{view_name}_{pol}.exr"
    write_exr(image_path, {pol: power})
    picture = quick_look(image_path, view, pol, power, scene)
    draw_together([picture])
    slc_path = keep_phase(image_path, pol, gridded)
    stated = {
        "looks": None if looks is None else round(looks, 2),
        "looks_estimated": None if looks is None else True,
        "clipped_at": clip_level(measured, per_pixel),
        "role": role,
    }
    with editing(scene_path) as document:
        if origin is not None and "origin" not in document["scene"]:
            document["scene"]["origin"] = tomlkit.inline_table()
            keys = ("latitude_deg", "longitude_deg", "height_m")
            document["scene"]["origin"].update(zip(keys, origin, strict=True))
        if scale == "unknown":
            document["image"]["calibrated"] = False
        messages += _pose(document, facts)
        if blur is not None:
            messages += _blur(document, measured.source, blur)
        declare(document, view, exists, pol, image_path.name, stated, slc_path)
    return Imported(image_path, power, pol, looks, facts, per_pixel, tuple(messages), picture.path, slc_path, blur)


def keep_phase(image: Path, polarization: str, gridded: Gridded) -> Path | None:
    """Write the samples of a complex image beside its power; None where the measurement is none."""
    if gridded.slc is None:
        return None
    path = image.with_suffix(".npz")
    complex_image.write(path, gridded.range_m, gridded.azimuth_m, {polarization: gridded.slc})
    return path


def quick_look(image: Path, view: View, polarization: str, power: np.ndarray, scene: Scene) -> QuickLook:
    """The picture of a measured image, to lie beside it."""
    title = f"{view.name}, measured: azimuth {view.azimuth_deg:g}°, incidence {view.incidence_deg:g}°"
    return QuickLook.of(image.with_suffix(".png"), title, {polarization: power}, scene.grid.spacing_m)


def opened(path: Path, view_name: str | None) -> tuple[Scene, bool]:
    """The scene without its images, which may not be there yet, and whether it had the view; a stand-in where not.

    With None no view is asked for, and none is added where there is one.
    """
    _, raw = scenefile.read(path)
    views = raw.setdefault("views", [])
    exists = False
    for view in views if isinstance(views, list) else []:
        if isinstance(view, dict):
            exists |= view.get("name") == view_name
            for key in ("images", "mask", "slc"):
                view.pop(key, None)
    if not exists and isinstance(views, list) and (view_name is not None or not views):
        views.append({"name": view_name or _NOBODY, **_NEW_VIEW})
    with tempfile.NamedTemporaryFile("w", suffix=".toml", dir=path.parent, encoding="utf-8") as file:
        file.write(tomlkit.dumps(raw))
        file.flush()
        try:
            return Scene.load(file.name), exists
        except InputError as error:
            resolved = path.parent.resolve() / Path(file.name).name
            raise InputError(str(error).replace(str(resolved), str(path)).replace(file.name, str(path))) from None


def _frame(scene: Scene, origin: tuple[float, float, float] | None) -> EarthFrame | None:
    """Where the world lies on the earth: a DEM or the scene file says it, else `origin`; None where none does."""
    frame = frame_of(scene)
    if origin is None:
        return frame
    if frame is not None and scene.origin is None:
        raise InputError(f"--origin: the mesh {scene.mesh_path} is a DEM that says itself where it lies; leave it out")
    if frame is not None and frame != LocalEarth(*origin):
        raise InputError(f"--origin {origin}: the scene file says {frame}; leave it out, or make them the same")
    if not (-90.0 <= origin[0] <= 90.0 and -360.0 <= origin[1] <= 360.0 and abs(origin[2]) < 1e5):
        raise InputError(f"--origin {origin}: latitude, longitude [degrees] and height [m] are needed")
    return LocalEarth(*origin)


def polarization_of(source: str, found: str | None, asked: str | None, scene: Scene) -> str:
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
    """Raise InputError where the view of the scene file and the facts of the measured file differ."""
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
    """The view as the measured file describes it. What [radar] says of every view must agree."""
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


@contextmanager
def editing(path: Path) -> Iterator[Any]:
    """The scene file as a document, written back atomically, its comments and all else as they were."""
    document: Any = tomlkit.parse(path.read_text(encoding="utf-8-sig"))
    yield document
    with replacing(path) as temporary:
        temporary.write_text(tomlkit.dumps(document), encoding="utf-8", newline="\n")


def clip_level(measured: PhaseHistory | ImageChip, samples_per_pixel: tuple[int, int]) -> float | None:
    """Linear power at which the image was clipped; None where it was not. A mean of samples has no such level."""
    if not isinstance(measured, ImageChip) or measured.top is None or samples_per_pixel != (1, 1):
        return None
    return measured.top if measured.quantity == "power" else measured.top**2


def rounding(measured: PhaseHistory | ImageChip) -> list[str]:
    """What the file's own rounding does to the image, in words: none, or one message."""
    error = measured.error if isinstance(measured, ImageChip) else None
    if error is None:
        return []
    return [f"the JPEG rounds its levels, by up to {error:.1f} rms; pixels that are no brighter show little else"]


def _blur(document: Any, source: str, table: Mapping[str, Any]) -> list[str]:
    """The system's response in the document, where it has none yet; else where the two contradict each other."""
    if "effects" not in document:
        document.append("effects", tomlkit.table(is_super_table=True))
    stated = document["effects"].get("point_spread")
    if stated is not None:
        wrong = contradicts(table, stated)
        return [f"effects.point_spread: {one}; it stays as it is" for one in wrong]
    made = tomlkit.table()
    made.update({key: value for key, value in table.items() if key != "tolerance"})
    made["tolerance"] = tomlkit.inline_table()
    made["tolerance"].update(table["tolerance"])
    made.comment(f"as {Path(source).name} declares it")
    document["effects"]["point_spread"] = made
    return []


def declare(
    document: Any,
    view: View,
    exists: bool,
    pol: str,
    image: str,
    stated: Mapping[str, float | str | None],
    slc: Path | None = None,
) -> None:
    """The view's image, its complex samples, and what is `stated` of it, in the document of a scene file."""
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
    if slc is not None:
        table.setdefault("slc", tomlkit.inline_table())[pol] = slc.name
    elif pol in table.get("slc", {}):  # of an earlier import: its phase is not this image's
        del table["slc"][pol]
        if not table["slc"]:
            del table["slc"]
    for key, value in stated.items():
        if value is not None:
            table[key] = value


def _pose(document: Any, facts: Facts) -> list[str]:
    """What the target's header says of its attitude, for the only object of the scene that has a mesh."""
    found = {"roll_deg": facts.target_roll_deg, "pitch_deg": facts.target_pitch_deg}
    bodies = [one for one in document.get("objects", []) if "mesh" in one]
    if len(bodies) != 1 or None in found.values():
        return []
    (body,) = bodies
    messages = []
    for key, value in found.items():
        if key not in body:
            body[key] = round(float(value or 0.0), 4)
        elif abs(body[key] - float(value or 0.0)) > ANGLE_TOLERANCE_DEG:
            messages.append(f"objects: {key} = {body[key]:g}, but the file says {value:.2f}; it stays as it is")
    return messages
