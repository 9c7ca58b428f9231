"""Covariances of scores under correlated speckle, against explicit matrices over all pixels."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.sparse import csc_array
from worlds import view

from warpsar.compare.observation import Observation
from warpsar.diagnosis.scores.evidence import TRIALS, Evidence
from warpsar.diagnosis.scores.score import TangentProjection, TemplateGroup, group
from warpsar.diagnosis.scores.templates import Template
from warpsar.effects.base.trial import ScoreStep, Trial
from warpsar.learning.identify import score_products
from warpsar.runtime.matmul import gram, gram_by_tiles, times, transposed_times

RANDOM = np.random.default_rng(7)
SHAPES = ((17, 23), (20, 11))
RANKS = 3


def autocovariance(kind: str) -> np.ndarray:
    found = np.zeros((13, 13))
    found[6, 6] = 1.3
    if kind == "near":
        found[6, 5] = found[6, 7] = 0.4
    if kind == "wide":  # slanted: rows and columns are not alike
        lags = np.arange(-6, 7)
        found = 1.3 * np.exp(-((lags[:, None] / 2.0) ** 2) - ((lags - lags[:, None] / 3.0) / 3.0) ** 2)
    return found


def explicit(insides: Sequence[np.ndarray], lags: np.ndarray) -> np.ndarray:
    """The covariance matrix of all pixels: `lags` at the difference of two places of one image, else 0."""
    places = [(image, *place) for image, inside in enumerate(insides) for place in np.argwhere(inside)]
    found = np.zeros((len(places), len(places)))
    for a, (image, row, col) in enumerate(places):
        for b, (other, there, across) in enumerate(places):
            if image == other and max(abs(row - there), abs(col - across)) <= 6:
                found[a, b] = lags[6 + row - there, 6 + col - across]
    return found


def the_evidence(lags: np.ndarray) -> Evidence:
    insides = [RANDOM.random(shape) < 0.6 for shape in SHAPES]
    insides[0][:, :4] = False  # nothing is compared at one edge
    nowhere = [np.zeros(shape, bool) for shape in SHAPES]
    seen = [
        Observation(view(0, 40), "HH", np.ones(inside.shape), inside, none, none, 4.0, False)
        for inside, none in zip(insides, nowhere, strict=True)
    ]
    n = sum(int(inside.sum()) for inside in insides)
    modelled = [np.ones(int(inside.sum())) for inside in insides]
    return Evidence(seen, modelled, np.zeros(n), RANDOM.uniform(1.0, 3.0, n), lags, [none * 1.0 for none in nowhere])


def one(columns: np.ndarray) -> Template:
    steps = (ScoreStep("x", 1.0, {}),) * columns.shape[1]
    return Template("x", Trial(steps, ({},)), csc_array(columns), (False,) * columns.shape[1])


def made(
    evidence: Evidence, tangent: np.ndarray, columns: Sequence[np.ndarray]
) -> tuple[TangentProjection, TemplateGroup]:
    projection = TangentProjection(tangent, evidence.root_looks)
    (found,) = group([one(each) for each in columns], projection, evidence)
    return projection, found


@pytest.mark.parametrize("kind", ["white", "near", "wide"])
@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize("sparse", [False, True])
def test_group_is_that_of_explicit_matrices(kind: str, k: int, sparse: bool) -> None:
    """(1 - BB') T for the projection and T' C T for the covariance, all dense; rounding is what they may differ by."""
    evidence = the_evidence(autocovariance(kind))
    n, trials = evidence.root_looks.size, TRIALS + 5  # more than are made dense at once
    tangent = RANDOM.standard_normal((n, RANKS))
    columns = RANDOM.standard_normal((trials, n, k))
    if sparse:
        lit = np.zeros((trials, n, 1))
        for trial in lit:
            first = RANDOM.integers(0, n - 9)
            trial[first : first + 9] = 1.0
        columns = columns * lit
    projection, found = made(evidence, tangent, list(columns))
    assert isinstance(found.columns, csc_array) == sparse

    roots = evidence.root_looks[:, None]
    basis = np.linalg.qr(roots * tangent)[0]
    left_of = np.eye(n) - basis @ basis.T
    matrix = explicit([seen.interior for seen in evidence.observations], evidence.autocovariance)
    residuals = RANDOM.standard_normal((n, 4))
    np.testing.assert_allclose(projection(residuals), left_of @ residuals, atol=1e-12)
    statistics, minus_log_p = found.statistics(projection(residuals))
    np.testing.assert_allclose(found.largest(projection(residuals)), minus_log_p.max(axis=0), rtol=1e-14)
    for trial in range(trials):
        unit = roots * columns[trial]
        unit /= np.linalg.norm(unit, axis=0)
        np.testing.assert_allclose(found.columns_of(trial), unit, atol=1e-14)
        left = left_of @ unit
        assert found.eta[trial] == pytest.approx((left**2).sum(axis=0).max(), rel=1e-12)
        covariance = left.T @ matrix @ left
        np.testing.assert_allclose(found.covariance[trial], covariance, rtol=1e-11, atol=1e-12)
        scores = left.T @ residuals
        expected = (scores * np.linalg.solve(covariance, scores)).sum(axis=0)
        np.testing.assert_allclose(statistics[trial], expected, rtol=1e-9)


@pytest.mark.parametrize("kind", ["white", "near", "wide"])
def test_score_products_are_those_of_the_explicit_matrix(kind: str) -> None:
    evidence = the_evidence(autocovariance(kind))
    seen = evidence.observations[0]
    scaled = RANDOM.standard_normal((int(seen.interior.sum()), 20))
    expected = scaled.T @ explicit([seen.interior], evidence.autocovariance) @ scaled
    np.testing.assert_allclose(score_products(scaled, evidence.autocovariance, seen), expected, rtol=1e-11, atol=1e-9)


def test_a_trial_that_changes_nothing_scores_nothing() -> None:
    evidence = the_evidence(autocovariance("wide"))
    n = evidence.root_looks.size
    _, found = made(evidence, RANDOM.standard_normal((n, 2)), [np.zeros((n, 1))])
    assert found.eta.tolist() == [0.0]
    assert found.largest(RANDOM.standard_normal((n, 3))).tolist() == pytest.approx([0.0] * 3)


@pytest.mark.parametrize(
    ("n", "k", "m"), [(1, 1, 1), (255, 3, 25), (1000, 70, 25), (700, 70, 130), (5000, 2, 1), (300, 0, 4)]
)
def test_products_in_pieces(n: int, k: int, m: int) -> None:
    a, b, c = (RANDOM.standard_normal(shape) for shape in ((n, k), (n, m), (k, m)))
    for tall in (a, np.asfortranarray(a)):
        np.testing.assert_allclose(transposed_times(tall, b), a.T @ b, atol=1e-11)
        np.testing.assert_allclose(times(tall, c), a @ c, atol=1e-11)


@pytest.mark.parametrize("k", [0, 1, 63, 150])
def test_normal_matrices_in_pieces(k: int) -> None:
    """Of columns of which some are 0 in some tiles of the image, too."""
    shape, pixels = (40, 25), np.sort(RANDOM.choice(1000, 700, replace=False))
    j, weight = RANDOM.standard_normal((700, k)), RANDOM.uniform(0.5, 2.0, 700)
    j[pixels < 500, : k // 2] = 0.0
    expected = j.T @ (weight[:, None] * j)
    np.testing.assert_allclose(gram(j, weight), expected, atol=1e-11)
    np.testing.assert_allclose(gram_by_tiles(j, weight, pixels, shape), expected, atol=1e-11)
