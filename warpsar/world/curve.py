"""`[[curves]]`: measured radar cross-sections against angle, beside or instead of images."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from warpsar.world.tables import FileName, Number, Polarization, Table

_Azimuth = Annotated[Number, Field(ge=-720.0, le=720.0)]
_Level = Annotated[Number, Field(ge=-200.0, le=200.0)]


class Curve(Table):
    """`[[curves]]`: one curve of a file, and what it is used for. `file` is absolute in memory."""

    file: FileName = Field(
        description="CSV (frequency_hz, theta_deg, phi_deg, rcs_dbsm), or the Austin suite's text.",
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

    @field_validator("mask")
    @classmethod
    def _ascending(cls, value: tuple[tuple[float, float], ...] | None) -> tuple[tuple[float, float], ...] | None:
        for low, high in value or ():
            if low > high:
                raise ValueError(f"found [{low:g}, {high:g}]; must be [from, to] with from <= to")
        return value
