"""SICD with a grid of range and zero Doppler, written by sarkit alone, with the orbit of `product_files`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from measured_files import C
from product_files import DAY, SITE, Band, earth_fixed, ground_speed, nearest, place

NAMESPACE = "urn:SICD:1.3.0"
LASTS = 3.0


def write_rgzero(folder: Path, image: np.ndarray, beta_factor: float = 1.0, **changed: Any) -> Path:
    """By sarkit alone: rows of slant range, columns of zero-Doppler time, the orbit of `product_files`."""
    import lxml.etree
    import sarkit.sicd as sarkit_sicd
    from sarkit import wgs84

    band = Band()
    start, near = band.start()
    begins = start - 1.0
    at = np.linspace(0.0, LASTS, 31)
    track = np.polynomial.polynomial.polyfit(at, place(begins + at), 5)
    row, column = (int(each) for each in band.centre[::-1])
    column_m = ground_speed() * band.line_s
    centre = earth_fixed(SITE)
    root = lxml.etree.Element(f"{{{NAMESPACE}}}SICD", nsmap={None: NAMESPACE})
    tables = sarkit_sicd.ElementWrapper(root)
    shape = image.T.shape
    ahead = (place(begins + 1.01) - place(begins + 0.99)) / np.linalg.norm(place(begins + 1.01) - place(begins + 0.99))
    away = centre - place(nearest(SITE)[0])
    away /= np.linalg.norm(away)
    axis = {"Sgn": -1, "KCtr": 0.0, "DeltaKCOAPoly": np.zeros((1, 1)), "WgtType": {"WindowName": "UNIFORM"}}
    bandwidths = 2 * band.range_hz / C, band.azimuth_hz / ground_speed()
    axes = [
        axis | {"UVectECF": vector, "SS": step, "ImpRespWid": 0.886 / wide, "ImpRespBW": wide, "DeltaK1": -wide / 2,
                "DeltaK2": wide / 2}
        for vector, step, wide in zip((away, ahead), (band.step_m, column_m), bandwidths, strict=True)
    ]  # fmt: skip
    begun = np.datetime64(f"{DAY}T12:00:00", "us") + np.timedelta64(round(begins * 1e6), "us")
    closest = np.array([start + column * band.line_s - begins, band.line_s / column_m])
    for name, table in {
        "CollectionInfo": {"CollectorName": "made", "CoreName": "made", "CollectType": "MONOSTATIC",
                           "RadarMode": {"ModeType": "STRIPMAP"}, "Classification": "UNCLASSIFIED"},
        "ImageData": {"PixelType": "RE32F_IM32F", "NumRows": shape[0], "NumCols": shape[1], "FirstRow": 0,
                      "FirstCol": 0, "FullImage": {"NumRows": shape[0], "NumCols": shape[1]},
                      "SCPPixel": [row, column]},
        "GeoData": {"EarthModel": "WGS_84", "SCP": {"ECF": centre, "LLH": wgs84.cartesian_to_geodetic(centre)},
                    "ImageCorners": np.array(SITE[:2]) + np.array([[1, -1], [1, 1], [-1, 1], [-1, -1]]) * 3e-3},
        "Grid": {"ImagePlane": "SLANT", "Type": "RGZERO", "TimeCOAPoly": closest[None],
                 "Row": axes[0], "Col": axes[1]},
        "Timeline": {"CollectStart": begun.astype(object), "CollectDuration": LASTS},
        "Position": {"ARPPoly": track},
        "RadarCollection": {"TxFrequency": {"Min": 5.38e9, "Max": 5.43e9}, "TxPolarization": "V",
                            "RcvChannels": {"@size": 1, "ChanParameters": [{"@index": 1, "TxRcvPolarization": "V:V"}]}},
        "ImageFormation": {"TxRcvPolarizationProc": "V:V", "TxFrequencyProc": {"MinProc": 5.38e9, "MaxProc": 5.43e9}},
        "RMA": {"RMAlgoType": "OMEGA_K", "ImageType": "INCA", "INCA": {
            # The pixel that is the scene's centre, a fraction beside the site.
            "TimeCAPoly": closest,
            "R_CA_SCP": near + row * band.step_m, "FreqZero": 5.405e9, "DRateSFPoly": np.ones((1, 1))}},
        "Radiometric": {"NoiseLevel": {"NoiseLevelType": "ABSOLUTE", "NoisePoly": np.full((1, 1), -20.0)},
                        "BetaZeroSFPoly": np.full((1, 1), beta_factor)},
    }.items():  # fmt: skip
        tables[name] = table
    tables["SCPCOA"] = sarkit_sicd.compute_scp_coa(root.getroottree())
    for name, value in changed.items():
        next(root.iter(f"{{*}}{name}")).text = value
    security: Any = {"security": {"clas": "U"}}
    metadata = sarkit_sicd.NitfMetadata(
        xmltree=root.getroottree(), file_header_part={"ostaid": "made", **security},
        im_subheader_part={"isorce": "made", **security}, de_subheader_part=security,
    )  # fmt: skip
    path = folder / "made.nitf"
    with path.open("wb") as file, sarkit_sicd.NitfWriter(file, metadata) as writer:
        writer.write_image(np.ascontiguousarray(image.T))
    return path
