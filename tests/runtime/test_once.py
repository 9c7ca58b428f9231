"""What a run does once, in one process; and how values get from one process to another. Several processes:
tests/runtime/test_distributed.py."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from warpsar.effects.base.signature import Signature
from warpsar.errors import InputError
from warpsar.learning.optimise import FitState
from warpsar.runtime import once
from warpsar.runtime.distributed import processes
from warpsar.runtime.distributed.processes import ALONE, Sharing
from warpsar.runtime.distributed.travel import packed, unpacked
from warpsar.speckle.scan import Spot

pytestmark = pytest.mark.unit


class Second(Sharing):
    """The second of two processes, of which the first says 1."""

    rank, size = 1, 2

    def same(self, array: Any) -> np.ndarray:
        return np.ones_like(np.asarray(array, float))

    def gather(self, value: Any) -> list[Any]:
        return [None, value]

    def hand_out(self, value: Any) -> Any:
        assert value is None  # what the first one finds is not found here
        return "found"


@pytest.fixture
def second(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "_here", Second())


VALUES: dict[str, Any] = {
    "single values": [None, True, 3, -0.1, float("inf"), "ä"],
    "tuples and lists": ((1, [2, (3,)]), [], ()),
    "tables of any key": {"a": {1: (2.0,)}, ("HH", 0): None},
    "a number of NumPy": np.float32(0.1).item(),
    "a dataclass": Signature("none", "says nothing", {"gain": 0.1}),
    "a dataclass with a tuple": Spot(4.5, 1, 2, 3, (3, 5)),
}


@pytest.mark.parametrize("kind", VALUES)
def test_values_travel_whole(kind: str) -> None:
    found = unpacked(packed(VALUES[kind]))
    assert found == VALUES[kind]
    assert type(found) is type(VALUES[kind])


def test_arrays_travel_to_the_bit() -> None:
    random = np.random.default_rng(1)
    arrays = {
        "a": random.normal(size=(3, 0)),
        "b": random.normal(size=(2, 3)).astype("<f4"),
        "c": random.random(4) > 0.5,
    }
    for key, array in unpacked(packed({**arrays, "nan": np.array([np.nan, -0.0])})).items():
        if key in arrays:
            assert (array.dtype, array.shape) == (arrays[key].dtype, arrays[key].shape)
            assert array.tobytes() == arrays[key].tobytes()
    state = FitState(random.normal(size=3), 1.0 / 3.0, random.normal(size=3), 0.1, iteration=4)
    again = unpacked(packed([state]))[0]
    assert (again.x.tobytes(), again.loss, again.iteration) == (state.x.tobytes(), state.loss, 4)


@dataclass
class Foreign:
    """Not one of the package's."""

    number: int = 1


def test_nothing_else_travels() -> None:
    for value in (object(), np.array([object()]), {"deep": [{1, 2}]}):
        with pytest.raises(TypeError, match="cannot go to another process"):
            packed(value)
    with pytest.raises(TypeError, match="is no dataclass of warpsar"):
        unpacked(packed(Foreign()))


def test_one_process_does_all_by_itself() -> None:
    assert once.processes() == 1
    assert once.write(lambda: "written") == once.find(lambda: "written") == "written"
    assert once.decide([1.0, 2.0]).tolist() == [1.0, 2.0]
    assert once.share([lambda: 1, lambda: 2]) == [1, 2]
    with pytest.raises(InputError, match="no"):
        once.find(refused)


def refused() -> None:
    raise InputError("no")


@pytest.mark.usefixtures("second")
def test_the_second_of_two_writes_nothing_and_follows_the_first() -> None:
    written: list[int] = []
    assert once.processes() == 2
    assert once.write(lambda: written.append(1)) is None
    assert once.find(lambda: written.append(1)) == "found"
    assert written == []
    assert once.decide([5.0, 6.0]).tolist() == [1.0, 1.0]
    assert once.refusal(InputError("no")).quiet
    with pytest.raises(InputError, match="no") as found:
        once.agree(refused)
    assert not found.value.quiet  # it alone was refused, and says so


@pytest.mark.usefixtures("second")
def test_a_task_of_one_process_sees_no_other() -> None:
    assert once.alone(lambda: (once.processes(), once.write(lambda: "mine"))) == (1, "mine")
    with pytest.raises(InputError):
        once.alone(refused)
    assert once.processes() == 2
    assert ALONE.deal_out([once.processes, once.processes]) == [1, 1]
