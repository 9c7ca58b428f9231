"""What an effect is: what it changes, at which stage between hits and image, and by which parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, get_args

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.effects.base.parameter import EffectParameter, Setting
from warpsar.effects.base.phase import ComplexImage, Copy, Response
from warpsar.effects.base.product import Product
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage, Signature
from warpsar.effects.base.trial import Context, Trial
from warpsar.errors import InputError
from warpsar.world.frame import ViewGeometry
from warpsar.world.tables import Grid
from warpsar.world.world import World

StageName = Literal["surface", "gain", "position", "path", "image"]
STAGES: tuple[StageName, ...] = get_args(StageName)
"""In the order in which they act."""


class Effect:
    """One physical effect, in one file. A subclass overrides the hook of its stage.

    A hook records launches on the render's program. It returns a new array in place of the one that it was given, and
    never changes that one. `p` holds the effect's continuous parameters in this view, on the device, in the order of
    `parameters`: float32, shape (number of parameters,), with a gradient of its own. At neutral values the image is
    the one without the effect, to float32 rounding, and every gradient is finite.
    """

    name: ClassVar[str]
    stage: ClassVar[StageName]
    order: ClassVar[int]  # among the effects of its stage: smaller ones act first
    summary: ClassVar[str]
    example: ClassVar[dict[str, Any]]
    """Its table, strong enough to be seen in a picture of the example scene; values per view are for `v0` and `v1`."""
    rate_case: ClassVar[dict[str, Any]]
    """Its table where `diagnose` is counted (benchmarks/diagnosis_rates.py); values per view are for `v0` to `v3`."""
    parameters: ClassVar[tuple[EffectParameter, ...]] = ()
    settings: ClassVar[tuple[Setting, ...]] = ()
    additive: ClassVar[bool] = False  # puts power where the scene has none: judged on the dark pixels too
    is_floor: ClassVar[bool] = False  # adds the same positive power to every pixel: none may measure exactly 0
    in_image: ClassVar[bool] = False  # acts at places of the image, whatever surface lies there
    at_edges: ClassVar[bool] = False  # moves or spreads what an image has: edges tell it, even ground does not
    affine: ClassVar[bool] = False  # image stage: a matrix times the image, plus an image that does not depend on it
    by_incidence: ClassVar[bool] = False  # changes a hit's power by its angles alone, wherever it lies
    needs_all_hits: ClassVar[bool] = False  # starts from all hits of a view at once: cannot be rendered in bands
    contains: ClassVar[tuple[str, ...]] = ()  # effects that a fit holds while it moves this one: it can do all they do
    follows_rays: ClassVar[bool] = (
        False  # traces ways over several surfaces: one fit of it costs as much as many others
    )
    last_resort: ClassVar[bool] = False  # can do what named effects do: none of the candidates of a search
    of_left_out: ClassVar[bool] = False  # its places come from what images leave: `diagnose --folds` looks for it
    of_phase: ClassVar[bool] = False  # power cannot tell it: `diagnose` asks complex images
    of_numbers: ClassVar[bool] = False  # how a product wrote power as numbers: not searched where the product says it
    beyond_mesh: ClassVar[bool] = False  # stands for detail that stands out from the mesh, and ends a body
    sets_positions: ClassVar[bool] = False  # a fit that moves it holds the positions of objects
    acts_on: ClassVar[tuple[Product, ...]] = ("beta0",)  # all other products refuse it by name
    in_place: ClassVar[str] = ""  # what a user writes for products that refuse it; they say so
    term: ClassVar[str] = ""  # the term of a complex model (`radar.terms`) that has it, which curves of RCS can ask for
    of_surfaces_with: ClassVar[Literal["", "default", "eps_r"]] = ""
    """What a material must have beside it: the default backscatter model, whose equations it takes; a permittivity."""
    bins_per_pixel: ClassVar[int] = 1  # how much finer than the image, per axis, the hits are binned for it

    def margin_m(self, grid: Grid, values: np.ndarray) -> float:
        """How far beyond the image, on each side, hits are binned for it [m].

        `values` are in the order of `parameters`.
        """
        return 0.0

    def spread_m(self, table: Mapping[str, Any]) -> float | None:
        """Up to the image stage: the full width of the Gaussian by which it spreads power over the image [m], 0 where
        it does not (`shift_m` is beside that); None where it carries power anywhere."""
        return None if self.stage == "path" else 0.0

    def law_db(self, table: Mapping[str, Any], incidence_deg: np.ndarray) -> Mapping[str, np.ndarray]:
        """What `table` makes of sigma0 [dB] at local incidences (n,), by polarization: a law for people to look at;
        none for an effect that has a name."""
        return {}

    # ---- products with phase, where `acts_on` names them ----
    # A gain acts on them by its hook `gain`: the power of a scatterer is multiplied, its phase stays. A position
    # effect acts by `shift_m`: scatterers move. Other effects override one of these.

    def response(self, values: np.ndarray, settings: Mapping[str, Any]) -> Response:
        """What it asks of the system's response. `values` as in `margin_m`."""
        return Response()

    def noise_beta0(self, values: np.ndarray) -> float:
        """Mean beta0 of the receiver's noise in a focused image. It is white in the phase history."""
        return 0.0

    def copies(self, values: np.ndarray) -> tuple[Copy, ...]:
        """Further images of all scatterers that lie in the image, each times a phase of its own."""
        return ()

    def phase(
        self, values: np.ndarray, settings: Mapping[str, Any], place: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """By how much it turns the samples that are recorded at places of the aperture [rad], of the shape of `place`,
        which goes from -1 to 1 along azimuth. None where it turns none."""
        return None

    def samples(
        self, image: ComplexImage, values: np.ndarray, settings: Mapping[str, Any], samples: np.ndarray
    ) -> np.ndarray:
        """What becomes of the samples of a complex image, complex64, (rows, cols), of one polarization."""
        return samples

    def shift_m(self, values: np.ndarray, geometry: ViewGeometry) -> np.ndarray:
        """Range and azimuth [m] by which the effect moves a view's image, shape (2,); `values` as in `margin_m`."""
        return np.zeros(2)

    def trials(self, context: Context) -> list[Trial]:
        """How a score test looks for the effect; empty where this scene has no place for it."""
        raise NotImplementedError

    def refinements(
        self, scene: World, table: Mapping[str, Any], others: Sequence[Mapping[str, Any]]
    ) -> list[tuple[Mapping[str, Any], int]]:
        """Tables to try in place of the fitted `table`, where no derivative leads to them.

        They have other settings near its own, or more of the same. The number beside each says how many more free
        choices it makes than `table`. `others` are the tables of the other trials that scored, best first.
        """
        return []

    def extensions(self, table: Mapping[str, Any]) -> Mapping[str, Mapping[str, Any]]:
        """Tables where fits begin with more of the effect than the fitted `table` states, by what is more."""
        return {}

    def simpler(self, table: Mapping[str, Any]) -> list[Mapping[str, Any]]:
        """The table less one of its parts each, where it has several: what was taken in for an effect that was still
        missing may be needless beside it."""
        return []

    def placed_in_the_dark(
        self, scene: World, table: Mapping[str, Any], power: Mapping[str, np.ndarray]
    ) -> Mapping[str, Any] | None:
        """`table` with the places at which it alone can put power into dark pixels; None where these say nothing, and
        empty where they leave it no place.

        `power` [beta0] by view name, shape (rows, cols), is measured where nothing else can be: 0 where nothing is,
        NaN where this cannot be said.
        """
        return None

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """Places of an image that must hold the effect alike, as masks (rows, cols); none for an effect that has no
        such places. `table` is the fitted one."""
        return {}

    def own_test(self, images: Sequence[SeenImage], table: Mapping[str, Any]) -> Signature | None:
        """A test of what this effect leaves and no other does, where there is one."""
        return None

    def doubts(self, render: Recorder) -> list[str]:
        """After a run: what may be wrong with the mesh, sentences. It costs work that a fit does not need."""
        return []

    def further(self, render: Recorder) -> Mapping[str, Any] | None:
        """After a run, of an effect that `follows_rays`: settings under which it follows them over one more surface;
        None where no ray goes on, or none can be followed."""
        return None

    def left_out(self, render: Recorder, other: Recorder) -> LeftOut | None:
        """What the image of `render` lacks of the one of `other`, whose settings are `further`, if it matters."""
        return None

    def check(self, scene: World, table: Mapping[str, Any]) -> str | None:
        """What is wrong with a valid table in this scene; None if nothing. The text follows `effects.<name>`."""
        return None

    def needed(self) -> list[EffectParameter | Setting] | None:
        """The keys of which a table must state one, since it would do nothing without; None if it acts anyway."""
        bring: list[EffectParameter | Setting] = [p for p in self.parameters if p.brings_it]
        return None if any(p.brings_it and p.unstated is not None for p in self.parameters) else bring

    def parameter(self, name: str) -> EffectParameter:
        """The continuous parameter `name`. Raises InputError for a setting: it has no derivative to learn by."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        known = ", ".join(p.name for p in self.parameters)
        discrete = any(s.name == name for s in self.settings)
        what = "is discrete and cannot be learned" if discrete else "is no parameter"
        raise InputError(f"effects.{self.name}.{name}: {what}; allowed are {known}")

    def setting(self, name: str) -> Setting:
        """The setting `name`."""
        return next(one for one in self.settings if one.name == name)

    def coordinates(self, render: Recorder, p: wp.array, zeta: wp.array, points: wp.array, page: int) -> wp.array:
        """Surface effects: change the learned coordinates `zeta` (vec4, kernels/shade.py) at `points`.

        These are the coordinates from number 4 * `page` on: models with more than four have several vectors, and an
        effect is asked for each. `points` are vec3 [m] about the reference point. All arrays have one shape, (n,).
        Here, in `scattering` and in `gain` an element of the result depends on the same element of `zeta` or `sigma`
        alone: Jacobians rely on it.
        """
        return zeta

    def scattering(self, render: Recorder, p: wp.array, zeta: wp.array, sigma: wp.array, polarization: int) -> wp.array:
        """Surface effects: change sigma0 of the hits, shape (hits,)."""
        return sigma

    def gain(self, render: Recorder, p: wp.array, sigma: wp.array, points: wp.array) -> wp.array:
        """Gains: change the power `sigma` that seems to come from `points` (vec3 [m], about the reference point).

        It is a factor on each `sigma`, of the point and of the view alone, and may use `render.program` and
        `render.geometry`: so it serves scatterers, too. The point of a hit is where the hit lies. A path over several
        surfaces has the point from which a single bounce would have its range, its azimuth and its mean elevation.
        """
        return sigma

    def shift(self, render: Recorder, p: wp.array, shift: wp.array) -> wp.array:
        """Position effects: `shift` plus their own. It is how far (rows, columns) [pixels] the bins of
        `render.hits.grid` are moved before they fall into pixels, shape (2,)."""
        raise NotImplementedError

    def paths(self, render: Recorder, p: wp.array, image: wp.array, polarization: int) -> wp.array:
        """Further paths from the radar to the scene and back: `image` plus their beta0 (see `Recorder.collect`)."""
        return image

    def image(self, render: Recorder, p: wp.array, image: wp.array) -> wp.array:
        """What the system does to the image, beta0, shape (rows * cols,)."""
        return image


@dataclass(frozen=True)
class LeftOut:
    """Power of ways over one surface more than an image has: over `bounces` surfaces.

    `rcs_m2`: the sum over the image in `polarization`; `over`: the ratio to the bounces that the image has, infinite
    where it has none. `takes`: whether an image can have them.
    """

    bounces: int
    polarization: str
    rcs_m2: float
    over: float
    takes: bool = True


@dataclass
class DeclaredEffect:
    """An effect with the values it has in one view: `values` in the order of `effect.parameters`."""

    effect: Effect
    values: np.ndarray
    settings: Mapping[str, Any] = field(default_factory=dict)
