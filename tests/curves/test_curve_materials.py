"""Materials of parts by their curves: named where they are there, tied where two say the same, else refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from synthetic import curve, field

from warpsar.curves.materials import MODEL, Kind, MaterialHypothesis, ask_materials, opened
from warpsar.curves.observed import ObservedCurve
from warpsar.curves.shape import ProfileInterval

CASES = (("VV", 5e9, "train"), ("HH", 5e9, "train"), ("VV", 7e9, "test"), ("HH", 7e9, "test"))


def hypothesis(part: str, kind: Kind, curves: Sequence[ObservedCurve]) -> MaterialHypothesis:
    train = tuple(one for one in curves if one.role == "train")
    return MaterialHypothesis(part, kind, train, lambda: tuple(curves))


def hypotheses(
    seed: int, shown: str, alike: float = 0.0, louder: float = 1.0, on_test: float = 1.0
) -> tuple[MaterialHypothesis, list[MaterialHypothesis]]:
    """Metal declared; curves show `shown`. Half the power is the part's. `alike`: how much the foil is as the resin.

    `louder`: power of the noise of test curves over that of train curves. `on_test`: the part's amplitude on test
    curves over that on train curves. Below 1, the foil is as the resin on train curves, and between resin and metal on
    test curves.
    """
    rng = np.random.default_rng(seed)
    made: dict[str, list] = {"metal": [], "resin": [], "foil": []}
    for pol, frequency, role in CASES:
        rest, part = field(rng, frequency), field(rng, frequency)
        resin = 0.6 * field(rng, frequency)
        foil = alike * resin + (1.0 - alike) * 0.6 * field(rng, frequency)
        if on_test < 1.0:
            foil = resin if role == "train" else alike * resin + (1.0 - alike) * part
        size = on_test if role == "test" else 1.0
        terms = {"metal": rest + size * part, "resin": rest + size * resin, "foil": rest + size * foil}
        level = 0.01 * (louder if role == "test" else 1.0)
        one = curve(rng, terms, [shown], frequency_hz=frequency, polarization=pol, role=role, background_m2=level)
        for name in made:
            made[name].append(one.beside({MODEL: one.terms[name]}))
    declared = hypothesis("", "declared", made["metal"])
    return declared, [
        hypothesis("tip", "dielectric", made["resin"]),
        hypothesis("tail", "dielectric", made["foil"]),
    ]


@pytest.mark.parametrize("seed", range(3))
def test_the_material_that_is_there_is_named(seed: int) -> None:
    first, second = ask_materials(*hypotheses(seed, "resin"))
    assert (first.part, first.outcome) == ("tip", "named")
    assert second.outcome == "refused"


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_named_where_the_declared_material_is_there(seed: int) -> None:
    assert {one.outcome for one in ask_materials(*hypotheses(seed, "metal"))} == {"refused"}


@pytest.mark.parametrize("seed", range(6))
def test_a_test_curve_may_have_a_noise_of_its_own(seed: int) -> None:
    """Its noise is as strong as half the body (100 times that of train curves): with theirs it would speak loudly."""
    first, _ = ask_materials(*hypotheses(seed, "resin", louder=100.0))
    assert (first.part, first.kind) == ("tip", "dielectric")
    test = next(one for one in first.left_out if one.name == "test")
    assert test.gain > -2.0 * test.error  # the material that is there is never spoken against
    assert {one.outcome for one in ask_materials(*hypotheses(seed, "metal", louder=100.0))} == {"refused"}


def test_materials_that_say_the_same_are_tied() -> None:
    found = ask_materials(*hypotheses(0, "resin", alike=1.0))
    assert {one.outcome for one in found} == {"tied"}
    assert "not told from" in found[0].words


@pytest.mark.parametrize("seed", [1, 6, 12])
def test_what_the_curves_left_out_leave_in_doubt_takes_the_name_from_what_is_not_told_from_it(seed: int) -> None:
    """Test curves hardly show the part, so that one passes two standard errors on them and the other does not."""
    found = ask_materials(*hypotheses(seed, "resin", alike=0.4, on_test=0.05))
    assert sorted(all(each.holds for each in one.left_out) for one in found) == [False, True]
    assert {one.outcome for one in found} == {"tied"}


def test_a_level_stands_for_an_open_part() -> None:
    """What comes from the part is noise that no model of it has; its level is found to 2 dB, by some 50 directions."""
    rng = np.random.default_rng(3)
    without, declared = [], []
    for pol, frequency, role in CASES:
        rest, part, cavity = (field(rng, frequency) for _ in range(3))
        one = curve(
            rng, {"a": rest, "b": 2.0 * cavity}, ["a", "b"], frequency_hz=frequency, polarization=pol, role=role
        )
        without.append(one.beside({MODEL: one.terms["a"]}))
        declared.append(one.beside({MODEL: one.terms["a"] + 0.1 * part[: len(one.terms["a"])]}))
    found = opened(hypothesis("front", "open", without), lambda one: np.full(len(one.measured_m2), 10.0))
    # the fitted background of a curve can hold a level that is the same everywhere, so the two share it
    assert found.train[0].level_m2.max() < 4.0 * 10.0**0.2
    assert [one.level_m2.max() for one in found.every()] == [found.train[0].level_m2.max()] * len(CASES)
    assert found.parameters == 1


def test_eps_r_has_an_interval_over_what_was_tried() -> None:
    declared, (resin, foil) = hypotheses(1, "resin")
    some = [replace(resin, eps_r=3.0), replace(foil, part="tip", eps_r=2.0)]
    some += [replace(declared, part="tip", kind="dielectric", eps_r=4.0)]
    (found,) = ask_materials(declared, some)
    assert found.eps_r is not None
    assert found.eps_r.low <= 3.0 <= found.eps_r.high


def test_what_explains_less_than_the_engines_own_error_is_not_named() -> None:
    """A material that takes 0.25 dB off the noise everywhere: with 4,000 directions no chance, but no evidence either.

    The declared model lacks a field of 6 % of the noise's power: 10 log10(1.06) = 0.25 dB.
    """
    rng = np.random.default_rng(2)
    declared, other = [], []
    for number in range(80):
        pol, frequency, role = CASES[number % len(CASES)]
        own, lacked = field(rng, frequency), np.sqrt(0.006) * field(rng, frequency)
        one = curve(
            rng, {"a": own, "b": lacked}, ["a", "b"], frequency_hz=frequency, polarization=pol, role=role,
            background_m2=0.1, share=1e-6,
        )  # fmt: skip
        declared.append(one.beside({MODEL: one.terms["a"]}))
        other.append(one.beside({MODEL: one.terms["a"] + one.terms["b"]}))
    asked = hypothesis("tip", "dielectric", other)
    (found,) = ask_materials(hypothesis("", "declared", declared), [asked])
    assert found.gain > found.price
    assert all(one.holds for one in found.left_out)
    assert found.outcome == "refused"
    assert "0.4 dB" in found.why


@pytest.mark.parametrize(("shown", "told"), [("resin", ["tip"]), ("metal", [])])
def test_what_is_costly_is_asked_of_what_stands_alone(shown: str, told: list[str]) -> None:
    """Test curves of the likeliest hypothesis of each question, and intervals of the one that is named."""
    declared, others = hypotheses(0, shown)
    swept, asked = list[str](), list[str]()

    def counted(one: MaterialHypothesis) -> MaterialHypothesis:
        def every() -> tuple[ObservedCurve, ...]:
            swept.append(one.part)
            return one.every()

        def intervals() -> dict[str, ProfileInterval]:
            asked.append(one.part)
            return {"thickness_m": ProfileInterval(2.0, 1.0, 3.0, False)}

        return replace(one, every=every, intervals=intervals)

    worse = replace(others[0], eps_r=9.0, train=others[1].train)
    found = ask_materials(declared, [counted(one) for one in (replace(others[0], eps_r=3.0), worse, others[1])])
    assert sorted(swept) == ["tail", "tip"]
    assert asked == told == [one.part for one in found if one.values]
