"""The materials that parts of a body may have instead of the declared ones, and the curves beside such bodies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.coherent.directions import Directions
from warpsar.coherent.joints import joints
from warpsar.coherent.rcs import rcs
from warpsar.coherent.shape import shape_of
from warpsar.curves.materials import (
    MODEL,
    Kind,
    MaterialHypothesis,
    MaterialTest,
    ask_materials,
    likelier,
    opened,
)
from warpsar.curves.observe import observe
from warpsar.curves.observed import ObservedCurve
from warpsar.curves.search import CANDIDATES, DECLARED
from warpsar.curves.sectors import SEEN
from warpsar.diagnosis.curve_layers import FAMILIES, SWEEPS, Probed, coated, layer_of, layered
from warpsar.runtime import console
from warpsar.scene.scene import Scene
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.mesh import Mesh
from warpsar.world.tables import Material

SOLIDS = (2.0, 2.5, 3.0, 4.0, 6.0)
"""Permittivities of a solid that is tried: foam is below them, ceramics are above."""
LOSS_TANGENT = 0.03
"""Of a solid that is tried: of resins and plastics, 0.005 to 0.05. One value, since curves hardly tell it apart."""
SHEET_EPS = 3.0
"""Permittivity of a sheet that is tried, of plastic or resin: its curves tell (eps_r - 1) x thickness."""
SHEETS = np.geomspace(0.003, 1.0, 21)
"""That product over the shortest wavelength, 2.5 dB apart: the first reflects -40 dB, the last nearly as metal does."""
FLAT = 1e-6
"""Thickness of a flat part over its size."""
TERMS = (*DECLARED, *CANDIDATES.values())
"""Of every hypothesis, whatever is declared: physics has them all. `diagnosis.curves` then asks which of them show."""
SHARES = (0.25, 0.5, 0.75, 1.0)
"""Of a flat part, which an opening may take."""
PER_DIRECTION = 3.0
"""Rows for an independent direction: two hold all that there is (Nyquist), and each costs a sweep of every material."""
_ABSORBER = 1.0 + 1e-6
_LOOKS = np.arange(0.0, 360.0, 30.0)


def ask(
    scene: Scene, cache: Path, device: str | None = None, *, parts: Sequence[str] | None = None
) -> list[MaterialTest]:
    """Which part of the body shows another material than the declared one, likeliest first.

    `parts` are materials of the mesh; without them all, but for those that the radar never sees first. A closed body of
    one material is also asked whether one of its flat parts is open.
    """
    whole = parts is None and len(scene.mesh.materials) == 1
    if parts is None:
        parts = [name for name in scene.materials if len(scene.materials) == 1 or _seen(scene, name, device)]
    closed = bool((joints(scene.mesh.vertices, scene.mesh.faces).other >= 0).all())
    at = partial(beside, cache, device)
    declared = at("", "declared", scene)
    as_it_stands = at("", "declared", scene, scene.radar.terms)
    shortest = _shortest_m(declared.train)
    wanted = [(name, one) for name in parts for one in _alternatives(scene, name, closed, shortest)]
    cuts = list(_with_lids(scene, declared.every())) if whole and closed else []  # nobody said where an opening may be
    metal = [name for name in parts if scene.materials[name].conductor]
    bar = console.progress(len(wanted) + len(cuts) + SWEEPS * len(metal), "materials", "material")
    others = []
    for name in metal:

        def swept(material: Material, name: str = name) -> MaterialHypothesis:
            bar.update()
            return at(name, "metal", replace(scene, materials={**scene.materials, name: material}))

        probed = Probed(swept, shortest)
        others += [layered(probed, family) for family in FAMILIES]
    for name, tried in wanted:
        one = at(name, tried.kind, _changed(scene, name, tried))
        one = replace(one, eps_r=tried.eps_r, thickness_m=tried.thickness_m)
        others.append(opened(one, partial(_area, scene, name)) if tried.kind == "open" else one)
        bar.update()
    for cut, name in cuts:
        gone = at(name, "open", _changed(cut, name, TriedMaterial("open")))
        others += [opened(_opened_in_part(declared, gone, share), partial(_area, cut, name)) for share in SHARES]
        bar.update()
    bar.close()
    return ask_materials(likelier(declared, as_it_stands), others)  # nothing is to win by terms that are not there


def beside(
    cache: Path, device: str | None, part: str, kind: Kind, scene: Scene, terms: Sequence[str] | None = None
) -> MaterialHypothesis:
    """The curves of a scene beside the sum of all terms, or of some; test curves are swept when they are asked for."""
    whole = _whole(scene)

    def curves(scene: Scene) -> tuple[ObservedCurve, ...]:
        seen = observe(scene, cache=cache, device=device, per_direction=PER_DIRECTION)
        return tuple(one.beside({MODEL: one.amplitude(terms or whole.radar.terms)}) for one in seen)

    train = replace(whole, curves=tuple(one for one in whole.curves if one.role == "train"))
    return MaterialHypothesis(part, kind, curves(train), partial(curves, whole))


def _opened_in_part(declared: MaterialHypothesis, gone: MaterialHypothesis, share: float) -> MaterialHypothesis:
    def mixed(first: Sequence[ObservedCurve], second: Sequence[ObservedCurve]) -> tuple[ObservedCurve, ...]:
        return tuple(
            one.beside({MODEL: (1.0 - share) * one.terms[MODEL] + share * other.terms[MODEL]})
            for one, other in zip(first, second, strict=True)
        )

    train = mixed(declared.train, gone.train)
    return replace(gone, train=train, every=lambda: mixed(declared.every(), gone.every()), share=share)


def _with_lids(scene: Scene, curves: Sequence[ObservedCurve]) -> Iterator[tuple[Scene, str]]:
    """For each flat part that an opening may lie behind, the scene that has it as a part, and the part's name."""
    mesh, (material,) = scene.mesh, scene.mesh.materials
    looks = np.concatenate([Directions.of(one.azimuth_deg, one.incidence_deg).s for one in curves])
    for faces in lids(
        mesh, looks, (_shortest_m(curves) / 4.0) ** 2
    ):  # a quarter of a wavelength: nothing enters what is narrower
        corners = mesh.vertices[mesh.faces[faces]]
        low, high = (np.round(end, 3) + 0.0 for end in (corners.min(axis=(0, 1)), corners.max(axis=(0, 1))))  # no -0
        ends = zip("xyz", low, high, strict=True)
        name = f"{material} ({', '.join(f'{axis} {low:.3f} to {high:.3f}' for axis, low, high in ends)} m)"
        of = mesh.face_material.copy()
        of[faces] = 1
        cut = replace(mesh, face_material=of, materials=(material, name))
        same = scene.materials[material]
        yield replace(scene, mesh=cut, materials={**scene.materials, name: same}), name


def with_material(scene: Scene, found: MaterialTest) -> Scene:
    """The scene in which the part has the material that was named; an opening stays what it was declared."""
    if found.kind == "open":
        return scene
    if found.values:
        return replace(
            scene, materials={**scene.materials, found.part: coated(layer_of(found.kind, dict(found.values)))}
        )
    if found.product_m is not None:
        tried = TriedMaterial(found.kind, SHEET_EPS, found.product_m.value / (SHEET_EPS - 1.0))
    else:
        tried = TriedMaterial(found.kind, None if found.eps_r is None else found.eps_r.value)
    changed = _changed(scene, found.part, tried)
    terms = (*scene.radar.terms, *(("transmission",) if "transmission" in changed.radar.terms else ()))
    radar = scene.radar.model_copy(update={"terms": tuple(dict.fromkeys(terms))})
    return replace(changed, radar=radar)


@dataclass(frozen=True)
class TriedMaterial:
    """What a part may be of: a solid has an eps_r, a sheet in air a thickness, too."""

    kind: Kind
    eps_r: float | None = None
    thickness_m: float | None = None

    @property
    def material(self) -> Material:
        if self.kind == "metal":
            return Material(conductor=True)
        if self.kind == "open":
            return Material(eps_r=_ABSORBER, rms_height_m=0.0)
        assert self.eps_r is not None
        eps = self.eps_r, -LOSS_TANGENT * self.eps_r
        return Material(eps_r=eps, thickness_m=self.thickness_m, rms_height_m=0.0)


def _alternatives(scene: Scene, name: str, closed: bool, shortest_m: float) -> Iterator[TriedMaterial]:
    material = scene.materials[name]
    if not material.bare:
        yield TriedMaterial("metal")
    if closed and not material.stack:
        yield from (TriedMaterial("dielectric", eps) for eps in SOLIDS)
    if closed:
        yield TriedMaterial("open")
    elif material.conductor and _flat(scene.mesh, name):  # rays say what a sheet reflects, not what lies behind it
        yield from (
            TriedMaterial("dielectric", SHEET_EPS, product * shortest_m / (SHEET_EPS - 1.0))
            for product in SHEETS.tolist()
        )


def _flat(mesh: Mesh, name: str) -> bool:
    """Whether a part lies in one plane."""
    corners = mesh.vertices[mesh.faces[mesh.face_material == mesh.materials.index(name)]].reshape(-1, 3)
    spread = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
    return bool(spread[2] <= FLAT * spread[0])


def _shortest_m(curves: Sequence[ObservedCurve]) -> float:
    """The shortest wavelength."""
    return SPEED_OF_LIGHT / max(one.frequency_hz for one in curves)


def _changed(scene: Scene, name: str, tried: TriedMaterial) -> Scene:
    return _whole(replace(scene, materials={**scene.materials, name: tried.material}))


def _whole(scene: Scene) -> Scene:
    """The scene with all terms; `transmission` where there is a solid that is more than an absorber."""
    solid = any(m.solid and m.eps_r != _ABSORBER for m in scene.materials.values())
    terms = (*TERMS, "transmission") if solid else TERMS
    return replace(scene, radar=scene.radar.model_copy(update={"terms": terms}))


def _seen(scene: Scene, name: str, device: str | None) -> bool:
    """Whether the radar sees a part first from anywhere around: its reflection then changes the field."""
    radar = scene.radar.model_copy(update={"terms": ("single",)})
    looks = [replace(scene, radar=radar), replace(_changed(scene, name, TriedMaterial("open")), radar=radar)]
    if scene.materials[name].conductor:
        looks[0] = replace(_changed(scene, name, TriedMaterial("metal")), radar=radar)
    found = [rcs(one, _LOOKS, 90.0, device=device).amplitude_m for one in looks]
    return bool(np.abs(found[0] - found[1]).max() > 1e-6 * np.abs(found[0]).max())


def _area(scene: Scene, name: str, curve: ObservedCurve) -> NDArray[np.float64]:
    """Area of a part's faces that look toward the radar, across its line of sight, (n,) [m2]."""
    mesh = scene.mesh
    corners = mesh.vertices[mesh.faces[mesh.face_material == mesh.materials.index(name)]]
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    s = Directions.of(curve.azimuth_deg, curve.incidence_deg).s
    return np.asarray(np.clip(s @ area.T, 0.0, None).sum(axis=1))


# ---- where a closed body may have an opening: flat parts between sharp edges, as a lid over a duct is


EVEN = 0.97
"""Length of the mean normal of a part, by area, that counts as flat: its faces turn by some 15 degrees at most."""
ALIKE = 0.01
"""Relative difference of area up to which two parts are one another's mirror image."""
TURNED = 0.85
"""Cosine between the normals of two such parts, at least: openings on both sides of a body face the same way."""


def lids(mesh: Mesh, looks: NDArray[np.float64], least_m2: float) -> list[NDArray[np.int64]]:
    """The faces of each flat part that looks toward the radar, largest first; mirror images that face alike are one.

    `looks` are unit vectors to the radar, (n, 3): from one of them a part shows half of its area or more, as the sector
    `aperture` has it. `least_m2` is the least area. A part is what no edge of more than `world.mesh.SMOOTH_DEG`
    cuts. A smooth body has none.
    """
    surface = shape_of(mesh.vertices, mesh.faces, mesh.face_material).surface
    corners = mesh.vertices[mesh.faces]
    across = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.stack([np.bincount(surface, across[:, i]) for i in range(3)], axis=1)
    area = np.bincount(surface, np.linalg.norm(across, axis=1))
    normal = total / area[:, None]
    even = np.linalg.norm(normal, axis=1) > EVEN
    even &= ((looks @ normal.T).max(axis=0) >= SEEN) & (area < area.sum() / 2.0)
    left = [int(i) for i in np.argsort(-area) if even[i]]
    found = []
    while left:
        first = left[0]
        same = [i for i in left if area[first] - area[i] <= ALIKE * area[first] and normal[i] @ normal[first] > TURNED]
        if area[same].sum() >= least_m2:
            found.append(np.flatnonzero(np.isin(surface, same)))
        left = [i for i in left if i not in same]
    return found
