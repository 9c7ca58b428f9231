"""What has a derivative in the coherent engine, by name, and how a parameter's gradient comes from the kernels'."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.coherent.held import TubeSlopes
from warpsar.coherent.rough_models import kind_of
from warpsar.errors import InputError
from warpsar.parameters.at import at
from warpsar.parameters.parameter import Parameter
from warpsar.parameters.tree import POSE as POSE_WORDS
from warpsar.parameters.tree import Parameters
from warpsar.world.objects.pose import rotation
from warpsar.world.objects.table import KEYS
from warpsar.world.tables import LOSS, Material, layer_of
from warpsar.world.world import World

WHOLE = "pose"
"""The owner of a pose that moves all that there is."""
POSE = tuple(KEYS[word] for word in POSE_WORDS)
_STEP_DEG = 1e-3
"""Of a central difference of vertices in an angle: its error is a 2e-11 of the slope, its rounding 1e-11."""


@dataclass(frozen=True)
class RcsParameter:
    """A parameter: its shape, and its gradient from those to vertices and materials."""

    shape: tuple[int, ...]
    gradient: Callable[[TubeSlopes], NDArray[np.float64]]


def moves_vertices(names: Collection[str]) -> bool:
    """Whether any of these parameters moves vertices."""
    return any(name.partition(".")[0] in (WHOLE, "objects", "mesh") for name in names)


def learned(scene: World, names: Sequence[str], tree: Parameters[Parameter]) -> dict[str, RcsParameter]:
    """The parameters of these names, from the scene's `tree`.

    Raises InputError, which says why, for one that has no derivative.
    """
    if isinstance(names, str) or not names:
        raise InputError(f"parameters: found {names!r}; must be one or more names")
    found = {}
    for called in names:
        owner, _, key = str(called).partition(".")
        if owner == WHOLE and key in POSE:
            found[called] = _moved(scene, called, partial(_turned, scene, key), key)
            continue
        try:
            one = tree[called]
        except KeyError:
            raise InputError(f"parameters: {called}: {_why(scene, called, tree)}") from None
        if "amplitude" not in one.derivatives:
            raise InputError(f"parameters: {called}: has no derivative here; {_allowed(tree)} have one")
        if one.root == "mesh":
            found[one.name] = _vertices(scene)
        elif one.root == "objects":
            found[one.name] = _moved(scene, one.name, partial(_placed, scene, one), one.key)
        else:
            found[one.name] = _material(scene, one.owner, one.key)
            _refuse_models(scene, one.name, [one.owner])
    return found


def _refuse_models(scene: World, name: str, materials: Collection[str]) -> None:
    """Refuse what changes the scatterers of materials that have no derivative."""
    for one in materials:
        material = scene.materials[one]
        if "rough" in scene.radar.terms and material.rms_height_m != 0.0 and kind_of(material):
            found = "a learned term" if material.learned_term is not None else f'model = "{material.model}"'
            raise InputError(
                f"parameters: {name}: materials.{one} has {found}, whose scatterers have no derivative; must be "
                'model = "ka_spm" without a learned term, or leave "rough" out of radar.terms'
            )


def _why(scene: World, name: str, tree: Parameters[Parameter]) -> str:
    owner, _, key = name.removeprefix("materials.").rpartition(".")
    if owner == "radar" and key in ("terms", "max_bounces"):
        return "is a choice, not a number, and has no derivative"
    if key in ("visibility", "rays_per_wavelength", "seed", "edges"):
        return "is discrete: what is lit, hit or drawn has no derivative"
    if owner in scene.materials and key in Material.model_fields:
        if getattr(scene.materials[owner], key) is None:
            return "the scene does not state it, so it has no derivative"
        return f"has no derivative here; {_allowed(tree)} have one"
    return f"found no such parameter; must be one of {_allowed(tree)}"


def _allowed(tree: Parameters[Parameter]) -> str:
    named = [name for name, one in tree.items() if "amplitude" in one.derivatives]
    return ", ".join([*named, *(f"{WHOLE}.{key}" for key in POSE)])


def _vertices(scene: World) -> RcsParameter:
    rough = [n for n in scene.mesh.materials if scene.materials[n].rms_height_m != 0.0]
    if rough and "rough" in scene.radar.terms:
        raise InputError(
            f"parameters: mesh.vertices: materials.{rough[0]} is rough, and a face that changes its area has its "
            'scatterers drawn anew; leave "rough" out of radar.terms, or ask for a pose'
        )
    return RcsParameter(scene.mesh.vertices.shape, lambda slopes: slopes.vertices)


def _material(scene: World, name: str, key: str) -> RcsParameter:
    material, where = scene.materials[name], f"parameters: materials.{name}.{key}"
    if key.startswith("layers."):
        return _layer(scene, name, material, key)
    value = getattr(material, key)
    if key == "eps_r" and material.bare:
        raise InputError(f"{where}: a conductor does not depend on it; it has no derivative")
    if key in ("rms_height_m", "correlation_length_m") and material.rms_height_m == 0.0:
        raise InputError(f"{where}: a smooth face has no scatterers; where they appear there is no derivative")
    index = scene.mesh.materials.index(name)
    pair = isinstance(value, tuple)

    def gradient(slopes: TubeSlopes) -> NDArray[np.float64]:
        stuff, surface = slopes.stuff[index], slopes.surfaces[index]
        if key == "thickness_m":
            return np.array(stuff["thickness"])
        if key == "rms_height_m":
            return np.array(stuff["rms_height"] + surface["rms_height"])
        if key == "correlation_length_m":
            both = surface["length"]
            return np.array(both if pair else both.sum())
        both = stuff["permittivity"] + (0.0 if material.conductor else surface["permittivity"])
        return np.array(both if pair else both[0])

    return RcsParameter((2,) if pair else (), gradient)


def _layer(scene: World, name: str, material: Material, key: str) -> RcsParameter:
    """A value of one of `layers`, `layers.0.mu_r`. In air its mirror image moves with it."""
    number, called = layer_of(key)
    index, of = scene.mesh.materials.index(name), called.removesuffix(LOSS)
    is_loss = called != of
    pair = isinstance(getattr(material.layers[number], of), tuple) and not is_loss

    def gradient(slopes: TubeSlopes) -> NDArray[np.float64]:
        stuff = slopes.stuff[index]
        outer = np.concatenate([stuff["permittivity"], stuff["permeability"], [stuff["thickness"]]])
        whole = np.sum([outer if each == 0 else stuff["under"][each - 1] for each in material.alike(number)], axis=0)
        both = whole[{"eps_r": slice(0, 2), "mu_r": slice(2, 4), "thickness_m": slice(4, 5)}[of]]
        return np.array(both if pair else -both[1] if is_loss else both[0])

    return RcsParameter((2,) if pair else (), gradient)


def _moved(scene: World, name: str, vertices: Callable[[Any], NDArray[np.float64]], key: str) -> RcsParameter:
    """A pose: the chain rule through the vertices, whose slopes are differences of a closed form in float64."""
    if key == "position_m":
        slopes = np.stack([vertices(0.5 * step) - vertices(-0.5 * step) for step in np.eye(3)])
    else:
        slopes = (vertices(_STEP_DEG) - vertices(-_STEP_DEG))[None] / (2.0 * _STEP_DEG)
    mesh = scene.mesh
    some = np.any(slopes != 0.0, axis=(0, 2))[mesh.faces].any(axis=1)
    _refuse_models(scene, name, [mesh.materials[m] for m in np.unique(mesh.face_material[some])])
    if key == "position_m":
        return RcsParameter((3,), lambda found: np.einsum("ijk,jk->i", slopes, found.vertices))
    return RcsParameter((), lambda found: np.asarray((slopes[0] * found.vertices).sum()))


def _turned(scene: World, key: str, step: Any) -> NDArray[np.float64]:
    """The vertices of all that there is, moved, or turned about the reference point."""
    about = np.asarray(scene.reference_point_m)
    if key == "position_m":
        return scene.mesh.vertices + step
    angles = {"heading_deg": 0.0, "pitch_deg": 0.0, "roll_deg": 0.0, key: step}
    moved: NDArray[np.float64] = (scene.mesh.vertices - about) @ rotation(**angles).T + about
    return moved


def _placed(scene: World, one: Parameter, step: Any) -> NDArray[np.float64]:
    """The vertices with one object moved by a step of one key."""
    return np.asarray(at(scene, {one: one.value + step}).mesh.vertices)
