"""The statistics of `warpsar diagnose`, each against a closed form, brute force or many draws."""

import numpy as np
import pytest
from scipy import ndimage, optimize, special, stats
from worlds import view

from warpsar.compare.observation import Observation
from warpsar.diagnosis.scores.bootstrap import Bootstrap
from warpsar.diagnosis.scores.score import REACH, TangentProjection, TemplateGroup, log_tail, minus_log_p
from warpsar.diagnosis.scores.templates import Template
from warpsar.effects.base.trial import ScoreStep, Trial
from warpsar.speckle.draws import Speckle, _white
from warpsar.speckle.scan import LIKELIHOOD, POWER, Scan, surest
from warpsar.speckle.tail import Tail, Tails

WHITE = np.zeros((13, 13))
WHITE[6, 6] = 1.0


def observation(interior: np.ndarray, looks: float = 16.0) -> Observation:
    nowhere = np.zeros_like(interior)
    return Observation(view(0, 40), "HH", np.ones(interior.shape), interior, nowhere, nowhere, looks, False)


# Tails


# 1, 2 and 4 degrees of freedom have closed forms that never underflow: 2 Phi(-sqrt(s)), exp(-s/2), exp(-s/2) (1 + s/2)
@pytest.mark.parametrize("statistic", [0.0, 0.3, 4.0, 60.0, 590.0, 610.0, 5000.0, 1e5])
@pytest.mark.parametrize(
    ("degrees", "closed_form"),
    [
        (1, lambda s: np.log(2.0) + special.log_ndtr(-np.sqrt(s))),
        (2, lambda s: -s / 2.0),
        (4, lambda s: -s / 2.0 + np.log1p(s / 2.0)),
    ],
)
def test_log_tail_of_chi_square(statistic: float, degrees: int, closed_form: object) -> None:
    assert callable(closed_form)
    # the series beyond 600 stops after (2/s)^2: 1e-7
    assert float(log_tail(statistic, degrees)) == pytest.approx(closed_form(statistic), rel=1e-9, abs=1e-6)


def test_log_tail_meets_scipy() -> None:
    s = np.linspace(0.1, 500.0, 50)
    for degrees in range(1, 8):
        np.testing.assert_allclose(log_tail(s, degrees), stats.chi2.logsf(s, degrees), rtol=1e-9)


def test_mixture_by_hand() -> None:
    s = np.array([0.5, 4.0, 30.0])
    one, two, three = (stats.chi2.sf(s, k) for k in (1, 2, 3))
    np.testing.assert_allclose(minus_log_p(s, 2, 0), -np.log(two), rtol=1e-9)
    np.testing.assert_allclose(minus_log_p(s, 0, 1), -np.log(0.5 * one), rtol=1e-9)
    np.testing.assert_allclose(minus_log_p(s, 0, 2), -np.log(0.5 * one + 0.25 * two), rtol=1e-9)
    np.testing.assert_allclose(minus_log_p(s, 1, 2), -np.log(0.25 * one + 0.5 * two + 0.25 * three), rtol=1e-9)
    np.testing.assert_allclose(minus_log_p(np.zeros(1), 0, 1), 0.0, atol=1e-12)


# Scores


def a_group(columns: np.ndarray, covariance: np.ndarray, one_sided: tuple[bool, ...]) -> TemplateGroup:
    step = ScoreStep("x", 1.0, {})
    template = Template("x", Trial((step,) * len(one_sided), ({},)), columns, one_sided)
    return TemplateGroup([template], columns, covariance[None], np.ones(1))


@pytest.mark.parametrize(
    "one_sided",
    [(True,), (False,), (True, True), (False, True), (True, False), (True, True, True), (False, True, False, True)],
)
def test_statistic_is_the_best_over_the_cone(one_sided: tuple[bool, ...]) -> None:
    """max of 2 theta.S - theta' V theta with some theta >= 0, by non-negative least squares; a free theta is the
    difference of two that are not negative."""
    random = np.random.default_rng(len(one_sided))
    k, n, draws = len(one_sided), 40, 30
    columns = random.standard_normal((n, k))
    covariance = np.cov(random.standard_normal((k, 3 * k + 3))).reshape(k, k) + 0.2 * np.eye(k)
    residuals = random.standard_normal((n, draws))
    found, scores = a_group(columns, covariance, one_sided).statistics(residuals)
    root = np.linalg.cholesky(covariance)
    for draw in range(draws):
        target = np.linalg.solve(root, columns.T @ residuals[:, draw])
        free = [i for i, bound in enumerate(one_sided) if not bound]
        _, distance = optimize.nnls(np.hstack([root.T, -root.T[:, free]]), target)
        assert found[0, draw] == pytest.approx(target @ target - distance**2, rel=1e-8, abs=1e-8)
    expected = minus_log_p(found, one_sided.count(False), one_sided.count(True))
    np.testing.assert_allclose(scores, expected)


def test_one_sided_p_values_are_uniform() -> None:
    """Independent coordinates, one free and one not negative: where p < 1 it is uniform, exactly."""
    random = np.random.default_rng(3)
    columns = np.eye(2)
    _, scores = a_group(columns, np.eye(2), (False, True)).statistics(random.standard_normal((2, 20_000)))
    p = np.exp(-scores[0])
    # 20 000 draws: a share of 0.05 has a standard deviation of 0.0015
    for level in (0.01, 0.05, 0.3):
        assert np.mean(p < level) == pytest.approx(level, abs=4 * np.sqrt(level / 20_000))


def test_projection_takes_out_the_tangent_and_nothing_else() -> None:
    random = np.random.default_rng(0)
    tangent = random.standard_normal((200, 3)) * [1.0, 1e3, 0.1]
    looks = random.uniform(1.0, 4.0, 200)
    # a column twice and one of zeros: no more is taken out by them
    projection = TangentProjection(np.hstack([tangent, tangent[:, :1] - tangent[:, 1:2], np.zeros((200, 1))]), looks)
    assert projection.basis.shape == (200, 3)
    columns = random.standard_normal((200, 5))
    left = projection(columns)
    scale = np.linalg.norm(looks[:, None] * tangent, axis=0)
    np.testing.assert_allclose((looks[:, None] * tangent / scale).T @ left, 0.0, atol=1e-12)
    np.testing.assert_allclose(projection(left), left, atol=1e-12)
    np.testing.assert_allclose(np.linalg.matrix_rank(np.hstack([columns - left, looks[:, None] * tangent / scale])), 3)


def test_a_direction_beyond_all_moves_is_not_taken_out() -> None:
    """Two columns that differ by little: along their difference a parameter would have to move by 1 / (difference's
    length) to change the images by one standard deviation. Beyond `REACH` it imitates nothing."""
    one, other = np.linalg.qr(np.random.default_rng(1).standard_normal((300, 2)))[0].T
    for apart, taken in ((2.0 / REACH, 2), (0.5 / REACH, 1)):
        tangent = np.stack([100.0 * one, 100.0 * one + 2.0 * apart * other], axis=1)
        # x moves by (1, -1) for a change of 2 `apart` along `other`
        projection = TangentProjection(tangent, np.ones(300))
        assert projection.basis.shape == (300, taken)


# Bootstrap


def test_tail_is_calibrated_inside_and_beyond_the_draws() -> None:
    """Exponential draws: -ln p of x is x, also where no draw has been."""
    tail = Tail.of(np.random.default_rng(0).exponential(size=4000))
    x = np.array([0.05, 0.3, 1.0, 2.0, 2.3])
    # the share above x of 4000 draws is known to 1 / sqrt(4000 p)
    np.testing.assert_allclose(tail(x), x, atol=0.1)
    # beyond, the slope comes from the 400 largest: 1 / sqrt(400)
    np.testing.assert_allclose(tail(np.array([8.0, 15.0, 40.0])), [8.0, 15.0, 40.0], rtol=0.15)
    many = tail(np.linspace(0.0, 20.0, 500))
    assert (np.diff(many) >= 0).all()


@pytest.mark.parametrize("draws", [200, 1000, 4000])
def test_threshold_is_passed_at_the_family_error(draws: int) -> None:
    """Exponential draws: 1 % lie above ln 100. Over 400 families the threshold scatters about it as is stated, and the
    statement itself by a tenth and by what the scale is off."""
    families = np.random.default_rng(1).exponential(size=(400, draws))
    boots = [Bootstrap({}, np.sort(one)) for one in families]
    found = np.array([boot.threshold(0.01) for boot in boots])
    stated = np.mean([Tail.of(boot.largest).value_error(np.log(100.0)) for boot in boots])
    assert found.mean() == pytest.approx(np.log(100.0), abs=4.0 * stated / 20.0 + 0.02)  # 0.02: a quantile of 200
    assert found.std() == pytest.approx(stated, rel=0.15)
    boot = boots[0]
    assert boot.p_family(1e9) == pytest.approx(1 / (draws + 1))
    assert boot.threshold(0.5) == np.quantile(families[0], 0.5)  # among the draws there is no tail


def test_an_interval_of_a_tail_holds_the_truth() -> None:
    """-ln p of a value of exponential draws is the value: of 400 tails, 2 standard errors hold it in 95 %."""
    tails = [Tail.of(one) for one in np.random.default_rng(2).exponential(size=(400, 200))]
    for truth in (4.0, 8.0, 30.0):
        held = np.mean([low <= truth <= high for low, high in (tail.interval(truth) for tail in tails)])
        assert 0.9 < held <= 1.0
    assert tails[0].interval(0.1) == tails[0].interval(tails[0].edge)  # among the draws


def test_the_first_draws_decide_as_all_do() -> None:
    """300 families of 15 scores, with nothing there or with one that stands out. Where 200 draws are said to decide,
    the scores that pass are those that pass by 1000; but for those that the best one leaves behind."""
    random = np.random.default_rng(3)
    settled, agreed = 0, 0
    for family in range(300):
        scores = {str(k): float(v) for k, v in enumerate(random.exponential(size=15))}
        if family % 2:
            scores["0"] = float(random.uniform(4.0, 40.0))
        drawn = {name: random.exponential(size=1000) for name in scores}
        few, all_of_them = (_calibrated({n: d[:count] for n, d in drawn.items()}) for count in (200, 1000))
        if few.decides(scores, 0.01):
            settled += 1
            agreed += _passing(few, scores) == _passing(all_of_them, scores)
    assert settled > 150  # else nothing is saved
    assert agreed >= 0.98 * settled


def _calibrated(drawn: dict[str, np.ndarray]) -> Bootstrap:
    tails = {name: Tail.of(values) for name, values in drawn.items()}
    return Bootstrap(tails, np.sort(np.max([tails[name](values) for name, values in drawn.items()], axis=0)))


def _passing(boot: Bootstrap, scores: dict[str, float]) -> set[str]:
    """Scores beyond the threshold, but for those far behind the best."""
    calibrated = {name: float(boot.tails[name](score)) for name, score in scores.items()}
    best = max(calibrated.values())
    return {name for name, score in calibrated.items() if score > max(boot.threshold(0.01), 0.6 * best)}


@pytest.mark.parametrize("looks", [1.0, 4.0, 16.0])
def test_white_speckle_is_gamma(looks: float) -> None:
    seen = observation(np.ones((20, 20), bool), looks)
    draws = Speckle([seen], WHITE)(np.random.default_rng(0), 50)
    assert draws.shape == (400, 50)
    power = draws.ravel() / np.sqrt(looks) + 1.0
    assert stats.kstest(power, stats.gamma(looks, scale=1 / looks).cdf).pvalue > 1e-3
    assert draws.var() == pytest.approx(1.0, abs=0.05)


def test_noise_of_three_values_makes_fields_of_one_look() -> None:
    """Power in images of 72 x 72 pixels: exponential, and its mean over an image scatters as that of 5184 pixels. The
    errors of 200 images: 6e-4 in a chance, and 5 % in the scatter."""
    noise = _white(np.random.default_rng(0), (200, 72, 72))
    assert np.unique(noise.real).size == 3
    assert [(noise.real**k).mean() for k in (2, 4)] == pytest.approx([1.0, 3.0], rel=0.01)
    power = 0.5 * np.abs(np.fft.ifft2(noise, norm="ortho")) ** 2
    for level in (1.0, 4.0, 7.0):
        assert (power > level).mean() == pytest.approx(np.exp(-level), abs=2e-3)
    assert power.mean(axis=(1, 2)).std() * 72 == pytest.approx(1.0, rel=0.15)


@pytest.mark.parametrize("looks", [1.0, 4.0, 16.0])
def test_correlated_speckle_has_the_asked_autocovariance(looks: float) -> None:
    """Gamma marginals, the autocovariance that was asked for, and the mask's holes left out."""
    lag = np.arange(-6, 7)
    asked = np.exp(-(lag[:, None] ** 2 + lag[None, :] ** 2) / 3.0)
    asked[np.hypot(*np.meshgrid(lag, lag)) > 3.5] = 0.0
    interior = np.ones((40, 40), bool)
    interior[10:14, 20:30] = False
    seen = observation(interior, looks)
    draws = Speckle([seen], asked)(np.random.default_rng(0), 200)
    assert draws.shape == (interior.sum(), 200)
    power = draws[::37].ravel() / np.sqrt(looks) + 1.0
    assert stats.kstest(power, stats.gamma(looks, scale=1 / looks).cdf).pvalue > 1e-3
    grid = np.full((40, 40, 200), np.nan)
    grid[interior] = draws
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (0, 2), (4, 0)):
        product = grid[: 40 - i, : 40 - j] * grid[i:, j:]
        # 200 fields of some 1600 / 9 independent patches: 0.01. And no field has correlations that end at 3.5 pixels as
        # these do: the nearest one is 0.03 off.
        assert np.nanmean(product) == pytest.approx(asked[6 + i, 6 + j], abs=0.04), (i, j)


@pytest.mark.parametrize("looks", [1, 2, 4])
def test_peaks_of_correlated_speckle_are_as_wide_as_those_of_fields(looks: int) -> None:
    """The strongest 3 x 3 window of a draw, against fields that are blurred pixel by pixel: medians of 300 draws."""
    sigma, side, draws = 0.7, 48, 300
    lag = np.arange(-6, 7)
    asked = np.exp(-(lag[:, None] ** 2 + lag[None, :] ** 2) / (2.0 * sigma**2))
    seen = observation(np.ones((side, side), bool), float(looks))
    drawn = Speckle([seen], np.where(asked < 0.02, 0.0, asked))(np.random.default_rng(0), draws)
    random, strongest = np.random.default_rng(1), []
    for _ in range(draws):
        parts = random.standard_normal((2 * looks, side + 12, side + 12))
        power = (ndimage.gaussian_filter(parts, (0.0, sigma, sigma), mode="wrap") ** 2).mean(axis=0)[6:-6, 6:-6]
        strongest.append(uniform_peak(power))
    mean = ndimage.gaussian_filter(np.eye(1, 441, 220).reshape(21, 21), sigma)
    fields = (np.array(strongest) / (mean**2).sum() - 1.0) * np.sqrt(looks)
    here = [uniform_peak(one.reshape(side, side)) for one in drawn.T]
    # each median has an error of 1 %; a normal field that is taken to the law is 10 % lower at one look
    assert np.median(here) == pytest.approx(np.median(fields), rel=0.04)


def uniform_peak(image: np.ndarray) -> float:
    return float(ndimage.uniform_filter(image, 3)[1:-1, 1:-1].max())


def test_residual_that_varies_more_than_speckle_makes_draws_that_do() -> None:
    seen = observation(np.ones((30, 30), bool))
    draws = Speckle([seen], 2.25 * WHITE)(np.random.default_rng(0), 40)
    assert draws.std() == pytest.approx(1.5, rel=0.03)
    calm = Speckle([seen], 0.5 * WHITE)(np.random.default_rng(0), 40)
    assert calm.std() == pytest.approx(1.0, rel=0.03)


# Scan


@pytest.mark.parametrize(("size", "height"), [(3, 6.0), (5, -3.0), (9, 2.0)])
def test_scan_finds_a_planted_patch(size: int, height: float) -> None:
    interior = np.ones((40, 50), bool)
    interior[:5] = False
    masks = [observation(np.ones((30, 30), bool)), observation(interior)]
    scan = Scan(masks, WHITE)
    residual = np.zeros((40, 50))
    residual[20 : 20 + size, 30 : 30 + size] = height
    spots, strength = scan.strongest([np.zeros(900), residual[interior]])
    spot = spots[LIKELIHOOD]
    assert (spot.observation, spot.row, spot.col) == (1, 20 + size // 2, 30 + size // 2)
    assert spot.window == (size, size)
    assert spot.z == pytest.approx(height * size)  # size^2 pixels over the root of their number
    largest = scan.largest([np.zeros((900, 2)), np.stack([residual[interior]] * 2, axis=1)])
    np.testing.assert_allclose(largest, np.stack([strength] * 2, axis=1))
    assert strength[POWER] == pytest.approx(max(spot.z, 0.0))
    factor, looks = max(1.0 + height / 4.0, 0.01), 16.0 * size**2
    assert strength[LIKELIHOOD] == pytest.approx(np.sqrt(2.0 * looks * (factor - 1.0 - np.log(factor))))


def test_pixels_that_measure_nothing_count_where_the_data_are_looked_at() -> None:
    """Nine silent pixels of 16 looks: 9 * (-4) over the root of 9; the draws know nothing of them."""
    interior = np.ones((20, 20), bool)
    interior[8:11, 4:7] = False
    silent = np.where(interior, 0.0, -4.0)
    scan = Scan([observation(interior)], WHITE, [silent])
    spot = scan.strongest([np.zeros(int(interior.sum()))])[0][LIKELIHOOD]
    assert (spot.row, spot.col, spot.window) == (9, 5, (3, 3))
    assert spot.z == pytest.approx(-12.0)
    assert scan.largest([np.zeros((int(interior.sum()), 2))]).max() == 0.0


def test_scan_windows_are_standard_normal_and_leave_thin_places_out() -> None:
    interior = np.ones((30, 30), bool)
    interior[:, 12:] = False
    interior[4, 20] = True  # a pixel by itself fills no window by half
    scan = Scan([observation(interior)], WHITE)
    random = np.random.default_rng(0)
    noise = random.standard_normal((int(interior.sum()), 300))
    windows = scan._windows(0, noise)
    for z in windows:
        used = (z != 0).any(axis=0)
        assert z[:, used].std() == pytest.approx(1.0, rel=0.03)
    alone = np.zeros(int(interior.sum()))
    alone[np.flatnonzero(np.flatnonzero(interior) == 4 * 30 + 20)] = 100.0
    assert not scan.strongest([alone])[1].any()


def test_scan_knows_that_speckle_is_correlated() -> None:
    """Twice the variance of sums: z shrinks by its root."""
    wide = WHITE.copy()
    wide[6, 5] = wide[6, 7] = 0.5
    residual = np.ones(900)
    seen = [observation(np.ones((30, 30), bool))]
    white, correlated = (Scan(seen, each).strongest([residual])[1][POWER] for each in (WHITE, wide))
    ratio = white / correlated
    assert ratio == pytest.approx(np.sqrt(2.0))


def test_a_shadow_is_told_beside_bright_speckle_of_one_look() -> None:
    """A square of 5 pixels without power, z = -5, is weaker than the bright spots of a hundred draws, and darker than
    any of them: it is found, and speckle alone is not."""
    scan = Scan([observation(np.ones((60, 60), bool), looks=1.0)], WHITE)
    drawn = scan.largest([np.random.default_rng(5).exponential(size=(3600, 200)) - 1.0])
    tails = Tails.of(drawn)
    residual = np.random.default_rng(6).exponential(size=(60, 60)) - 1.0
    assert surest(*scan.strongest([residual.ravel()]), tails)[1] < 4.0
    residual[20:25, 30:35] = -1.0
    assert drawn[0].max() > 5.0
    spot, surprise = surest(*scan.strongest([residual.ravel()]), tails)
    assert (spot.row, spot.col, spot.window) == (22, 32, (5, 5))
    assert surprise > 12.0


def test_several_statistics_are_one_question() -> None:
    """-ln p of the most improbable of several is that of any so improbable: exponential, though their tails differ."""
    random = np.random.default_rng(7)
    scales = np.array([[1.0], [0.1], [30.0]])
    tails = Tails.of(scales * random.exponential(size=(3, 1000)))
    new = tails(scales * random.exponential(size=(3, 20000)))
    for level in (1.0, 2.0, 4.0):
        assert np.mean(new > level) == pytest.approx(np.exp(-level), rel=0.3)
    assert tails.first([1.0, 0.5, 30.0]) == 1
