"""Images of an independent renderer, declared otherwise: what does `warpsar diagnose` say of what is wrong then?

    python benchmarks/redeclared.py run CASES -o out/redeclared [--only NAME] [--jobs 2] [--minutes 5]
    python benchmarks/redeclared.py table -o out/redeclared [--write]

CASES is the folder of cases with known effects, each a scene.toml, scene.obj and images that nothing of this package
made. A trial takes one of them. It changes what the scene file or the mesh declares, or what an image holds, so that
one thing is wrong, or two, or something that has no name here. The images stay what another program made of the truth.
docs/diagnosis-rates.md has the results.
"""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import click
import numpy as np
import runs
import tables
import trimesh

from warpsar.diagnosis import command
from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.io.images import read_channel, write_tiff

Group = tuple[np.ndarray, list[list[int]], str]
"""Vertices, faces and material of a part of the mesh."""
Mesh = dict[str, Group]
ChangesMesh = Callable[[Mesh], None]
ChangesText = Callable[[str], str]
ChangesImage = Callable[[str, np.ndarray], np.ndarray]
UNNAMED = "something without a name here"


@dataclass(frozen=True)
class Redeclaration:
    """A case that is changed: its mesh, the text of its scene file, and its images by their names. `wrong`: the names
    that are right; none where nothing is wrong."""

    base: str
    wrong: tuple[str, ...] = ()
    mesh: tuple[ChangesMesh, ...] = ()
    text: tuple[ChangesText, ...] = ()
    image: ChangesImage | None = field(default=None)


# ---- meshes


def read_mesh(path: Path) -> Mesh:
    groups: Mesh = {}
    first = count = 0
    for words in map(str.split, path.read_text().splitlines()):
        match words:
            case ["o", name]:
                first = count
                vertices: list[list[float]] = []
                faces: list[list[int]] = []
                groups[name] = (np.zeros((0, 3)), faces, name)
            case ["v", *place]:
                vertices.append([float(one) for one in place])
                groups[name] = (np.array(vertices), faces, name)
                count += 1
            case ["f", *corners]:
                faces.append([int(one) - 1 - first for one in corners])
    return groups


def write_mesh(mesh: Mesh, path: Path) -> None:
    lines, first = ["mtllib scene.mtl"], 1
    for name, (vertices, faces, material) in mesh.items():
        lines += [f"o {name}", f"usemtl {material}"]
        lines += ["v {:.6f} {:.6f} {:.6f}".format(*place) for place in vertices]
        lines += ["f " + " ".join(str(first + corner) for corner in face) for face in faces]
        first += len(vertices)
    path.write_text("\n".join(lines) + "\n")


def height(body: str, metres: float) -> ChangesMesh:
    def change(mesh: Mesh) -> None:
        vertices = mesh[body][0]
        vertices[vertices[:, 2] > 0.0, 2] = metres

    return change


def moved(body: str, east_m: float, north_m: float, turn_deg: float = 0.0) -> ChangesMesh:
    def change(mesh: Mesh) -> None:
        plan, angle = mesh[body][0][:, :2], np.radians(turn_deg)
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        middle = plan.mean(axis=0)
        plan[:] = (plan - middle) @ turn + middle + (east_m, north_m)

    return change


def wider(body: str, east_m: float, north_m: float) -> ChangesMesh:
    def change(mesh: Mesh) -> None:
        plan = mesh[body][0][:, :2]
        middle = plan.mean(axis=0)
        plan[:] = (plan - middle) * (1.0 + np.array([east_m, north_m]) / np.ptp(plan, axis=0)) + middle

    return change


def removed(body: str) -> ChangesMesh:
    def change(mesh: Mesh) -> None:
        del mesh[body]

    return change


def added(low: tuple[float, float, float], high: tuple[float, float, float], material: str) -> ChangesMesh:
    def change(mesh: Mesh) -> None:
        box = trimesh.creation.box(bounds=[low, high])
        mesh["more"] = np.array(box.vertices), box.faces.tolist(), material

    return change


def gable(body: str, rise_m: float) -> ChangesMesh:
    """A ridge from west to east over a box whose roof is flat."""

    def change(mesh: Mesh) -> None:
        vertices, faces, material = mesh[body]
        (west, south, _), (east, north, top) = vertices.min(axis=0), vertices.max(axis=0)
        middle, high = (south + north) / 2.0, top + rise_m
        roof = {
            (x > (west + east) / 2.0, y > middle): k for k, (x, y, z) in enumerate(vertices) if z > 0.0
        }  # eastern, northern
        ridge_west, ridge_east = len(vertices), len(vertices) + 1
        kept = [face for face in faces if not set(face) <= set(roof.values())]
        a, b, c, d = (roof[corner] for corner in ((False, False), (True, False), (True, True), (False, True)))
        slopes = [[a, b, ridge_east], [a, ridge_east, ridge_west], [c, d, ridge_west], [c, ridge_west, ridge_east]]
        ends = [[d, a, ridge_west], [b, c, ridge_east]]
        whole = np.vstack([vertices, [[west, middle, high], [east, middle, high]]])
        mesh[body] = whole, [*kept, *slopes, *ends], material

    return change


def tilted(degrees: float) -> ChangesMesh:
    def change(mesh: Mesh) -> None:
        vertices = mesh["ground"][0]
        vertices[:, 2] += np.tan(np.radians(degrees)) * vertices[:, 0]

    return change


# ---- scene files


def angle(key: str, off_deg: float, only: str | None = None) -> ChangesText:
    def change(text: str) -> str:
        head, *views = text.split("[[views]]")
        for number, view in enumerate(views):
            if only is None or f'name = "{only}"' in view:
                views[number] = re.sub(
                    rf"{key} = ([\d.]+)", lambda found: f"{key} = {(float(found[1]) + off_deg) % 360.0}", view
                )
        return "[[views]]".join([head, *views])

    return change


def azimuth(off_deg: float, only: str | None = None) -> ChangesText:
    return angle("azimuth_deg", off_deg, only)


def incidence(off_deg: float, only: str | None = None) -> ChangesText:
    return angle("incidence_deg", off_deg, only)


def spacing(range_m: float, azimuth_m: float) -> ChangesText:
    return lambda text: re.sub(r"spacing_m = \[[^]]*\]", f"spacing_m = [{range_m}, {azimuth_m}]", text)


def looks(number: float) -> ChangesText:
    return lambda text: re.sub(r"looks = [\d.]+", f"looks = {number}", text)


# ---- images


def gains(**factors: float) -> ChangesImage:
    return lambda name, image: image * np.float32(factors.get(name, 1.0))


def rolled(only: str, rows: int) -> ChangesImage:
    return lambda name, image: np.roll(image, rows, axis=0) if name == only else image


def smeared(name: str, image: np.ndarray) -> np.ndarray:
    """A bright patch over 14 pixels of azimuth in three views, as of what moves."""
    changed = image.copy()
    if name in ("az090", "az180", "az225"):
        changed[90:100, 20:34] += 0.8 * np.random.default_rng(2).gamma(16.0, 1.0 / 16.0, (10, 14))
    return changed


TOWER, BRICK, CONCRETE = "tower", "brick", "concrete"
TRIALS = {
    "nothing": Redeclaration("none"),
    "azimuth of one": Redeclaration("none", ("view_angles",), text=(azimuth(1.0, "az225"),)),
    "azimuth of a test view": Redeclaration("none", ("view_angles",), text=(azimuth(1.5, "az180"),)),
    "azimuth of two": Redeclaration("none", ("view_angles",), text=(azimuth(1.0, "az225"), azimuth(-0.8, "az000"))),
    "azimuth of all": Redeclaration("none", ("view_angles",), text=(azimuth(0.9),)),
    "incidence of one": Redeclaration("none", ("view_angles",), text=(incidence(-0.9, "az090"),)),
    "incidence of all": Redeclaration("none", ("view_angles",), text=(incidence(-0.6),)),
    "both angles of one": Redeclaration(
        "none", ("view_angles",), text=(azimuth(1.0, "az090"), incidence(0.8, "az090"))
    ),
    "spacing in azimuth": Redeclaration("none", ("pixel_spacing",), text=(spacing(0.5, 0.491),)),
    "spacing in range": Redeclaration("none", ("pixel_spacing",), text=(spacing(0.512, 0.5),)),
    "both spacings": Redeclaration("none", ("pixel_spacing",), text=(spacing(0.508, 0.508),)),
    "tower too low": Redeclaration("none", ("object_size",), (height(TOWER, 7.6),)),
    "house too high": Redeclaration("none", ("object_size",), (height(CONCRETE, 7.2),)),
    "house too wide": Redeclaration("none", ("object_size",), (wider(BRICK, 1.0, 0.0),)),
    "tower moved": Redeclaration("none", ("object_pose",), (moved(TOWER, 0.6, 0.4),)),
    "house turned": Redeclaration("none", ("object_pose",), (moved(CONCRETE, 0.0, 0.0, 4.0),)),
    "two moved": Redeclaration("none", ("object_pose",), (moved(CONCRETE, 0.6, 0.0), moved(BRICK, 0.0, -0.6))),
    "no tower": Redeclaration("none", ("missing_object",), (removed(TOWER),)),
    "no house": Redeclaration("none", ("missing_object",), (removed(BRICK),)),
    "one house more": Redeclaration("none", ("absent_object",), (added((-18, -18, 0), (-12, -14, 3.5), CONCRETE),)),
    "an annex more": Redeclaration("none", ("absent_object",), (added((-5, 2, 0), (-2, 6, 3), CONCRETE),)),
    "fewer looks": Redeclaration("none", ("looks",), text=(looks(10.0),)),
    "more looks": Redeclaration("none", ("looks",), text=(looks(24.0),)),
    "gain of one": Redeclaration("none", ("view_gain",), image=gains(az135=1.32)),
    "gains of two": Redeclaration("none", ("view_gain",), image=gains(az000=1.3, az225=0.8)),
    "shift of one": Redeclaration("none", ("aim_point",), image=rolled("az225", 1)),
    "gabled roof": Redeclaration("none", (UNNAMED,), (gable(BRICK, 2.0),)),
    "tilted ground": Redeclaration("none", (UNNAMED,), (tilted(1.5),)),
    "smears": Redeclaration("none", (UNNAMED,), image=smeared),
    "mirrored images": Redeclaration("none", (UNNAMED,), image=lambda name, image: image[:, ::-1]),
    "floor, house too high": Redeclaration("noise_floor", ("noise_floor", "object_size"), (height(BRICK, 5.0),)),
    "floor, spacing": Redeclaration("noise_floor", ("noise_floor", "pixel_spacing"), text=(spacing(0.5, 0.491),)),
    "floor, a test view": Redeclaration("noise_floor", ("noise_floor", "view_angles"), text=(azimuth(1.2, "az045"),)),
    "floor, gabled roof": Redeclaration("noise_floor", ("noise_floor", UNNAMED), (gable(BRICK, 2.0),)),
    "blur, incidence": Redeclaration("point_spread", ("point_spread", "view_angles"), text=(incidence(0.7),)),
    "blur, house too high": Redeclaration("point_spread", ("point_spread", "object_size"), (height(CONCRETE, 7.0),)),
    "shift, no house": Redeclaration("registration", ("registration", "missing_object"), (removed(BRICK),)),
    "texture, azimuth": Redeclaration("texture", ("texture", "view_angles"), text=(azimuth(1.2, "az315"),)),
    "bounces, spacing": Redeclaration("multibounce", ("multibounce", "pixel_spacing"), text=(spacing(0.5, 0.49),)),
    "antenna, tower moved": Redeclaration(
        "antenna_pattern", ("antenna_pattern", "object_pose"), (moved(TOWER, 0.7, -0.4),)
    ),
    "missing box, looks": Redeclaration("missing_object", ("missing_object", "looks"), text=(looks(9.0),)),
    "missing box, tower": Redeclaration("missing_object", ("missing_object", "object_size"), (height(TOWER, 7.8),)),
    "looks, tower moved": Redeclaration("looks_wrong", ("looks", "object_pose"), (moved(TOWER, 0.7, 0.6),)),
    "house, a test view": Redeclaration("tall", ("object_size", "view_angles"), text=(azimuth(1.2, "az270"),)),
    "spacing, house too low": Redeclaration("spacing_off", ("pixel_spacing", "object_size"), (height(CONCRETE, 5.2),)),
    "gain, house moved": Redeclaration(
        "none", ("view_gain", "object_pose"), (moved(BRICK, 0.6, 0.0),), image=gains(az090=1.41)
    ),
}


def make(trial: Redeclaration, cases: Path, folder: Path) -> Path:
    """The trial's scene file, in `folder` with all that it names."""
    shutil.copytree(cases / trial.base, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("truth.json"))
    mesh, path = read_mesh(folder / "scene.obj"), folder / "scene.toml"
    for change in trial.mesh:
        change(mesh)
    write_mesh(mesh, folder / "scene.obj")
    text = path.read_text()
    for edit in trial.text:
        text = edit(text)
    present = {material for _, _, material in mesh.values()}
    tables_of = r"\[materials\.(\w+)\]\n(?:.+\n)+\n"
    path.write_text(re.sub(tables_of, lambda found: found[0] if found[1] in present else "", text))
    for image in sorted(folder.glob("*.tif")) if trial.image else ():
        write_tiff(image, np.ascontiguousarray(trial.image(image.stem, read_channel(image)), np.float32))
    return path


def run_trial(name: str, cases: Path, out: Path, minutes: float, device: str | None) -> runs.Row:
    """One trial's verdict."""
    folder = out / re.sub(r"\W+", "_", name)
    scene = make(TRIALS[name], cases, folder / "given")
    options = DiagnoseOptions(time_limit_s=60.0 * minutes)
    started = time.perf_counter()
    content = command.run(scene, folder / "found", device=device, options=options)
    keys = ("verdict", "unexplained", "not_established", "not_asked")
    after = content["after"]["test"] or content["after"]["train"]
    took = {"wall_s": time.perf_counter() - started, "deviance": after["deviance"]}
    return {"name": name, **took, **{key: content.get(key) for key in keys}}


def outcome(row: runs.Row) -> str:
    """How the verdict compares with what is wrong."""
    wrong, said = set(TRIALS[row["name"]].wrong), set(row["verdict"])
    if said - wrong:
        return "false name"
    if UNNAMED in wrong:
        return "right" if row["unexplained"] else "false all-clear"
    if said == wrong:
        return "right" if not row["unexplained"] else "named, unexplained"
    return "unexplained" if row["unexplained"] else "missed"


@click.group(help=__doc__)
def main() -> None:
    """The commands `run` and `table`."""


@main.command()
@click.argument("cases", type=click.Path(exists=True, file_okay=False, path_type=Path))
@runs.out
@click.option("--only", multiple=True, type=click.Choice(list(TRIALS)), help="These trials; by default all.")
@runs.jobs(2)
@runs.minutes(5.0)
@runs.device
@runs.max_time
def run(
    cases: Path, out: Path, only: tuple[str, ...], jobs: int, minutes: float, device: str | None, max_time: float
) -> None:
    """Diagnose the trials; none is made twice."""
    runs.append(
        out,
        only or list(TRIALS),
        run_trial,
        lambda row: f"{row['name']}: {outcome(row)}",
        cases,
        out,
        minutes,
        device,
        jobs=jobs,
        max_time=max_time,
        key_of=lambda row: row["name"],
    )


@runs.table(main)
def table(rows: list[runs.Row]) -> dict[str, str]:
    """The verdict on each trial."""
    found = {row["name"]: row for row in rows}
    lines = [
        [
            name,
            ", ".join(trial.wrong) or "nothing",
            ", ".join(row["verdict"]) or "nothing",
            "yes" if row["unexplained"] else "",
            outcome(row) + (", time over" if row["not_asked"] else ""),
            f"{row['deviance']:.3f}",
            f"{row['wall_s']:.0f}",
        ]
        for name, trial in TRIALS.items()
        if (row := found.get(name)) is not None
    ]
    head = ["trial", "wrong", "named", "unexplained", "outcome", "test deviance", "time [s]"]
    return {"redeclared": tables.markdown(head, lines)}


if __name__ == "__main__":
    main()
