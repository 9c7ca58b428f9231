"""A fixed sequence of kernel launches that is replayed forward and backward, whole or in parts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import warp as wp

from warpsar.runtime.launches import Launch, LaunchPiece
from warpsar.runtime.structs import arrays_in, renewed

Adjoint = Callable[[], None] | Sequence[tuple[wp.array, Callable[[], None]]]
"""The adjoint of a launch: for all inputs at once, or a part for each."""


@dataclass(frozen=True, eq=False)
class _Step:
    """A recorded launch; `adjoint` and `keeping` are as in `Program.launch`."""

    kernel: wp.Kernel
    dim: int | tuple[int, ...]
    inputs: list[Any]
    outputs: list[Any]
    command: Launch
    adjoint: Adjoint | None
    keeping: Callable[[], Launch] | None

    @cached_property
    def reads(self) -> set[int]:
        return {id(a) for a in arrays_in(self.inputs)}

    @cached_property
    def writes(self) -> set[int]:
        return {id(a) for a in arrays_in(self.outputs)}

    def backward(self, wanted: set[int] | None) -> Callable[[], None] | None:
        """What adds the outputs' gradients to those of the inputs; None where there is nothing to add.

        `wanted`: the arrays whose gradients are asked for; None: of all.
        """
        if callable(self.adjoint):
            return self.adjoint
        if self.adjoint is not None:
            parts = [part for array, part in self.adjoint if wanted is None or id(array) in wanted]

            def run() -> None:
                for part in parts:
                    part()

            return run
        enabled = self.kernel.options.get("enable_backward")
        if not (self.kernel.module.options.get("enable_backward") if enabled is None else enabled):
            return None
        device = arrays_in(self.outputs)[0].device
        return adjoint_of(self.kernel, self.dim, self.inputs, self.outputs, device).launch


def adjoint_of(
    kernel: wp.Kernel,
    dim: int | tuple[int, ...],
    inputs: Sequence[Any],
    outputs: Sequence[Any],
    device: wp.Device | None,
) -> wp.Launch:
    """The adjoint that Warp makes of a launch: it adds the outputs' gradients to those of the inputs that have one.

    Inputs are arrays, and structs with arrays in their fields.
    """
    inputs, outputs = ([renewed(a) for a in arguments] for arguments in (inputs, outputs))
    gradient_of = wp.Tape().get_adjoint
    recorded: wp.Launch = wp.launch(
        kernel,
        dim,
        inputs=inputs,
        outputs=outputs,
        adj_inputs=[gradient_of(a) for a in inputs],
        adj_outputs=[gradient_of(a) for a in outputs],
        device=device,
        adjoint=True,
        record_tape=False,
        record_cmd=True,
    )
    return recorded


class ProgramPart:
    """Some launches of a program, in their order, which are replayed by themselves.

    A forward run zeroes the sums that it makes. Call `backward` right after `forward`, at the same parameters.
    """

    def __init__(self, program: Program, steps: list[_Step], changed: set[int] | None = None) -> None:
        """`changed`: the arrays that have changed, and so those whose gradients may be asked for; None: all."""
        self._program, self._steps = program, steps
        self._wanted = None if changed is None else changed.union(*(step.writes for step in steps))
        written = set().union(*(step.writes for step in steps)) if steps else set()
        self._sums = [array for array in program.sums if id(array) in written]

    @property
    def runs(self) -> bool:
        """Whether there is anything to run."""
        return bool(self._steps)

    def forward(self, *, gradient: bool = False) -> None:
        """Run the launches; with `gradient` they also store what `backward` needs, which takes longer."""
        for array in self._sums:
            array.zero_()
        for step in self._steps:
            if step.keeping is None:
                step.command.launch()
            elif gradient:
                self._program.keep(step)
            else:
                step.command.launch()
                self._program.kept.discard(step)

    @cached_property
    def _gradients(self) -> list[wp.array]:
        """Of every array that the launches read or write."""
        self._program.make_gradients()
        arrays = {id(a): a for s in self._steps for a in arrays_in([*s.inputs, *s.outputs])}
        return [array.grad for array in arrays.values() if array.requires_grad]

    @cached_property
    def _backward(self) -> list[Callable[[], None]]:
        self._program.make_gradients()
        return [found for step in reversed(self._steps) if (found := step.backward(self._wanted)) is not None]

    def zero_gradients(self) -> None:
        """Set the gradients of all arrays to zero."""
        for gradient in self._gradients:
            gradient.zero_()

    def backward(self, seeds: Mapping[wp.array, Any], *, zero: bool = True) -> None:
        """Gradients of sum(seed * array) into every `.grad`; `seeds` holds an array or a number for each array.

        They are zeroed first; with `zero` false they add to what is there (programs that share an array).
        """
        keeping = [step for step in self._steps if step.keeping is not None]
        if not self._program.kept.issuperset(keeping):
            for step in keeping:  # all: a launch may write over what another one made
                self._program.keep(step)
        commands = self._backward
        if zero:
            self.zero_gradients()
        for array, seed in seeds.items():
            if isinstance(seed, float):
                array.grad.fill_(seed)
            else:
                array.grad.assign(seed)
        for command in commands:
            command()


class Program:
    """Launches that are recorded once and replayed whenever parameters change.

    Each program owns the arrays that it writes. So programs of several views run side by side on the CPU, and a CUDA
    graph can capture one. A `with wp.Tape()` block is global and would serialise them: the adjoint launches are
    recorded one by one instead.
    """

    def __init__(self, device: wp.Device) -> None:
        self.device = device
        self.sums: list[wp.array] = []
        self.kept: set[_Step] = set()  # launches whose last run left what their adjoints need
        self._steps: list[_Step] = []
        self._differentiable: list[wp.array] = []
        self._parts: dict[Any, ProgramPart] = {}

    def keep(self, step: _Step) -> None:
        """Run a launch so that it leaves what its adjoint needs."""
        assert step.keeping is not None
        step.keeping().launch()
        self.kept.add(step)

    def array(
        self, shape: int | tuple[int, ...], dtype: type = float, *, grad: bool = True, sum_into: bool = False
    ) -> Any:
        """A device array of this program.

        With `sum_into` it is zeroed before every forward run. With `grad` it gets a gradient once one is asked for:
        images alone need no memory for it.
        """
        array = wp.zeros(shape, dtype=dtype, device=self.device)
        if grad:
            self._differentiable.append(array)
        if sum_into:
            self.sums.append(array)
        return array

    def make_gradients(self) -> None:
        """Give every array its gradient."""
        for array in self._differentiable:
            if not array.requires_grad:
                array.requires_grad = True

    def launch(
        self,
        kernel: wp.Kernel,
        dim: int | tuple[int, ...],
        inputs: Sequence[Any],
        outputs: Sequence[Any],
        adjoint: Adjoint | None = None,
        keeping: Callable[[], Launch] | None = None,
        pieces: Sequence[LaunchPiece] = (),
    ) -> None:
        """Record a launch; nothing runs before `forward`.

        Arrays are found among the arguments and in the fields of structs.
        `adjoint` adds the outputs' gradients to those of the inputs, in place of the adjoint that Warp makes of the
        kernel. Where it has a part for each input, only those of arrays that have changed run. `keeping` makes the
        launch that replaces this one where a gradient is asked for: it also stores what `adjoint` needs. `pieces`: the
        pieces into which a CPU may cut the launch.
        """
        inputs, outputs = list(inputs), list(outputs)
        command = Launch(kernel, dim, inputs, outputs, self.device, pieces)
        if not command.runs:  # nothing to do: a view without hits
            return
        self._steps.append(_Step(kernel, dim, inputs, outputs, command, adjoint, keeping and cache(keeping)))
        self._parts.clear()

    def mapped(self, kernel: wp.Kernel, like: wp.array, inputs: Sequence[Any]) -> Any:
        """Record a launch of a kernel that writes an array like `like`, an element in each thread: this new array."""
        result = self.array(like.shape, like.dtype)
        self.launch(kernel, like.shape[0], inputs, [result])
        return result

    def part(self, wanted: Iterable[wp.array], changed: Iterable[wp.array] | None = None) -> ProgramPart:
        """The launches that bring the arrays `wanted` up to date once the arrays `changed` have changed.

        None: once anything may have.
        """
        needed = {id(array) for array in wanted}
        dirty = None if changed is None else {id(array) for array in changed}
        key = frozenset(needed), None if dirty is None else frozenset(dirty)
        if key not in self._parts:
            steps = self._before(needed)
            self._parts[key] = ProgramPart(self, steps if dirty is None else self._after(dirty, steps), dirty)
        return self._parts[key]

    def _before(self, wanted: set[int]) -> list[_Step]:
        """The launches on which the arrays depend."""
        needed, found = set(wanted), []
        for step in reversed(self._steps):
            if step.writes & needed:
                needed |= step.reads
                found.append(step)
        return found[::-1]

    def _after(self, changed: set[int], steps: list[_Step]) -> list[_Step]:
        """Those of `steps` that read what has changed, or add to a sum that must be made again."""
        sums = {id(array) for array in self.sums}
        dirty, again = set(changed), set[int]()
        found = set[_Step]()
        while True:
            step = next((s for s in steps if s not in found and (s.reads & dirty or s.writes & again)), None)
            if step is None:
                return [step for step in steps if step in found]
            found.add(step)
            dirty |= step.writes
            again |= step.writes & sums

    @property
    def _whole(self) -> ProgramPart:
        if None not in self._parts:
            self._parts[None] = ProgramPart(self, self._steps)
        return self._parts[None]

    def forward(self, *, gradient: bool = False) -> None:
        """As `ProgramPart.forward`, of all launches."""
        self._whole.forward(gradient=gradient)

    def zero_gradients(self) -> None:
        """As `ProgramPart.zero_gradients`, of all launches."""
        self._whole.zero_gradients()

    def backward(self, seeds: Mapping[wp.array, Any], *, zero: bool = True) -> None:
        """As `ProgramPart.backward`, of all launches."""
        self._whole.backward(seeds, zero=zero)
