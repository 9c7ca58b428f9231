"""All data of a scene: a mesh, its materials, the views of it, and the measured images."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from dataclasses import field as dataclass_field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError, refuse_number
from warpsar.io.images import read_channel, read_mask
from warpsar.models import registry
from warpsar.models.base.model import DEFAULT
from warpsar.world.collection import Collection
from warpsar.world.curve import Curve
from warpsar.world.frame import SPEED_OF_LIGHT, ViewGeometry, view_geometry
from warpsar.world.mesh import Mesh
from warpsar.world.objects.assembly import Assembly
from warpsar.world.objects.table import Object
from warpsar.world.pixels import Pixels
from warpsar.world.tables import SURFACE_KEYS, Grid, Material, Origin, Radar, Sampling, View

W = TypeVar("W", bound="World")

NO_IMAGE = Grid(shape=(1, 1), spacing_m=(1.0, 1.0))
"""Stands for the grid of a scene that has no views: of a body whose radar cross-section alone is asked for."""


@dataclass(frozen=True, eq=False)
class World:
    """A scene with all that its files hold, checked; `dataclasses.replace` makes a changed one.

    Effects, rays and surfaces need no more. `warpsar.scene.scene.Scene` adds load and save.
    """

    mesh: Mesh
    radar: Radar
    grid: Grid
    materials: dict[str, Material]
    """In the order of `mesh.materials`."""
    views: list[View]
    sampling: Sampling = dataclass_field(default_factory=Sampling)
    effects: dict[str, dict[str, Any]] = dataclass_field(default_factory=dict)
    """Parameters of the declared effects, as `warpsar.effects.registry.validate` gives them."""
    reference_point_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where range and azimuth are zero [m], world."""
    accuracy_m: float | None = None
    """Standard deviation of the mesh's outlines about their true places along each axis [m]; None if not stated."""
    origin: Origin | None = None
    """Where the world lies on the earth; None where it is not said, or said by a DEM."""
    path: Path | None = None
    """The scene file, absolute; None for a scene made in memory."""
    mesh_path: Path | None = None
    """The mesh file, absolute."""
    warnings: tuple[str, ...] = ()
    """What the user should be told about the input, one line each."""
    source: str = dataclass_field(default="", repr=False)
    """The scene file's text: `save` keeps its comments."""
    objects: tuple[Object, ...] = ()
    """What `[[objects]]` places; `mesh` holds it already."""
    assembly: Assembly | None = dataclass_field(default=None, repr=False)
    """What `mesh` is made of, where there are objects."""
    curves: tuple[Curve, ...] = ()
    """Measured radar cross-sections; their files are absolute."""
    collection: Collection | None = None
    """How a sensor collects the views; its file is absolute."""

    def seed(self, given: int | None) -> int:
        """The seed that was given, else that of `[sampling]`. Raises InputError for what is none."""
        if given is None:
            return self.sampling.seed
        refuse_number(given, "seed", whole=True)
        return int(given)

    @property
    def name(self) -> str:
        """What a message calls it: the scene file, else the mesh's, or "scene in memory"."""
        return str(self.path or self.mesh_path or "scene in memory")

    def wavenumber(self, view: View) -> float:
        """2 pi f / c [rad/m] of a view."""
        return 2.0 * math.pi * (view.frequency_hz or self.radar.frequency_hz) / SPEED_OF_LIGHT

    def slant_range_m(self, view: View) -> float | None:
        """Range from the track to the reference point [m]; None for a plane wave."""
        return view.slant_range_m or self.radar.slant_range_m

    @property
    def has_images(self) -> bool:
        """Whether any view has a measured image."""
        return any(view.images for view in self.views)

    @property
    def has_curves_alone(self) -> bool:
        """Whether curves are all that was measured."""
        return bool(self.curves) and not self.has_images

    def measured(self, view: View, polarization: str) -> NDArray[np.float32]:
        """The measured image: beta0, linear power, shape (rows, cols); NaN where it is not finite."""
        given = view.images[polarization]  # type: ignore[index]
        image = given.values if isinstance(given, Pixels) else read_channel(given, polarization, self.grid.shape)
        return np.where(np.isfinite(image), image, np.float32(np.nan))

    def mask(self, view: View) -> NDArray[np.bool_] | None:
        """The pixels that the view's mask lets through, shape (rows, cols); None without a mask."""
        if isinstance(view.mask, Pixels):
            return view.mask.values
        return None if view.mask is None else read_mask(view.mask, shape=self.grid.shape)

    def field(self, material: str, key: str) -> NDArray[np.float32] | NDArray[np.float64]:
        """The values of the field that a material's value `key` names.

        A texture is float32, (rows, cols), with row 0 at v = 1. A scalar of the mesh's vertices is float64, (n,).
        Raises InputError where the value is a number.
        """
        table = self.materials[material]
        name = getattr(table, key)
        if isinstance(name, Pixels):
            return name.values
        if not isinstance(name, str):
            raise InputError(f"materials.{material}.{key} is the number {name}, not the name of a field")
        return read_channel(name, key) if table.layout == "texture" else self.mesh.vertex_scalars[name]

    def rasters(self) -> Iterator[Path | Pixels]:
        """Every image, mask, map and file of curves that the scene refers to, in a fixed order."""
        for material in self.materials.values():
            yield from (file for file in (material.sigma0, material.learned_term) if file is not None)
            for key in SURFACE_KEYS:
                value = getattr(material, key)
                if isinstance(value, Pixels):
                    yield value
                elif isinstance(value, str) and material.layout == "texture":
                    yield Path(value)
        for view in self.views:
            yield from (view.images[key] for key in sorted(view.images))
            if view.mask is not None:
                yield view.mask
        yield from sorted({curve.file for curve in self.curves})
        yield from sorted({curve.mesh for curve in self.curves if curve.mesh is not None})
        if self.collection is not None:
            yield from self.collection.files.values()

    @cached_property
    def input_hash(self) -> str:
        """SHA-256 of the scene file, the mesh as read, and every image that the scene names; paths do not count.

        A scene made in memory has no file: its tables stand for it.
        """
        total = hashlib.sha256((self.source or self._tables()).encode())
        mesh = self.mesh
        scalars = dict(sorted(mesh.vertex_scalars.items()))
        total.update(repr((mesh.materials, mesh.vertices.shape, mesh.faces.shape, list(scalars))).encode())
        for array in (mesh.vertices, mesh.faces, mesh.face_material, mesh.uv, *scalars.values()):
            if array is not None:
                total.update(np.ascontiguousarray(array).data)
        for raster in self.rasters():
            if isinstance(raster, Pixels):
                total.update(raster.sha256.encode())
                continue
            with raster.open("rb") as stream:
                total.update(hashlib.file_digest(stream, "sha256").digest())
        return total.hexdigest()

    def _tables(self) -> str:
        """The tables as text, without what names a file."""
        plain: list[Any] = [self.radar, self.grid, self.sampling, self.effects, self.reference_point_m, self.accuracy_m]
        plain += [one.model_dump(exclude={"mesh"}) for one in self.objects]
        plain += [one.model_dump(exclude={"file", "mesh"}) for one in self.curves]
        plain += [] if self.collection is None else [self.collection.with_files(lambda _: "").model_dump()]
        for name, material in self.materials.items():
            model = registry.get(material.model)
            beside = {"sigma0", "learned_term"} | (registry.own_parameters().keys() - set(model.keys))
            beside |= {"model"} if material.model == DEFAULT else set()
            given = {
                key: value
                for key, value in material
                if key not in beside and (material.layout != "texture" or not isinstance(value, str))
            }
            plain.append((name, material.layout, material.spectrum, given))
        for view in self.views:
            plain.append(
                [
                    (key, sorted(value) if key == "images" else value)
                    for key, value in view
                    if key not in ("mask", "slc")
                ]
            )
        return repr(plain)


def refuse_without_views(world: World) -> None:
    """Raise InputError where a scene has no view, so that no image of it can be made."""
    if not world.views:
        raise InputError(f"{world.name}: views: found none; an image needs [image] and [[views]]")


def lacks_images(world: World, *roles: str) -> InputError:
    """To raise where no view of these roles has measured images: how to get some."""
    return InputError(
        f"{world.name}: views: none with role {' or '.join(roles)} has measured images; warpsar import brings one onto "
        "a view's grid, and warpsar simulate --looks 4 --declare makes some to try"
    )


def refuse_both_kinds(world: World) -> None:
    """Raise InputError where a scene to be diagnosed has curves beside images."""
    if world.curves and world.has_images:
        raise InputError(
            f"{world.name}: found curves and images; diagnose must have one of them, because a departure of images is "
            f"no hypothesis about curves; learn and evaluate take both"
        )


def posed(world: W, objects: Sequence[Object]) -> W:
    """The scene with its objects, the same ones, at other places or of other sizes."""
    assert world.assembly is not None
    mesh = world.assembly.moved_mesh(world.mesh, world.objects, objects)
    return replace(world, objects=tuple(objects), mesh=mesh)


def geometry_of(world: World, view: View) -> ViewGeometry:
    """Axes of a view, with its own frequency and slant range or those of [radar]."""
    frequency_hz = view.frequency_hz or world.radar.frequency_hz
    return view_geometry(view.azimuth_deg, view.incidence_deg, frequency_hz, world.slant_range_m(view))
