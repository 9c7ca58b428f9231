"""The files of `warpsar simulate`: of each view, in the formats asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from warpsar.effects.base.phase import Response
from warpsar.io.quick_look import QuickLook
from warpsar.runtime.busy import busy
from warpsar.simulation.formats import registry
from warpsar.simulation.ground import MapGround
from warpsar.simulation.speckle import SHARP, speckled, suffix
from warpsar.simulation.strong_scatterers import StrongScatterers, write_csv, write_ply
from warpsar.simulation.view import SimulatedView
from warpsar.world.mesh import Mesh


def refuse_formats(formats: Sequence[str]) -> None:
    """Raise InputError where a library that a format needs is not there, before any work."""
    for name in formats:
        if (extra := registry.get(name).extra) is not None:
            extra.require(f"--format {name}:")


@dataclass(frozen=True)
class Output:
    """What is written of each view into the folder `out`; `seed` is that of the speckle.

    `formats`: names of them; `exr_speckle` writes EXR of a speckled image anyway. `ground`: where images on the
    ground lie; without it none is written.
    """

    out: Path
    seed: int
    looks: float | None = None
    formats: tuple[str, ...] = ("exr",)
    exr_speckle: bool = False
    responses: Mapping[str, Response] = field(default_factory=dict)
    """Of every view, by name: what makes the speckle of neighbours alike."""
    ground: MapGround | None = None
    mesh: Mesh | None = None
    """Whose faces scatterers name."""
    looks_at: list[QuickLook] = field(default_factory=list)
    """Quick looks of the views written so far: they are drawn when the scale of all is known."""

    def write(self, view: SimulatedView, index: int) -> dict[str, Any]:
        """The files of the scene's view number `index`, and what simulate.json says of it."""
        files = {"quick_look": self._quick_look(view, view.name)}
        files |= self._image(view, view.name, "image")
        if view.scatterers is not None:
            files |= self._scatterers(view, view.scatterers)
        content = {
            "name": view.name,
            "files": files,
            "rays": view.rays,
            "hits": view.hits,
            "lit_fraction": view.lit_fraction,
            "mean_beta0": {p: float(image.mean(dtype=float)) for p, image in view.beta0.items()},
            **view.metadata,
        }
        if self.looks is not None:
            name, noisy = view.name + suffix(self.looks), self._with_speckle(view, index, self.looks)
            files["speckled_quick_look"] = self._quick_look(noisy, name)
            files |= self._image(noisy, name, "speckled")
            content["looks"] = self.looks
        return content

    def _scatterers(self, view: SimulatedView, found: StrongScatterers) -> dict[str, str]:
        table, points = (f"{view.name}_scatterers.{kind}" for kind in ("csv", "ply"))
        assert self.mesh is not None
        write_csv(found, self.mesh, self.out / table)
        write_ply(found, self.out / points)
        return {"scatterers": table, "scatterers_ply": points}

    def _quick_look(self, view: SimulatedView, name: str) -> str:
        """Keep a quick look of the view for later; the name of its file."""
        facts = view.metadata
        title = f"{name}: azimuth {facts['azimuth_deg']:g}°, incidence {facts['incidence_deg']:g}°"
        path = self.out / f"{name}.png"
        self.looks_at.append(QuickLook.of(path, title, view.beta0, facts["spacing_m"], view.covered))
        return f"{name}.png"

    def _image(self, view: SimulatedView, name: str, key: str) -> dict[str, str]:
        """A view's files in every format asked for, by what simulate.json calls them: the first is `key` itself."""
        formats = self.formats
        if key == "speckled" and self.exr_speckle and "exr" not in formats:
            formats = (*formats, "exr")
        files: dict[str, str] = {}
        for each in formats:
            for what, file, write in registry.get(each).parts(view, name, self.ground):
                with busy(f"{view.name}: writing {file}"):
                    write(self.out / file)
                if what and key == "speckled":
                    what = f"{key}_{what}"
                files[what or (f"{key}_{each}" if key in files else key)] = file
        return files

    def _with_speckle(self, view: SimulatedView, index: int, looks: float) -> SimulatedView:
        beta0 = {
            pol: speckled(
                image,
                looks,
                seed=self.seed,
                view=index,
                polarization=pol,
                response=self.responses.get(view.name, SHARP),
                spacing_m=view.metadata["spacing_m"],
            )
            for pol, image in view.beta0.items()
        }
        metadata = {**view.metadata, "looks": looks, "speckle_seed": self.seed}
        return replace(view, beta0=beta0, looks=looks, metadata=metadata, layers={}, sampling_variance={})


KINDS = {
    "image": "beta0",
    "quick_look": "quick look, dB",
    "layers": "layers",
    "scatterers": "strongest scatterers",
    "scatterers_ply": "strongest scatterers, points",
    "ground": "beta0 on the ground",
    "speckled_quick_look": "quick look with speckle, dB",
    "speckled": "beta0 with speckle",
    "speckled_ground": "beta0 with speckle on the ground",
}
"""What simulate.json calls a view's files, and what they are."""


def written(out: Path, content: dict[str, Any]) -> str:
    """What lies in `out` now, a line for each kind of file, from the content of simulate.json."""
    names: dict[str, list[str]] = {}
    for view in content["views"]:
        for kind, name in view["files"].items():
            names.setdefault(kind, []).append(name)
    lines = [f"{out}:"]
    for kind, files in names.items():
        shown = ", ".join(files[:2]) + (f" and {len(files) - 2} more" if len(files) > 2 else "")
        plain, _, form = kind.partition("_") if kind not in KINDS else (kind, "", "")
        lines.append(f"  {KINDS[plain]}{' as ' + form if form else ''}: {shown}")
    lines.append(f"  facts: simulate.json{', ' + content['scene'] if 'scene' in content else ''}")
    return "\n".join(lines)
