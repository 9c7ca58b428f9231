"""Levels of the library's surfaces: by band, and beside published means.

    python benchmarks/levels.py [--write]

Levels are computed by the surfaces' own models. Published means are those of `warpsar.world.library.clutter`, and Oh's
model of measured bare soils at the permittivity and roughness of asphalt.
"""

from __future__ import annotations

import numpy as np
import tables

from warpsar.simulation.materials import levels, sigma0_db
from warpsar.world.library import clutter
from warpsar.world.library.fill import material
from warpsar.world.library.surfaces import BANDS_HZ, SURFACES

DEG = (20.0, 30.0, 40.0, 50.0, 60.0)
AT = DEG.index(40.0)
Channels = dict[str, np.ndarray]


def by_band() -> str:
    """HH, VV - HH and HV - HH at 40 deg of every surface."""
    rows = []
    for name, one in SURFACES.items():
        cells = []
        for found in levels(name).values():
            hh, vv, hv = (found[channel][1] for channel in ("HH", "VV", "HV"))
            cells.append(f"{hh:.1f} / {vv - hh:+.1f} / {hv - hh:+.1f}")
        rows.append([f"`{name}`", *cells, f"{one.spread_db:g}"])
    return tables.markdown(["HH / VV - HH / HV - HH [dB]", *BANDS_HZ, "spread_db"], rows)


def published(name: str, band: str) -> dict[str, Channels]:
    """Published means beside a surface, by source and channel."""
    angles, found = np.array(DEG), {}
    cover, _gamma = clutter.BESIDE.get(name, (None, None))
    if cover is not None and band in clutter.HANDBOOK_GHZ:
        found["handbook"] = {one: clutter.handbook_db(band, cover, one, angles) for one in ("HH", "VV", "HV")}
    if name in clutter.SEA:
        state, wind = clutter.SEA[name]
        found[f"NRL, sea state {state}"] = {
            one: clutter.sea_db(state, one, BANDS_HZ[band], angles) for one in ("HH", "VV")
        }
        if band == "C":
            found[f"CMOD5.N, {wind:g} m/s"] = {"VV": clutter.cmod5n_db(wind, angles)}
    if name in ("asphalt", "concrete") and band in ("X", "Ku"):  # below kh is outside of Oh's domain
        soil = material(name, BANDS_HZ[band], model="oh")
        found["Oh 2004"] = {one: sigma0_db(soil, one, BANDS_HZ[band], angles) for one in ("HH", "VV", "HV")}
    return found


def beside() -> str:
    """Library less published: the range from 20 to 60 deg in each channel, and VV - HH at 40 deg of both."""
    rows = []
    for name in SURFACES:
        own = levels(name, DEG)
        for band in BANDS_HZ:
            for source, means in published(name, band).items():
                ranges = []
                for channel in ("HH", "VV", "HV"):
                    off = own[band][channel] - means.get(channel, np.full(len(DEG), np.nan))
                    ranges.append(f"{np.nanmin(off):+.1f} to {np.nanmax(off):+.1f}" if np.isfinite(off).any() else "")
                apart = f"{own[band]['VV'][AT] - own[band]['HH'][AT]:.1f}"
                if {"HH", "VV"} <= means.keys():
                    apart += f" ({means['VV'][AT] - means['HH'][AT]:.1f})"
                middle = [own[band][one][AT] - means[one][AT] for one in ("HH", "VV") if one in means]
                within = "yes" if max(map(abs, middle)) <= SURFACES[name].spread_db else "no"  # of C to Ku band
                rows.append([f"`{name}`", band, source, *ranges, within, apart])
    head = ["surface", "band", "published", "HH [dB]", "VV [dB]", "HV [dB]"]
    head += ["HH, VV at 40° within spread_db", "VV - HH at 40° (published)"]
    return tables.markdown(head, rows)


def choices() -> str:
    rows = [[f"`{name}`", one.choice, one.published or "none that we could read"] for name, one in SURFACES.items()]
    return tables.markdown(["surface", "our choice", "published levels beside it"], rows)


def main() -> None:
    parser = tables.parser(__doc__, stored=False)
    given = parser.parse_args()
    made = {"levels": by_band(), "published": beside(), "choices": choices()}
    tables.publish({f"materials.{name}": text for name, text in made.items()}, {"made": tables.made()}, given.write)


if __name__ == "__main__":
    main()
