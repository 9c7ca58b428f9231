"""The renderer as a function of JAX arrays: `renderer.jax`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from warpsar.differentiable.derivatives import Derivatives
from warpsar.errors import InputError


class JaxRenderer:
    """Images of a scene as a function of arrays that `jax.grad` and `jax.vjp` differentiate, under `jax.jit` too.

    A `custom_vjp` around a host callback: values, images and gradients go through the host. JAX has no forward mode of
    it, so `jax.jvp` refuses; `Renderer.jvp` is there. Raises InputError where JAX is missing.
    """

    def __init__(self, renderer: Derivatives) -> None:
        try:
            import jax
        except ImportError as error:
            raise InputError('renderer.jax: needs JAX: pip install "warpsar[jax]"') from error
        self._renderer, self._jax = renderer, jax

    def __call__(self, values: Mapping[str, Any] | None = None) -> dict[str, dict[str, Any]]:
        """Arrays of beta0 by view and polarization, shape (rows, cols), float32.

        `values`: arrays or numbers by parameter, of its shape and in its unit; what is left out is as declared. Raises
        InputError for names and shapes. Numbers that are not allowed are seen when the callback runs, and JAX raises
        an error of its own with our message in it.
        """
        given = {}
        for called, value in (values or {}).items():
            name = self._renderer.known(called)
            shape = self._renderer.parameters[name].shape
            if np.shape(value) != shape:
                raise InputError(f"{name}: found shape {np.shape(value)}; must be {shape}")
            given[name] = self._jax.numpy.asarray(value, dtype=float)
        found: dict[str, dict[str, Any]] = self._function(given)
        return found

    @cached_property
    def _function(self) -> Any:
        jax, renderer = self._jax, self._renderer
        shapes = {
            view: {p: jax.ShapeDtypeStruct(render.shape, np.float32) for p in render.images}
            for view, render in renderer.renders.items()
        }

        def on_host(values: Mapping[str, Any]) -> Any:
            return renderer({name: np.asarray(value) for name, value in values.items()})

        def pulled(values: Mapping[str, Any], cotangents: Any) -> Any:
            host = {name: np.asarray(value) for name, value in values.items()}
            found = renderer.vjp(host, cotangents)
            return {name: found[name].astype(value.dtype) for name, value in host.items()}

        @jax.custom_vjp
        def images(values: Any) -> Any:
            return jax.pure_callback(on_host, shapes, values, vmap_method="sequential")

        def forward(values: Any) -> Any:
            return images(values), values

        def backward(values: Any, cotangents: Any) -> Any:
            like = {name: jax.ShapeDtypeStruct(value.shape, value.dtype) for name, value in values.items()}
            return (jax.pure_callback(pulled, like, values, cotangents, vmap_method="sequential"),)

        images.defvjp(forward, backward)
        return images
