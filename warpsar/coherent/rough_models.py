"""Models of rough faces beside `ka_spm`: which scatterers have which, and what their kernels look up."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent.records import upload
from warpsar.errors import InputError
from warpsar.kernels import crossed_table, parts
from warpsar.kernels.codes import Coordinate, Spectrum, Variant
from warpsar.kernels.incidence_table import DOUBLE
from warpsar.models import registry
from warpsar.runtime import devices
from warpsar.surface import tables as sigma0_tables
from warpsar.surface.surface import places_of
from warpsar.surface.terms import Terms
from warpsar.world.tables import OF_RAYS, Material
from warpsar.world.world import World


def refuse_tables(world: World) -> None:
    """Raise InputError where a term needs the permittivity of a material that has a table of sigma0 alone."""
    terms = [term for term in world.radar.terms if term in OF_RAYS]
    for name in world.mesh.materials:
        material = world.materials[name]
        needless = not registry.get(material.model).of_surface
        if terms and needless and None in (material.eps_r, material.rms_height_m):
            raise InputError(
                f'{world.name}: materials.{name}: found model = "{material.model}" without eps_r and rms_height_m, '
                f"which the terms {', '.join(terms)} need; state both, or leave these terms out of radar.terms"
            )


def kind_of(material: Material) -> int:
    """0 for `ka_spm`; materials of another model, or with a learned term, have another number."""
    return 2 * registry.names().index(material.model) + (material.learned_term is not None)


def backscatter_alone(materials: Iterable[Material], variant: int) -> list[str]:
    """What rough faces of these materials send back toward the transmitter alone, in words."""
    rough = [each for each in materials if each.rms_height_m != 0.0]
    found = {f'the model "{each.model}"' for each in rough if kind_of(each) > 1}  # 0 and 1 are those of the first one
    found |= {"a learned term" for each in rough if each.learned_term is not None}
    if rough and variant == Variant.AS_PRINTED:
        found.add('radar.variant "as_printed"')
    return sorted(found)


@dataclass(frozen=True)
class ScattererGroup:
    """Scatterers of one kind, which lie together."""

    kind: int
    part: slice
    crossed: wp.array | None
    """(n,), vec2d: complex Gaussian numbers of double scattering; None for `ka_spm`, which has none."""

    def launched(self, default: wp.Kernel, make: Callable[[str, bool], wp.Kernel], tables: Any) -> Any:
        """The kernel, and its inputs beyond those of the `default` one, which is that of `ka_spm`."""
        if self.crossed is None:
            return default, []
        return kernel_of(self.kind, make), [tables, self.crossed]


def load(kinds: NDArray[np.int64], make: Callable[[str, bool], wp.Kernel], device: wp.Device) -> None:
    """Compile the kinds' kernels, or load them from Warp's cache, before threads launch them."""
    devices.load_kernels(device, alone=[kernel_of(kind, make) for kind in np.unique(kinds[kinds > 0]).tolist()])


def kernel_of(kind: int, make: Callable[[str, bool], wp.Kernel]) -> wp.Kernel:
    """That of the kind's model, with or without a learned term."""
    return make(registry.names()[kind // 2], bool(kind % 2))


def tables_of(materials: Sequence[Material], k: NDArray[np.float64], device: wp.Device) -> Any:
    """What the models look up at each wavenumber [1/m]. Raises InputError for files that are no tables or terms."""
    found: Any = parts.Lookup()
    found.twice = _double_scattering(materials, k, device)
    zeta = np.zeros((len(materials), max(len(places_of(each.model)) for each in materials)))
    for m, each in enumerate(materials):
        own = _coordinates(each)
        zeta[m, : len(own)] = own
    found.zeta = upload(zeta, wp.float64, device)
    tables = sigma0_tables.Tables.of([each.sigma0 for each in materials], device)
    if tables is not None:
        found.rows, found.incidence_deg, found.sigma0_db = tables.rows, tables.incidence_deg, tables.sigma0_db
    terms = Terms.of([each.learned_term for each in materials], device)
    if terms is not None:
        found.units, found.inverse_width = terms.first, terms.inverse_width
        found.places, found.weights = terms.places, terms.weights
    return found


def _coordinates(material: Material) -> list[float]:
    """The learned coordinates of a uniform material, by their places; 0 of what it does not state."""
    stated: list[Any] = [getattr(material, kind.key) for kind in places_of(material.model)]
    numbers = [each[0] if isinstance(each, tuple) else each for each in stated]
    return [
        0.0 if number is None else float(kind.to_coordinate(number))
        for kind, number in zip(places_of(material.model), numbers, strict=True)
    ]


def _double_scattering(materials: Sequence[Material], k: NDArray[np.float64], device: wp.Device) -> wp.array:
    """HV of `i2em` by double scattering: the intensity renderer's tables, (wavenumbers * materials, nodes)."""
    own = [m for m, each in enumerate(materials) if each.model == "i2em"]
    if not own:
        return wp.empty((0, 0), dtype=wp.vec4, device=device)
    zeta = np.zeros((len(materials), len(Coordinate)), np.float32)
    eps_im = np.zeros(len(materials), np.float32)
    spectrum = np.zeros(len(materials), np.int32)
    for m in own:
        each: Any = materials[m]
        eps = each.eps_r if isinstance(each.eps_r, tuple) else (each.eps_r, 0.0)
        zeta[m, :3] = np.log([eps[0] - 1.0, each.rms_height_m, each.correlation_length_m])
        eps_im[m], spectrum[m] = -eps[1], Spectrum[each.spectrum.upper()]
    shared = upload(np.array([own, own], np.int32).T.copy(), wp.vec2i, device), upload(spectrum, int, device)
    losses, surface = upload(eps_im, float, device), upload(zeta, wp.vec4, device)
    wave = wp.empty((len(own), DOUBLE, crossed_table.WAVES), dtype=wp.vec4d, device=device)
    out = wp.zeros((len(k) * len(materials), DOUBLE), dtype=wp.vec4, device=device)
    for i, wavenumber in enumerate(k.tolist()):
        inputs = [wavenumber, *shared, losses, surface]
        wp.launch(crossed_table.wave_kernel, wave.shape, inputs=inputs, outputs=[wave], device=device)
        rows = out[i * len(materials) : (i + 1) * len(materials)]
        inputs = [wavenumber, *shared, surface, wave]
        wp.launch(crossed_table.double_kernel, wave.shape[:2], inputs=inputs, outputs=[rows], device=device)
    return out
