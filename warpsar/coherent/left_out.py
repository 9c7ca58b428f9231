"""What a scene declares and a product with phase does not have."""

from __future__ import annotations

from warpsar.effects.base.product import CALLED, Product
from warpsar.effects.registry import acting, get
from warpsar.errors import InputError, listed
from warpsar.world.world import World


def left_out(world: World, product: Product) -> dict[str, str]:
    """Keys of the scene that change its images and not this product; each with what is written in its place, or "".

    An effect at neutral values changes nothing, and is none of them.
    """
    effects = map(get, acting(world))
    found = {f"effects.{effect.name}": effect.in_place for effect in effects if product not in effect.acts_on}
    if product != "beta0" and world.radar.polarization_basis != "radar":
        found["radar.polarization_basis"] = ""
    return found


def refuse_left_out(world: World, product: Product) -> None:
    """Raise InputError, one message with every key, for a product that would be another than the scene declares."""
    problems = [
        f"{key}: found in a scene for {CALLED[product]}, a product with phase on which it does not act; "
        + (f"use {instead}" if instead else "must be left out there")
        for key, instead in left_out(world, product).items()
    ]
    if problems:
        raise InputError(listed(world.name, problems))


def left_out_warning(world: World, what: str) -> list[str]:
    """The warning that `what`, a cross-section or a curve of it, goes on without them; empty where there are none."""
    found = left_out(world, "rcs")
    return [f"not applied, since they act on images and not on {what}: {', '.join(found)}"] if found else []
