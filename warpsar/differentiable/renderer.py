"""`warpsar.renderer`: the images of a scene for gradients, in NumPy, PyTorch and JAX."""

from __future__ import annotations

from functools import cached_property
from os import PathLike

from warpsar.differentiable.derivatives import Derivatives
from warpsar.differentiable.jax_callback import JaxRenderer
from warpsar.differentiable.pytorch import TorchRenderer
from warpsar.errors import refuse_number
from warpsar.runtime import devices
from warpsar.scene.scene import Scene, scene_or_file
from warpsar.trace.hits import DEFAULT_MEMORY_GIB
from warpsar.world.world import refuse_without_views


class Renderer(Derivatives):
    """`Derivatives`, and the same as a function of PyTorch tensors and of JAX arrays."""

    @cached_property
    def torch(self) -> TorchRenderer:
        """The renderer as a function of PyTorch tensors (extra `torch`)."""
        return TorchRenderer(self)

    @cached_property
    def jax(self) -> JaxRenderer:
        """The renderer as a function of JAX arrays (extra `jax`)."""
        return JaxRenderer(self)


def renderer(
    scene: Scene | PathLike[str] | str,
    *,
    device: str | None = None,
    seed: int | None = None,
    max_memory_gib: float = DEFAULT_MEMORY_GIB,
    vertices: bool = False,
) -> Renderer:
    """The scene's images as a differentiable function of its parameters.

    >>> render = warpsar.renderer(scene)
    >>> wetter = {"materials.ground.eps_r": 5.0}
    >>> images = render(wetter)                                  # {view: {polarization: (rows, cols) float32}}
    >>> gradients = render.vjp(wetter, images)                   # {parameter: array}, of half the sum of squares
    >>> moved = render.jvp({}, {"materials.ground.eps_r": 1.0})  # {view: {polarization: d image / d eps_r}}

    Parameters are what `learn` of the materials and objects names, and what the declared effects state
    (`Renderer.parameters`). `vertices` frees every vertex of the mesh, as "mesh.vertices". `render.torch` and
    `render.jax` are the same for PyTorch and JAX. The images are those of `simulate`, with the scene's sampling; where
    anything of the geometry is free, they are of exact areas (`trace.exact`). The hits of all views are kept in memory.
    `seed` overrides the scene's. Raises DeviceError for a device that is not there, and InputError where no view can be
    rendered, or where the geometry is free and the images have no derivative to it.
    """
    scene = scene_or_file(scene)
    refuse_without_views(scene)
    refuse_number(max_memory_gib, "max_memory_gib", above=True)
    where = devices.resolve_device(device)
    return Renderer(scene, where, scene.seed(seed), max_memory_gib, vertices=vertices)
