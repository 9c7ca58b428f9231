"""What a scene declares and a product with phase does not have: it concerns images of power alone."""

from __future__ import annotations

from warpsar.effects.registry import acting, get
from warpsar.errors import InputError
from warpsar.world.world import World


def left_out(world: World) -> dict[str, str]:
    """Keys of the scene that change its images, and no phase history, complex image or RCS; each with what stands for
    it there, or "".

    An effect at neutral values changes nothing, and is none of them.
    """
    found = {f"effects.{name}": get(name).with_phase for name in acting(world)}
    if world.radar.polarization_basis != "radar":
        found["radar.polarization_basis"] = ""
    return found


def refuse_left_out(world: World) -> None:
    """Raise InputError, one message with every key, for a product that would be another than the scene declares."""
    problems = [
        f"{key}: found in a scene for a product with phase, which does not have it; "
        + (f"allowed there is {instead}" if instead else "must be left out there")
        for key, instead in left_out(world).items()
    ]
    if problems:
        one = problems[0] if len(problems) == 1 else "\n  ".join([f"{len(problems)} things are wrong", *problems])
        raise InputError(f"{world.name}: {one}")


def said_left_out(world: World, what: str) -> list[str]:
    """The warning that `what`, which is no image, goes on without them; empty where there are none."""
    found = left_out(world)
    return [f"not applied, since {what} has none of what concerns images alone: {', '.join(found)}"] if found else []
