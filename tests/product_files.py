"""Radar products with a satellite's orbit, made for tests: Sentinel-1 SAFE, GAMMA, NISAR, Capella.

The orbit is a circle in space over a turning earth, in closed form, and zero Doppler is found here by minimizing the
distance, so that nothing of the project's geometry is checked against itself.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from measured_files import C
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

EARTH_TURN = 7.2921159e-5  # [rad/s]
RADIUS, INCLINATION = 7.071e6, np.deg2rad(98.18)
PERIOD_S = 5924.0
F64 = NDArray[np.float64]
DAY = "2024-03-05"
NOON_S = 43200.0
SITE = (46.0, 12.0, 250.0)
"""Latitude, longitude [deg], height [m]: seen at some 51 degrees by `place` and `velocity`."""


def place(time_s: F64 | float) -> F64:
    """Earth-fixed position [m], (..., 3), at seconds from the middle of the pass."""
    time = np.asarray(time_s, np.float64)
    around = np.deg2rad(46.9) + 2.0 * np.pi / PERIOD_S * time  # argument of latitude
    node = np.deg2rad(10.7) - EARTH_TURN * time
    in_plane = np.stack([np.cos(around), np.sin(around) * np.cos(INCLINATION), np.sin(around) * np.sin(INCLINATION)])
    x, y, z = RADIUS * in_plane
    return np.stack([x * np.cos(node) - y * np.sin(node), x * np.sin(node) + y * np.cos(node), z], axis=-1)


def velocity(time_s: F64 | float) -> F64:
    """By central differences of the closed form: right to 1e-6 m/s."""
    step = 0.01
    time = np.asarray(time_s, np.float64)
    return (8.0 * (place(time + step) - place(time - step)) - (place(time + 2 * step) - place(time - 2 * step))) / (
        12.0 * step
    )


def earth_fixed(geodetic: tuple[float, float, float]) -> F64:
    from sarkit import wgs84

    return np.asarray(wgs84.geodetic_to_cartesian(np.array(geodetic)))


def ground_speed(geodetic: tuple[float, float, float] = SITE) -> float:
    """How fast zero Doppler moves over the ground: a step along the flight, over the time between both approaches."""
    point = earth_fixed(geodetic)
    time, _ = approach(point)
    ahead = velocity(time) / np.linalg.norm(velocity(time))
    return 200.0 / (approach(point + 100.0 * ahead)[0] - approach(point - 100.0 * ahead)[0])


def nearest(geodetic: tuple[float, float, float]) -> tuple[float, float]:
    return approach(earth_fixed(geodetic))


def approach(point: F64) -> tuple[float, float]:
    """Time [s] and distance [m] of the closest approach, where the distance's slope is zero."""

    def distance(time: float) -> float:
        return float(np.linalg.norm(place(time) - point))

    found = minimize_scalar(distance, bounds=(-300.0, 300.0), method="bounded", options={"xatol": 1e-9})
    # A minimum is flat: its place comes from the slope's zero instead, by secants.
    time = [float(found.x), float(found.x) + 1e-3]

    def slope(t: float) -> float:
        return float((place(t) - point) @ velocity(t))

    for _ in range(20):
        a, b = (slope(t) for t in time)
        if a == b:
            break
        time = [time[1], time[1] - b * (time[1] - time[0]) / (b - a)]
    return time[1], distance(time[1])


@dataclass(frozen=True)
class Band:
    """An image's spacing and bandwidths; the site lies at `centre` (line, pixel)."""

    line_s: float = 2.0e-3
    step_m: float = 2.5
    lines: int = 256
    pixels: int = 256
    centre: tuple[float, float] = (128.3, 127.6)
    frequency_hz: float = 5.405e9
    range_hz: float = 48.0e6
    azimuth_hz: float = 400.0

    def start(self, site: tuple[float, float, float] = SITE) -> tuple[float, float]:
        """Time of line 0 [s from the middle of the pass], and slant range of pixel 0 [m]."""
        time, distance = nearest(site)
        return time - self.centre[0] * self.line_s, distance - self.centre[1] * self.step_m


def utc(seconds: float) -> str:
    return str(np.datetime64(f"{DAY}T12:00:00", "ns") + np.timedelta64(round(seconds * 1e9), "ns"))[:26]


def ground_range(near_m: float, band: Band) -> tuple[F64, F64]:
    """Slant range of ground range, from pixel 0 on, and the inverse, as polynomials: a sphere's law of cosines."""
    earth = float(np.linalg.norm(earth_fixed(SITE)))
    ground = np.linspace(0.0, band.pixels * band.step_m, 50)
    first = np.arccos((earth**2 + RADIUS**2 - near_m**2) / (2.0 * earth * RADIUS))
    slant = np.sqrt(earth**2 + RADIUS**2 - 2.0 * earth * RADIUS * np.cos(first + ground / earth))
    fit = np.polynomial.Polynomial.fit
    return fit(ground, slant, 4).convert().coef, fit(slant - near_m, ground, 4).convert().coef


def ground_near(band: Band) -> float:
    """Slant range of pixel 0, where pixels lie on the ground and the site is at the centre."""
    distance, near = nearest(SITE)[1], band.start()[1]
    for _ in range(8):
        near += distance - float(
            np.polynomial.polynomial.polyval(band.centre[1] * band.step_m, ground_range(near, band)[0])
        )
    return near


STATE_TIMES = np.arange(-70.0, 71.0, 10.0)


def write_safe(
    folder: Path,
    image: NDArray[np.complex64],
    band: Band | None = None,
    *,
    beta_lut: float = 200.0,
    noise: float = 4.0,
    calibration: bool = True,
    orbit: bool = True,
    day: str = DAY,
    ground: bool = False,
    swath: str = "S3",
) -> Path:
    """A SAFE folder of a strip-map SLC, int16: digital numbers are `image` times `beta_lut`.

    A further `swath` comes into the same folder. `ground`: a GRD instead, uint16, whose `image` has pixels of
    `Band.step_m` on the ground (`ground_range`).
    """
    import rasterio

    band = band or Band()
    start, near = band.start()
    kind = "GRD" if ground else "SLC"
    safe = folder / f"S1A_S3_{kind}__1SSV_{day.replace('-', '')}T115959.SAFE"
    (safe / "annotation" / "calibration").mkdir(parents=True, exist_ok=True)
    (safe / "measurement").mkdir(exist_ok=True)
    stem = f"s1a-{swath.lower()}-{kind.lower()}-vv-{day.replace('-', '')}t115959-001"
    vectors = "".join(
        f"<orbit><time>{utc(t)}</time><frame>Earth Fixed</frame>"
        + "".join(
            f"<{name}>" + "".join(f"<{a}>{v:.9f}</{a}>" for a, v in zip("xyz", of(t), strict=True)) + f"</{name}>"
            for name, of in (("position", place), ("velocity", velocity))
        )
        + "</orbit>"
        for t in STATE_TIMES
    )
    header = (
        f"<adsHeader><missionId>S1A</missionId><productType>{kind}</productType><polarisation>VV</polarisation>"
        f"<mode>SM</mode><swath>{swath}</swath><startTime>{utc(start)}</startTime></adsHeader>"
    )
    processing = "".join(
        f"<{axis}Processing><windowCoefficient>{1.0}</windowCoefficient><processingBandwidth>{value}</processingBandwidth>"
        f"<lookBandwidth>{value}</lookBandwidth></{axis}Processing>"
        for axis, value in (("range", band.range_hz), ("azimuth", band.azimuth_hz))
    )
    projection, conversion = "Slant Range", ""
    if ground:
        projection, near = "Ground Range", ground_near(band)
        to_slant, to_ground = (" ".join(f"{c:.17e}" for c in each) for each in ground_range(near, band))
        conversion = (
            f"<coordinateConversion><coordinateConversionList><coordinateConversion><azimuthTime>{utc(start)}"
            f"</azimuthTime><sr0>{near:.9f}</sr0><srgrCoefficients>{to_ground}</srgrCoefficients><gr0>0</gr0>"
            f"<grsrCoefficients>{to_slant}</grsrCoefficients></coordinateConversion></coordinateConversionList>"
            "</coordinateConversion>"
        )
    text = (
        f"<product>{header}<generalAnnotation><productInformation><projection>{projection}</projection>"
        f"<rangeSamplingRate>{C / 2 / band.step_m:.12g}</rangeSamplingRate>"
        f"<radarFrequency>{band.frequency_hz}</radarFrequency></productInformation>"
        f"<orbitList>{vectors if orbit else ''}</orbitList></generalAnnotation>"
        f"<imageAnnotation><imageInformation><productFirstLineUtcTime>{utc(start)}</productFirstLineUtcTime>"
        f"<slantRangeTime>{2 * near / C:.18e}</slantRangeTime><azimuthTimeInterval>{band.line_s}</azimuthTimeInterval>"
        f"<rangePixelSpacing>{band.step_m}</rangePixelSpacing>"
        f"<numberOfSamples>{band.pixels}</numberOfSamples><numberOfLines>{band.lines}</numberOfLines>"
        f"</imageInformation><processingInformation><swathProcParamsList><swathProcParams>{processing}"
        "</swathProcParams></swathProcParamsList></processingInformation></imageAnnotation>"
        f"{conversion}</product>"
    )
    (safe / "annotation" / f"{stem}.xml").write_text(text.replace(DAY, day))
    (safe / "manifest.safe").write_text('<xfdu:XFDU xmlns:xfdu="urn:ccsds:schema:xfdu:1"></xfdu:XFDU>')
    ends = f"0 {band.pixels - 1}"
    if calibration:
        vector = "".join(
            f"<calibrationVector><line>{line}</line><pixel>{ends}</pixel>"
            f"<betaNought>{beta_lut} {beta_lut}</betaNought></calibrationVector>"
            for line in (0, band.lines - 1)
        )
        (safe / "annotation" / "calibration" / f"calibration-{stem}.xml").write_text(
            f"<calibration><calibrationVectorList>{vector}</calibrationVectorList></calibration>"
        )
        (safe / "annotation" / "calibration" / f"noise-{stem}.xml").write_text(
            "<noise><noiseRangeVectorList><noiseRangeVector><line>0</line>"
            f"<pixel>{ends}</pixel><noiseRangeLut>{noise} {noise}</noiseRangeLut></noiseRangeVector>"
            "</noiseRangeVectorList><noiseAzimuthVectorList><noiseAzimuthVector><line>0</line>"
            "<noiseAzimuthLut>1.5</noiseAzimuthLut></noiseAzimuthVector></noiseAzimuthVectorList></noise>"
        )
    scaled = np.abs(np.round(image * beta_lut)) if ground else np.round(image * beta_lut)
    with rasterio.open(
        safe / "measurement" / f"{stem}.tiff",
        "w",
        driver="GTiff",
        width=band.pixels,
        height=band.lines,
        count=1,
        dtype="uint16" if ground else "complex_int16",
    ) as file:
        file.write(scaled.astype(np.uint16 if ground else np.complex64), 1)
    return safe


def write_gamma(folder: Path, power: F64, band: Band | None = None, *, orbit: bool = True, day: str = DAY) -> Path:
    """A .mli of power and its .par, in slant range."""
    band = band or Band()
    start, near = band.start()
    path = folder / f"{day.replace('-', '')}_VV.mli"
    power.astype(">f4").tofile(path)
    year, month, date = day.split("-")
    lines = [
        "Gamma Interferometric SAR Processor (ISP) - Image Parameter File",
        "",
        "title:     made of nothing VV",
        "sensor:    S1A IW IW1 VV",
        f"date:      {year} {month} {date}",
        f"start_time:             {NOON_S + start:.9f}   s",
        f"azimuth_line_time:      {band.line_s:.9e}   s",
        f"range_samples:          {band.pixels}",
        f"azimuth_lines:          {band.lines}",
        "range_looks:            1",
        "azimuth_looks:          1",
        "image_format:           FLOAT",
        "image_geometry:         SLANT_RANGE",
        f"range_pixel_spacing:    {band.step_m:.9f}   m",
        f"near_range_slc:         {near:.6f}  m",
        "azimuth_angle:          90.0000   degrees",
        f"radar_frequency:        {band.frequency_hz:.9e}  Hz",
        f"chirp_bandwidth:        {band.range_hz:.6e}  Hz",
        f"azimuth_proc_bandwidth: {band.azimuth_hz:.5f}  Hz",
    ]
    if orbit:
        lines += [
            f"number_of_state_vectors: {STATE_TIMES.size}",
            f"time_of_first_state_vector: {NOON_S + STATE_TIMES[0]:.6f}   s",
            "state_vector_interval:   10.000000   s",
        ]
        for i, t in enumerate(STATE_TIMES, 1):
            for name, of, unit in (("position", place, "m"), ("velocity", velocity, "m/s")):
                lines.append(f"state_vector_{name}_{i}: " + " ".join(f"{v:.9f}" for v in of(t)) + f" {unit}" * 3)
    path.with_name(path.name + ".par").write_text("\n".join(lines) + "\n")
    return path


CAPELLA_SCALE, CAPELLA_NESZ_DB = 0.02, -20.0
CAPELLA_BAND = Band(lines=48, pixels=96, centre=(23.25, 47.75), step_m=1.25, frequency_hz=9.65e9)


def capella_metadata(**geometry: Any) -> dict[str, Any]:
    """By the fields of Capella's format specification, for the orbit in closed form."""
    start, near = CAPELLA_BAND.start()
    vectors = [
        {"time": utc(t) + "000Z", "position": place(t).tolist(), "velocity": velocity(t).tolist()} for t in STATE_TIMES
    ]
    zero = {"degree": [0, 0], "coefficients": [[0.0]]}
    return {
        "software_version": "2.60.0",
        "product_type": "SLC",
        "collect": {
            "platform": "capella-14",
            "mode": "stripmap",
            "image": {
                "data_type": "CInt16",
                "rows": CAPELLA_BAND.lines,
                "columns": CAPELLA_BAND.pixels,
                "scale_factor": CAPELLA_SCALE,
                "radiometry": "beta_nought",
                "processed_azimuth_bandwidth": 4000.0,
                "nesz_polynomial": {"degree": 0, "coefficients": [CAPELLA_NESZ_DB]},
                "center_pixel": {"target_position": earth_fixed(SITE).tolist()},
                "image_geometry": {
                    "type": "slant_plane",
                    "doppler_centroid_polynomial": zero,
                    "first_line_time": utc(start) + "000Z",
                    "delta_line_time": CAPELLA_BAND.line_s,
                    "range_to_first_sample": near,
                    "delta_range_sample": CAPELLA_BAND.step_m,
                    **geometry,
                },
            },
            "radar": {
                "center_frequency": CAPELLA_BAND.frequency_hz,
                "pointing": "right",
                "transmit_polarization": "H",
                "receive_polarization": "H",
            },
            "state": {"coordinate_system": {"type": "ecef"}, "state_vectors": vectors},
        },
    }


def write_capella(
    folder: Path, image: NDArray[np.complex64], said: dict[str, Any] | None = None, *, inside: bool = True
) -> Path:
    """A GeoTIFF, with the metadata in its description or in the JSON beside it."""
    import rasterio

    said = said or capella_metadata()
    path = folder / "CAPELLA_C14_SM_SLC_HH.tif"
    rows, columns = image.shape
    with rasterio.open(path, "w", driver="GTiff", width=columns, height=rows, count=1, dtype="complex64") as file:
        file.write(image, 1)
        if inside:
            file.update_tags(TIFFTAG_IMAGEDESCRIPTION=json.dumps(said))
    if not inside:
        path.with_name(f"{path.stem}_extended.json").write_text(json.dumps(said))
    return path
