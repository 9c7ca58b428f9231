"""What stands in a folder, a file each: effects, backscatter models, formats. Each folder has its registry."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules


def names_in(package: str) -> tuple[str, ...]:
    """Names of a package's files but its registry, sorted. None of them is imported: `--help` needs names alone."""
    modules = iter_modules(import_module(package).__path__)
    return tuple(sorted(module.name for module in modules if not module.ispkg and module.name != "registry"))
