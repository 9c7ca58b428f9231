"""Parameters of surfaces, which several models share. Their order is that of `kernels.codes.Coordinate`."""

from warpsar.models.base.model import SurfaceParameter

EPS_R = SurfaceParameter("eps_r", "eps_r", "contrast", 1.01, 300.0, (1.0, 1e9))
RMS_HEIGHT = SurfaceParameter("rms_height_m", "h", "log", 1e-6, 10.0, (0.0, 100.0))
CORRELATION_LENGTH = SurfaceParameter("correlation_length_m", "l", "log", 1e-5, 100.0, (0.0, 1e4))
SPECULAR_FRACTION = SurfaceParameter("specular_fraction", "tau", "logit", 1e-6, 1.0 - 1e-6, (0.0, 1.0))

OF_SURFACES = (EPS_R, RMS_HEIGHT, CORRELATION_LENGTH, SPECULAR_FRACTION)


def places_of(parameters: tuple[SurfaceParameter, ...]) -> tuple[SurfaceParameter, ...]:
    """The learned coordinates of a model, in the order in which a hit has them on the device.

    Those of surfaces have their own places, which a model's own take in turn where it leaves them free. A place that
    is left has its parameter of surfaces, which the model does not look at. What is more stands behind these four.
    """
    own = [parameter for parameter in parameters if parameter not in OF_SURFACES]
    first = [own.pop(0) if own and one not in parameters else one for one in OF_SURFACES]
    return (*first, *own)
