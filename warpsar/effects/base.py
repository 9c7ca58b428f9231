"""What an effect is: what it changes, where on the way from hits to image, and with which parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

if TYPE_CHECKING:
    from warpsar.render import ViewRender

Stage = Literal["surface", "gain", "position", "path", "image"]


@dataclass(frozen=True)
class Parameter:
    """A continuous parameter of an effect, as it stands in scene.toml.

    At `neutral` the effect is not there. `start` is where a fit begins, `low` and `high` are what is allowed,
    `unit` is for people. `per_view` parameters are tables of view name -> value.
    """

    name: str
    unit: str
    neutral: float
    low: float
    high: float
    start: float
    per_view: bool = False


@dataclass(frozen=True)
class Setting:
    """A discrete choice of an effect: never differentiated, never learned."""

    name: str
    default: Any
    allowed: tuple[Any, ...]


class Effect:
    """One physical effect, in one file. Subclasses override the hook of their stage.

    A hook records launches on the render's program and returns the array that takes the place of the one it was
    given; it never changes that one. `p` is the device array of the effect's continuous parameters for this view,
    in the order of `parameters`, float32, with its own gradient.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    summary: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    settings: ClassVar[tuple[Setting, ...]] = ()
    bins_per_pixel: ClassVar[int] = 1  # how much finer than the image, per axis, the hits are binned for it
    margin_m: ClassVar[float] = 0.0  # and how far beyond the image on each side

    def coordinates(self, render: ViewRender, p: Any, zeta: Any) -> Any:
        """Surface effects on the learned coordinates of the hits: vec4 array, shape (hits,)."""
        return zeta

    def scattering(self, render: ViewRender, p: Any, zeta: Any, sigma: Any, polarization: int) -> Any:
        """Surface effects on sigma0 of the hits, shape (hits,)."""
        return sigma

    def gain(self, render: ViewRender, p: Any, sigma: Any, points: Any) -> Any:
        """Gains on the power that comes from `points` (vec3 array about the reference point), same shape as `sigma`."""
        return sigma

    def deposit(self, render: ViewRender, p: Any, sigma: Any, weight: Any, bins: Any, image: Any) -> None:
        """Position effects: add sigma * weight of each bin of `render.hits.grid` into `image`, shape (rows * cols,)."""
        raise NotImplementedError

    def paths(self, render: ViewRender, p: Any, image: Any, polarization: int) -> Any:
        """Further ways from radar to scene and back: a new array, `image` plus their beta0 (see `render.collect`)."""
        return image

    def image(self, render: ViewRender, p: Any, image: Any) -> Any:
        """What the system does to the image."""
        return image
