"""The renderer as a function of PyTorch tensors: `renderer.torch`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from typing import Any

import warp as wp

from warpsar.differentiable.derivatives import Derivatives
from warpsar.errors import InputError
from warpsar.render.render import ViewRender


class TorchRenderer:
    """Images of a scene as a function of tensors that autograd differentiates, in reverse mode and once.

    On CUDA tensors and renderer share memory: nothing goes through the host, and all work lies on PyTorch's current
    stream. Raises InputError where PyTorch is missing.
    """

    def __init__(self, renderer: Derivatives) -> None:
        try:
            import torch
        except ImportError as error:
            raise InputError('renderer.torch: needs PyTorch: pip install "warpsar[torch]"') from error
        self._renderer, self._torch = renderer, torch
        self.device = torch.device(wp.device_to_torch(renderer.device))
        self._nodes = torch.as_tensor(renderer.start, dtype=torch.float64, device=self.device)
        self._order = [(view, name) for view, render in renderer.renders.items() for name in render.images]

    def __call__(self, values: Mapping[str, Any] | None = None) -> dict[str, dict[str, Any]]:
        """Tensors of beta0 by view and polarization, shape (rows, cols), float32, on the renderer's device.

        `values`: tensors or numbers by parameter, of its shape and in its unit; what is left out is as declared.
        Raises InputError as the renderer's own call does.
        """
        given = self._checked(values or {})
        nodes = self._nodes.clone()
        for name, value in given.items():
            parameter = self._renderer.parameters[name]
            if (block := parameter.block) is not None:
                used = self._torch.atleast_1d(value)[parameter.used].reshape(-1)
                nodes[block.start : block.stop] = parameter.transform.to_coordinate(used, self._torch)
            elif parameter.column is not None:
                places = self._torch.as_tensor(self._renderer.places(parameter.column), device=self.device)
                nodes[places] = value[:, None].expand(places.shape)
        effects = [
            self._effect(render, effect, given)
            for render in self._renderer.renders.values()
            for effect in render.effect_values
        ]
        moved = [given.get(name, self._torch.as_tensor(p.value)) for name, p in self._renderer.moves.parameters.items()]
        images = self._function.apply(nodes.float(), *(effect.float() for effect in effects), *moved)
        found: dict[str, dict[str, Any]] = {view: {} for view in self._renderer.renders}
        for (view, polarization), image in zip(self._order, images, strict=True):
            found[view][polarization] = image
        return found

    def _checked(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Float64 tensors on the device. Raises InputError."""
        torch, found = self._torch, {}
        for called, value in values.items():
            name = self._renderer.known(called)
            parameter = self._renderer.parameters[name]
            tensor = torch.as_tensor(value).to(self.device, torch.float64)
            if tuple(tensor.shape) != parameter.shape:
                raise InputError(f"{name}: found shape {tuple(tensor.shape)}; must be {parameter.shape}")
            used = torch.atleast_1d(tensor.detach())[parameter.used]
            if not bool(((used >= parameter.low) & (used <= parameter.high)).all()):  # one bit comes to the host
                parameter.checked(tensor.detach().cpu().numpy())
            found[name] = tensor
        return found

    def _effect(self, render: ViewRender, effect: str, given: Mapping[str, Any]) -> Any:
        declared = self._renderer.declared[render.view.name][effect]
        values = self._torch.zeros(max(1, declared.size), dtype=self._torch.float64, device=self.device)
        values[: declared.size] = self._torch.as_tensor(declared, device=self.device)
        for name, value in given.items():
            parameter = self._renderer.parameters[name]
            if parameter.index is not None and parameter.owner == effect:
                share, index = self._renderer.share(parameter, render.view), parameter.index
                values[index] = values[index] + share * (value - float(parameter.value))
        return values

    @contextmanager
    def _on_its_stream(self) -> Iterator[None]:
        """On CUDA Warp's work goes onto PyTorch's stream, which waits for Warp's own, and Warp's own for it at the
        end: the renderer's call with NumPy may stand between two of these."""
        if self.device.type != "cuda":
            yield
            return
        stream = wp.stream_from_torch(self._torch.cuda.current_stream(self.device))
        with wp.ScopedStream(stream, sync_enter=True, sync_exit=True):
            yield

    def _run(self, nodes: Any, others: tuple[Any, ...]) -> object:
        """Run the programs at float32 tensors of nodes and effects; geometry comes last, through the host."""
        moves = self._renderer.moves.parameters
        effects = others[: len(others) - len(moves)]
        moved = zip(moves, others[len(effects) :], strict=True)
        self._renderer.place({name: tensor.detach().cpu().numpy().astype(float) for name, tensor in moved})
        its = iter(effects)
        by_view = {
            view: {e: next(its) for e in render.effect_values} for view, render in self._renderer.renders.items()
        }

        def set_parameters(render: ViewRender) -> None:
            arrays = self._renderer.arrays(render)
            parts = nodes.split([array.size for array in arrays])
            for array, tensor in [
                *((a, part.reshape(a.shape)) for a, part in zip(arrays, parts, strict=True)),
                *((render.effect_values[e], values) for e, values in by_view[render.view.name].items()),
            ]:
                given: Any = wp.from_torch(tensor.detach().contiguous())
                wp.copy(array, given)

        return self._renderer.run(set_parameters, gradient=True)

    def _images(self) -> tuple[Any, ...]:
        """Copies, on the device: the next run writes over the programs' own arrays."""
        renders = self._renderer.renders
        return tuple(
            wp.to_torch(renders[view].images[p], requires_grad=False).reshape(renders[view].shape).clone()
            for view, p in self._order
        )

    def _gradients(self, cotangents: tuple[Any, ...]) -> tuple[Any, ...]:
        """To the nodes, and to every view's effects."""
        renders = self._renderer.renders
        seeds: dict[str, dict[Any, Any]] = {view: {} for view in renders}
        for (view, p), cotangent in zip(self._order, cotangents, strict=True):
            flat = cotangent.detach().to(self._torch.float32).contiguous().reshape(-1)
            seeds[view][renders[view].images[p]] = wp.from_torch(flat)
        self._renderer.backward(seeds)
        nodes = sum(
            self._torch.cat([wp.to_torch(array.grad).reshape(-1) for array in self._renderer.arrays(render)])
            for render in renders.values()
        )
        effects = [wp.to_torch(values.grad).clone() for r in renders.values() for values in r.effect_values.values()]
        moved = self._renderer.moved_gradients(renders).values()
        return (nodes, *effects, *(self._torch.as_tensor(gradient, device=self.device) for gradient in moved))

    @cached_property
    def _function(self) -> Any:
        torch, outer = self._torch, self

        class Render(torch.autograd.Function):  # type: ignore[name-defined, misc]
            @staticmethod
            def forward(ctx: Any, nodes: Any, *effects: Any) -> Any:
                ctx.save_for_backward(nodes, *effects)
                with outer._on_its_stream():
                    ctx.run = outer._run(nodes, effects)
                    return outer._images()

            @staticmethod
            def backward(ctx: Any, *cotangents: Any) -> Any:
                if torch.is_grad_enabled():  # create_graph: a second derivative would lack the renderer's part
                    raise InputError("renderer.torch: has no second derivative; create_graph must be False")
                with outer._on_its_stream():
                    if outer._renderer.last_run is not ctx.run:  # another call has run since
                        nodes, *effects = ctx.saved_tensors
                        outer._run(nodes, tuple(effects))
                    return outer._gradients(cotangents)

        return Render
