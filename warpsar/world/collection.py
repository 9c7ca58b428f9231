"""`[collection]`: the track of a sensor, its band and its antenna."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from warpsar.world.tables import FileName, Number, Polarization, Table

Mode = Literal["spotlight", "stripmap", "circular", "inverse", "file"]
Preset = Literal["x-spotlight", "c-stripmap", "l-stripmap"]
Taper = Literal["none", "hann", "taylor"]

_Positive = Annotated[Number, Field(gt=0.0)]
_Frequency = Annotated[Number, Field(ge=1e6, le=1e13)]
_Count = Annotated[int, Field(strict=True, ge=2, le=10_000_000)]
_Place = Annotated[Number, Field(ge=-1e9, le=1e9)]
_Speed = Annotated[Number, Field(ge=-1e5, le=1e5)]
_Width = Annotated[Number, Field(gt=0.0, le=120.0)]
_Point = tuple[_Place, _Place, _Place]
_Part = Annotated[Number, Field(ge=-100.0, le=100.0)]
_Complex = tuple[_Part, _Part]


_NOT_WITH: dict[str, tuple[str, ...]] = {
    "circular": ("squint_deg",),
    "inverse": ("squint_deg",),
    "file": ("pulses", "prf_hz", "aperture_deg", "squint_deg", "side", "transmitter"),
}
"""What a mode cannot follow. A range or a speed beside a track from a file says what the track says."""
RENAMED = {"resolution_m": "effects.point_spread", "noise_beta0": "effects.noise_floor"}
"""Old keys, and the tables that say it now. The old keys act on products with phase alone, as they always did."""


class Antenna(Table):
    """`[collection] antenna`: half-power widths of the one-way pattern of a rectangular antenna, or a measured one."""

    azimuth_deg: _Width | None = Field(
        default=None, description="Half-power width along the track [deg].", examples=[0.9]
    )
    elevation_deg: _Width | None = Field(
        default=None, description="Half-power width across it [deg]; even without it.", examples=[3.0]
    )
    pattern: FileName | None = Field(
        default=None,
        description="Measured two-way pattern, in place of widths: CSV of azimuth_deg and elevation_deg off the beam's "
        "axis (along the track, and up), gain_db and phase_deg, on a regular grid. Without elevation_deg it is even.",
        examples=["pattern.csv"],
    )

    @model_validator(mode="after")
    def _one(self) -> Antenna:
        if (self.azimuth_deg is None) == (self.pattern is None) or (self.pattern and self.elevation_deg):
            raise ValueError("found widths and a pattern, or neither; must be azimuth_deg, or pattern")
        return self


class AntennaChannels(Table):
    """`[collection.errors] transmit` and `receive`: what the two channels of an antenna make of the two waves."""

    imbalance: _Complex = Field(
        default=(1.0, 0.0),
        description="The vertical channel over the horizontal one: real and imaginary part.",
        examples=[[1.1, 0.05]],
    )
    v_in_h: _Complex = Field(
        default=(0.0, 0.0), description="What the horizontal channel has of the vertical wave.", examples=[[0.03, 0.0]]
    )
    h_in_v: _Complex = Field(
        default=(0.0, 0.0), description="What the vertical channel has of the horizontal wave.", examples=[[0.0, 0.02]]
    )

    @property
    def crosstalk(self) -> bool:
        return any(self.v_in_h) or any(self.h_in_v)


class CollectionErrors(Table):
    """`[collection] errors`: what a system does, and its files do not say."""

    track: FileName | None = Field(
        default=None,
        description="The recorded track less the true one: CSV of time_s, x_m, y_m, z_m, between which a spline goes. "
        "Files and focusing know the recorded one. Times of a track that is no file are 0 in its middle.",
        examples=["track_error.csv"],
    )
    timing_s: Annotated[Number, Field(ge=-1e-3, le=1e-3)] = Field(
        default=0.0, description="By how much echoes are recorded too late [s].", examples=[2e-8]
    )
    frequency_hz: Annotated[Number, Field(ge=-1e6, le=1e6)] = Field(
        default=0.0,
        description="By how much the oscillators of both ways differ: echoes turn so often a second [Hz].",
        examples=[0.5],
    )
    transmit: AntennaChannels | None = Field(
        default=None, description="Channels of the transmitter.", examples=[{"imbalance": [1.05, 0.0]}]
    )
    receive: AntennaChannels | None = Field(
        default=None, description="Channels of the receiver.", examples=[{"imbalance": [0.95, 0.1]}]
    )

    @property
    def of_pulses(self) -> bool:
        """Whether pulses differ by it, or their ranges."""
        return self.track is not None or bool(self.timing_s or self.frequency_hz)


class Transmitter(Table):
    """`[collection] transmitter`: where a transmitter apart from the receiver is in the middle of the collection."""

    position_m: _Point = Field(
        description="Place from the reference point: east, north, up [m].", examples=[[0.0, -9e3, 9e3]]
    )
    velocity_m_s: tuple[_Speed, _Speed, _Speed] = Field(
        default=(0.0, 0.0, 0.0), description="Its velocity: east, north, up [m/s].", examples=[[100.0, 0.0, 0.0]]
    )


class Collection(Table):
    """`[collection]`: how a sensor collects each view. The view's direction is that of the middle of the track."""

    preset: Preset | None = Field(
        default=None, description="A published system; keys that are stated replace its own.", examples=["x-spotlight"]
    )
    mode: Mode | None = Field(
        default=None,
        description="Track: straight with the beam on the reference point, straight with the beam abeam, a circle, a "
        'turntable, or a file; "spotlight" without it and without a preset.',
        examples=["stripmap"],
    )
    trajectory: FileName | None = Field(
        default=None,
        description="Track for mode file: CSV of time_s, x_m, y_m, z_m (and tx_x_m, tx_y_m, tx_z_m), or CPHD.",
        examples=["track.csv"],
    )
    bandwidth_hz: _Positive | None = Field(
        default=None, description="Bandwidth about the view's carrier frequency [Hz].", examples=[6e8]
    )
    start_hz: _Frequency | None = Field(
        default=None, description="First frequency, in place of bandwidth_hz [Hz].", examples=[9.3e9]
    )
    stop_hz: _Frequency | None = Field(default=None, description="Last frequency [Hz].", examples=[9.9e9])
    frequencies: _Count | None = Field(
        default=None, description="Samples of a pulse; as many as the scene needs without it.", examples=[512]
    )
    pulses: _Count | None = Field(
        default=None, description="Pulses; as many as the scene needs without it.", examples=[1024]
    )
    prf_hz: _Positive | None = Field(default=None, description="Pulses a second [1/s].", examples=[3000.0])
    speed_m_s: Annotated[Number, Field(gt=0.0, le=1e5)] | None = Field(
        default=None,
        description="Speed along the track [m/s]; 7,500 without it and without a preset.",
        examples=[100.0],
    )
    aperture_deg: Annotated[Number, Field(gt=0.0, le=360.0)] | None = Field(
        default=None,
        description="Angle through which the reference point sees the sensor move [deg]; in a stripmap, any point.",
        examples=[3.0],
    )
    resolution_m: tuple[_Positive, _Positive] | None = Field(
        default=None,
        description="Old name of range_fwhm_m and azimuth_fwhm_m of [effects.point_spread], for products with phase "
        "alone [m].",
        examples=[[0.3, 0.3]],
    )
    slant_range_m: Annotated[Number, Field(gt=0.0, le=1e9)] | None = Field(
        default=None,
        description="From the middle of the track to the reference point [m]; else that of the view or [radar].",
        examples=[10e3],
    )
    side: Literal["right", "left"] = Field(
        default="right", description="Side of the track on which the scene lies.", examples=["left"]
    )
    squint_deg: Annotated[Number, Field(ge=-80.0, le=80.0)] = Field(
        default=0.0, description="Angle of the look before (+) or behind (-) abeam [deg].", examples=[10.0]
    )
    transmitter: Transmitter | None = Field(
        default=None, description="A transmitter apart from the receiver.", examples=[{"position_m": [0.0, -9e3, 9e3]}]
    )
    antenna: Antenna | None = Field(
        default=None, description="Antenna of transmitter and receiver.", examples=[{"azimuth_deg": 0.3}]
    )
    noise_beta0: Annotated[Number, Field(ge=0.0, le=1e9)] = Field(
        default=0.0,
        description="Old name of level of [effects.noise_floor], for products with phase alone.",
        examples=[0.002],
    )
    azimuth_ambiguities: bool = Field(
        default=False,
        description="Let pulses be too far apart for the scene, as `prf_hz`, `pulses` or the track says: echoes fold.",
        examples=[True],
    )
    nesz_db: dict[Polarization, Annotated[Number, Field(ge=-200.0, le=100.0)]] = Field(
        default_factory=dict,
        description="Noise of each polarization as sigma0 of level ground at the view's incidence [dB]; adds to "
        "[effects.noise_floor].",
        examples=[{"HH": -22.0, "HV": -24.0}],
    )
    errors: CollectionErrors | None = Field(
        default=None, description="What files do not say.", examples=[{"timing_s": 2e-8}]
    )
    velocity_m_s: dict[str, tuple[_Speed, _Speed, _Speed]] = Field(
        default_factory=dict,
        description="Velocities of [[objects]], by their names: east, north, up [m/s].",
        examples=[{"car": [0.0, 8.0, 0.0]}],
    )
    window: Taper | None = Field(
        default=None, description='Taper of a focused image; "taylor" (-35 dB) without it.', examples=["hann"]
    )
    focus: Literal["backprojection", "direct"] = Field(
        default="backprojection",
        description="How an image is made: from the phase history, or each scatterer times the system's response.",
        examples=["direct"],
    )
    scatterers_per_cell: Annotated[Number, Field(ge=1.0, le=1e4)] = Field(
        default=4.0, description="Scatterers of rough faces in a resolution cell, at least.", examples=[16.0]
    )

    @property
    def files(self) -> dict[str, Path]:
        """The files that the table names, by their keys."""
        inner = {
            "antenna.pattern": None if self.antenna is None else self.antenna.pattern,
            "errors.track": None if self.errors is None else self.errors.track,
        }
        return {key: path for key, path in {"trajectory": self.trajectory, **inner}.items() if path is not None}

    def with_files(self, place: Callable[[Path], Any]) -> Collection:
        """The table with each file's name put through `place`."""
        changed: dict[str, Any] = {}
        for key, path in self.files.items():
            table, _, name = key.rpartition(".")
            changed[table or name] = (
                getattr(self, table).model_copy(update={name: place(path)}) if table else place(path)
            )
        return self.model_copy(update=changed)

    @property
    def old_keys(self) -> list[str]:
        """The keys of `RENAMED` that say something."""
        return [key for key in RENAMED if getattr(self, key)]

    @model_validator(mode="after")
    def _together(self) -> Collection:
        if (self.start_hz is None) != (self.stop_hz is None) or (self.start_hz and self.bandwidth_hz):
            raise ValueError("found a part of a band, or two; must be bandwidth_hz, or both start_hz and stop_hz")
        if self.start_hz is not None and self.stop_hz is not None and self.start_hz >= self.stop_hz:
            raise ValueError(f"found start_hz = {self.start_hz:g}, stop_hz = {self.stop_hz:g}; the first must be lower")
        if (self.mode == "file") != (self.trajectory is not None):
            raise ValueError('trajectory and mode = "file" go together; found one without the other')
        if self.azimuth_ambiguities and not (self.prf_hz or self.pulses or self.trajectory):
            raise ValueError(
                "found azimuth_ambiguities without prf_hz, pulses or a trajectory, which say how far apart"
            )
        wrong = [name for name in _NOT_WITH.get(self.mode or "", ()) if name in self.model_fields_set]
        if wrong:
            raise ValueError(f'found {", ".join(wrong)} with mode = "{self.mode}", which has no use for it')
        return self
