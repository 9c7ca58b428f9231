from .library.fill import material as material
from .library.surfaces import SURFACES as SURFACES
from .library.surfaces import LibrarySurface as LibrarySurface
from .objects.table import Object as Object
from .pixels import Pixels as Pixels
from .scattering_term import learned as learned

__all__ = ["SURFACES", "LibrarySurface", "Object", "Pixels", "learned", "material"]
