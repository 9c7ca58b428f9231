"""Small perturbation on tilted facets."""

from warpsar.models.base.model import BackscatterModel, Domain, SurfaceParameter
from warpsar.models.base.parameters import CORRELATION_LENGTH, EPS_R, RMS_HEIGHT

MODEL = BackscatterModel(
    name="two_scale",
    summary="small perturbation on tilted facets, with HV by the tilts",
    order=45,
    parameters=(
        EPS_R,
        RMS_HEIGHT,
        CORRELATION_LENGTH,
        SurfaceParameter(
            *("slope_variance", "s2", "log", 1e-5, 0.3),
            limits=(0.0, 1.0),
            default=0.01,
            description="Variance of the slopes of the large scale, per axis, in the model two_scale; may be learned.",
            example=0.02,
        ),
    ),
    domain=Domain("two_scale (kh < 0.3 of the small scale)", kh=(0.0, 0.3)),
    spectra=("gaussian", "exponential"),
)
