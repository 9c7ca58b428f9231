"""A fixed sequence of kernel launches that is replayed forward, and backward through Warp's tape."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, cached_property
from typing import Any

import warp as wp

from warpsar.runtime.launches import Launch, Piece

# kernel, dim, inputs, outputs, and what takes the place of Warp's adjoint
_Recorded = tuple[wp.Kernel, int | tuple[int, ...], list[Any], list[Any], Callable[[], None] | None]


class Program:
    """Launches that are recorded once and replayed whenever parameters change.

    Each program owns the arrays that it writes. So programs of several views run side by side on the CPU, and a CUDA
    graph can capture one. A `with wp.Tape()` block is global and would serialise them: `record_launch` fills the tape
    instead.
    """

    def __init__(self, device: wp.Device) -> None:
        self.device = device
        self._launches: list[_Recorded] = []
        self._differentiable: list[wp.array] = []
        self._commands: list[tuple[Launch, Callable[[], Launch] | None]] = []
        self._sums: list[wp.array] = []
        self._has_slopes = False  # whether the last forward run left what adjoints need

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
            self._sums.append(array)
        return array

    def launch(
        self,
        kernel: wp.Kernel,
        dim: int | tuple[int, ...],
        inputs: Sequence[Any],
        outputs: Sequence[Any],
        adjoint: Callable[[], None] | None = None,
        keeping: Callable[[], Launch] | None = None,
        pieces: Sequence[Piece] = (),
    ) -> None:
        """Record a launch; nothing runs before `forward`.

        `adjoint` adds the outputs' gradients to those of the inputs, in place of the adjoint that Warp makes of the
        kernel. `keeping` makes the launch that replaces this one where a gradient is asked for: it also stores what
        `adjoint` needs. `pieces`: the pieces into which a CPU may cut the launch.
        """
        inputs, outputs = list(inputs), list(outputs)
        command = Launch(kernel, dim, inputs, outputs, self.device, pieces)
        if not command.runs:  # nothing to do: a view without hits
            return
        self._commands.append((command, keeping and cache(keeping)))
        self._launches.append((kernel, dim, inputs, outputs, adjoint))
        self.__dict__.pop("_tape", None)

    @cached_property
    def _tape(self) -> wp.Tape:
        tape = wp.Tape()
        for array in self._differentiable:
            array.requires_grad = True
        for kernel, dim, inputs, outputs, adjoint in self._launches:
            if adjoint is None:
                tape.record_launch(kernel, dim, 0, inputs, outputs, self.device)
            else:
                arrays = [a for a in [*inputs, *outputs] if isinstance(a, wp.array) and a.requires_grad]
                tape.record_func(adjoint, arrays)
        return tape

    def forward(self, *, gradient: bool = False) -> None:
        """Run the launches; with `gradient` they also store what `backward` needs, which takes longer."""
        for array in self._sums:
            array.zero_()
        for command, keeping in self._commands:
            (keeping() if gradient and keeping else command).launch()
        self._has_slopes = gradient

    def zero_gradients(self) -> None:
        """Set the gradients of all arrays to zero."""
        self._tape.zero()

    def backward(self, seeds: Mapping[wp.array, Any], *, zero: bool = True) -> None:
        """Gradients of sum(seed * array) into every `.grad`; `seeds` holds an array or a number for each array.

        They are zeroed first; with `zero` false they add to what is there (programs that share an array). Call it right
        after `forward`, at the same parameters.
        """
        tape = self._tape
        if not self._has_slopes:
            for _, keeping in self._commands:
                if keeping:
                    keeping().launch()
            self._has_slopes = True
        if zero:
            self.zero_gradients()
        for array, seed in seeds.items():
            if isinstance(seed, float):
                array.grad.fill_(seed)
            else:
                array.grad.assign(seed)
        tape.backward()
