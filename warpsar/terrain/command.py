"""The command `twin`, and `warpsar.twin`: what a product should show of an elevation model, on the product's grid."""

from __future__ import annotations

import hashlib
import math
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpsar.errors import InputError, NothingShownError, did_you_mean
from warpsar.formats import registry
from warpsar.io import figures
from warpsar.io import html as report
from warpsar.products.product import RADIOMETRIES, Product, Radiometry
from warpsar.runtime import console, devices
from warpsar.runtime.threads import in_threads
from warpsar.simulation.outputs import make_folder, refuse_unwritable, write_json
from warpsar.terrain import files
from warpsar.terrain.blocks import Box, check_crop, places_in, places_on, window_of
from warpsar.terrain.buildings import TerrainBuildings, placed
from warpsar.terrain.comparison import TerrainComparison, compared
from warpsar.terrain.differences import TerrainDifferences, differences
from warpsar.terrain.elevation import Elevation
from warpsar.terrain.figures import comparison_figure, differences_figure, image_figure, map_figure
from warpsar.terrain.landcover import LandCover, table_of
from warpsar.terrain.result import SimulatedProduct, simulated
from warpsar.terrain.scenery import POLARIZATIONS, Scenery, surface_sigma0
from warpsar.terrain.summary import TwinSummary, summary
from warpsar.world.library.surfaces import SURFACES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SURFACE = "grass"
LANDCOVER_TABLE = "worldcover"


def twin(
    product: Product | PathLike[str] | str,
    dem: PathLike[str] | str,
    *,
    surface: str = SURFACE,
    landcover: PathLike[str] | str | None = None,
    landcover_table: str = LANDCOVER_TABLE,
    buildings: PathLike[str] | str | None = None,
    crop: Box | None = None,
    geoid_offset_m: float | None = None,
    polarization: str | None = None,
    radiometry: Radiometry | None = None,
    file_format: str = "auto",
    device: str | None = None,
    scratch: PathLike[str] | str | None = None,
) -> SimulatedProduct:
    """What a radar product should show of the ground: layers on the product's own grid and on the map.

    `product`: a file, a SAFE folder, or a product that is open. Of several sub-swaths it is the one that shows the
    ground; where several do, name an annotation file (the command makes a view of each). `dem`: a GeoTIFF of heights
    [m]. Where it does not say above what they are, or PROJ lacks the grid from there to the ellipsoid, `geoid_offset_m`
    is added to all of them. `surface`: one of the library, where `landcover` says nothing. `landcover`: a GeoTIFF of
    classes, which become surfaces by `landcover_table`: "worldcover", "corine", or a TOML file. `buildings`: GeoJSON or
    CityGML. `crop`: west, south, east, north [deg]; without it all that the DEM covers. `polarization` chooses an image
    where a product has several. `radiometry` says what power is where the product does not: "beta0", "sigma0" or
    "gamma0". Layers of more than 1 GiB are arrays in files without a name in `scratch`, by default in the folder for
    temporary files.

    Facets of the ground are brought to zero Doppler by the orbit and cut by the pixels, so their areas are exact. A ray
    from each piece to the radar says whether it is lit. beta0 is the sum of sigma0 times lit area over the pixel's area
    in the slant plane; sigma0 and gamma0 divide by the lit areas (Small 2011, IEEE Trans. Geosci. Remote Sens. 49(8)).

    Raises InputError for what cannot be read, for a product without an orbit, and where both do not overlap.
    """
    _refuse(surface, crop, radiometry, polarization)
    where = devices.resolve_device(device)
    views = {"": product} if isinstance(product, Product) else _opened(Path(product), polarization, file_format)
    views = {name: _stated(one, radiometry) for name, one in views.items()}
    ground = _Ground.read(dem, surface, landcover, landcover_table, buildings, crop, geoid_offset_m)
    shown, _ = ground.shown_in(views)
    if len(shown) > 1:
        sources = ", ".join(Path(one.source).name for one in shown.values())
        raise InputError(f"{product}: found {len(shown)} sub-swaths that show the ground; name one of {sources}")
    (one,) = shown.values()
    return ground.seen_by(one, where, None if scratch is None else Path(scratch))


@dataclass(frozen=True)
class _Ground:
    """What lies there, whoever looks."""

    elevation: Elevation
    surfaces: tuple[str, ...]
    cover: LandCover | None
    built: TerrainBuildings | None
    crop: Box | None

    @classmethod
    def read(
        cls,
        dem: PathLike[str] | str,
        surface: str,
        landcover: PathLike[str] | str | None,
        landcover_table: str,
        buildings: PathLike[str] | str | None,
        crop: Box | None,
        geoid_offset_m: float | None,
    ) -> _Ground:
        elevation = Elevation.read(Path(dem), geoid_offset_m)
        if crop is not None:
            check_crop(elevation, crop)
        surfaces = [surface]
        cover = built = None
        if landcover is not None:
            cover = LandCover.read(Path(landcover), table_of(landcover_table), surfaces, surface)
            if not cover.meets(*(places_on(elevation) if crop is None else places_in(crop))):
                where_not = f"{elevation.path}" if crop is None else "--crop"
                raise InputError(f"{cover.path}: it holds no place of {where_not}; must overlap")
        if buildings is not None:
            built = placed(Path(buildings), elevation, surfaces)
            elevation = replace(elevation, highest_m=max(elevation.highest_m, built.highest_m))
        return cls(elevation, tuple(surfaces), cover, built, crop)

    def shown_in(self, views: Mapping[str, Product]) -> tuple[dict[str, Product], dict[str, str]]:
        """The views that can show it, and why others cannot. Raises NothingShownError where none can."""
        shown: dict[str, Product] = {}
        refused: dict[str, str] = {}
        for name, one in views.items():
            try:
                window_of(one, self.elevation, self.crop)
            except NothingShownError as error:
                refused[name] = str(error)
            else:
                shown[name] = one
        if not shown:
            raise NothingShownError(next(iter(refused.values())))
        return shown, refused

    def seen_by(self, product: Product, device: wp.Device, scratch: Path | None) -> SimulatedProduct:
        sigma0 = np.stack([surface_sigma0(name, product) for name in self.surfaces])
        scenery = Scenery(self.surfaces, sigma0, self.cover, self.built)
        return simulated(product, self.elevation, scenery, self.crop, device, scratch)


def _refuse(surface: str, crop: Box | None, radiometry: str | None, polarization: str | None) -> None:
    if surface not in SURFACES:
        raise InputError(
            f"--surface: found {surface!r}; must be one of {', '.join(SURFACES)}{did_you_mean(surface, SURFACES)}"
        )
    if radiometry is not None and radiometry not in RADIOMETRIES:
        raise InputError(f"--radiometry: found {radiometry!r}; must be one of {', '.join(RADIOMETRIES)}")
    if polarization is not None and polarization not in POLARIZATIONS:
        raise InputError(f"--polarization: found {polarization!r}; must be one of {', '.join(POLARIZATIONS)}")
    if crop is None:
        return
    west, south, east, north = crop
    inside = -180.0 <= west < east <= 360.0 and -90.0 <= south < north <= 90.0
    if not all(map(math.isfinite, crop)) or not inside:
        raise InputError(
            f"--crop: found {west:g} {south:g} {east:g} {north:g}; must be west, south, east and north in degrees, "
            "west below east and south below north"
        )


def _stated(product: Product, radiometry: Radiometry | None) -> Product:
    """A product whose power is known by what the user says, where the file does not."""
    _ = product.required_orbit  # before the elevation model is read
    return product if radiometry is None or product.radiometry is not None else replace(product, radiometry=radiometry)


def _opened(path: Path, polarization: str | None, file_format: str) -> dict[str, Product]:
    """The images of a product, by sub-swath. Raises InputError where a sub-swath has several."""
    found = registry.products(path, file_format=file_format, polarization=polarization, option="--product-format")
    views = {_view_name(one): one for one in found}
    if len(views) == len(found):
        return views
    names = list(dict.fromkeys(Path(one.source).name for one in found))
    kinds = sorted({one.polarization or "unknown" for one in found})
    if len(kinds) > 1:
        raise InputError(f"{path}: found images of the polarizations {', '.join(kinds)}; state one by --polarization")
    raise InputError(f"{path}: found {len(found)} images ({', '.join(names)}); name one of these files")


def _view_name(product: Product) -> str:
    """The sub-swath, as a folder may be called."""
    name = (product.platform.split() or [""])[-1]
    return name if re.fullmatch(r"\w{1,16}", name, re.ASCII) else Path(product.source).stem


def run(
    product: Path,
    dem: Path,
    out: Path,
    *,
    surface: str = SURFACE,
    landcover: Path | None = None,
    landcover_table: str = LANDCOVER_TABLE,
    buildings: Path | None = None,
    crop: Box | None = None,
    geoid_offset_m: float | None = None,
    polarization: str | None = None,
    radiometry: Radiometry | None = None,
    file_format: str = "auto",
    formats: Sequence[str] = ("geotiff",),
    device: str | None = None,
    command: Sequence[str] = (),
) -> dict[str, Any]:
    """`warpsar twin`: the files in `out`. Returns the JSON's content. Raises InputError and DeviceError."""
    started = time.perf_counter()
    for one in formats:
        if one in files.EXTRAS:
            files.EXTRAS[one].require(f"--format {one}:")
    if landcover is None and landcover_table != LANDCOVER_TABLE:
        raise InputError(f"--landcover-table: found {landcover_table!r} without --landcover; state that, too")
    where = devices.resolve_device(device)
    console.say_device(where)
    refuse_unwritable(out)
    disk = next(each for each in (out, *out.absolute().parents) if each.exists())
    _refuse(surface, crop, radiometry, polarization)
    views = {name: _stated(one, radiometry) for name, one in _opened(product, polarization, file_format).items()}
    ground = _Ground.read(dem, surface, landcover, landcover_table, buildings, crop, geoid_offset_m)
    for one in formats:
        if one in files.EXTRAS:
            files.refuse_askew(ground.elevation, f"--format {one}")
    shown, refused = ground.shown_in(views)
    settings = {
        "crop": crop,
        "geoid_offset_m": geoid_offset_m,
        "radiometry": radiometry,
        "landcover_table": landcover_table,
        "formats": list(formats),
    }
    inputs = (dem, *filter(None, (landcover, buildings)))

    def write(one: Product, folder: Path, began: float) -> dict[str, Any]:
        found = ground.seen_by(one, where, disk)
        make_folder(folder)  # nothing is written for what is refused
        return _written(found, folder, inputs, formats, settings, where, began, command)

    if refused:
        console.say(f"twin: the ground is in {', '.join(shown)}, and not in {', '.join(refused)}")
    if len(shown) == 1:
        return write(next(iter(shown.values())), out, started)
    contents: dict[str, Any] = {}
    for name, view in shown.items():
        console.say(f"twin: {name}")
        try:
            contents[name] = write(view, out / name, time.perf_counter())
        except NothingShownError as error:  # ground there may be without data
            refused[name] = str(error)
    if not contents:
        raise NothingShownError(next(iter(refused.values())))
    digest = _digest(*(Path(one.source) for one in shown.values()), *inputs)
    return _write_views(out, product, digest, contents, refused, settings, where, started, command)


def _written(
    found: SimulatedProduct,
    out: Path,
    inputs: Sequence[Path],
    formats: Sequence[str],
    settings: dict[str, Any],
    where: wp.Device,
    started: float,
    command: Sequence[str],
) -> dict[str, Any]:
    """One view's files, and its JSON's content. `inputs`: what was read beside the product."""
    overall, against, differs = summary(found), compared(found), differences(found)
    layers: dict[str, Callable[[], None]] = {}
    for one in dict.fromkeys(formats):
        layers |= files.writers(found, out, one)
    drawn = _figures(found, against, differs)

    def draw() -> None:  # one after the other: Matplotlib works in one thread
        for name, figure in drawn.items():
            figures.save(figure, out / name)

    # the largest part of the time is packing of tiles, which holds no lock
    tasks = [draw, *layers.values()]
    # copies of layers that do not fit into memory take room on the disk, so one follows the other
    list((task() for task in tasks) if found.forecast.in_files else in_threads(tasks))
    written = [*layers, *drawn]
    source = Path(found.product.source)
    content = {
        "input": {"scene": source.name, "sha256": _digest(source, *inputs)},
        **files.facts(found),
        "window": {"lines": list(found.window.lines), "pixels": list(found.window.pixels)},
        "map_shape": list(next(iter(found.map.values())).shape),
        "blocks": found.forecast.blocks,
        "forecast": found.forecast.content(),
        **overall.content(),
        "comparison": against.content() if isinstance(against, TerrainComparison) else against,
        "differences": differs.content() if isinstance(differs, TerrainDifferences) else differs,
        "files": [*written, "report.html"],
        "settings": settings,
    }
    content = write_json(out / "twin.json", None, where, None, started, content)
    write_report(out / "report.html", overall, against, differs, {name: out / name for name in drawn}, content, command)
    console.say_written(out, "report.html", "twin.json", *written)
    print("\n".join([*overall.words, *words_of(against), *words_of(differs)]))
    return content


def _write_views(
    out: Path,
    product: Path,
    digest: str,
    contents: dict[str, Any],
    refused: Mapping[str, str],
    settings: dict[str, Any],
    where: wp.Device,
    started: float,
    command: Sequence[str],
) -> dict[str, Any]:
    """What leads to the views of several sub-swaths: report.html and twin.json in `out`. Returns the JSON's content."""
    one = next(iter(contents.values()))
    content = {
        "input": {"scene": product.name, "sha256": digest},
        "product": product.name,
        "acquired": one["acquired"],
        "views": {name: f"{name}/twin.json" for name in contents},
        "without_ground": dict(refused),
        "files": [*(f"{name}/{file}" for name, each in contents.items() for file in each["files"]), "report.html"],
        "settings": settings,
    }
    content = write_json(out / "twin.json", None, where, None, started, content)
    intro = f"warpsar twin {content['version']}; {product.name}, {one['acquired'][:19]} UTC"
    sections = [
        report.section(
            name,
            *(report.paragraph(_sentence(each)) for each in words_in(of)),
            report.picture((out / name / "map.png").read_bytes(), CAPTIONS["map.png"]),
            report.link(f"{name}/report.html", f"Report of {name}"),
        )
        for name, of in contents.items()
    ]
    if refused:
        sections.append(
            report.section(
                "Without ground", report.bullets([_sentence(f"{name}: {why}") for name, why in refused.items()])
            )
        )
    sections.append(
        report.reproduce(content, list(command) or ["warpsar", "twin"], f"Beside this file: {_beside(content)}.")
    )
    report.write(
        out / "report.html", report.page("What the product should show: a view of each sub-swath", intro, *sections)
    )
    console.say_written(out, "report.html", "twin.json")
    return content


def words_in(content: Mapping[str, Any]) -> list[str]:
    """What a view's JSON says, a line each."""
    sentences = list(content["words"])
    for key in ("comparison", "differences"):
        answer = content[key]
        sentences += [] if answer is None else [answer] if isinstance(answer, str) else answer["words"]
    return sentences


def _figures(
    found: SimulatedProduct,
    against: TerrainComparison | str | None,
    differs: TerrainDifferences | str | None,
) -> dict[str, Figure]:
    """The pictures by their file names."""
    drawn = {"image.png": image_figure(found), "map.png": map_figure(found)}
    if isinstance(against, TerrainComparison):
        drawn["comparison.png"] = comparison_figure(found, against)
    if isinstance(differs, TerrainDifferences):
        drawn["differences.png"] = differences_figure(found, differs)
    return drawn


def _digest(*paths: Path) -> str:
    """Of the annotation, or of the image file, and of what else was read, one after the other."""
    total = hashlib.sha256()
    for path in paths:
        with path.open("rb") as file:
            while piece := file.read(2**20):
                total.update(piece)
    return total.hexdigest()


# ---- report.html


CAPTIONS = {
    "image.png": "On the product's grid: lines downward, pixels to the right. Blue: no ground, or nothing is seen",
    "map.png": "On the map",
    "comparison.png": "Cells of the measured and the simulated image, and what is left, less its median",
    "differences.png": "Cells of the measured image less the model [dB], without and with what was found",
}
LIMITS = (
    "One bounce, surfaces of the library at their median levels. No trees, and no speckle.",
    "Places are those of orbit and annotation. Atmosphere, tides and the product's own timing are not corrected.",
    "At the near edge of the elevation model nothing throws a shadow from outside of it.",
    "A ray to the radar starts at the middle of each piece of a facet: borders of shadow are right to about half a "
    "pixel.",
)


def write_report(
    path: Path,
    overall: TwinSummary,
    against: TerrainComparison | str | None,
    differs: TerrainDifferences | str | None,
    drawn: Mapping[str, Path],
    content: dict[str, Any],
    command: Sequence[str],
) -> None:
    """`drawn` are files of pictures, `content` is that of twin.json, `command` the words that made it."""
    intro = f"warpsar twin {content['version']}; {content['product']}, {content['acquired'][:19]} UTC"
    pictures = {name: report.picture(file.read_bytes(), CAPTIONS[name]) for name, file in drawn.items()}
    compared = [report.paragraph(_sentence(each)) for each in words_of(against)]
    if against is not None:
        compared += [pictures.pop("comparison.png")] if "comparison.png" in pictures else []
    differences = [report.paragraph(_sentence(each)) for each in words_of(differs)]
    if isinstance(differs, TerrainDifferences):
        columns = ["hypothesis", "value", "95 %, low", "95 %, high", "unit", "2 ln L on the other half", "named"]
        rows = [
            [one.name, f"{one.value:+.2f}", f"{one.low:+.2f}", f"{one.high:+.2f}", one.unit, f"{one.gain:.0f}",
             "yes" if one.named else "no: expected"]
            for one in differs.found
        ]  # fmt: skip
        differences += [pictures.pop("differences.png")]
        if rows:
            differences.append(report.table(columns, rows, "Chosen in half of the squares, confirmed in the other"))
        differences += [report.paragraph(f"Asked: {', '.join(differs.asked)}.")]
    rows = [[one.name, one.unit, *(f"{value:.4g}" for value in one.percentiles), one.words] for one in overall.layers]
    columns = ["layer", "unit", "5 %", "median", "95 %", "what it is"]
    names = (
        *("platform", "polarization", "look_side", "elevation_model", "vertical_datum", "surfaces"),
        *("landcover", "buildings", "pixels", "first_line", "first_pixel"),
    )
    facts = [("frequency", f"{content['frequency_hz'] / 1e9:.4g} GHz")]
    facts += [(name.replace("_", " "), str(content[name])) for name in names]
    sections = [
        report.section("In short", *(report.paragraph(_sentence(each)) for each in overall.words)),
        *([report.section("Measured beside simulated", *compared)] if compared else []),
        *([report.section("What differs", *differences)] if differences else []),
        report.section("Pictures", *pictures.values()),
        report.section("Layers", report.table(columns, rows, "Percentiles over the pixels with ground", (5,))),
        report.section("What is left out", report.bullets(LIMITS)),
        report.section("Product", report.facts(facts)),
        report.reproduce(content, list(command) or ["warpsar", "twin"], f"Beside this file: {_beside(content)}."),
    ]
    report.write(path, report.page("What the product should show", intro, *sections))


def words_of(answer: TerrainComparison | TerrainDifferences | str | None) -> list[str]:
    """What an answer says, a line each; nothing where there is none."""
    if answer is None:
        return []
    return [answer] if isinstance(answer, str) else list(answer.words)


def _sentence(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}."


def _beside(content: dict[str, Any]) -> str:
    return ", ".join(["twin.json", *(name for name in content["files"] if name != "report.html")])
