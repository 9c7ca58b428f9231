"""A fixed sequence of kernel launches, replayed forward, and backward through Warp's tape."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, cached_property
from typing import Any

import warp as wp

from warpsar.runtime.launches import Launch, Piece


class Program:
    """Launches recorded once and replayed as often as parameters change.

    Each program owns the arrays it writes, so that programs of several views run side by side on the CPU, and a
    CUDA graph can capture one. A `with wp.Tape()` block is global and would serialise them; the tape is therefore
    filled by `record_launch`.
    """

    def __init__(self, device: Any) -> None:
        self.device = device
        self._launches: list[tuple[Any, Any, list[Any], list[Any], Callable[[], None] | None]] = []
        self._differentiable: list[Any] = []
        self._commands: list[tuple[Launch, Callable[[], Launch] | None]] = []
        self._sums: list[Any] = []
        self._kept = False  # what adjoints need of the last forward run

    def array(self, shape: Any, dtype: Any = float, *, grad: bool = True, sum_into: bool = False) -> Any:
        """A device array of this program; with `sum_into` it is zeroed before every forward run, and with `grad` it has
        a gradient from when the first one is asked for: images alone need no memory for it."""
        array = wp.zeros(shape, dtype=dtype, device=self.device)
        if grad:
            self._differentiable.append(array)
        if sum_into:
            self._sums.append(array)
        return array

    def launch(
        self,
        kernel: Any,
        dim: Any,
        inputs: Sequence[Any],
        outputs: Sequence[Any],
        adjoint: Callable[[], None] | None = None,
        keeping: Callable[[], Launch] | None = None,
        pieces: Sequence[Piece] = (),
    ) -> None:
        """Record a launch; nothing runs before `forward`.

        `adjoint` adds the outputs' gradients to those of the inputs, in place of what Warp makes of the kernel.
        `keeping` makes the launch that takes this one's place where a gradient is asked for: it leaves besides what
        `adjoint` needs. `pieces`: into which a CPU may cut it.
        """
        inputs, outputs = list(inputs), list(outputs)
        command = Launch(kernel, dim, inputs, outputs, self.device, pieces)
        if not command.runs:  # nothing to do: a view without hits
            return
        self._commands.append((command, keeping and cache(keeping)))
        self._launches.append((kernel, dim, inputs, outputs, adjoint))
        self.__dict__.pop("_tape", None)

    @cached_property
    def _tape(self) -> Any:
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
        """Run the launches; with `gradient`, which takes longer, `backward` finds what it needs of them."""
        for array in self._sums:
            array.zero_()
        for command, keeping in self._commands:
            (keeping() if gradient and keeping else command).launch()
        self._kept = gradient

    def zero_gradients(self) -> None:
        self._tape.zero()

    def backward(self, seeds: dict[Any, Any], *, zero: bool = True) -> None:
        """Gradients of sum(seed * array) over `seeds`, arrays or numbers, into every `.grad`.

        They are zeroed first; with `zero` false they add to what is there (programs that share an array). Right after
        `forward`, at the same parameters.
        """
        tape = self._tape
        if not self._kept:
            for _, keeping in self._commands:
                if keeping:
                    keeping().launch()
            self._kept = True
        if zero:
            self.zero_gradients()
        for array, seed in seeds.items():
            if isinstance(seed, float):
                array.grad.fill_(seed)
            else:
                array.grad.assign(seed)
        tape.backward()
