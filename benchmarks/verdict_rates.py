"""How often the judgement calls speckle alone something else, white and blurred speckle.

python benchmarks/verdict_rates.py --repeats 50
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.ndimage import gaussian_filter

from warpsar.compare.comparison import LEVEL_SHARE, Comparison
from warpsar.compare.judgement import judge
from warpsar.compare.observation import Observation
from warpsar.world.tables import View

SIDE, IMAGES = 40, 3
LOOKS = (1.0, 4.0, 16.0)
BLURS = (0.0, 0.7, 1.2)  # pixels, standard deviation of the field's


def speckle(random: np.random.Generator, looks: float, blur: float) -> np.ndarray:
    """The mean of `looks` intensities of circular Gaussian fields blurred by `blur` pixels: gamma, of mean 1."""
    if blur == 0:
        return random.gamma(looks, 1.0 / looks, (SIDE, SIDE))
    total = np.zeros((SIDE + 40, SIDE + 40))
    impulse = np.zeros(total.shape)
    impulse[0, 0] = 1.0
    power = 2.0 * (gaussian_filter(impulse, blur, mode="wrap") ** 2).sum()
    for _ in range(int(looks)):
        fields = [gaussian_filter(part, blur, mode="wrap") for part in random.normal(size=(2, *total.shape))]
        total += (np.stack(fields) ** 2).sum(axis=0) / power
    return total[20:-20, 20:-20] / looks


def alarms(looks: float, blur: float, repeats: int) -> int:
    """How many of `repeats` scenes of speckle about the true model get another finding than speckle."""
    rows, cols = np.mgrid[:SIDE, :SIDE]
    inside = (rows > 2) & (rows < SIDE - 3) & (cols > 2) & (cols < SIDE - 3)
    shadow = (np.abs(cols - SIDE // 2) < 5) & (rows > SIDE // 3) & (rows < 2 * SIDE // 3)
    interior, nowhere = inside & ~shadow, np.zeros((SIDE, SIDE), bool)
    modelled = np.where(shadow, 0.0, np.where(cols > SIDE / 2, 0.1, 0.02))
    found = 0
    for repeat in range(repeats):
        random = np.random.default_rng([repeat, int(looks), int(10 * blur)])
        images = []
        for k in range(IMAGES):
            view = View(name=f"v{k}", azimuth_deg=0.0, incidence_deg=40.0)
            measured = modelled * speckle(random, looks, blur)
            seen = Observation(view, "HH", measured, interior, nowhere, nowhere, looks, False)
            images.append(
                Comparison(
                    seen=seen,
                    simulated=modelled,
                    gain=1.0,
                    level=LEVEL_SHARE * float(np.median(modelled[interior])),
                    usable=inside,
                    slopes=np.zeros((2, SIDE, SIDE)),
                    moves=np.zeros((0, SIDE, SIDE)),
                    exact=True,
                    reach_px=(0.1, 0.1),
                    smeared=1.0,
                    by_rays=np.zeros((SIDE, SIDE)),
                    sampling_noise=0.0,
                    incidence_deg=np.full((SIDE, SIDE), 40.0),
                    material=np.zeros((SIDE, SIDE), int),
                    start_m=(0.0, 0.0),
                    spacing_m=(0.5, 0.5),
                )
            )
        found += judge(images).finding != "speckle"
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=50, help="scenes of each kind")
    repeats = parser.parse_args().repeats
    for blur in BLURS:
        for looks in LOOKS:
            print(f"blur {blur:g} pixels, {looks:g} looks: {alarms(looks, blur, repeats)} of {repeats}", flush=True)


if __name__ == "__main__":
    main()
