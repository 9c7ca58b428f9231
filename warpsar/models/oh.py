"""Oh 2004, fitted to bare soils."""

from warpsar.models.base.model import BackscatterModel, Domain
from warpsar.models.base.parameters import EPS_R, RMS_HEIGHT

MODEL = BackscatterModel(
    name="oh",
    summary="Oh 2004, fitted to bare soils",
    order=20,
    parameters=(EPS_R, RMS_HEIGHT),
    domain=Domain(
        "oh (kh from 0.13 to 6.98, incidence from 10 to 70 degrees, moisture from 0.04 to 0.291)",
        incidence_deg=(10.0, 70.0),
        kh=(0.13, 6.98),
        moisture=(0.04, 0.291),
    ),
)
