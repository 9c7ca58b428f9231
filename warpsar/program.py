"""A fixed sequence of kernel launches, replayed forward, and backward through Warp's tape."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any


class Program:
    """Launches recorded once and replayed as often as parameters change.

    Each program owns the arrays it writes, so that programs of several views run side by side on the CPU, and a
    CUDA graph can capture one. A `with wp.Tape()` block is global and would serialise them; the tape is therefore
    filled by `record_launch`.
    """

    def __init__(self, device: Any) -> None:
        import warp as wp

        self.device = device
        self._tape = wp.Tape()
        self._commands: list[Any] = []
        self._sums: list[Any] = []

    def array(self, shape: Any, dtype: Any = float, *, grad: bool = True, sum_into: bool = False) -> Any:
        """A device array of this program; with `sum_into` it is zeroed before every forward run."""
        import warp as wp

        array = wp.zeros(shape, dtype=dtype, device=self.device, requires_grad=grad)
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
    ) -> None:
        """Record a launch; nothing runs before `forward`.

        `adjoint` adds the outputs' gradients to those of the inputs, in place of what Warp makes of the kernel.
        """
        import warp as wp

        inputs, outputs = list(inputs), list(outputs)
        command = wp.launch(
            kernel,
            dim,
            inputs=inputs,
            outputs=outputs,
            device=self.device,
            record_tape=False,
            record_cmd=True,
        )
        if command is None:  # nothing to do: a view without hits
            return
        self._commands.append(command)
        if adjoint is None:
            self._tape.record_launch(kernel, dim, 0, inputs, outputs, self.device)
        else:
            arrays = [a for a in [*inputs, *outputs] if isinstance(a, wp.array) and a.requires_grad]
            self._tape.record_func(adjoint, arrays)

    def forward(self) -> None:
        for array in self._sums:
            array.zero_()
        for command in self._commands:
            command.launch()

    def zero_gradients(self) -> None:
        self._tape.zero()

    def backward(self, seeds: dict[Any, Any], *, zero: bool = True) -> None:
        """Gradients of sum(seed * array) over `seeds`, arrays or numbers, into every `.grad`.

        They are zeroed first; with `zero` false they add to what is there (programs that share an array).
        """
        if zero:
            self.zero_gradients()
        for array, seed in seeds.items():
            if isinstance(seed, float):
                array.grad.fill_(seed)
            else:
                array.grad.assign(seed)
        self._tape.backward()
