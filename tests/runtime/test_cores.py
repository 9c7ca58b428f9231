"""One view on all cores: its launches in pieces, and the same numbers to the bit whatever the threads."""

import threading
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from test_gradients import tiny_scene

from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices, launches, threads

pytestmark = pytest.mark.unit


@pytest.mark.parametrize("layout", ["uniform", "vertex", "texture"])
def test_threads_do_not_change_a_bit(layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Image, loss and gradient of one view, its launches whole and cut into as many pieces as the threads allow."""
    scene = tiny_scene(tmp_path, layout=layout)
    device = devices.resolve_device("cpu")
    cut: list[int] = []
    apart = threads.side_by_side

    def counted(tasks: list[object]) -> None:
        cut.append(len(tasks))
        apart(tasks)  # type: ignore[arg-type]

    monkeypatch.setattr(threads, "side_by_side", counted)
    found = []
    for count, least in (("1", 2**14), ("1", 16), ("2", 16), ("3", 16), ("7", 16)):
        monkeypatch.setenv("WARPSAR_THREADS", count)
        monkeypatch.setattr(launches, "_LEAST", least)
        cut.clear()
        problem = FitProblem(scene, device, views=["HV"])
        loss, gradient = problem.gradient(problem.x0)
        assert max(cut, default=1) == (1 if least > 16 else pytest.approx(2 * int(count), abs=1))
        found.append((loss, gradient, problem.views[0].render.images["HV"].numpy().copy()))
    for loss, gradient, image in found[1:]:
        assert loss == found[0][0]
        np.testing.assert_array_equal(gradient, found[0][1])
        np.testing.assert_array_equal(image, found[0][2])


def test_stretches_are_cut_between_sums(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neighbours that add to one sum stay in one piece; every thread is in one, with the ends of its values."""
    monkeypatch.setattr(launches, "_LEAST", 1)
    monkeypatch.setenv("WARPSAR_THREADS", "3")
    first = wp.array([0, 3, 4, 8, 9, 15, 16], dtype=int, device="cpu")
    node = wp.array([5, 5, 5, 6, 7, 7, 9], dtype=int, device="cpu")
    values = wp.array(np.arange(20, dtype=np.float32), dtype=float, device="cpu")
    pieces = launches.by_stretches(first, values, [node])
    assert len(pieces) > 1
    seen = [p.views[id(node)].numpy() for p in pieces]
    np.testing.assert_array_equal(np.concatenate(seen), node.numpy())
    assert [p.threads for p in pieces] == [len(s) for s in seen]
    for one, other in pairwise(seen):
        assert one[-1] != other[0]
    ends = [p.views[id(values)].shape[0] for p in pieces]
    begins = [int(p.views[id(first)].numpy()[0]) for p in pieces]
    assert ends == [*begins[1:], 20]


def test_pieces_inside_of_tasks_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer tasks than threads, each in pieces: all are done, however busy the threads are, and an error comes out."""
    monkeypatch.setenv("WARPSAR_THREADS", "4")
    done: list[int] = []
    lock = threading.Lock()

    def piece(number: int) -> None:
        with lock:
            done.append(number)

    def task(number: int) -> int:
        threads.side_by_side([partial(piece, 100 * number + k) for k in range(20)])
        return number

    device = devices.resolve_device("cpu")
    for count in (1, 2, 3, 9):
        done.clear()
        assert list(threads.ordered([partial(task, n) for n in range(count)], device)) == list(range(count))
        assert sorted(done) == [100 * n + k for n in range(count) for k in range(20)]

    def failing() -> None:
        raise ValueError("of a piece")

    with pytest.raises(ValueError, match="of a piece"):
        threads.side_by_side([failing, *(partial(piece, k) for k in range(5))])


def test_no_task_goes_on_after_another_one_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that ran out of time hung: tasks that it left behind waited for a lock on both threads, and the last
    fit held that lock and waited for a thread."""
    monkeypatch.setenv("WARPSAR_THREADS", "2")
    begun, ended, last = threading.Event(), threading.Event(), threading.Event()

    def fails() -> None:
        begun.wait(10.0)
        raise ValueError("time is up")

    def slow() -> None:
        begun.set()
        last.wait(0.3)
        ended.set()

    with pytest.raises(ValueError, match="time is up"):
        list(threads.in_threads([fails, slow, last.set]))
    assert ended.is_set()
