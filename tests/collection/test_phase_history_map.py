"""The linear map of a collection and its adjoint: inner products, sums of their own, and backprojection."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from test_phase_history import TRACKS, plan, summed

import warpsar
from warpsar.collection import Collected, PhaseHistoryMap
from warpsar.collection.response import band_weights
from warpsar.measured.focus import focus
from warpsar.world.collection import Antenna, CollectionErrors

MORE: dict[str, Any] = {
    "beam and errors": {
        "antenna": Antenna(azimuth_deg=0.3),
        "errors": CollectionErrors(timing_s=1e-9, frequency_hz=0.5),
    }
}


def drawn(*shape: int, seed: int = 0) -> np.ndarray:
    return (np.random.default_rng(seed).normal(size=(*shape, 2)) @ [1.0, 1j]).astype(np.complex64)


@pytest.mark.parametrize("track", ["squinted", "bistatic", *MORE])
def test_the_adjoint_has_the_inner_products_of_the_map(track: str, device: str) -> None:
    """<F a, s> = <a, F^H s>, to what float32 sums of 1e5 samples keep."""
    planned = plan(collection={"resolution_m": (1.0, 1.0), **{**TRACKS, **MORE}[track]})
    place = np.random.default_rng(1).uniform(-14.0, 14.0, (50, 3))
    amplitude, samples = drawn(50), drawn(planned.frequencies, len(planned.track), seed=2)
    one = PhaseHistoryMap(planned, place, device)
    there, back = one.forward(amplitude), one.adjoint(samples)
    left, right = np.vdot(samples.astype(complex), there), np.vdot(back.astype(complex), amplitude)
    assert abs(left - right) < 2e-6 * np.linalg.norm(there) * np.linalg.norm(samples)


def test_the_adjoint_is_the_sum_over_samples(device: str) -> None:
    """In float64, by the definition, to -80 dB of the largest."""
    planned = plan(collection={"resolution_m": (1.0, 1.0)})
    place, samples = (
        np.random.default_rng(1).uniform(-14.0, 14.0, (5, 3)),
        drawn(planned.frequencies, len(planned.track)),
    )
    wanted = [np.vdot(summed(planned, one[None], np.ones(1)), samples) for one in place]
    found = PhaseHistoryMap(planned, place, device).adjoint(samples)
    assert np.abs(found - wanted).max() < 1e-4 * np.linalg.norm(samples)


def test_the_map_is_the_adjoint_of_backprojection() -> None:
    """<B s, g> = <s, B^H g> with the backprojection of `warpsar.measured`, whose tapers weigh samples; it interpolates
    range profiles, which costs 6e-4 of the edge of the band."""
    planned = plan(collection={"resolution_m": (1.0, 1.0)})
    place, values = np.random.default_rng(1).uniform(-10.0, 10.0, (40, 3)), drawn(40)
    samples = drawn(1, planned.frequencies, len(planned.track), seed=2)
    made = Collected(planned, ("HH",), samples, 0, 0.0)
    tapers = {"window_range": "taylor", "window_azimuth": "taylor"}
    (image,) = focus(made.history("HH"), place, reference_point_m=np.zeros(3), **tapers, device="cpu")
    band, pulses = band_weights("taylor", planned.frequencies), planned.azimuth_taper
    weights = np.outer(band / band.sum(), pulses / pulses.sum())
    left = np.vdot(image.astype(complex), values)
    back = weights * PhaseHistoryMap(planned, place, "cpu").forward(values)
    right = np.vdot(samples[0].astype(complex), back)
    assert abs(left - right) < 1e-3 * np.linalg.norm(samples) * np.linalg.norm(back)


def test_points_and_samples_of_other_shapes_are_refused() -> None:
    planned = plan(collection={"resolution_m": (1.0, 1.0)})
    with pytest.raises(warpsar.InputError, match=r"points_m: found the shape \(2,\)"):
        PhaseHistoryMap(planned, [0.0, 1.0])
    one = PhaseHistoryMap(planned, np.zeros((2, 3)), "cpu")
    with pytest.raises(warpsar.InputError, match="amplitude: found the shape"):
        one.forward(np.ones(3))
    with pytest.raises(warpsar.InputError, match="samples: found the shape"):
        one.adjoint(np.ones((3, 3)))
