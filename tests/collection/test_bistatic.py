"""A transmitter apart from the receiver, and a band so wide that amplitudes change in it: right, said, or refused."""

from __future__ import annotations

import numpy as np
import pytest
from collected_scenes import FREQUENCY, WAVELENGTH, field, scene, square_trihedral

import warpsar
from warpsar.collection.plan import WIDEST_DEG
from warpsar.world.collection import Transmitter

A = 10 * WAVELENGTH
K = 2 * np.pi / WAVELENGTH
AXIS = np.ones(3) / np.sqrt(3)
PEAK = K / (2 * np.pi) * np.sqrt(3) * A**2
"""Amplitude of the corner along its axis: k / 2 pi times its aperture."""


def corner(transmitter: np.ndarray, receiver: np.ndarray) -> np.ndarray:
    """Amplitudes [m] of HH and VV by the program."""
    azimuth, incidence = np.rad2deg([np.arctan2(receiver[0], receiver[1]), np.arccos(receiver[2])])
    collection = {"pulses": 32, "aperture_deg": 0.02, "resolution_m": None, "bandwidth_hz": 1e7}
    made = scene(
        square_trihedral(A),
        material={"conductor": True},
        view={"azimuth_deg": float(azimuth), "incidence_deg": float(incidence)},
        radar={"terms": ("single", "multibounce"), "polarizations": ("HH", "VV")},
        collection={**collection, "transmitter": Transmitter(position_m=tuple(10e3 * transmitter))},
    )
    (found,) = warpsar.phase_history(made, device="cpu")
    samples = np.abs(found.samples[:, found.samples.shape[1] // 2, found.plan.middle])
    return np.asarray(samples / np.sqrt(4 * np.pi))


def by_rays(transmitter: np.ndarray, receiver: np.ndarray, rays: int = 600) -> float:
    """The same from rays of the transmitter itself, three mirrors, and physical optics of the last face."""
    u = np.cross([0.0, 0.0, 1.0], transmitter)
    u /= np.linalg.norm(u)
    v = np.cross(transmitter, u)
    edge = np.linspace(-1.3 * A, 1.3 * A, rays)
    first, second = (each.ravel()[:, None] for each in np.meshgrid(edge, edge))
    place = first * u + second * v + 3 * A * transmitter
    way, alive = np.full(len(place), -3 * A), np.ones(len(place), bool)
    toward = np.broadcast_to(-transmitter, place.shape).copy()
    for _ in range(3):
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = -place / toward
        steps = np.where((steps > 1e-9) & (toward < 0.0), steps, np.inf)
        for axis in range(3):
            met = place + np.where(np.isfinite(steps[:, [axis]]), steps[:, [axis]], 0.0) * toward
            others = np.delete(met, axis, axis=1)
            inside = (others >= -1e-9).all(axis=1) & (others <= A).all(axis=1)
            steps[:, axis] = np.where(inside, steps[:, axis], np.inf)
        face, step = steps.argmin(axis=1), steps.min(axis=1)
        alive &= np.isfinite(step)
        step = np.where(np.isfinite(step), step, 0.0)
        place, way = place + step[:, None] * toward, way + step
        toward[np.arange(len(place)), face] *= -1.0
    normal = np.eye(3)[face]
    leaving = (normal * toward).sum(axis=1)
    oblique = (normal @ receiver + leaving) / (2.0 * leaving)
    field_there = np.exp(-1j * K * (way - place @ receiver)) * oblique
    return float(K / (2 * np.pi) * (edge[1] - edge[0]) ** 2 * abs(field_there[alive].sum()))


@pytest.mark.full
@pytest.mark.parametrize("angle_deg", [1.0, 2.0, 3.0, 5.0, 8.0, 11.5])
def test_a_corner_fades_as_the_receiver_leaves_its_beam(angle_deg: float) -> None:
    """To 5 % of its peak: rays of the antenna between enter at other places than those of the transmitter. It was the
    peak itself, at every angle."""
    half, across = np.deg2rad(angle_deg) / 2, np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0)
    sent, received = (np.cos(half) * AXIS + sign * np.sin(half) * across for sign in (1.0, -1.0))
    expected = by_rays(sent, received)
    assert expected < 0.95 * PEAK
    assert np.abs(corner(sent, received) - expected).max() < 0.05 * PEAK


def test_antennas_far_apart_are_refused() -> None:
    def made(angle_deg: float) -> warpsar.Scene:
        tilt = np.deg2rad(40.0 + angle_deg)  # in the plane of incidence of the view
        azimuth = np.deg2rad(30.0)
        place = 10e3 * np.array([np.sin(azimuth) * np.sin(tilt), np.cos(azimuth) * np.sin(tilt), np.cos(tilt)])
        collection = {"transmitter": Transmitter(position_m=tuple(place)), "resolution_m": (1.0, 1.0)}
        return scene(field(6.0, 6.0), collection=collection, shape=(16, 16), spacing=(0.5, 0.5))

    assert warpsar.slc(made(WIDEST_DEG - 0.5), device="cpu")
    for product in (warpsar.slc, warpsar.phase_history):
        message = r"transmitter: found the transmitter 20\S* degrees from the receiver.*must be at most 12"
        with pytest.raises(warpsar.InputError, match=message):
            product(made(20.0), device="cpu")


def test_a_wide_band_says_what_its_middle_hides(capsys: pytest.CaptureFixture[str]) -> None:
    """A flat conductor sends back in proportion to the frequency: 20 log10(1 - 0.31) at the lower end."""

    def said(share: float, **more: object) -> str:
        collection = {"bandwidth_hz": share * FREQUENCY, "resolution_m": None, "aperture_deg": 2.0}
        made = scene(field(1.0, 1.0), collection=collection, shape=(16, 16), spacing=(0.1, 0.1), **more)
        warpsar.phase_history(made, device="cpu")
        return capsys.readouterr().err

    smooth = {"material": {"conductor": True}, "radar": {"terms": ("single",)}}
    assert "a band of 62 % of its middle frequency" in said(0.62, **smooth)
    assert f"up to {-20 * np.log10(1 - 0.31):.2g} dB" in said(0.62, **smooth)
    assert "wrong by up to" in said(0.62)
    assert "wrong by up to" not in said(0.04)
