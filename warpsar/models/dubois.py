"""Dubois, van Zyl and Engman 1995, fitted to bare soils."""

from warpsar.models.base.model import BackscatterModel, Domain
from warpsar.models.base.parameters import EPS_R, RMS_HEIGHT

MODEL = BackscatterModel(
    name="dubois",
    summary="Dubois 1995, fitted to bare soils; HH and VV alone",
    order=30,
    parameters=(EPS_R, RMS_HEIGHT),
    domain=Domain(
        "dubois (kh < 2.5, incidence above 30 degrees, moisture below 0.35)",
        incidence_deg=(30.0, 90.0),
        kh=(0.0, 2.5),
        moisture=(0.0, 0.35),
    ),
    channels=("HH", "VV"),
)
