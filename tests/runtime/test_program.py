"""Parts of a recorded program: what runs again after a change, and what its sums and gradients are."""

import numpy as np
import pytest
import warp as wp

from warpsar.runtime import devices, launches, threads
from warpsar.runtime.program import Program
from warpsar.runtime.structs import arrays_in, fill

pytestmark = pytest.mark.unit


@wp.kernel
def scale_kernel(p: wp.array(dtype=float), values: wp.array(dtype=float), out: wp.array(dtype=float)):
    i = wp.tid()
    out[i] = p[0] * values[i]


@wp.kernel
def add_up_kernel(values: wp.array(dtype=float), out: wp.array(dtype=float)):
    wp.atomic_add(out, 0, values[wp.tid()])


class Chain:
    """total = sum(a * x) + sum(b * y), and beside it a * x once more, times c."""

    def __init__(self, device: str) -> None:
        self.program = program = Program(devices.resolve_device(device))
        self.x, self.y, self.ax, self.by, self.other = (program.array(3) for _ in range(5))
        self.a, self.b, self.c = (program.array(1) for _ in range(3))
        self.total = program.array(1, sum_into=True)
        for factor, values, out in (
            (self.a, self.x, self.ax),
            (self.b, self.y, self.by),
            (self.c, self.ax, self.other),
        ):
            program.launch(scale_kernel, 3, [factor, values], [out])
        for values in (self.ax, self.by):
            program.launch(add_up_kernel, 3, [values], [self.total])
        for array, values in ((self.x, [1, 2, 3]), (self.y, [4, 5, 6]), (self.a, [2]), (self.b, [3]), (self.c, [5])):
            array.assign(np.array(values, np.float32))


def test_a_part_makes_what_is_wanted(device: str) -> None:
    chain = Chain(device)
    chain.program.part([chain.total]).forward()
    assert chain.total.numpy() == [57.0]
    assert not chain.other.numpy().any()  # nobody wanted it


def test_a_change_runs_what_depends_on_it(device: str) -> None:
    """A sum is made anew from all that adds to it, with what has not changed as it stands."""
    chain = Chain(device)
    chain.program.forward()
    chain.x.assign(np.full(3, 100.0, np.float32))  # not said to have changed
    chain.b.assign(np.ones(1, np.float32))
    chain.program.part([chain.total], [chain.b]).forward()
    assert chain.total.numpy() == [12.0 + 15.0]
    chain.program.part([chain.total, chain.other], [chain.a, chain.x]).forward()
    assert chain.total.numpy() == [600.0 + 15.0]
    assert chain.other.numpy() == pytest.approx(1000.0)
    assert not chain.program.part([chain.other], [chain.y]).runs


def test_gradients_of_a_part(device: str) -> None:
    """From one array back to another, and no further."""
    chain = Chain(device)
    chain.program.forward(gradient=True)
    chain.program.part([chain.other], [chain.ax]).backward({chain.other: 1.0})
    assert chain.ax.grad.numpy() == pytest.approx(5.0)
    assert not chain.x.grad.numpy().any()
    chain.program.backward({chain.total: 1.0})
    assert chain.x.grad.numpy() == pytest.approx(2.0)
    assert chain.b.grad.numpy() == [15.0]


def test_a_launch_that_comes_later_counts(device: str) -> None:
    chain = Chain(device)
    assert chain.program.part([chain.total]).runs
    chain.program.launch(add_up_kernel, 3, [chain.other], [chain.total])
    chain.program.part([chain.total]).forward()
    assert chain.total.numpy() == [57.0 + 60.0]


@wp.struct
class Scaled:
    values: wp.array(dtype=float)
    factor: float


@wp.struct
class Line:
    scaled: Scaled
    level: wp.array(dtype=float)


@wp.struct
class Points:
    out: wp.array(dtype=float)


@wp.kernel
def line_kernel(line: Line, points: Points):
    i = wp.tid()
    points.out[i] = line.level[0] + line.scaled.factor * line.scaled.values[i] * line.scaled.values[i]


class Structs:
    """out = level + 3 x^2, whose arrays stand in structs, one inside another; beside it the sum of all."""

    def __init__(self, device: str, n: int = 3, pieces: bool = False) -> None:
        self.program = program = Program(devices.resolve_device(device))
        self.x, self.out = program.array(n), program.array(n)
        self.level, self.total = program.array(1), program.array(1, sum_into=True)
        line = fill(Line, scaled=fill(Scaled, values=self.x, factor=3.0), level=self.level)
        cut = launches.by_elements([self.x, self.out]) if pieces else []
        self.pieces = len(cut)
        program.launch(line_kernel, n, [line], [fill(Points, out=self.out)], pieces=cut)
        program.launch(add_up_kernel, n, [self.out], [self.total])
        self.x.assign(np.arange(n, dtype=np.float32))
        self.level.assign(np.array([10.0], np.float32))


def test_arrays_in_structs_tie_launches_together(device: str) -> None:
    one = Structs(device)
    assert one.program.part([one.total], [one.x]).runs
    assert one.program.part([one.out], [one.level]).runs
    one.program.part([one.total], [one.level]).forward()
    assert one.total.numpy() == [30.0 + 3.0 * 5.0]


def test_gradients_of_arrays_in_structs(device: str) -> None:
    """They are asked for long after the structs have been filled, when the arrays had none."""
    one = Structs(device)
    one.program.forward(gradient=True)
    one.program.backward({one.total: 1.0})
    assert one.x.grad.numpy() == pytest.approx([0.0, 6.0, 12.0])
    assert one.level.grad.numpy() == [3.0]
    one.program.backward({one.total: 1.0})  # zeroed first
    assert one.level.grad.numpy() == [3.0]


def test_a_launch_over_structs_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each piece sees its own part of the arrays in the structs, and all of the others."""
    monkeypatch.setattr(threads, "thread_count", lambda: 4)
    n = 5 * 2**14 + 7
    one = Structs("cpu", n, pieces=True)
    assert one.pieces > 1
    one.program.forward()
    x = np.arange(n, dtype=np.float32)
    np.testing.assert_allclose(one.out.numpy(), 10.0 + 3.0 * x.astype(float) ** 2, rtol=1e-6)  # a rounding or two


def test_arrays_are_found_in_structs() -> None:
    one = wp.zeros(2, dtype=float, device="cpu")
    line = fill(Line, scaled=fill(Scaled, values=one))
    assert [id(array) for array in arrays_in([1.0, line, one])] == [id(one), id(one)]
