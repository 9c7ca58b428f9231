"""Names of what a diagnosis may find: an effect's own, or the kind of a change of geometry and what it is of."""

from __future__ import annotations


def name_of(kind: str, label: str) -> str:
    """The name of a change."""
    return f"{kind} {label}"


def kind_of(name: str) -> str:
    """What a verdict says: the kind of a change, or the effect's own name."""
    return name.partition(" ")[0]


def object_of(name: str) -> str:
    """The object that a change is of; empty for an effect."""
    return name.partition(" ")[2]
