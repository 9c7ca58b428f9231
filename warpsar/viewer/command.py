"""The command `view`: a page that shows a scene in 3D, with its views and images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from warpsar.errors import InputError
from warpsar.io.html import write
from warpsar.runtime import console
from warpsar.scene.scene import Scene
from warpsar.simulation.outputs import make_folder
from warpsar.simulation.strong_scatterers import read_csv
from warpsar.version import __version__
from warpsar.viewer.drapes import drapes
from warpsar.viewer.page import State, page
from warpsar.viewer.points import with_points
from warpsar.viewer.surface import drawn


def run(
    path: Path,
    out: Path,
    *,
    before: Path | None = None,
    scatterers: Path | None = None,
    device: str | None = None,
) -> Path:
    """Write `view.html` into the folder `out`, and return its path. `path` is a scene file, or a folder with a
    scene.toml as `learn` and `diagnose` leave it; `before` is a scene to compare it with; `scatterers` a list of
    `simulate`, shown in `path`. Raises InputError."""
    given = [("before", before), ("after", path)] if before is not None else [("scene", path)]
    scenes = [(name, _loaded(one)) for name, one in given]
    points = None if scatterers is None else read_csv(scatterers)
    make_folder(out)
    bar = console.progress(len(scenes), "view", "scene")
    states = []
    for name, scene in scenes:
        console.warn(scene.warnings)
        shown = drapes(scene, device) if scene.views else []
        states.append(State(name, drawn(scene), shown, scene.grid.shape, scene.grid.spacing_m))
        bar.update()
    bar.close()
    if points is not None:
        states[-1] = replace(states[-1], surface=with_points(states[-1].surface, scenes[-1][1], *points))
    scene = scenes[-1][1]
    faces, views = len(scene.mesh.faces), len(scene.views)
    title = Path(scene.path).parent.name + "/" + Path(scene.path).name if scene.path else "scene"
    summary = f"warpsar {__version__} view; {faces:,} triangles, {views} view{'s' * (views != 1)}"
    write(out / "view.html", page(title, summary, states))
    return out / "view.html"


def _loaded(path: Path) -> Scene:
    file = path / "scene.toml" if path.is_dir() else path
    if not file.is_file():
        raise InputError(f"{path}: found no scene.toml in it; must be a scene file, or a folder of learn or diagnose")
    return Scene.load(file)
