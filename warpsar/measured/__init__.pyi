from .chips import import_chips as import_chips
from .importer import import_measured as import_measured

__all__ = ["import_chips", "import_measured"]
