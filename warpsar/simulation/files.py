"""The files of `warpsar simulate`: of each view, in the formats asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from warpsar.io.images import quick_look, write_exr
from warpsar.runtime.busy import busy
from warpsar.simulation.speckle import speckled, suffix
from warpsar.simulation.view import SimulatedView


@dataclass(frozen=True)
class Output:
    """What is written of each view into the folder `out`; `seed` is that of the speckle."""

    out: Path
    seed: int
    looks: float | None = None

    def write(self, view: SimulatedView, index: int) -> dict[str, Any]:
        """The files of the scene's view number `index`, and what simulate.json says of it."""
        files = {"quick_look": f"{view.name}.png"}
        with busy(f"{view.name}: writing {files['quick_look']}"):
            quick_look(self.out / files["quick_look"], next(iter(view.beta0.values())))
        files |= self._image(view, view.name, "image")
        extra = view.channels()
        if extra:
            files["layers"] = f"{view.name}_layers.exr"
            write_exr(self.out / files["layers"], extra, view.metadata)
        said = {
            "name": view.name,
            "files": files,
            "rays": view.rays,
            "hits": view.hits,
            "lit_fraction": view.lit_fraction,
            "mean_beta0": {p: float(image.mean(dtype=float)) for p, image in view.beta0.items()},
            **view.metadata,
        }
        if self.looks is not None:
            files |= self._image(
                self._with_speckle(view, index, self.looks), view.name + suffix(self.looks), "speckled"
            )
            said["looks"] = self.looks
        return said

    def _image(self, view: SimulatedView, name: str, key: str) -> dict[str, str]:
        with busy(f"{view.name}: writing {name}.exr"):
            write_exr(self.out / f"{name}.exr", view.beta0, view.metadata)
        return {key: f"{name}.exr"}

    def _with_speckle(self, view: SimulatedView, index: int, looks: float) -> SimulatedView:
        beta0 = {
            pol: speckled(image, looks, seed=self.seed, view=index, polarization=pol)
            for pol, image in view.beta0.items()
        }
        metadata = {**view.metadata, "looks": looks, "speckle_seed": self.seed}
        return replace(view, beta0=beta0, looks=looks, metadata=metadata, layers={}, sampling_variance={})


KINDS = {
    "image": "beta0",
    "quick_look": "quick look, dB",
    "layers": "layers",
    "speckled": "beta0 with speckle",
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
        lines.append(f"  {KINDS[kind]}: {shown}")
    lines.append(f"  facts: simulate.json{', ' + content['scene'] if 'scene' in content else ''}")
    return "\n".join(lines)
