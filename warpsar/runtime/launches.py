"""Launches that are recorded once and replayed; on the CPU in pieces, so that all cores work on one view.

A launch is cut only where no sum crosses the cut. So results are the same to the bit for any number of cores.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpsar.runtime import threads
from warpsar.runtime.structs import with_views

# Two threads that load one module at once leave one of them with code that the other's load has unloaded.
_loading = threading.Lock()
_LEAST = 2**14  # elements of a piece: to hand a piece to another core costs as much as some thousands of elements


@dataclass(frozen=True)
class LaunchPiece:
    """Some threads of a launch. `views` holds what they see of an array, under its `id`, where that is not all.

    The array may be an argument of the launch or a field of a struct.
    """

    threads: int
    views: dict[int, wp.array]


class Launch:
    """A launch, or its `pieces` side by side; `runs` is false where there is nothing to do."""

    def __init__(
        self,
        kernel: wp.Kernel,
        dim: int | tuple[int, ...],
        inputs: Sequence[Any],
        outputs: Sequence[Any],
        device: wp.Device,
        pieces: Sequence[LaunchPiece] = (),
    ) -> None:
        def recorded(dim: int | tuple[int, ...], views: dict[int, wp.array]) -> wp.Launch | None:
            given, found = ([with_views(a, views) for a in arguments] for arguments in (inputs, outputs))
            with _loading:
                return wp.launch(
                    kernel, dim, inputs=given, outputs=found, device=device, record_tape=False, record_cmd=True
                )

        further = tuple(dim[1:]) if isinstance(dim, tuple) else ()
        commands = [recorded((p.threads, *further), p.views) for p in pieces] or [recorded(dim, {})]
        self._tasks = [command.launch for command in commands if command is not None]
        self.runs = bool(self._tasks)

    def launch(self) -> None:
        if len(self._tasks) == 1:  # small views are launched by the thousand
            self._tasks[0]()
        else:
            threads.side_by_side(self._tasks)


def by_elements(arrays: Sequence[wp.array], per_thread: int = 1) -> list[LaunchPiece]:
    """Pieces of a launch whose thread i sees only `per_thread` elements of `arrays`, from i * per_thread on."""
    n = arrays[0].shape[0]
    count = _count(arrays[0])
    if count < 2:
        return []
    step = -(-n // (count * per_thread)) * per_thread
    ends = [(begin, min(begin + step, n)) for begin in range(0, n, step)]
    return [LaunchPiece(-(-(end - begin) // per_thread), {id(a): a[begin:end] for a in arrays}) for begin, end in ends]


def by_stretches(
    first: wp.array, values: wp.array, each: Sequence[wp.array] = (), per_thread: int = 1
) -> list[LaunchPiece]:
    """Pieces of a launch that adds up `values` from first[i] to first[i + 1] - 1, or to their end, for every i.

    A thread sees `per_thread` elements of `first`, and of the arrays `each`. Equal elements of these add to one sum:
    they stay in one piece.
    """
    count = _count(values)
    if count < 2:
        return []
    begin = first.numpy()
    edges = np.searchsorted(begin, np.arange(1, count) * (values.shape[0] / count))
    for array in each:
        rows = array.numpy().reshape(begin.size, -1)
        new = np.append(np.flatnonzero((rows[1:] != rows[:-1]).any(axis=1)) + 1, begin.size)
        edges = new[np.searchsorted(new, edges)]
    edges = np.unique([0, *edges, begin.size])
    pieces = []
    for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        end = int(begin[high]) if high < begin.size else values.shape[0]
        pieces.append(
            LaunchPiece(
                -(-(high - low) // per_thread),
                {id(a): a[low:high] for a in (first, *each)} | {id(values): values[:end]},
            )
        )
    return pieces


def _count(array: wp.array) -> int:
    """Number of pieces for a launch over all elements; 1 on CUDA."""
    device = array.device
    assert device is not None
    return min(2 * threads.thread_count(), array.shape[0] // _LEAST) if device.is_cpu else 1
