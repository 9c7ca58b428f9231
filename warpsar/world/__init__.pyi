from .library.fill import material as material
from .objects.table import Object as Object
from .pixels import Pixels as Pixels
from .scattering_term import learned as learned

__all__ = ["Object", "Pixels", "learned", "material"]
