"""`[[curves]]`: measured radar cross-sections against angle, beside or instead of images."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from warpsar.io import curves
from warpsar.io.curves import RcsTable
from warpsar.world.tables import FileName, Number, Polarization, Table

_Azimuth = Annotated[Number, Field(ge=-720.0, le=720.0)]
_Level = Annotated[Number, Field(ge=-200.0, le=200.0)]


class ProfileFile(Table):
    """`[[curves]] profiles`: the file holds complex range profiles without an absolute level, one bin of which counts.

    The level is one factor for all such curves of a scene. It is fitted to the train curves.
    """

    bins: Annotated[int, Field(strict=True, ge=1, le=1_000_000)] = Field(
        description="Range bins of a direction. The file is complex64, little endian, one direction after another.",
        examples=[256],
    )
    bin: Annotated[int, Field(strict=True, ge=0)] = Field(
        description="The bin that is used, counted from 0. It lies at the reference point.", examples=[20]
    )
    azimuths_deg: tuple[_Azimuth, _Azimuth] = Field(
        description="Azimuth of the first and of the last direction; those between are even [deg].",
        examples=[[141.0, 33.4]],
    )
    incidence_deg: Annotated[Number, Field(ge=0.0, le=180.0)] = Field(
        default=90.0, description="Incidence of all directions [deg].", examples=[90.0]
    )
    bandwidth_hz: Annotated[Number, Field(ge=0.0, le=1e12)] = Field(
        default=0.0,
        description="Band about frequency_hz that the bin was made of, without a window; the model is its mean [Hz].",
        examples=[3.07e9],
    )
    every: Annotated[int, Field(strict=True, ge=1, le=10_000)] = Field(
        default=1, description="Every how many-th direction is used.", examples=[4]
    )


class Curve(Table):
    """`[[curves]]`: one curve of a file, and its role. `file` is absolute in memory, as is `mesh`."""

    file: FileName = Field(
        description="CSV (frequency_hz, theta_deg, phi_deg, rcs_dbsm), or the Austin suite's text; see profiles.",
        examples=["plate_5GHz.csv"],
    )
    frequency_hz: Annotated[Number, Field(ge=1e6, le=1e13)] | None = Field(
        default=None, description="Which frequency of the file [Hz]; needed where it has several.", examples=[5.12e9]
    )
    polarization: Polarization | None = Field(
        default=None, description="Polarization; needed where the file names none, or several.", examples=["VV"]
    )
    role: Literal["train", "test"] = Field(
        default="train",
        description="train curves are fitted; test curves only measure how good the fit is.",
        examples=["test"],
    )
    mask: Annotated[tuple[tuple[_Azimuth, _Azimuth], ...], Field(min_length=1)] | None = Field(
        default=None,
        description="Ranges of azimuth_deg (90 - phi) that are used, ends included [deg].",
        examples=[[[-90.0, -5.0], [5.0, 90.0]]],
    )
    background_dbsm: _Level | None = Field(
        default=None,
        description="Mean power of the background, where a repeated measurement or an empty range tells it [dBsm].",
        examples=[-45.0],
    )
    error_db: Annotated[Number, Field(gt=0.0, le=20.0)] | None = Field(
        default=None,
        description="Standard deviation of the measurement's multiplicative error, where it is known [dB].",
        examples=[0.3],
    )
    mesh: FileName | None = Field(
        default=None,
        description="Mesh of the curve's body, where it is another one than the scene's; it has the same materials.",
        examples=["dihedral-15cm.obj"],
    )
    profiles: ProfileFile | None = Field(
        default=None,
        description="How a file of complex range profiles is read; frequency_hz is then needed.",
        examples=[{"bins": 256, "bin": 20, "azimuths_deg": [141.0, 33.4]}],
    )

    def rows(self) -> RcsTable:
        """The rows of the file. Raises InputError where the choice of one curve is open, or fits no row."""
        if self.profiles is None:
            return curves.read(self.file).select(self.frequency_hz, self.polarization)
        assert self.frequency_hz is not None
        one = self.profiles
        table = curves.read_profiles(
            self.file, one.bins, one.bin, one.azimuths_deg, one.incidence_deg, one.every, self.frequency_hz
        )
        return table.select(None, self.polarization)

    @model_validator(mode="after")
    def _named(self) -> Curve:
        if self.profiles is not None and self.frequency_hz is None:
            raise ValueError("frequency_hz: missing; must be stated beside profiles")
        if self.profiles is not None and self.profiles.bin >= self.profiles.bins:
            raise ValueError(f"profiles.bin: found {self.profiles.bin}; must be less than bins, {self.profiles.bins}")
        return self

    @field_validator("mask")
    @classmethod
    def _ascending(cls, value: tuple[tuple[float, float], ...] | None) -> tuple[tuple[float, float], ...] | None:
        for low, high in value or ():
            if low > high:
                raise ValueError(f"found [{low:g}, {high:g}]; must be [from, to] with from <= to")
        return value
