"""`warpsar new`: a first scene file for a mesh, with comments, that simulates as it is."""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import tomlkit
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.io.images import replacing
from warpsar.io.ply import write_ply
from warpsar.runtime import console
from warpsar.scene import city, footprints
from warpsar.scene.unwrap import write_obj
from warpsar.world.frame import SPEED_OF_LIGHT, ViewGeometry, view_geometry
from warpsar.world.library.names import surface_named
from warpsar.world.mesh import GLTF, SUFFIXES, Mesh, read_mesh, unlikely_size
from warpsar.world.meshes.dem import SUFFIXES as DEM_SUFFIXES
from warpsar.world.objects.table import UNITS
from warpsar.world.sensors import SENSORS, Sensor, noise_beta0
from warpsar.world.tables import Grid
from warpsar.world.units import guessed_unit

FREQUENCY_HZ = 9.6e9
INCIDENCE_DEG = 40.0
NESZ_DB = -22.0  # Sentinel-1's, of a scene for no sensor in particular
PIXELS_PER_WIDTH = 2.0  # of the resolution: no pixel is smaller
WAVELENGTHS_PER_WIDTH = 2.0
"""Of the finest resolution where no sensor is stated. It is c / (2 B) in range. The band B of imaging radars is a
quarter of their frequency at most, so they resolve two wavelengths or more; and a patch of a surface that is smaller
than a wavelength has no cross-section of its own."""
_GROUND = 4.0  # sides of a ground over the mesh's size: shadows of a tower as high as wide end on it
FEW_PIXELS = 32  # across the mesh: fewer show hardly more than a blot
AZIMUTHS_DEG = {20.0: "train", 140.0: "train", 260.0: "train", 320.0: "test"}
"""Of the views, with their roles: no side of a building that faces north lies straight across. The last one is for the
check that learn and diagnose make, so that a fit has three sides of a body, and one that it has not seen."""

_HEAD = """\
# Made from {source}. Lengths are in metres, angles in degrees.

[scene]
mesh = {mesh}
reference_point_m = {reference}  # {middle}

{sensor}[radar]
frequency_hz = {frequency}
polarizations = ["HH"]      # any of HH, HV, VH, VV

[image]  # {pixels}
shape = {shape:<18}  # pixels along slant range (down) and azimuth (across)
spacing_m = {spacing:<14}  # of a pixel, likewise; the whole mesh lies inside in every view

[sampling]
rays_per_pixel = 64.0       # more rays: less sampling noise, more time; the mean does not change

# One table for each material of the mesh. The surface is a half space of relative permittivity eps_r, with small
# random heights (standard deviation rms_height_m) that stay alike over correlation_length_m. A material whose name says
# a surface of the library (`warpsar materials` lists them) begins as that; a key that you state takes the place of the
# surface's own. Any other begins as dry, fairly smooth ground: replace it by what you know.
"""

_MIDDLE = "the world point in the middle of every image"

_MATERIAL = """
[materials.{name}]  # no surface of the library has this name: dry, fairly smooth ground
eps_r = 5.0
rms_height_m = 0.001
correlation_length_m = 0.006
"""

_OF_LIBRARY = """
[materials.{name}]
library = "{surface}"
"""

_EFFECTS = """
# What an image holds beside single reflections; without its table an effect is off. Bounces between surfaces make the
# bright lines at the foot of walls. They take more rays, and more time.
[effects.multibounce]
strength = 1.0

# The receiver's own noise, the same in every pixel, so that shadows are grey: beta0 = NESZ / sin(incidence).
# NESZ {nesz:g} dB{of}. State that of your sensor.
[effects.noise_floor]
level = {level:.3g}
"""

_RESPONSE = """
# {whose}, as half-power widths in slant range and azimuth.
[effects.point_spread]
range_fwhm_m = {widths[0]:g}
azimuth_fwhm_m = {widths[1]:g}
"""

_STATED_WIDTHS = "The resolution that is stated"
_WIDTHS_OF_PIXELS = "The resolution: two pixels. State that of your radar"
_SENSOR_PIXELS = "no pixel is smaller than half of the sensor's resolution"
_OWN_PIXELS = (
    "no pixel is smaller than a wavelength, as no radar resolves less than about two ({wavelength:.3g} m each)"
)

_OF_NO_SENSOR = ": as ESA specifies it for Sentinel-1 (Sentinel-1 SAR Technical Guide, Performance)"
_NOT_READ = ": Sentinel-1's, in place of the noise of {title}, which we could not read"
_INCIDENCE_NOT_READ = "incidences: we could not read them; the views have {incidence_deg:g} degrees"

_OBJECTS = """
# A body with a place of its own, such as a parked car, stands in a table [[objects]]:
# [[objects]]
# primitive = "car"                 # or mesh = "FILE", or group = "NAME" of a part of the mesh above
# size_m = [4.6, 1.8, 1.5]          # length, width, height
# position_m = [0.0, 0.0, 0.0]      # east, north, up
# heading_deg = 0.0                 # clockwise from north
# material = {material}

# If the mesh has no ground, shadows and the bounces at the foot of walls have nothing to fall on. This lays some:
# [[objects]]
# name = "ground"
# primitive = "plate"
# size_m = {ground}
# position_m = {foot}
# material = "ground"
# [materials.ground]
# library = "grass"
"""

_VIEWS = """
# Where the radar stands: azimuth_deg clockwise from north (+Y), incidence_deg from the zenith (+Z). A measured image
# stands in its view as `images = { HH = "FILE" }`; `warpsar import` brings one in.
"""

_VIEW = """
[[views]]
name = "{name}"
azimuth_deg = {azimuth}
incidence_deg = {incidence}
"""

_ROLES = {"train": "", "test": 'role = "test"  # no fit uses it: learn, evaluate and diagnose are checked by it\n'}


def new_scene(
    folder: Path | str,
    mesh_path: Path | str,
    *,
    units: str | None = None,
    up: str | None = None,
    yes: bool = False,
    dem: Path | str | None = None,
    force: bool = False,
    sensor: str | None = None,
) -> Path:
    """`warpsar new`: `scene.toml` in `folder`, which is made if missing. Returns its path.

    The scene refers to the mesh where it lies. Where its unit is not the metre, or Z is not up, a copy in metres with Z
    up is written into `folder`, and the scene refers to that. `units` is a key of `UNITS`; it is guessed where it is
    None, and what was guessed is said. `up` is the axis of the file that points up, "y" or "z"; where it is None that
    of the format is taken, and it is said where the mesh seems to contradict. `yes` takes a mesh whose size is
    unlikely. Buildings of a GeoJSON or CityGML file (`footprints.SUFFIXES`) become a mesh in `folder`, `city.obj`, on
    the ground of the GeoTIFF `dem`, or on level ground. `sensor` is a name of `world.sensors.SENSORS`: the scene then
    has its frequency, resolution and noise.

    Raises InputError where a scene file is there and `force` is false, for a mesh that cannot be read, and for one of
    unlikely size.
    """
    folder, mesh_path = Path(folder), Path(mesh_path)
    path = folder / "scene.toml"
    if path.exists() and not force:
        raise InputError(f"{path}: found a scene file there already; --force replaces it")
    if mesh_path.suffix.lower() in footprints.SUFFIXES:
        if units is not None:
            raise InputError(f"--units: found {units}; a file of buildings states its own unit, leave it out")
        if up is not None:
            raise InputError(f"--up: found {up}; a file of buildings says itself what is up, leave it out")
        return _new_city(folder, mesh_path, None if dem is None else Path(dem), sensor)
    if dem is not None:
        raise InputError(f"--dem: found {dem}; it goes with buildings ({', '.join(footprints.SUFFIXES)}), not a mesh")
    suffix = mesh_path.suffix.lower()
    for option, given, what in (("--units", units, "its own unit"), ("--up", up, "heights, which point up")):
        if given is not None and suffix in DEM_SUFFIXES:
            raise InputError(f"{option}: found {given}; an elevation model states {what}, leave it out")
    if suffix not in SUFFIXES:
        known = ", ".join((*SUFFIXES, *footprints.SUFFIXES))
        raise InputError(f"{mesh_path}: found a file of type '{suffix}'; must be a mesh or buildings: {known}")
    mesh = read_mesh(mesh_path, up=up)
    if up is None:
        _say_what_is_up(mesh_path, mesh)
    unit = units or _guessed_unit(mesh_path, mesh)
    _refuse_unlikely_size(mesh_path, mesh, unit, yes)
    folder.mkdir(parents=True, exist_ok=True)
    made = mesh_path.name
    turned = _turned(mesh_path, mesh, up)
    if unit != "m" or turned:
        made = made if unit == "m" else f"{made} in {unit}"
        made = f"{made}, {up} up" if turned else made
        how = " ".join([*(["in metres"] if unit != "m" else []), *(["with Z up"] if turned else [])])
        mesh_path, mesh = _copy(folder, mesh_path, mesh, UNITS[unit], "in_metres" if unit != "m" else "z_up")
        console.say(f"{mesh_path}: the mesh {how}; the scene refers to it")
    grid, text = _scene(mesh, _relative(mesh_path, folder), made, sensor)
    return _written(path, grid, text)


def _say_what_is_up(path: Path, mesh: Mesh) -> None:
    """What is taken as up where nobody said it, if that is not plain."""
    doubts = [f"{path}: {warning}" for warning in mesh.warnings if "Z up" in warning]
    console.warn(doubts)
    if path.suffix.lower() in GLTF and not doubts:
        console.say(f"{path}: glTF has Y up by its standard; turned to Z up. If this file has not: --up z")


def _turned(path: Path, mesh: Mesh, up: str | None) -> bool:
    """Whether `up` has turned the mesh against what its file alone would be read as."""
    if path.suffix.lower() not in GLTF:
        return up == "y"
    return up is not None and not np.array_equal(mesh.vertices, read_mesh(path).vertices)


def _refuse_unlikely_size(path: Path, mesh: Mesh, unit: str, yes: bool) -> None:
    if yes or path.suffix.lower() in DEM_SUFFIXES:
        return
    found = unlikely_size(UNITS[unit] * mesh.vertices)
    if found is not None:
        raise InputError(f"{path}: taken as {unit}, {found}; --units with {', '.join(UNITS)} scales it, --yes takes it")


def _written(path: Path, grid: Grid, text: str) -> Path:
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    size = " x ".join(map(str, grid.shape))
    console.say(f"{path}: {len(AZIMUTHS_DEG)} views of {size} pixels of {grid.spacing_m[0]:g} m")
    return path


def _new_city(folder: Path, source: Path, dem: Path | None, sensor: str | None) -> Path:
    """The scene of a file of buildings, and its mesh."""
    mesh, origin = city.mesh_of(source, dem)
    folder.mkdir(parents=True, exist_ok=True)
    write_obj(folder / "city.obj", mesh)
    console.say(f"{folder / 'city.obj'}: {len(mesh.faces)} triangles")
    made = source.name if dem is None else f"{source.name} and {dem.name}"
    grid, text = _scene(mesh, "city.obj", made, sensor, city.LIBRARY)
    place = ", ".join(f"{key} = {value}" for key, value in origin.model_dump().items())
    text = text.replace(_MIDDLE, f"{_MIDDLE}\norigin = {{ {place} }}", 1)
    return _written(folder / "scene.toml", grid, text)


def _guessed_unit(path: Path, mesh: Mesh) -> str:
    """The likely unit of the mesh's coordinates; says what was guessed, and how to change it."""
    unit, words = guessed_unit(path, mesh.vertices)
    if words is not None:
        console.say(words)
    return unit


def _copy(folder: Path, path: Path, mesh: Mesh, metres: float, ending: str) -> tuple[Path, Mesh]:
    """A copy of the mesh in metres: a PLY where it has scalars, else an OBJ; its path, and the mesh as written."""
    names = [" ".join(name.split()) for name in mesh.materials]  # a line of an OBJ holds a name
    mesh = replace(mesh, vertices=mesh.vertices * metres, materials=tuple(names))
    written = folder / f"{path.stem}_{ending}{'.ply' if mesh.vertex_scalars else '.obj'}"
    if mesh.vertex_scalars:
        write_ply(written, mesh.vertices, mesh.faces, mesh.vertex_scalars)
    else:
        write_obj(written, mesh)
    return written, mesh


def _relative(path: Path, folder: Path) -> str:
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive
        return path.resolve().as_posix()


def _scene(
    mesh: Mesh, mesh_name: str, source: str, sensor: str | None, library: Mapping[str, str] | None = None
) -> tuple[Grid, str]:
    """The grid that fits, and the text of the scene file; `library` names surfaces for the mesh's materials, beyond
    what their names say."""
    corners = mesh.vertices[np.unique(mesh.faces)]
    low, high = corners.min(axis=0), corners.max(axis=0)
    # Rounded to a hundredth of the mesh: a point to read, and still in the middle.
    decimals = 2 - int(np.floor(np.log10((high - low).max())))
    reference = np.round((low + high) / 2.0, decimals) + 0.0  # + 0.0: no -0
    known = None if sensor is None else SENSORS[sensor]
    frequency_hz = FREQUENCY_HZ if known is None else known.frequency_hz
    between = None if known is None else known.incidence_deg
    incidence_deg = INCIDENCE_DEG if between is None else float(np.clip(INCIDENCE_DEG, *between))
    looks = [view_geometry(azimuth, incidence_deg, frequency_hz) for azimuth in AZIMUTHS_DEG]
    wavelength_m = SPEED_OF_LIGHT / frequency_hz
    if known is None:
        finest = _rounded_up(WAVELENGTHS_PER_WIDTH * wavelength_m / PIXELS_PER_WIDTH)
        pixels = _OWN_PIXELS.format(wavelength=wavelength_m)
    else:
        finest, pixels = min(known.resolution_m) / PIXELS_PER_WIDTH, _SENSOR_PIXELS
    grid = fitted_grid(corners, reference, looks, finest)
    _say_if_small(float((high - low).max()), grid.spacing_m[0])
    head = _HEAD.format(
        source="".join(letter if letter.isprintable() else "?" for letter in source),
        mesh=tomlkit.item(mesh_name).as_string(),
        reference=reference.tolist(),
        middle=_MIDDLE,
        sensor="" if known is None else "".join(f"# {line}\n" for line in _of_sensor(known, incidence_deg)),
        frequency=f"{frequency_hz / 1e9:g}e9",
        pixels=pixels,
        shape=str(list(grid.shape)),
        spacing=str(list(grid.spacing_m)),
    )
    surfaces = {name: (library or {}).get(name) or surface_named(name) for name in dict.fromkeys(mesh.materials)}
    materials = "".join(
        (_MATERIAL if surface is None else _OF_LIBRARY).format(name=tomlkit.key(name).as_string(), surface=surface)
        for name, surface in surfaces.items()
    )
    if known is None or known.nesz_db is None:
        nesz, of = NESZ_DB, _OF_NO_SENSOR if known is None else _NOT_READ.format(title=known.title)
    else:
        nesz, of = known.nesz_db, f", the bound for {known.title}"
    effects = _EFFECTS.format(nesz=nesz, of=of, level=noise_beta0(nesz, incidence_deg))
    if known is None:
        widths_m = tuple(PIXELS_PER_WIDTH * spacing for spacing in grid.spacing_m)
        effects += _RESPONSE.format(whose=_WIDTHS_OF_PIXELS, widths=widths_m)
    else:
        effects += _RESPONSE.format(whose=_STATED_WIDTHS, widths=known.resolution_m)
    views = "".join(
        _VIEW.format(name=f"az{azimuth:03.0f}", azimuth=azimuth, incidence=incidence_deg) + _ROLES[role]
        for azimuth, role in AZIMUTHS_DEG.items()
    )
    spread = [float(f"{_GROUND * side:.3g}") for side in np.full(2, (high - low).max())]
    foot = [*reference[:2].tolist(), float(np.round(low[2], decimals)) + 0.0]
    objects = _OBJECTS.format(material=tomlkit.item(mesh.materials[0]).as_string(), ground=[*spread, 0.0], foot=foot)
    return grid, head + materials + effects + objects + _VIEWS + views


def _say_if_small(size_m: float, spacing_m: float) -> None:
    if size_m < FEW_PIXELS * spacing_m:
        console.say(
            f"the mesh is {size_m:.3g} m across, and a pixel {spacing_m:g} m: an image shows little of it. For the "
            "radar cross-section of a small body: warpsar rcs. If the unit is wrong: --units"
        )


def _of_sensor(sensor: Sensor, incidence_deg: float) -> list[str]:
    """Its name, and where its numbers stand."""
    lines = [sensor.title, *sensor.source]
    return lines if sensor.incidence_deg else [*lines, _INCIDENCE_NOT_READ.format(incidence_deg=incidence_deg)]


EXAMPLE = Path(__file__).parent / "assets" / "example"  # in a checkout a link to data/example
SCENE = "scene.toml"


def copy_example(folder: Path | str, *, force: bool = False) -> Path:
    """Copy the example scene, its mesh and its material file into `folder`, which is made if missing.

    Returns the path of the scene file. Raises InputError where one of the files is there and `force` is false.
    """
    folder = Path(folder)
    names = sorted(path.name for path in EXAMPLE.iterdir())
    there = [name for name in names if (folder / name).exists()]
    if there and not force:
        raise InputError(f"{folder / there[0]}: found a file there already; --force replaces it")
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        shutil.copyfile(EXAMPLE / name, folder / name)
    return folder / SCENE


PIXELS = 512
"""Pixels along an axis, at most."""
_MARGIN = 1.05  # a rim of 2.5 % on either side
_BLOCK = 16  # numbers of pixels are multiples of it
_ROUND = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
_SMALLEST_M, _LARGEST_M = 1e-5, 1e5  # what [image].spacing_m allows


def fitted_grid(
    vertices: NDArray[np.float64],
    reference_m: NDArray[np.float64],
    looks: Iterable[ViewGeometry],
    finest_m: float = 0.0,
) -> Grid:
    """Square pixels of `finest_m` or more, at most 512 along an axis, about `reference_m` (3,) [m].

    They hold the `vertices` (n, 3) [m] as every plane wave of `looks` sees them, layover included. They also hold the
    shadows on level ground at the mesh's foot: a point at the height z above it shades up to z / cos(incidence)
    behind itself in range.
    """
    at = vertices - reference_m
    height = at[:, 2] - at[:, 2].min()
    reach = np.zeros(2)
    for look in looks:
        slant, azimuth = at @ look.d, at @ look.u
        shadow = slant + height / look.s[2]
        reach = np.maximum(reach, [max(-slant.min(), shadow.max()), np.abs(azimuth).max()])
    size = 2.0 * _MARGIN * reach
    spacing = min(max(_rounded_up(float(size.max()) / PIXELS), _SMALLEST_M, finest_m), _LARGEST_M)
    rows, columns = (_BLOCK * max(1, math.ceil(each / spacing / _BLOCK)) for each in size)
    return Grid(shape=(rows, columns), spacing_m=(spacing, spacing))


def _rounded_up(value: float) -> float:
    power = math.floor(math.log10(value))
    return next(each for step in _ROUND if (each := float(f"{step}e{power}")) >= value)
