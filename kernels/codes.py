"""Numbers that stand for names, in kernels, in native code and on the host alike. Importing them needs no Warp."""

from enum import IntEnum


class Polarization(IntEnum):
    """Channel of the radar, receive and transmit; HV and VH are equal by reciprocity."""

    HH = 0
    VV = 1
    HV = 2
    VH = 3

    @property
    def crossed(self) -> bool:
        """Whether the radar receives the polarization that it does not send."""
        return self in (Polarization.HV, Polarization.VH)


class Spectrum(IntEnum):
    """Roughness spectrum of the small-perturbation term; SEPARABLE is the paper's equation (16)."""

    GAUSSIAN = 0
    EXPONENTIAL = 1
    SEPARABLE = 2


class Variant(IntEnum):
    """Equations as derived, or with the constant of the paper's (13) and the amplitude of its (18)."""

    STANDARD = 0
    AS_PRINTED = 1


class Layout(IntEnum):
    """Where the nodes of a surface parameter stand; HELD is uniform and not learned."""

    UNIFORM = 0
    VERTEX = 1
    TEXTURE = 2
    HELD = 3


class Coordinate(IntEnum):
    """Learned coordinates of a surface, the four components of `zeta`."""

    EPS = 0  # ln(eps_r - 1)
    HEIGHT = 1  # ln h
    LENGTH = 2  # ln l
    FRACTION = 3  # logit tau


class Scale(IntEnum):
    """What a coordinate x is of a value v: v, ln v, ln(v - 1), or ln v - ln(1 - v)."""

    LINEAR = 0
    LOG = 1
    CONTRAST = 2
    LOGIT = 3


class Deposit(IntEnum):
    """How a ray's power falls into the range bins (`warpsar.trace.trace`)."""

    NEAREST = 0
    LINEAR = 1
    FOOTPRINT = 2


PAGE = 4
"""Learned coordinates that one vector of the device holds. Models with more have several vectors."""

# From here outward tau is 0 or 1 to the bit: its slope is below float32, and the sigmoid's adjoint would be inf * 0.
FRACTION_LIMIT = 40.0
