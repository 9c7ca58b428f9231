"""The same power in every pixel, which sidelobes of what is bright do not leave."""

import numpy as np
import pytest
from effect_worlds import Case, pair, plane
from scipy.ndimage import distance_transform_edt
from scipy.signal.windows import taylor
from worlds import view

from warpsar.effects.base.sidelobes import beside_sidelobes
from warpsar.effects.base.signature import SeenImage, Signature
from warpsar.effects.registry import get

WORKING = [Case({"level": 0.003})]


def test_noise_floor_is_everywhere() -> None:
    without, with_it = pair(plane(), "noise_floor", {"level": 0.004})
    assert (without == 0).any()
    assert with_it - without == pytest.approx(0.004, rel=1e-4)


SIZE = 96
FLOOR = 2e-3  # 4 dB under the ground, and twice what the sidelobes leave
LEVEL_DB = 40.0  # of the first sidelobes, below the peak


def focused(power: np.ndarray, random: np.random.Generator, looks: int) -> np.ndarray:
    """Speckle through a Taylor-weighted aperture of four fifths of the band, its energy kept; (rows, cols)."""
    count = 2 * SIZE  # what one border loses does not come in at the other
    band = int(0.8 * count) // 2 * 2 + 1
    weight = np.zeros(count)
    weight[:band] = taylor(band, nbar=6, sll=LEVEL_DB)
    weight = np.roll(weight, -(band // 2))
    both = np.outer(weight, weight)
    both /= np.sqrt((both**2).mean())
    image = np.zeros_like(power)
    for _ in range(looks):
        field = np.zeros((count, count), complex)
        field[:SIZE, :SIZE] = np.sqrt(power / 2) * (
            random.normal(size=power.shape) + 1j * random.normal(size=power.shape)
        )
        image += np.abs(np.fft.ifft2(np.fft.fft2(field) * both))[:SIZE, :SIZE] ** 2 / looks
    return image


def seen(floor: float, *, gain: float = 1.0, looks: int = 1, seed: int = 1) -> SeenImage:
    """A body 40 dB over its ground, and a shadow behind it. The model without the floor has no sidelobes."""
    power = np.full((SIZE, SIZE), 0.005)
    power[20:23, 36:60] = 50.0
    power[24:72, 34:62] = 0.0
    lit = power > 0
    random = np.random.default_rng(seed)
    measured = gain * (focused(power, random, looks) + floor * random.gamma(looks, 1 / looks, power.shape))
    dark = distance_transform_edt(~lit) >= 6
    model = gain * power
    of_one = np.zeros(power.shape, int)
    return SeenImage(
        view(10.0, 40.0), "HH", looks, False, (0.5, 0.5), measured, model, model, lit, dark, of_one, ("ground",), gain
    )


def judged(images: list[SeenImage], level: float) -> Signature:
    found = get("noise_floor").own_test(images, {"level": level})
    assert found is not None
    return found


@pytest.mark.parametrize("looks", [1, 4])
def test_sidelobes_in_a_shadow_are_no_floor(looks: int) -> None:
    """At -40 dB they fill it; the level is their mean, as a fit finds it; one view has 3 dB more. They are refused."""
    images = [seen(0.0, gain=gain, looks=looks, seed=k) for k, gain in enumerate((1.0, 2.0, 1.0))]
    level = float(np.mean([one.measured[one.dark].mean() / one.gain for one in images]))
    assert (np.concatenate([one.measured[one.dark] for one in images]) > 0).all()
    found = judged(images, level)
    assert found.outcome == "against"
    assert "as sidelobes do" in found.text


@pytest.mark.full
@pytest.mark.parametrize("looks", [1, 4])
def test_a_floor_is_confirmed_beside_sidelobes(looks: int) -> None:
    """Its share is 1 within four of the stated errors, and another level is refused."""
    images = [seen(FLOOR, gain=gain, looks=looks, seed=k) for k, gain in enumerate((1.0, 2.0, 1.0))]
    share, error, _ = beside_sidelobes(images, [one.gain * FLOOR for one in images])
    assert error < 0.15
    assert share == pytest.approx(1.0, abs=4 * error)
    assert judged(images, FLOOR).outcome == "confirmed"
    assert judged(images, 10 * FLOOR).outcome == judged(images, FLOOR / 10).outcome == "against"


def test_a_floor_that_does_nothing_is_refused() -> None:
    """A level far under what the model's own sidelobes have was confirmed, since the two together fit."""
    one = seen(0.0)
    sidelobes = focused(np.where(one.lit, one.without, 0.0), np.random.default_rng(7), 200)
    with_them = SeenImage(**{**vars_of(one), "without": sidelobes, "with_it": sidelobes})
    assert judged([with_them], 1e-11).outcome != "confirmed"


def vars_of(one: SeenImage) -> dict[str, object]:
    return {name: getattr(one, name) for name in SeenImage.__dataclass_fields__}


def test_bounces_in_the_shadow_do_not_refuse_a_floor() -> None:
    """A seventh of the dark pixels is fifty times as bright: the parts rest on the others."""
    images = [seen(FLOOR, seed=k) for k in range(3)]
    for one in images:
        inside = np.argwhere(one.dark)
        one.measured[tuple(inside[: len(inside) // 7].T)] += 50 * FLOOR
    share, error, _ = beside_sidelobes(images, [FLOOR] * 3)
    assert share == pytest.approx(1.0, abs=4 * error)
    assert judged(images, FLOOR).outcome != "against"


def test_a_shadow_without_power_refuses_it_and_few_pixels_say_nothing() -> None:
    one = seen(FLOOR)
    one.measured[one.dark] = 0.0
    assert judged([one], FLOOR).outcome == "against"
    few = seen(FLOOR)
    few.dark[:] = False
    few.dark[48, 40:50] = True
    assert judged([few], FLOOR).outcome == "none"
