"""Racks, rails, hatches and handles: what a body returns by detail that its mesh does not have."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.blur import WINDOWS, blurred
from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import EffectParameter, Setting, amount
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels import binning
from warpsar.kernels.codes import Polarization
from warpsar.kernels.effects import unresolved_detail as kernels
from warpsar.world.world import World

_WIDTHS_PX = (2.0, 6.0)  # of the spread that is tried


def off_axis_deg(to_radar: np.ndarray, axis_deg: float) -> float:
    """How far the azimuth of a direction (east, north, up) lies from the nearest of the axes, -45 to 45 degrees."""
    azimuth = math.degrees(math.atan2(to_radar[0], to_radar[1]))
    return (azimuth - axis_deg + 45.0) % 90.0 - 45.0


def _names(value: Any) -> bool:
    return isinstance(value, list | tuple) and all(isinstance(one, str) for one in value)


class UnresolvedDetail(Effect):
    """Adds `level` per square metre of a body that the radar sees, spread by a Gaussian of `spread_m` full width.

    Detail turns to all sides, so its return does not depend on how the mesh's face lies. It stands out from the mesh,
    and sends power along ways of more than one bounce. So its power does not lie where the face does. It returns the
    same in HH and VV, and nothing in HV. The parts of a body differ: `share` has a factor for each material.

    Racks and hatches stand square on the body, and make corners with it. Where the radar looks along one of the body's
    axes, fore and aft or across, they flash: the level is `flash` times more there.
    """

    name = "unresolved_detail"
    stage = "path"
    order = 30
    beyond_mesh = True
    needs_all_hits = True  # it spreads power from a band of the image into the next
    summary = "returns by detail that the mesh does not have"
    example: ClassVar[dict[str, Any]] = {"level": 0.03, "spread_m": 3.0}
    rate_case: ClassVar[dict[str, Any]] = {"level": 0.01, "spread_m": 2.0}
    parameters = (
        amount("level", "1", 1e6, 0.01, (1e-9, 1e4), "Cross-section per square metre across the look direction."),
        EffectParameter(
            "spread_m",
            "m",
            math.nan,
            0.0,
            1e3,
            1.0,
            scale="log",
            fit_low=1e-2,
            fit_high=1e2,
            description="Full width at half maximum over which this power is spread, in range and in azimuth.",
        ),
        amount("flash", "1", 1e4, 1.0, (1e-3, 1e3), "Level added along an axis of the body, as a multiple of `level`."),
        EffectParameter(
            "flash_deg",
            "deg",
            math.nan,
            1e-2,
            90.0,
            3.0,
            scale="log",
            fit_low=0.3,
            fit_high=30.0,
            description="Angle from the axis at which half of the flash is left.",
        ),
        EffectParameter(
            "share",
            "1",
            1.0,
            0.0,
            1e6,
            1.0,
            per_material=True,
            scale="log",
            fit_low=1e-3,
            fit_high=1e3,
            description="Factor on `level` for a material: the parts of a body carry more and less detail.",
        ),
    )
    settings = (
        Setting(
            "materials",
            [],
            _names,
            "a list of materials; empty: all of them",
            description="Materials whose surfaces carry the detail; all if none is named.",
            schema={"type": "array", "items": {"type": "string"}},
        ),
        Setting(
            "axis_deg",
            0.0,
            lambda value: isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < math.inf,
            "a number [deg]",
            description="Azimuth of the body's long axis, clockwise from north. It flashes at every 90 deg from it.",
            schema={"type": "number"},
        ),
    )

    def check(self, scene: World, table: Mapping[str, Any]) -> str | None:
        unknown = [name for name in table.get("materials", []) if name not in scene.mesh.materials]
        if unknown:
            return f".materials: found {', '.join(unknown)}; allowed are {', '.join(scene.mesh.materials)}"
        return None

    def spread_m(self, table: Mapping[str, Any]) -> float:
        return float(table.get("spread_m", 0.0))

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """It is all over the body."""
        return image.halves()

    def trials(self, context: Context) -> list[Trial]:
        """Every material alone, at two widths."""
        size, pixel = 0.1 * context.level, max(context.scene.grid.spacing_m)
        found = []
        for material in context.scene.mesh.materials:
            for width in _WIDTHS_PX:
                at = {"level": size, "spread_m": width * pixel, "materials": [material]}
                label = f"{material}, over {at['spread_m']:g} m"
                found.append(Trial((ScoreStep("level", size, at, one_sided=True),), (at,), label))
        return found

    def extensions(self, table: Mapping[str, Any]) -> Mapping[str, Mapping[str, Any]]:
        """A flash along the body's axes."""
        return {} if "flash" in table else {"flash": {**table, "flash": 5.0, "flash_deg": 3.0}}

    def paths(self, render: Recorder, p: wp.array, image: wp.array, polarization: int) -> wp.array:
        if Polarization(polarization).crossed:
            return image
        program, hits, stage = render.program, render.hits, render.stage
        names = stage.surface.materials
        wanted = render.settings[self.name]["materials"] or names
        flags = np.array([name in wanted for name in names], np.int32)
        has_detail: wp.array = wp.array(flags, dtype=int, device=program.device)
        sigma = program.array(hits.count)
        off_axis = off_axis_deg(render.geometry.s, render.settings[self.name]["axis_deg"])
        program.launch(
            kernels.detail_kernel,
            hits.count,
            [p, stage.face_material, has_detail, hits.face, hits.cos_incidence, off_axis],
            [sigma],
        )
        share = program.array(image.shape[0], sum_into=True)
        render.collect(sigma, hits.weight, hits.point, hits.pixel, share, faces=[hits.face])
        for axis in (0, 1):
            share = blurred(render, WINDOWS["gaussian"], p, 1, share, axis=axis)
        render.layers[f"beta0_detail_{Polarization(polarization).name}"] = share
        return program.mapped(binning.add_kernel, image, [image, share])


EFFECT = UnresolvedDetail()
