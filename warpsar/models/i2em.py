"""Improved integral equation model."""

from warpsar.models.base.model import BackscatterModel, Domain
from warpsar.models.base.parameters import CORRELATION_LENGTH, EPS_R, RMS_HEIGHT

MODEL = BackscatterModel(
    name="i2em",
    summary="improved integral equation, with double scattering in HV",
    order=10,
    parameters=(EPS_R, RMS_HEIGHT, CORRELATION_LENGTH),
    domain=Domain(
        "i2em (kh < 3, h / l < 0.4, and kl < 4 for HV of a gaussian spectrum)",
        kh=(0.0, 3.0),
        slope=0.4,
        crossed_gaussian_kl=(0.0, 4.0),
    ),
    spectra=("gaussian", "exponential"),
)
