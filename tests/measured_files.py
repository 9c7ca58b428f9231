"""Measured files made for tests with other people's writers: SICD and CPHD by sarkit, AFRL .mat by scipy.

Earth coordinates come from sarkit's own WGS 84, so that nothing of the project's geometry is checked against itself.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

C = 299792458.0
SITE = np.array([40.0, -84.0, 230.0])  # latitude, longitude [deg], height [m]


@dataclass(frozen=True)
class Pass:
    """A straight, level, broadside pass: directions as in docs/reference/scene-file.md, its middle at `azimuth_deg`."""

    azimuth_deg: float = 60.0
    incidence_deg: float = 40.0
    slant_range_m: float = 700e3
    frequency_hz: float = 9.6e9
    speed_m_s: float = 7500.0
    left: bool = False

    @property
    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Toward the radar, and azimuth, in east, north, up."""
        a, i = np.deg2rad([self.azimuth_deg, self.incidence_deg])
        return np.array([np.sin(a) * np.sin(i), np.cos(a) * np.sin(i), np.cos(i)]), np.array(
            [np.cos(a), -np.sin(a), 0.0]
        )

    def position(self, along_m: np.ndarray) -> np.ndarray:
        """Antenna positions in east, north, up of the site, (n, 3)."""
        s, u = self.axes
        return self.slant_range_m * s + np.asarray(along_m)[:, None] * u


def enu_axes() -> np.ndarray:
    from sarkit import wgs84

    return np.stack([wgs84.east(SITE), wgs84.north(SITE), wgs84.up(SITE)])


def to_ecef(enu: np.ndarray) -> np.ndarray:
    from sarkit import wgs84

    return enu @ enu_axes() + wgs84.geodetic_to_cartesian(SITE)


def echoes(
    positions: np.ndarray, frequency_hz: np.ndarray, points: np.ndarray, amplitude: np.ndarray, centre: np.ndarray
) -> np.ndarray:
    """Samples (frequency, pulse) of point scatterers: exp(-j 4 pi f (|p - q| - |p - centre|) / c), summed."""
    reference = np.linalg.norm(positions - centre, axis=1)
    samples = np.zeros((frequency_hz.size, positions.shape[0]), complex)
    for q, a in zip(points, amplitude, strict=True):
        dr = np.linalg.norm(positions - q, axis=1) - reference
        samples += a * np.exp(-4j * np.pi / C * frequency_hz[:, None] * dr[None, :])
    return samples


def write_mat(
    path: Path, samples: np.ndarray, frequency_hz: np.ndarray, positions: np.ndarray, **extra: object
) -> Path:
    from scipy.io import savemat

    x, y, z = positions.T[:, None, :]
    data = {
        "fp": samples.astype(np.complex64),
        "freq": frequency_hz[:, None],
        "x": x,
        "y": y,
        "z": z,
        "r0": np.linalg.norm(positions, axis=1)[None, :],
        **extra,
    }
    savemat(path, {"data": data})
    return path


def write_phoenix(path: Path, magnitude: np.ndarray, phase: np.ndarray, **changed: str) -> Path:
    fields = {
        "NumberOfColumns": str(magnitude.shape[1]),
        "NumberOfRows": str(magnitude.shape[0]),
        "native_header_length": "0",
        "TargetAz": "30.0",
        "MeasuredDepression": "50.0",
        "RadarPosition": "top",
        "CenterFrequency": "9.600000 GHz",
        "RangePixelSpacing": "0.5",
        "CrossRangePixelSpacing": "0.5",
        "Polarization": "HH",
    } | changed
    body = "".join(f"{key}= {value}\n" for key, value in fields.items()) + "[EndofPhoenixHeader]\n"
    head = "[PhoenixHeaderVer01.04]\n"
    length = len(head) + len("PhoenixHeaderLength= 00000\n") + len(body)
    header = f"{head}PhoenixHeaderLength= {length:05d}\n{body}"
    values = np.stack([magnitude, phase]).astype(">f4")
    path.write_bytes(header.encode() + values.tobytes())
    return path


def write_sicd(path: Path, image: np.ndarray, spacing_m: tuple[float, float], look: Pass, beta0_scale: float) -> Path:
    """A complex image of odd shape, its middle pixel the scene centre point, in range-azimuth compression geometry."""
    import lxml.etree
    import sarkit.sicd as sarkit_sicd
    from sarkit import wgs84

    rows, cols = image.shape
    scp = wgs84.geodetic_to_cartesian(SITE)
    duration = 1.0
    s, u = look.axes
    # Flying along +u, with the radar at +s, the scene lies to the right of the track.
    velocity = look.speed_m_s * (-u if look.left else u)
    arp = look.slant_range_m * s - velocity * duration / 2
    poly = np.stack([to_ecef(arp), velocity @ enu_axes()])
    row = {"Sgn": -1, "SS": spacing_m[0], "ImpRespBW": 0.8 / spacing_m[0], "KCtr": 2 * look.frequency_hz / C}
    col = {"Sgn": -1, "SS": spacing_m[1], "ImpRespBW": 0.8 / spacing_m[1], "KCtr": 0.0}
    for axis, direction in ((row, -s), (col, u)):
        axis["UVectECF"] = direction @ enu_axes()
        axis["ImpRespWid"] = 0.886 / axis["ImpRespBW"]
        axis["DeltaK1"], axis["DeltaK2"] = -axis["ImpRespBW"] / 2, axis["ImpRespBW"] / 2
        axis["DeltaKCOAPoly"] = np.zeros((1, 1))
    half_band = row["ImpRespBW"] * C / 4
    band = (look.frequency_hz - half_band, look.frequency_hz + half_band)
    r, a = (rows // 2) * spacing_m[0], (cols // 2) * spacing_m[1]
    outward = [-s @ [0, 0, 1], -s[:2] / np.hypot(*s[:2])]
    ground = np.append(outward[1], 0.0) / np.sin(np.deg2rad(look.incidence_deg))
    corners = [
        wgs84.cartesian_to_geodetic(to_ecef(i * r * ground + j * a * u))[:2]
        for i, j in ((-1, -1), (-1, 1), (1, 1), (1, -1))
    ]
    root = lxml.etree.Element("{urn:SICD:1.4.0}SICD", nsmap={None: "urn:SICD:1.4.0"})
    sicd = sarkit_sicd.ElementWrapper(root)
    sicd["CollectionInfo"] = {
        "CollectorName": "made",
        "CoreName": "made",
        "CollectType": "MONOSTATIC",
        "RadarMode": {"ModeType": "SPOTLIGHT"},
        "Classification": "UNCLASSIFIED",
    }
    sicd["ImageData"] = {
        "PixelType": "RE32F_IM32F",
        "NumRows": rows,
        "NumCols": cols,
        "FirstRow": 0,
        "FirstCol": 0,
        "FullImage": {"NumRows": rows, "NumCols": cols},
        "SCPPixel": [rows // 2, cols // 2],
    }
    sicd["GeoData"] = {"EarthModel": "WGS_84", "SCP": {"ECF": scp, "LLH": SITE}, "ImageCorners": np.array(corners)}
    sicd["Grid"] = {
        "ImagePlane": "SLANT",
        "Type": "RGAZIM",
        "TimeCOAPoly": np.full((1, 1), duration / 2),
        "Row": row,
        "Col": col,
    }
    start = np.datetime64("2024-01-01T00:00:00")
    sicd["Timeline"] = {"CollectStart": start.astype(object), "CollectDuration": duration}
    sicd["Position"] = {"ARPPoly": poly}
    sicd["RadarCollection"] = {
        "TxFrequency": {"Min": band[0], "Max": band[1]},
        "TxPolarization": "V",
        "RcvChannels": {"@size": 1, "ChanParameters": [{"@index": 1, "TxRcvPolarization": "V:V"}]},
    }
    sicd["ImageFormation"] = {
        "RcvChanProc": {"NumChanProc": 1, "ChanIndex": [1]},
        "TxRcvPolarizationProc": "V:V",
        "TStartProc": 0.0,
        "TEndProc": duration,
        "TxFrequencyProc": {"MinProc": band[0], "MaxProc": band[1]},
        "ImageFormAlgo": "RGAZCOMP",
        "STBeamComp": "NO",
        "ImageBeamComp": "NO",
        "AzAutofocus": "NO",
        "RgAutofocus": "NO",
    }
    sicd["SCPCOA"] = sarkit_sicd.compute_scp_coa(root.getroottree())
    sicd["Radiometric"] = {"BetaZeroSFPoly": np.full((1, 1), beta0_scale)}
    side = 1.0 if look.left else -1.0
    sicd["RgAzComp"] = {"AzSF": -side / look.slant_range_m, "KazPoly": np.zeros(2)}
    security = {"security": {"clas": "U"}}
    metadata = sarkit_sicd.NitfMetadata(
        xmltree=root.getroottree(),
        file_header_part={"ostaid": "made", **security},
        im_subheader_part={"isorce": "made", **security},
        de_subheader_part=security,
    )
    with path.open("wb") as file, sarkit_sicd.NitfWriter(file, metadata) as writer:
        writer.write_image(image.astype(np.complex64))
    return path


def write_cphd(
    path: Path,
    samples: np.ndarray,
    frequency_hz: np.ndarray,
    positions: np.ndarray,
    look: Pass,
    *,
    sgn: int = -1,
    bad: tuple[int, ...] = (),
) -> Path:
    """Phase history (frequency, pulse) with antenna positions in east, north, up of the site, which is IARP and SRP."""
    import lxml.etree
    import sarkit.cphd as sarkit_cphd
    from sarkit import wgs84

    count, pulses = samples.shape
    axes = enu_axes()
    iarp = wgs84.geodetic_to_cartesian(SITE)
    time = 0.001 * np.arange(pulses)
    velocity = np.gradient(positions, time, axis=0)
    toa = 0.4 / (frequency_hz[1] - frequency_hz[0])
    namespace = "http://api.nsgreg.nga.mil/schema/cphd/1.1.0"
    root = lxml.etree.Element(f"{{{namespace}}}CPHD", nsmap={None: namespace})
    cphd = sarkit_cphd.ElementWrapper(root)
    cphd["CollectionID"] = {
        "CollectorName": "made",
        "CoreName": "made",
        "CollectType": "MONOSTATIC",
        "RadarMode": {"ModeType": "SPOTLIGHT"},
        "Classification": "UNCLASSIFIED",
        "ReleaseInfo": "UNRESTRICTED",
    }
    low, high = frequency_hz[0], frequency_hz[-1]
    cphd["Global"] = {
        "DomainType": "FX",
        "SGN": sgn,
        "Timeline": {
            "CollectionStart": np.datetime64("2024-01-01T00:00:00").astype(object),
            "TxTime1": time[0],
            "TxTime2": time[-1],
        },
        "FxBand": {"FxMin": low, "FxMax": high},
        "TOASwath": {"TOAMin": -toa, "TOAMax": toa},
    }
    area = {"X1Y1": [-100.0, -100.0], "X2Y2": [100.0, 100.0]}
    corners = [
        wgs84.cartesian_to_geodetic(to_ecef(np.array([x, y, 0.0])))[:2]
        for x, y in ((-100, 100), (100, 100), (100, -100), (-100, -100))
    ]
    cphd["SceneCoordinates"] = {
        "EarthModel": "WGS_84",
        "IARP": {"ECF": iarp, "LLH": SITE},
        "ReferenceSurface": {"Planar": {"uIAX": axes[0], "uIAY": axes[1]}},
        "ImageArea": area,
        "ImageAreaCornerPoints": np.array(corners),
    }
    fields = (
        "TxTime",
        "TxPos",
        "TxVel",
        "RcvTime",
        "RcvPos",
        "RcvVel",
        "SRPPos",
        "aFDOP",
        "aFRR1",
        "aFRR2",
        "FX1",
        "FX2",
    )
    fields += ("TOA1", "TOA2", "TDTropoSRP", "SC0", "SCSS", "SIGNAL")
    layout, offset = {}, 0
    for name in fields:
        size = 3 if name.endswith(("Pos", "Vel")) else 1
        kind = np.dtype("3f8") if size == 3 else np.dtype("i8" if name == "SIGNAL" else "f8")
        layout[name] = {"Offset": offset, "Size": size, "dtype": kind}
        offset += size
    cphd["Data"] = {
        "SignalArrayFormat": "CF8",
        "NumBytesPVP": 8 * offset,
        "NumCPHDChannels": 1,
        "Channel": [
            {
                "Identifier": "1",
                "NumVectors": pulses,
                "NumSamples": count,
                "SignalArrayByteOffset": 0,
                "PVPArrayByteOffset": 0,
            }
        ],
        "NumSupportArrays": 0,
    }
    cphd["Channel"] = {
        "RefChId": "1",
        "FXFixedCPHD": True,
        "TOAFixedCPHD": True,
        "SRPFixedCPHD": True,
        "Parameters": [
            {
                "Identifier": "1",
                "RefVectorIndex": pulses // 2,
                "FXFixed": True,
                "TOAFixed": True,
                "SRPFixed": True,
                "Polarization": {"TxPol": "H", "RcvPol": "H"},
                "FxC": (low + high) / 2,
                "FxBW": high - low,
                "TOASaved": 2 * toa,
                "DwellTimes": {"CODId": "1", "DwellId": "1"},
            }
        ],
    }
    cphd["PVP"] = layout
    middle, dwell = np.full((1, 1), time.mean()), np.full((1, 1), time[-1])
    cphd["Dwell"] = {
        "NumCODTimes": 1,
        "CODTime": [{"Identifier": "1", "CODTimePoly": middle}],
        "NumDwellTimes": 1,
        "DwellTime": [{"Identifier": "1", "DwellTimePoly": dwell}],
    }
    pvp = np.zeros(pulses, sarkit_cphd.get_pvp_dtype(root.getroottree()))
    pvp["TxTime"], pvp["RcvTime"] = time, time + 2 * look.slant_range_m / C
    pvp["TxPos"] = pvp["RcvPos"] = to_ecef(positions)
    pvp["TxVel"] = pvp["RcvVel"] = velocity @ axes
    pvp["SRPPos"] = iarp
    pvp["FX1"], pvp["FX2"], pvp["SC0"], pvp["SCSS"] = low, high, low, frequency_hz[1] - low
    pvp["TOA1"], pvp["TOA2"] = -toa, toa
    pvp["SIGNAL"] = 1
    pvp["SIGNAL"][list(bad)] = 0
    cphd["ReferenceGeometry"] = sarkit_cphd.compute_reference_geometry(root.getroottree(), pvp)
    metadata = sarkit_cphd.Metadata(xmltree=root.getroottree())
    signal = np.ascontiguousarray((samples.conj() if sgn > 0 else samples).T.astype(np.complex64))
    signal[list(bad)] = 1e3  # what a reader must not look at
    with path.open("wb") as file, sarkit_cphd.Writer(file, metadata) as writer:
        writer.write_signal("1", signal)
        writer.write_pvp("1", pvp)
    return path
