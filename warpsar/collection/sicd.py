"""SICD 1.3.0 (NGA.STND.0024) of a complex image, written with sarkit.

The grid is of the type PLANE: each pixel is a place of the image's plane, onto which the phase history was
backprojected. Its projection into the world is then the standard's own, whatever the track.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.collection.plan import plan_axes
from warpsar.collection.response import band_weights
from warpsar.collection.slc import Slc
from warpsar.errors import InputError
from warpsar.io.images import replacing
from warpsar.measured.declared import half_power_width
from warpsar.measured.earth import ecef_to_geodetic
from warpsar.measured.focus import TAYLOR_NBAR, TAYLOR_SIDELOBE_DB
from warpsar.version import __version__
from warpsar.world.frame import SPEED_OF_LIGHT

NAMESPACE = "urn:SICD:1.3.0"
"""The newest that sarpy 2.1 knows; nothing that is written here is of a newer one."""
START = "2026-01-01T00:00:00"
"""A simulated collection has no date of its own."""
_ORDER = 4
"""Of the polynomial of the track: a circle of a few degrees to a micrometre."""
WINDOWS: dict[str, dict[str, Any]] = {
    "none": {"WindowName": "UNIFORM"},
    "hann": {"WindowName": "HANNING"},
    "taylor": {"WindowName": "TAYLOR", "Parameter": [("NBAR", f"{TAYLOR_NBAR}"), ("SLL", f"-{TAYLOR_SIDELOBE_DB}")]},
    "unknown": {"WindowName": "UNKNOWN"},
}
"""What the standard calls them."""
_WEIGHTS = 512
"""Of an aperture, as the standard recommends."""
F64 = NDArray[np.float64]
FAINT = 0.02
"""Share of the strongest weight under which pulses do not count for the width of the aperture."""


def write(path: Path, made: Slc, polarization: str) -> None:
    """The file, whole or not at all. Raises InputError where sarkit is missing."""
    try:
        import lxml.etree
        import sarkit.sicd as sarkit_sicd
    except ImportError as error:
        raise InputError(f'{path}: SICD needs sarkit: pip install "warpsar[sicd]"') from error
    root = lxml.etree.Element(f"{{{NAMESPACE}}}SICD", nsmap={None: NAMESPACE})
    tables = sarkit_sicd.ElementWrapper(root, _schema())
    plan, image = made.plan, made.images[polarization]
    for name, table in _tables(made, polarization).items():
        tables[name] = table
    tables["SCPCOA"] = sarkit_sicd.compute_scp_coa(root.getroottree())
    area = plan.response_m2
    graze, slope = (float(root.findtext(f"{{*}}SCPCOA/{{*}}{name}")) for name in ("GrazeAng", "SlopeAng"))
    tables["Radiometric"] = {
        "RCSSFPoly": np.full((1, 1), area),
        "SigmaZeroSFPoly": np.full((1, 1), np.cos(np.deg2rad(slope))),
        "BetaZeroSFPoly": np.ones((1, 1)),
        "GammaZeroSFPoly": np.full((1, 1), np.cos(np.deg2rad(slope)) / np.sin(np.deg2rad(graze))),
    }
    security: Any = {"security": {"clas": "U"}}
    made_by: Any = {"ostaid": "warpsar", **security}
    source: Any = {"isorce": "warpsar", **security}
    metadata = sarkit_sicd.NitfMetadata(
        xmltree=root.getroottree(),
        file_header_part=made_by,
        im_subheader_part=source,
        de_subheader_part=security,
    )
    with replacing(path) as temporary, temporary.open("wb") as file, sarkit_sicd.NitfWriter(file, metadata) as writer:
        writer.write_image(np.ascontiguousarray(image))


@cache
def _schema() -> Any:
    """What sarkit knows of the standard's elements, read once: by itself it reads it anew for every element."""
    import sarkit.sicd as sarkit_sicd

    found: Any = sarkit_sicd.XsdHelper(NAMESPACE)
    found.get_transcoder = cache(found.get_transcoder)
    return found


def _tables(made: Slc, polarization: str) -> dict[str, Any]:
    """What was collected, what the pixels are and where they lie."""
    plan, image = made.plan, made.images[polarization]
    low, high = plan.start_hz, plan.start_hz + (plan.frequencies - 1) * plan.step_hz
    times = plan.track.time_s - plan.track.time_s[0]
    label = f"{polarization[0]}:{polarization[1]}"
    return {
        "CollectionInfo": {
            "CollectorName": f"warpsar {__version__}",
            "CoreName": plan.view.name,
            "CollectType": "BISTATIC" if plan.track.bistatic else "MONOSTATIC",
            "RadarMode": {"ModeType": "STRIPMAP" if plan.stripmap else "SPOTLIGHT"},
            "Classification": "UNCLASSIFIED",
        },
        "ImageCreation": {"Application": f"warpsar {__version__}"},
        "ImageData": _image_data(image),
        "GeoData": {
            "EarthModel": "WGS_84",
            "SCP": {"ECF": _centre(made), "LLH": ecef_to_geodetic(_centre(made))},
            "ImageCorners": _corners(made),
        },
        "Grid": _grid(made, 0.5 * float(times[-1])),
        "Timeline": {"CollectStart": np.datetime64(START).astype(object), "CollectDuration": float(times[-1])},
        "Position": {"ARPPoly": _polynomial(made, times)},
        "RadarCollection": {
            "TxFrequency": {"Min": low, "Max": high},
            "TxPolarization": polarization[0],
            "RcvChannels": {"@size": 1, "ChanParameters": [{"@index": 1, "TxRcvPolarization": label}]},
        },
        "ImageFormation": {
            "RcvChanProc": {"NumChanProc": 1, "ChanIndex": [1]},
            "TxRcvPolarizationProc": label,
            "TStartProc": 0.0,
            "TEndProc": float(times[-1]),
            "TxFrequencyProc": {"MinProc": low, "MaxProc": high},
            "ImageFormAlgo": "OTHER",
            "STBeamComp": "NO",
            "ImageBeamComp": "NO",
            "AzAutofocus": "NO",
            "RgAutofocus": "NO",
        },
    }


def _image_data(image: NDArray[np.complex64]) -> dict[str, Any]:
    rows, columns = image.shape
    return {
        "PixelType": "RE32F_IM32F",
        "NumRows": rows,
        "NumCols": columns,
        "FirstRow": 0,
        "FirstCol": 0,
        "FullImage": {"NumRows": rows, "NumCols": columns},
        "SCPPixel": [rows // 2, columns // 2],
    }


def _place(made: Slc, row: int, column: int) -> NDArray[np.float64]:
    """A pixel, earth-centred, (3,) [m]."""
    along, across = plan_axes(made.plan)
    return made.plan.site.to_ecef(made.range_m[row] * along + made.azimuth_m[column] * across)


def _centre(made: Slc) -> NDArray[np.float64]:
    """The scene centre point: a pixel's, half a pixel from the reference point where their number is even."""
    return _place(made, len(made.range_m) // 2, len(made.azimuth_m) // 2)


def _corners(made: Slc) -> NDArray[np.float64]:
    """Latitude and longitude of the corners, (4, 2), cast along the slant plane's normal onto the level plane."""
    plan = made.plan
    centre = plan.track.centre()
    normal = np.cross(plan.track.velocity_m_s()[0][plan.middle], centre.towards()[0])
    along, across = plan_axes(plan)
    found = []
    for row, column in ((0, 0), (0, -1), (-1, -1), (-1, 0)):
        place = made.range_m[row] * along + made.azimuth_m[column] * across
        level = place - place[2] / normal[2] * normal
        found.append(ecef_to_geodetic(plan.site.to_ecef(level))[:2])
    return np.array(found)


def _grid(made: Slc, centre_s: float) -> dict[str, Any]:
    plan = made.plan
    along, across = plan_axes(plan)
    steep = float(-along @ plan.geometry.s)
    carrier = 2.0 * plan.centre_hz / SPEED_OF_LIGHT
    band: F64 = 2.0 * plan.step_hz / SPEED_OF_LIGHT * steep * np.arange(plan.frequencies, dtype=np.float64)
    aperture: F64 = carrier * (plan.track.towards() @ plan.geometry.u)
    used = plan.azimuth_weights > FAINT * plan.azimuth_weights.max()  # of a beam: its main lobe
    rows = _axis(band, band_weights(plan.windows[0], plan.frequencies), made.range_m)
    columns = _axis(aperture[used], plan.azimuth_weights[used], made.azimuth_m)
    beamed = np.ptp(plan.beam_gain) > 1e-3  # the beam tapers the aperture, too: no window has that name
    for axis, vector, centre, window in (
        (rows, along, carrier * steep, plan.windows[0]),
        (columns, across, 0.0, "unknown" if beamed else plan.windows[1]),
    ):
        axis |= {"UVectECF": vector @ plan.site.axes, "KCtr": centre, "WgtType": WINDOWS[window]}
        if window == "none":
            del axis["WgtFunct"]
    coefficients = np.full((1, 1), centre_s)
    if plan.stripmap and plan.track.straight is not None:  # each column has its own centre of aperture
        rate = float(across @ plan.track.straight) / float(np.linalg.norm(plan.track.velocity_m_s()[0][plan.middle]))
        coefficients = np.array([[centre_s + rate * made.azimuth_m[len(made.azimuth_m) // 2], rate]])
    return {
        "ImagePlane": "GROUND" if plan.ground else "SLANT",
        "Type": "PLANE",
        "TimeCOAPoly": coefficients,
        "Row": rows,
        "Col": columns,
    }


def _axis(at: F64, weight: F64, places_m: F64) -> dict[str, Any]:
    """One direction of the grid, with its samples at spatial frequencies `at` [1/m]."""
    step = float(places_m[1] - places_m[0])
    width = float(np.ptp(at)) * len(at) / (len(at) - 1)
    half = min(0.5 * width, 0.5 / step)
    order = np.argsort(at)
    middles = 0.5 * (at.min() + at.max()) + ((np.arange(_WEIGHTS) + 0.5) / _WEIGHTS - 0.5) * width
    return {
        "SS": step,
        "ImpRespWid": half_power_width(at, weight),
        "Sgn": -1,
        "ImpRespBW": 2.0 * half,
        "DeltaK1": -half,
        "DeltaK2": half,
        "DeltaKCOAPoly": np.zeros((1, 1)),
        "WgtFunct": np.interp(middles, at[order], weight[order]) / weight.max(),
    }


def _polynomial(made: Slc, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coefficients of the track in time, (order, 3), earth-centred; halfway between two antennas."""
    plan = made.plan
    place = plan.site.to_ecef(0.5 * (plan.track.receiver_m + plan.track.transmitter_m))
    order = 1 if plan.track.straight is not None else min(_ORDER, len(times) - 1)
    if order == 1:
        velocity = (place[-1] - place[0]) / (times[-1] - times[0])
        return np.stack([place[0], velocity])
    scale = times[-1]
    fitted = np.polynomial.polynomial.polyfit(times / scale, place - place[0], order)
    return fitted / scale ** np.arange(order + 1)[:, None] + np.eye(order + 1)[:, :1] * place[0]
