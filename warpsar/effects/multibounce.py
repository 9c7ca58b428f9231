"""Power that meets two and more surfaces on its way back to the radar."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect, LeftOut
from warpsar.effects.base.parameter import amount, one_of
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.effects.bounces.cells import bodies_of
from warpsar.effects.bounces.gaps import gaps, sentences
from warpsar.effects.bounces.lobe import lobe_power
from warpsar.effects.bounces.roughness import Fields, coherent_power, diffuse_power
from warpsar.effects.bounces.tracing import BouncesOfOneNumber, TracedPaths, planes_of, trace_paths
from warpsar.kernels import binning
from warpsar.kernels.codes import Polarization
from warpsar.kernels.effects.multibounce import SURFACES

REFLECTIONS = ("roughness", "lobe")
MOST = int(SURFACES) - 1  # bounces that an image may have
_STATED_SHARE = 0.05  # of the power of an image's bounces, 0.2 dB: less may be left out, unsaid
_SEEN = 1e-3  # of the brightest pixel: a pixel that what is left out would double is told from there on


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
        one_of("max_bounces", 3, *range(2, MOST + 1), description="Most surfaces on a path."),
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
            paths = traced.paths
            faces = [bounce.face for bounce in paths.bounces]
            render.collect(power, paths.weight, paths.point, paths.pixel, share, faces=faces)
            if of_samples is not None:
                samples, points = traced.coherent.samples, traced.coherent.paths.point
                faces = [bounce.face for bounce in traced.coherent.paths.bounces]
                power = coherent_power(render, p, traced.coherent, of_samples, polarization)
                fields_share = render.program.array(image.shape[0], sum_into=True)
                render.collect(power, samples.weight, points, samples.bin, fields_share, samples.path, faces)
                share = _sum(render, share, fields_share)
            render.layers[name] = share
            image = _sum(render, image, share)
        return image

    def further(self, render: Recorder) -> Mapping[str, Any] | None:
        most = render.settings[self.name]["max_bounces"]
        return {"max_bounces": most + 1} if self._traced(render).further > 0.0 else None

    def left_out(self, render: Recorder, other: Recorder) -> LeftOut | None:
        most = render.settings[self.name]["max_bounces"]
        found = []
        for name in (layer.removeprefix("beta0_2_bounces_") for layer in render.layers if "_2_bounces_" in layer):
            has = sum(render.layers[f"beta0_{n}_bounces_{name}"].numpy().astype(float) for n in range(2, most + 1))
            lacks = other.layers[f"beta0_{most + 1}_bounces_{name}"].numpy().astype(float)
            image = render.before_image[name].numpy()
            doubled = lacks > np.maximum(image, _SEEN * (image + lacks).max(initial=0.0))
            if lacks.sum() > _STATED_SHARE * has.sum() or doubled.any():
                over = lacks.sum() / has.sum() if has.any() else np.inf
                rcs_m2 = float(lacks.sum() * np.prod(render.spacing_m))
                found.append(LeftOut(most + 1, name, rcs_m2, float(over), most < MOST))
        return max(found, key=lambda one: one.rcs_m2, default=None)

    def doubts(self, render: Recorder) -> list[str]:
        """Corners that are open in the mesh."""
        target, double = render.stage.target, self._traced(render).of[0]
        if double is None:
            return []
        (vertices, faces), materials = target.places_once, render.stage.surface.materials
        pairs = np.stack([bounce.face.numpy() for bounce in double.paths.bounces], axis=1)
        wavelength_m = 2.0 * np.pi / render.geometry.wavenumber
        bodies = bodies_of(faces, planes_of(target))
        found = gaps(vertices, faces, bodies, pairs, double.paths.weight.numpy(), wavelength_m)
        return sentences(found, [materials[m] for m in render.stage.face_material.numpy()])

    def _traced(self, render: Recorder) -> TracedPaths:
        """Paths by number of bounces, traced once for all renders of the hits."""
        settings = render.settings[self.name]
        cell_m = render.resolution_m if settings["reflection"] == "roughness" else None
        most, derived = settings["max_bounces"], render.hits.derived
        key = (self.name, most, cell_m, render.taper)
        if key not in derived:
            # the same rays may have been sent for the other reading of a reflection
            of_cells = [traced for other, traced in list(derived.items()) if other[:2] == key[:2] and cell_m is None]
            derived[key] = of_cells[0].without_cells() if of_cells else trace_paths(render, most, cell_m)
        traced: TracedPaths = derived[key]
        return traced

    def _with_coordinates(self, render: Recorder) -> list[tuple[BouncesOfOneNumber, Fields, Fields | None] | None]:
        """Paths by number of bounces, with the fields on them."""
        traced = self._traced(render)
        if render.settings[self.name]["reflection"] == "roughness":
            render.remarks.extend(traced.remarks)
            if render.resolution_m == render.spacing_m:
                size = " x ".join(f"{side:g}" for side in render.resolution_m)
                render.remarks.append(
                    f"multibounce: fields of corners are summed over cells of a pixel ({size} m), on which their "
                    "levels depend; effects.point_spread declares the resolution"
                )
        return [
            None
            if one is None
            else (one, Fields(render, one.paths), Fields(render, one.coherent.paths) if one.coherent else None)
            for one in traced.of
        ]


def _sum(render: Recorder, one: wp.array, other: wp.array) -> wp.array:
    return render.program.mapped(binning.add_kernel, one, [one, other])


EFFECT = Multibounce()
