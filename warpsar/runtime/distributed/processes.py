"""The processes of one run that torchrun starts: they share sums, decisions and lists through torch.distributed.

Host numbers travel over gloo, and arrays on CUDA over NCCL. torch is imported only where WORLD_SIZE says that there is
more than one process. Values travel as `travel.packed` makes them: no pickle is ever read.
"""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Callable, Iterable, Sequence
from datetime import timedelta
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from warpsar.errors import DeviceError, InputError, NothingLitError, WarpsarError
from warpsar.runtime.distributed.travel import packed, unpacked

if TYPE_CHECKING:
    import warp as wp

# torchrun notices at once when a process dies; this is for hosts that fall silent. It must be longer than what one rank
# may do while the others wait.
SILENCE = timedelta(hours=2)

T = TypeVar("T")


def _as_it_is(value: Any) -> Any:
    return value


def _in_order(tasks: Iterable[Callable[[], T]]) -> Iterable[T]:
    return (task() for task in tasks)


class Sharing:
    """The single process of a run; its methods are also those of `Processes`."""

    rank = 0
    size = 1

    @property
    def alone(self) -> bool:
        """Whether nobody else shares the work."""
        return self.size == 1

    @property
    def first(self) -> bool:
        """Whether this rank does what is done once, and writes the files of which there is only one."""
        return self.rank == 0

    def sum(self, array: ArrayLike) -> np.ndarray:
        """Sum over the ranks of a host array, float64, the same to the bit on each."""
        return np.asarray(array, float)

    def sum_on_device(self, array: wp.array) -> None:
        """Sum a Warp array over the ranks, in place, on its device and in its stream."""

    def largest(self, value: float) -> float:
        """The largest of the ranks' values."""
        return value

    def same(self, array: ArrayLike) -> np.ndarray:
        """The first rank's array, float64: the first rank decides for all."""
        return np.array(array, float)

    def gather(self, value: T) -> list[T]:
        """Every rank's value (see travel.py), in the order of the ranks, on each; a rank's own stays as it is."""
        return [value]

    def collect(self, value: T) -> list[T]:
        """Every rank's value, in the order of the ranks, on the first; an empty list on the others."""
        return [value]

    def hand_out(self, value: T) -> T:
        """The first rank's value, on each."""
        return value

    def mine(self, costs: Sequence[float]) -> list[int]:
        """Which of the tasks of these costs are this rank's, ascending."""
        return deal(costs, self.size)[self.rank]

    def counter(self) -> Callable[[int], int]:
        """A counter that all ranks share, from 0: it adds its argument and returns the count before."""
        total = 0

        def add(number: int) -> int:
            nonlocal total
            total += number
            return total - number

        return add

    def barrier(self) -> None:
        """Wait until every rank is here."""
        self.sum(0.0)

    def agree(self, task: Callable[[], T]) -> T:
        """Run `task` on every rank; a refusal on one of them is raised on all."""
        problem: WarpsarError | None = None
        result: T | None = None
        try:
            result = task()
        except WarpsarError as error:
            problem = error
        refusals = self.gather(None if problem is None else (type(problem).__name__, str(problem)))
        first = next((rank for rank, refusal in enumerate(refusals) if refusal), None)
        if first is None:
            return cast(T, result)
        kind, text = cast(tuple[str, str], refusals[first])
        if problem is None:
            known = (InputError, NothingLitError, DeviceError)
            problem = {each.__name__: each for each in known}.get(kind, WarpsarError)(text)
        problem.quiet = first != self.rank
        raise problem

    def deal_out(
        self,
        tasks: Sequence[Callable[[], T]],
        *,
        run: Callable[[Iterable[Callable[[], T]]], Iterable[T]] = _in_order,
        leave: Callable[[T], Any] = _as_it_is,
        arrive: Callable[[Any], T] = _as_it_is,
    ) -> list[T]:
        """Results of independent tasks, in their order, on every rank: each runs its share and tells the others.

        `run` gives the results of tasks in their order. A result that holds more than can travel (see travel.py) goes
        as what `leave` makes of it, from which `arrive` makes it again; a rank's own results stay as they are. A task
        has one process. A refusal on one rank is raised on all.
        """
        some = [partial(alone, task) for task in tasks[self.rank :: self.size]]
        own = self.agree(lambda: list(run(some)))
        if self.size == 1:
            return own
        parts = self.gather([leave(result) for result in own])
        return [
            own[k // self.size] if k % self.size == self.rank else arrive(parts[k % self.size][k // self.size])
            for k in range(len(tasks))
        ]


ALONE = Sharing()


class Processes(Sharing):
    """One of several processes. All of them call the same methods in the same order."""

    def __init__(self, device: wp.Device) -> None:
        try:
            import torch
            import torch.distributed as dist
        except ImportError as error:
            raise InputError(
                f"WORLD_SIZE: found {os.environ['WORLD_SIZE']}; several processes need torch "
                f"(pip install 'warpsar[distributed]')"
            ) from error
        self._torch, self._dist, self.device = torch, dist, device
        if device.is_cuda:
            torch.cuda.set_device(device.ordinal)
        backend = "cpu:gloo,cuda:nccl" if device.is_cuda else "gloo"
        store, self.rank, self.size = next(iter(dist.rendezvous("env://", timeout=SILENCE)))
        if os.environ.get("TORCHELASTIC_USE_AGENT_STORE") == "True":
            # the store outlives a restart: what ended processes left in it must not be read again
            store = dist.PrefixStore(f"attempt {restarts() or 0}", store)
        self._lost = False
        world = {"store": store, "rank": self.rank, "world_size": self.size, "timeout": SILENCE}
        self._call(dist.init_process_group, backend, **world)
        atexit.register(self._leave)
        self._store, self._counters = dist.PrefixStore("counters", store), 0
        places = self.gather(device.uuid if device.is_cuda else str(self.rank))
        if len(set(places)) < self.size:
            refusal = DeviceError(
                f"--device {device.alias}: found {self.size} processes on {len(set(places))} GPUs; allowed is one each "
                f"(torchrun --nproc-per-node)"
            )
            refusal.quiet = not self.first
            raise refusal

    def _leave(self) -> None:
        if not self._lost:  # it would wait for a process that is gone
            self._dist.destroy_process_group()

    def _call(self, collective: Callable[..., Any], *arguments: Any, **more: Any) -> Any:
        try:
            return collective(*arguments, **more)
        except RuntimeError as error:
            self._lost = True
            reason = str(error).strip().splitlines()[-1:] or ["no reason given"]
            raise WarpsarError(
                f"rank {self.rank} of {self.size}: the others cannot be reached, or one is gone ({reason[0][:200]})"
            ) from error

    def sum(self, array: ArrayLike) -> np.ndarray:
        total = np.array(array, float)  # a copy of its own, which torch adds into
        self._call(self._dist.all_reduce, self._torch.from_numpy(total.reshape(-1)))
        return total

    def sum_on_device(self, array: wp.array) -> None:
        import warp as wp

        if not array.size:
            return
        tensor = wp.to_torch(array.flatten(), requires_grad=False)
        device = array.device
        assert device is not None
        if not device.is_cuda:
            self._call(self._dist.all_reduce, tensor)
            return
        with self._torch.cuda.stream(wp.stream_to_torch(device)):
            self._call(self._dist.all_reduce, tensor)

    def largest(self, value: float) -> float:
        tensor = self._torch.tensor([value], dtype=self._torch.float64)
        self._call(self._dist.all_reduce, tensor, op=self._dist.ReduceOp.MAX)
        return float(tensor[0])

    def same(self, array: ArrayLike) -> np.ndarray:
        mine = np.array(array, float)
        self._call(self._dist.broadcast, self._torch.from_numpy(mine.reshape(-1)), src=0)
        return mine

    def _lengths(self, data: bytes) -> list[int]:
        lengths = np.zeros(self.size)
        lengths[self.rank] = len(data)
        return [int(n) for n in self.sum(lengths)]

    def gather(self, value: T) -> list[T]:
        data = packed(value)
        lengths = self._lengths(data)
        mine = self._torch.zeros(max(lengths), dtype=self._torch.uint8)
        mine[: len(data)] = self._torch.frombuffer(bytearray(data), dtype=self._torch.uint8)
        found = [self._torch.empty_like(mine) for _ in lengths]
        self._call(self._dist.all_gather, found, mine)
        every = zip(found, lengths, strict=True)
        return [value if r == self.rank else unpacked(each[:n].numpy().tobytes()) for r, (each, n) in enumerate(every)]

    def collect(self, value: T) -> list[T]:
        data = b"" if self.first else packed(value)
        lengths = self._lengths(data)
        if not self.first:
            self._call(self._dist.send, self._torch.frombuffer(bytearray(data), dtype=self._torch.uint8), dst=0)
            return []
        found = [value]
        for rank in range(1, self.size):
            received = self._torch.empty(lengths[rank], dtype=self._torch.uint8)
            self._call(self._dist.recv, received, src=rank)
            found.append(unpacked(received.numpy().tobytes()))
        return found

    def hand_out(self, value: T) -> T:
        data = packed(value) if self.first else b""
        buffer = np.zeros(int(self.same(float(len(data)))), np.uint8)
        buffer[: len(data)] = np.frombuffer(data, np.uint8)
        self._call(self._dist.broadcast, self._torch.from_numpy(buffer), src=0)
        return value if self.first else cast(T, unpacked(buffer.tobytes()))

    def counter(self) -> Callable[[int], int]:
        self._counters += 1
        name = str(self._counters)
        return lambda number: int(self._call(self._store.add, name, number)) - number


_here: Sharing | None = None
_thread = threading.local()


def join(device: wp.Device) -> Sharing:
    """The processes that this one belongs to, joined at the first call; `device` is the one it works on.

    Raises InputError where WORLD_SIZE is there and the rest of torchrun's environment, or torch, is not.
    """
    global _here
    if _here is None:
        _here = Processes(device) if _asked_for() else ALONE
    return here()


def here() -> Sharing:
    """The processes that were joined; one where none were, and within a task that is one process's own."""
    return ALONE if _here is None or getattr(_thread, "alone", False) else _here


def alone(task: Callable[[], T]) -> T:
    """What a task gives that this process runs by itself: to it there is one process."""
    before = getattr(_thread, "alone", False)
    _thread.alone = True
    try:
        return task()
    finally:
        _thread.alone = before


def _asked_for() -> bool:
    size = os.environ.get("WORLD_SIZE", "1")
    if not size.isdigit() or int(size) < 1:
        raise InputError(f"WORLD_SIZE: found {size!r}; allowed is a whole number from 1")
    if int(size) == 1:
        return False
    missing = [name for name in ("RANK", "LOCAL_RANK", "MASTER_ADDR", "MASTER_PORT") if name not in os.environ]
    if missing:
        raise InputError(
            f"WORLD_SIZE={size}: {', '.join(missing)} is not set; start several processes with torchrun (docs/scale.md)"
        )
    return True


def restarts() -> int | None:
    """How often torchrun restarted this process after one had died; None where torchrun did not start it."""
    found = os.environ.get("TORCHELASTIC_RESTART_COUNT", "")
    return int(found) if found.isdigit() else None


def deal(costs: Sequence[float], ranks: int) -> list[list[int]]:
    """Indices of `costs`, ascending, for each rank.

    The longest task goes first, to the rank with the least load (Graham, 1969: within 4/3 of the best).
    """
    hands: list[list[int]] = [[] for _ in range(ranks)]
    load = [0.0] * ranks
    for index in sorted(range(len(costs)), key=lambda i: -costs[i]):
        least = min(range(ranks), key=load.__getitem__)
        hands[least].append(index)
        load[least] += costs[index]
    return [sorted(hand) for hand in hands]
