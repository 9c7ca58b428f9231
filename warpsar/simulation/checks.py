"""What a user should be told of a simulation: a grid that misses the mesh, units, domains, and empty polarizations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.effects.base.effect import LeftOut
from warpsar.effects.registry import get
from warpsar.models import registry
from warpsar.models.base.model import DEFAULT
from warpsar.render.domains import lit_areas, model_areas
from warpsar.render.render import ViewRender
from warpsar.surface.stage import Stage
from warpsar.world.frame import ViewGeometry
from warpsar.world.tables import View
from warpsar.world.world import World, geometry_of

OVERLAP = 0.1  # of the smaller of image and mesh: less is a grid that misses
UNITS = 300.0  # times larger or smaller than the image: more is a mesh in other units
SHARE = 0.1  # of the lit area outside its model's domain, before it is said
DARK = 0.5  # of the lit pixels that are 0 in HV or VH, before it is said
SLIPPED = 1e-3  # of the rays on a body, before the faces that they see from behind are said
GRAZING = 1e-3  # cosine up to which a face is seen from its edge, and neither from before nor from behind
_NAMED = 3  # views, by name


def grid_warnings(scene: World, stage: Stage, views: Sequence[View]) -> list[str]:
    """One sentence for each way in which the image's grid does not fit the mesh, before any ray is sent."""
    image = np.array([n * step for n, step in zip(scene.grid.shape, scene.grid.spacing_m, strict=True)])
    covers = f"the image covers {image[0]:g} x {image[1]:g} m (range x azimuth)"
    missed: dict[str, str] = {}
    units: dict[str, str] = {}
    for view in views:
        first, last = _extent(stage, geometry_of(scene, view))
        size = last - first
        ratio = float(size.max() / image.max())
        inside = np.clip(np.minimum(last, image / 2) - np.maximum(first, -image / 2), 0, None)
        share = float(np.prod(inside / np.minimum(np.maximum(size, 1e-9), image)))
        if not 1 / UNITS < ratio < UNITS:
            units[view.name] = (
                f"{covers}, and the mesh {size[0]:.3g} x {size[1]:.3g} m: is the mesh in metres, or its size a mistake?"
            )
        elif share < OVERLAP:
            how = "the mesh" if share == 0 else "most of the mesh"
            missed[view.name] = (
                f"{covers} about the reference point and misses {how}, which lies at range {first[0]:.4g} to "
                f"{last[0]:.4g} m and azimuth {first[1]:.4g} to {last[1]:.4g} m; see reference_point_m of [scene], and "
                f"[image]"
            )
    return [f"{_views(found)}: {next(iter(found.values()))}" for found in (missed, units) if found]


def _extent(stage: Stage, geometry: ViewGeometry) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest (range, azimuth) of the mesh about the reference point [m], shape (2,) each."""
    low, high = stage.target.ends(geometry)
    if geometry.slant_range_m is None:
        return low[:2], high[:2]
    track = np.array([geometry.slant_range_m, 0.0])
    return low[[3, 1]] - track, high[[3, 1]] - track


@dataclass
class Findings:
    """What images showed. `areas`: as `lit_areas`, summed over views; `dark`: polarization -> view -> share of its lit
    pixels that are exactly 0; `remarks`: of effects, with the views that they are said of; `rays`: of each face of
    the mesh, those that reach it, and those that reach it from behind, shape (2, faces), where bounces are followed;
    `left_out`: view -> what its bounces leave out."""

    areas: Any = 0.0
    dark: dict[str, dict[str, float]] = field(default_factory=dict)
    remarks: dict[str, dict[str, None]] = field(default_factory=dict)
    rays: Any = 0.0
    left_out: dict[str, LeftOut] = field(default_factory=dict)

    def add_left_out(self, render: ViewRender, found: LeftOut | None) -> None:
        """What the bounces of a view whose render has run leave out."""
        if found is not None:
            self.left_out[render.view.name] = found

    def add_remarks(self, render: ViewRender, remarks: Sequence[str]) -> None:
        """What effects say of a view."""
        for remark in remarks:
            self.remarks.setdefault(remark, {})[render.view.name] = None

    def add(self, stage: Stage, render: ViewRender, beta0: dict[str, np.ndarray], lit: np.ndarray) -> None:
        """Of one view whose render has run."""
        if not _surely_small(stage, render.geometry.wavenumber):
            areas = lit_areas(stage, [render])
            if (other := ~stage.surface.by_default).any():  # theirs in the place of small perturbation's
                areas[other] = 0.0
                areas[:, 0][other], areas[:, 2][other] = model_areas(stage, [render])[other].T
            self.areas = self.areas + areas
        self.add_remarks(render, render.remarks)
        if any(get(name).follows_rays for name in render.settings):
            self.rays = self.rays + _rays_of_faces(stage, render)
        for polarization in beta0.keys() & {"HV", "VH"}:
            seen = beta0[polarization][lit] if lit.any() else np.zeros(min(render.hits.count, 1))
            share = float((seen == 0).mean()) if seen.size else 0.0
            if share > DARK:
                self.dark.setdefault(polarization, {})[render.view.name] = share

    @classmethod
    def together(cls, parts: Sequence[Findings]) -> Findings:
        whole = cls()
        for part in parts:
            whole.areas = whole.areas + part.areas
            whole.rays = whole.rays + part.rays
            for polarization, views in part.dark.items():
                whole.dark.setdefault(polarization, {}).update(views)
            whole.left_out |= part.left_out
            for remark, named in part.remarks.items():
                whole.remarks.setdefault(remark, {}).update(named)
        return whole

    def warnings(self, scene: World) -> list[str]:
        """One sentence for each thing that is to be told."""
        found = _domain_warnings(scene, self.areas) if np.ndim(self.areas) else []
        found += _behind_warnings(scene, self.rays) if np.ndim(self.rays) else []
        found += [f"{_views(views)}: {remark}" for remark, views in self.remarks.items()]
        found += _left_out_warning(self.left_out)
        for polarization, views in sorted(self.dark.items()):
            found.append(
                f"{_views(views)}: {polarization} is exactly 0 in {100 * max(views.values()):.3g} % of the lit pixels: "
                f"level ground, and whatever is not tilted across the look direction, scatters no {polarization} in "
                f"this model"
            )
        return found


def _rays_of_faces(stage: Stage, render: ViewRender) -> NDArray[np.floating]:
    """Rays on each face of the mesh, and those of them that see its corners run clockwise, shape (2, faces)."""
    corners = stage.target.faces.numpy()
    rays = np.zeros((2, len(corners)))
    np.add.at(rays[0], render.hits.face.numpy(), render.hits.weight.numpy())
    faces = np.flatnonzero(rays[0])
    p0, p1, p2 = (stage.target.corners[corner] for corner in corners[faces].T)
    d, v = render.geometry.d, render.geometry.v
    along, across = ((p0 + p1 + p2) / 3.0 @ axis for axis in (d, v))
    away = np.multiply.outer(np.ones(faces.size), d)
    if (slant_range := render.geometry.slant_range_m) is not None:
        away = np.multiply.outer(slant_range + along, d) + np.multiply.outer(across, v)
    normal = np.cross(p1 - p0, p2 - p0)
    toward = (normal * away).sum(axis=1)
    behind = faces[toward > GRAZING * np.linalg.norm(normal, axis=1) * np.linalg.norm(away, axis=1)]
    rays[1, behind] = rays[0, behind]
    return rays


def _behind_warnings(scene: World, rays: NDArray[np.floating]) -> list[str]:
    """One sentence for each object, and for each material of the rest, with faces that were seen from behind.

    Single rays slip through the seam of two faces of a closed body: up to SLIPPED of a body's rays say nothing."""
    parts = {} if scene.assembly is None else scene.assembly.faces_of(scene.objects)
    rest = np.setdiff1d(np.arange(len(scene.mesh.faces)), np.concatenate([*parts.values(), np.zeros(0, np.int64)]))
    of_rest = scene.mesh.face_material[rest]
    named = {f"object {label}": faces for label, faces in parts.items()}
    named |= {f"materials.{name}": rest[of_rest == i] for i, name in enumerate(scene.mesh.materials)}
    found = []
    for name, faces in named.items():
        every, behind = rays[:, faces]
        if behind.sum() > SLIPPED * every.sum():
            found.append(
                f"{name}: {np.count_nonzero(behind)} of {len(faces)} faces look away from a radar that sees them. "
                "Either they are wound the wrong way round, which changes nothing, as both sides reflect; or the body "
                "is open, and bounces inside of it are counted too"
            )
    return found


def _left_out_warning(left_out: Mapping[str, LeftOut]) -> list[str]:
    """One sentence for all views, with the power of the one that lacks most."""
    if not left_out:
        return []
    view, most = max(left_out.items(), key=lambda item: item[1].rcs_m2)
    beside = "and its image has no other bounces"
    if np.isfinite(most.over):
        beside = f"{10 * np.log10(most.over):+.1f} dB to all bounces of its image"
    return [
        f"{_views(left_out)}: multibounce: ways over more than max_bounces = {most.bounces - 1} surfaces are left out; "
        f"those over {most.bounces} hold {10 * np.log10(most.rcs_m2):.1f} dBsm in {most.polarization} of view {view}, "
        f"{beside}. " + (f"max_bounces = {most.bounces} takes them" if most.takes else "No image can have them")
    ]


SMALL = "small perturbation (kh < 0.3 and sqrt(2) h / l < 0.3)"
OPTICS = "geometric optics (kh cos(theta) > 1.58, kl > 6 and l^2 > 2.76 h lambda)"


def _domain_warnings(scene: World, areas: np.ndarray) -> list[str]:
    found = []
    for name, (small, optics, small_out, optics_out) in zip(scene.mesh.materials, areas, strict=True):
        if (own := scene.materials[name].model) != DEFAULT:
            model, share = registry.get(own).domain.words, small_out / small if small else 0.0
        elif small and optics:  # no h and l lie in both domains: what is in neither is what is left
            model, share = f"both {SMALL} and {OPTICS}", (small_out + optics_out) / small - 1
        elif small:
            model, share = SMALL, small_out / small
        else:
            model, share = OPTICS, optics_out / optics if optics else 0.0
        if share > SHARE:
            found.append(
                f"materials.{name}: {100 * share:.3g} % of its lit area lies outside the domain of {model}"
                f"{_measures(scene, name)}: its beta0 may be far from the truth"
            )
    return found


def _measures(scene: World, material: str) -> str:
    h, length = scene.materials[material].rms_height_m, scene.materials[material].correlation_length_m
    if not isinstance(h, float) or not isinstance(length, float):
        return ""
    k = scene.wavenumber(scene.views[0])
    return f"; here kh = {k * h:.3g}, kl = {k * length:.3g}"


def _surely_small(stage: Stage, wavenumber: float) -> bool:
    """Whether every material is small perturbation alone and inside its domain, whatever is lit."""
    surface = stage.surface
    if not surface.by_default.all():
        return False
    for name in surface.materials:
        h, length, tau = (
            surface.values(name, key) for key in ("rms_height_m", "correlation_length_m", "specular_fraction")
        )
        if tau.max() > 0 or wavenumber * h.max() >= 0.3 or np.sqrt(2.0) * h.max() / length.min() >= 0.3:
            return False
    return True


def _views(names: Any) -> str:
    """ "view north", or "views a, b, c and 5 more"."""
    names = list(names)
    shown = ", ".join(names[:_NAMED])
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"view{'s' if len(names) > 1 else ''} {shown}{more}"
