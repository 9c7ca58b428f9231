"""Power in its rows and its view alone; how bands are refined."""

from typing import Any

import numpy as np
import pytest
from effect_worlds import Case, plane, refusal, street, with_effect
from worlds import view

from warpsar.effects.registry import get
from warpsar.simulation.command import simulate

pytestmark = pytest.mark.unit

WORKING = [Case({"level": {"v0": 0.01}, "rows": {"v0": [[3, 5], [9, 10]]}})]


def test_interference_is_in_its_rows_and_its_view() -> None:
    views = [view(20.0, 40.0), view(110.0, 40.0, name="other")]
    scene = with_effect(
        plane(views=views), "interference", {"level": {"other": 0.01}, "rows": {"other": [[3, 5], [7, 8]]}}
    )
    plain = simulate(plane(views=views), device="cpu")
    first, second = simulate(scene, device="cpu")
    assert np.array_equal(first.beta0["HH"], plain[0].beta0["HH"])
    added = second.beta0["HH"].astype(float) - plain[1].beta0["HH"]
    assert added[[3, 4, 7]] == pytest.approx(0.01, rel=1e-4)
    assert np.delete(added, [3, 4, 7], axis=0).max() == 0


def test_refinements_of_interference_move_one_end_or_add_one_band() -> None:
    """Bands stay inside the image, apart from one another, and a band that scored joins only where there is room."""
    scene = street()
    rows = scene.grid.shape[0]
    table = {"level": {"v0": 0.1}, "rows": {"v0": [[0, 2], [6, 8]]}}
    others = [
        {"level": {"v0": 0.2}, "rows": {"v0": [[7, 9]]}},  # overlaps
        {"level": {"v1": 0.3}, "rows": {"v1": [[4, 5]]}},
    ]
    found = get("interference").refinements(scene, table, others)
    moved = [one["rows"] for one, chosen in found if chosen == 0]
    assert {"v0": [[0, 3], [6, 8]]} in moved
    assert {"v0": [[0, 2], [5, 8]]} in moved
    for bands in (rows_of["v0"] for rows_of in moved):
        assert len(bands) == 2
        assert all(0 <= first < end <= rows for first, end in bands)
        assert bands[0][1] < bands[1][0]
        assert np.count_nonzero(np.array(bands) != np.array(table["rows"]["v0"])) == 1
    added = [one for one, chosen in found if chosen == 1]
    assert added == [{"level": {"v1": 0.3, "v0": 0.1}, "rows": {"v0": [[0, 2], [6, 8]], "v1": [[4, 5]]}}]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ({}, "rows.v0: missing"),
        ({"v0": [[3, 3]]}, "first < end"),
        ({"v0": [[3, 99]]}, "allowed are rows of the image, to 16"),
    ],
)
def test_rows_are_refused(rows: dict[str, Any], message: str) -> None:
    assert message in refusal("interference", {"level": {"v0": 0.1}, "rows": rows})


def test_a_table_less_one_band_each() -> None:
    effect = get("interference")
    table = {"level": {"v0": 0.1, "v1": 0.2}, "rows": {"v0": [[3, 5], [9, 10]], "v1": [[7, 8]]}}
    assert effect.simpler(table) == [
        {"level": {"v0": 0.1, "v1": 0.2}, "rows": {"v0": [[9, 10]], "v1": [[7, 8]]}},
        {"level": {"v0": 0.1, "v1": 0.2}, "rows": {"v0": [[3, 5]], "v1": [[7, 8]]}},
        {"level": {"v0": 0.1}, "rows": {"v0": [[3, 5], [9, 10]]}},
    ]
    assert effect.simpler({"level": {"v0": 0.1}, "rows": {"v0": [[3, 5]]}}) == []
