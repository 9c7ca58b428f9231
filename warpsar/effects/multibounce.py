"""Power that meets two and more surfaces on its way back to the radar."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import amount, one_of
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.effects.bounces.lobe import lobe_power
from warpsar.effects.bounces.roughness import Fields, coherent_power, diffuse_power
from warpsar.effects.bounces.tracing import BouncesOfOneNumber, trace_paths
from warpsar.kernels import binning
from warpsar.kernels.codes import Polarization

REFLECTIONS = ("roughness", "lobe")


class Multibounce(Effect):
    """Rays followed over up to `max_bounces` surfaces (docs/checks.md).

    Every surface but the last is a mirror with |R_p(theta)|^2 exp(-4 k^2 h^2 cos^2 theta). Range is half the path,
    azimuth the middle of entry and exit. By `reflection`, the last surface returns the ray, if nothing lies between it
    and the radar,

    - "roughness": in two shares. The coherent one has a phase: fields of paths are summed over resolution cells, by
      physical optics, and the power of each cell is |sum|^2. The diffuse one is the surface's bistatic scattering.
    - "lobe": with the bistatic geometric-optics coefficient of slope variance 2 h^2 / l^2 + 1e-4, whatever the
      roughness. Powers add: both directions of a path are traced, each once. HV and VH get nothing.
    """

    name = "multibounce"
    stage = "path"
    of_surfaces_with = "eps_r"
    order = 10
    follows_rays = True
    needs_all_hits = True
    summary = "double and triple bounces between surfaces"
    term = "multibounce"
    in_place = "multibounce in radar.terms"
    example: ClassVar[dict[str, Any]] = {"strength": 1.0}
    rate_case: ClassVar[dict[str, Any]] = {"strength": 1.0}
    parameters = (
        amount(
            "strength", "1", 1e6, 1.0, (1e-6, 1e4), "Factor on the power of the paths: 1 is all of it.", unstated=1.0
        ),
    )
    settings = (
        one_of("max_bounces", 3, 2, 3, 4, description="Most surfaces on a path."),
        one_of(
            "reflection",
            *(REFLECTIONS[0], *REFLECTIONS),
            description="How a surface reflects: by its roughness, or at the end of a path as a lobe of slopes.",
        ),
    )

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """All corners must show it."""
        return image.halves()

    def trials(self, context: Context) -> list[Trial]:
        """Both readings of a reflection: the one that holds scores higher, and its fit is the likelier."""
        return [
            Trial(
                (ScoreStep("strength", 1.0, {"strength": 1.0, "reflection": reflection}, one_sided=True),),
                tuple({"strength": s, "reflection": reflection} for s in (1.0, 0.2, 5.0)),
                label=f'reflection = "{reflection}"',
            )
            for reflection in REFLECTIONS
        ]

    def paths(self, render: Recorder, p: wp.array, image: wp.array, polarization: int) -> wp.array:
        lobe = render.settings[self.name]["reflection"] == "lobe"
        if lobe and Polarization(polarization).crossed:
            return image
        if self.name not in render.recorded:
            render.recorded[self.name] = self._with_coordinates(render)
        for count, found in enumerate(render.recorded[self.name], start=2):
            name = f"beta0_{count}_bounces_{Polarization(polarization).name}"
            if found is None:
                render.layers[name] = render.program.array(image.shape[0], sum_into=True)
                continue
            traced, fields, of_samples = found
            if lobe:
                power = lobe_power(render, p, traced.paths, fields.zetas, polarization)
            else:
                power = diffuse_power(render, p, fields, polarization)
            share = render.program.array(image.shape[0], sum_into=True)
            render.collect(power, traced.paths.weight, traced.paths.point, traced.paths.pixel, share)
            if of_samples is not None:
                samples, points = traced.coherent.samples, traced.coherent.paths.point
                power = coherent_power(render, p, traced.coherent, of_samples, polarization)
                fields_share = render.program.array(image.shape[0], sum_into=True)
                render.collect(power, samples.weight, points, samples.bin, fields_share, samples.path)
                share = _sum(render, share, fields_share)
            render.layers[name] = share
            image = _sum(render, image, share)
        return image

    def _with_coordinates(self, render: Recorder) -> list[tuple[BouncesOfOneNumber, Fields, Fields | None] | None]:
        """Paths by number of bounces, traced once for all renders of the hits, with the fields on them."""
        settings = render.settings[self.name]
        cell_m = render.resolution_m if settings["reflection"] == "roughness" else None
        most, derived = settings["max_bounces"], render.hits.derived
        key = (self.name, most, cell_m, render.taper)
        if key not in derived:
            # the same rays may have been sent for the other reading of a reflection
            of_cells = [traced for other, traced in list(derived.items()) if other[:2] == key[:2] and cell_m is None]
            derived[key] = of_cells[0].without_cells() if of_cells else trace_paths(render, most, cell_m)
        if cell_m is not None:
            render.remarks.extend(derived[key].remarks)
            if cell_m == render.spacing_m:
                size = " x ".join(f"{side:g}" for side in cell_m)
                render.remarks.append(
                    f"multibounce: fields of corners are summed over cells of a pixel ({size} m), on which their "
                    "levels depend; effects.point_spread declares the resolution"
                )
        return [
            one and (one, Fields(render, one.paths), Fields(render, one.coherent.paths) if one.coherent else None)
            for one in derived[key].of
        ]


def _sum(render: Recorder, one: wp.array, other: wp.array) -> wp.array:
    return render.program.mapped(binning.add_kernel, one, [one, other])


EFFECT = Multibounce()
