"""Libraries that a plain installation lacks."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

from warpsar.errors import InputError


@dataclass(frozen=True)
class Extra:
    """`pip install "warpsar[name]"` brings the `libraries`."""

    name: str
    libraries: tuple[str, ...]

    @property
    def missing(self) -> str | None:
        """The first library that is not there; None where all are."""
        return next((library for library in self.libraries if find_spec(library) is None), None)

    def require(self, who: str) -> None:
        """Raise InputError, which begins with `who`, where a library is not there."""
        if (library := self.missing) is not None:
            raise InputError(f'{who} needs {library}: pip install "warpsar[{self.name}]"')
