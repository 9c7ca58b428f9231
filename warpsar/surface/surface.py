"""The surface parameters of all materials as one vector of nodes: what a fit changes.

A node is a number in the learned coordinate of its parameter: ln(eps_r - 1), ln h, ln l or logit tau. A parameter of a
material has one node (`uniform`), one for each vertex, or one for each texel of a texture. Kernels find all of them
through one table.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from warpsar.errors import InputError
from warpsar.kernels.codes import PAGE, Layout, Spectrum
from warpsar.models import registry
from warpsar.models.base import parameters
from warpsar.models.base.model import DEFAULT, SurfaceParameter
from warpsar.models.base.parameters import OF_SURFACES
from warpsar.world.pixels import Pixels
from warpsar.world.tables import Material
from warpsar.world.transform import Transform
from warpsar.world.world import World


@dataclass(frozen=True)
class Kind:
    """A surface parameter: its key in scene.toml, its symbol, its learned coordinate, and how far a fit may go (SI).

    `low_limit` and `high_limit` are the least and the most that it may be at all.
    """

    key: str
    symbol: str
    transform: Transform
    low: float
    high: float
    low_limit: float
    high_limit: float
    own: bool
    """Whether it is a model's own, and not of all surfaces"""

    def to_coordinate(self, value: ArrayLike) -> np.ndarray:
        """The learned coordinate of a value, of its shape."""
        return np.asarray(self.transform.to_coordinate(np.asarray(value, float)))

    def from_coordinate(self, coordinate: ArrayLike) -> np.ndarray:
        """The value at a learned coordinate, of its shape."""
        return np.asarray(self.transform.from_coordinate(coordinate))

    def slope(self, coordinate: ArrayLike) -> np.ndarray:
        """d value / d coordinate at a coordinate, of its shape."""
        return np.asarray(self.transform.slope(coordinate))

    def interval(self, ends: ArrayLike) -> tuple[float | None, float | None]:
        """Both ends (SI) of an interval of the coordinate, shape (2,); None where that is infinite: it is open."""
        with np.errstate(over="ignore"):  # hundreds of log units end at infinity
            low, high = (float(self.from_coordinate(end)) if np.isfinite(end) else None for end in np.asarray(ends))
        return low, high


@cache
def _kind(parameter: SurfaceParameter) -> Kind:
    low, high = parameter.limits
    least = low if parameter.from_low else float(np.nextafter(low, np.inf))
    bounds = parameter.low, parameter.high, least, high
    return Kind(
        parameter.key, parameter.symbol, Transform(parameter.coordinate), *bounds, own=parameter not in OF_SURFACES
    )


def kinds_of(model: str) -> tuple[Kind, ...]:
    """What sigma0 by a model depends on."""
    return tuple(map(_kind, registry.get(model).parameters))


def places_of(model: str) -> tuple[Kind, ...]:
    """The learned coordinates of a hit, by their places; a place that the model has not has a `KINDS`."""
    return tuple(map(_kind, parameters.places_of(registry.get(model).parameters)))


KINDS = tuple(map(_kind, OF_SURFACES))
KEYS = tuple(kind.key for kind in KINDS)


@dataclass(frozen=True)
class Block:
    """Nodes of one parameter of one material: `nodes[start : start + size]`, shaped `shape`."""

    material: str
    kind: Kind
    layout: str  # of this parameter: a plain number is "uniform" in every material
    start: int
    shape: tuple[int, ...]
    learn: bool
    first_vertex: int = 0  # vertex layout: the mesh vertex of the first node

    @property
    def size(self) -> int:
        return int(np.prod(self.shape, dtype=int))

    @property
    def stop(self) -> int:
        return self.start + self.size


def _refuse_smooth(scene: World, name: str, material: Material) -> None:
    """Refuse what sends no power back in the mean: it has a phase, and belongs into a coherent product."""
    stated = {"conductor = true": material.conductor, "rms_height_m = 0": material.rms_height_m == 0.0}
    stated[f"thickness_m = {material.thickness_m}"] = material.thickness_m is not None
    stated["layers"] = bool(material.layers)
    if found := [key for key, there in stated.items() if there]:
        raise InputError(
            f"{scene.name}: materials.{name}: found {', '.join(found)}; an image of power must have rough half-spaces "
            "(eps_r, rms_height_m above 0, correlation_length_m); smooth surfaces are for `warpsar rcs`"
        )


@dataclass
class Surface:
    """The parameters of all materials, and what each node means.

    `nodes`, float64 (n,), are in the learned coordinates. `places`, int32 (materials, p, 4), is the kernels' table of
    (layout, offset, width, height) for each parameter; p is 4, or the next multiple of it where a model has more.
    `spectrum` (int), `eps_im` and `aspect` (l_y / l_x),
    (materials,), are never learned; nor are the names of `model`, and the files of `sigma0` (tables) and of
    `learned_term`.
    """

    materials: tuple[str, ...]
    blocks: tuple[Block, ...]
    nodes: np.ndarray
    places: np.ndarray
    spectrum: np.ndarray
    eps_im: np.ndarray
    aspect: np.ndarray
    model: tuple[str, ...]
    sigma0: tuple[Path | None, ...]
    learned_term: tuple[Path | None, ...]

    @classmethod
    def of(cls, scene: World) -> Surface:
        """The surface a scene file declares."""
        blocks: list[Block] = []
        values: list[np.ndarray] = []
        names = tuple(scene.mesh.materials)
        most = max(len(places_of(scene.materials[name].model)) for name in names)
        places = np.zeros((len(names), -(-most // PAGE) * PAGE, 4), np.int32)
        places[:, :, 0] = Layout.HELD
        spectrum = np.zeros(len(names), np.int32)
        eps_im = np.zeros(len(names), np.float32)
        aspect = np.ones(len(names), np.float32)
        start = 0
        for m, name in enumerate(names):
            material = scene.materials[name]
            _refuse_smooth(scene, name, material)
            spectrum[m] = Spectrum[material.spectrum.upper()]
            ends: tuple[int, int] | None = None  # the first and the last vertex of its faces
            for k, kind in enumerate(places_of(material.model)):
                declared = getattr(material, kind.key)
                if declared is None:
                    declared = 1.0  # the model does not look at it
                if isinstance(declared, str | Pixels):
                    value = np.asarray(scene.field(name, kind.key), float)
                    layout = material.layout
                elif isinstance(declared, tuple):
                    value, layout = np.array([declared[0]], float), "uniform"
                    if kind.key == "eps_r":
                        eps_im[m] = -declared[1]
                    else:
                        aspect[m] = declared[1] / declared[0]
                else:
                    value, layout = np.array([declared], float), "uniform"
                first_vertex = 0
                if layout == "vertex":
                    if ends is None:
                        corners = scene.mesh.faces[scene.mesh.face_material == m]
                        ends = int(corners.min()), int(corners.max())
                    first_vertex = ends[0]
                    value = value[first_vertex : ends[1] + 1]
                height, width = value.shape if layout == "texture" else (0, 0)
                held = layout == "uniform" and kind.key not in material.learn
                code = Layout.HELD if held else Layout[layout.upper()]
                places[m, k] = (code, start - first_vertex, width, height)
                blocks.append(Block(name, kind, layout, start, value.shape, kind.key in material.learn, first_vertex))
                values.append(kind.to_coordinate(value).ravel())
                start += value.size
        tables = tuple(scene.materials[name].sigma0 for name in names)
        model = tuple(scene.materials[name].model for name in names)
        terms = tuple(scene.materials[name].learned_term for name in names)
        nodes = np.concatenate(values)
        return cls(names, tuple(blocks), nodes, places, spectrum, eps_im, aspect, model, tables, terms)

    @property
    def by_default(self) -> np.ndarray:
        """Which materials have the default model, (materials,) bool."""
        return np.array([model == DEFAULT for model in self.model])

    def block(self, material: str, key: str) -> Block:
        """The nodes of one parameter of a material."""
        return next(b for b in self.blocks if b.material == material and b.kind.key == key)

    def values(self, material: str, key: str, nodes: np.ndarray | None = None) -> np.ndarray:
        """One parameter of a material in SI units, in its block's shape; by default of the surface's own nodes."""
        block = self.block(material, key)
        source = self.nodes if nodes is None else nodes
        return np.asarray(block.kind.from_coordinate(source[block.start : block.stop])).reshape(block.shape)

    @property
    def learned(self) -> np.ndarray:
        """Indices of the nodes that may change, shape (p,), int64."""
        parts = [np.arange(b.start, b.stop) for b in self.blocks if b.learn]
        return np.concatenate(parts) if parts else np.zeros(0, int)
