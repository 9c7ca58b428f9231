"""A body has another length, width or height, about its foot."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from warpsar.diagnosis.geometry.base.body import MovedBody
from warpsar.diagnosis.geometry.base.change import GeometryCandidate
from warpsar.diagnosis.models.change import BodyDifference
from warpsar.diagnosis.models.movable import size_word
from warpsar.world.objects.table import Learnable, Object

SAME_IMAGES = 3.0  # of ln L: two readings of one body that differ by less explain the images alike


class ObjectSize(MovedBody):
    """Sizes of a primitive, or factors on those of a mesh. A body of another size may stand elsewhere, too."""

    name = "object_size"
    order = 20
    summary = "an object of the scene is of another size"
    frees = 3
    keys: ClassVar[frozenset[str]] = frozenset({"scale", "size_m"})
    commented = ("size_m",)

    def is_of(self, difference: BodyDifference) -> bool:
        return bool(difference.keys & self.keys)

    def words(self, one: Object) -> tuple[Learnable, ...]:
        return (size_word(one),)

    def one_reading(self, found: list[GeometryCandidate]) -> list[GeometryCandidate]:
        """A body that is sunk looks as one that is lower. Where both explain the images alike they are one hypothesis,
        which has the name of its size and says the other reading."""
        mine = next((one for one in found if one.kind == self.name), None)

        def alike(one: GeometryCandidate) -> bool:
            return mine is not None and bool(one.reading) and abs(one.gain - mine.gain) <= SAME_IMAGES

        if mine is None or not any(map(alike, found)):
            return found
        words = [f"{mine.object}: the same images come from {one.reading}" for one in found if alike(one)]
        with_readings = replace(mine, words=[*mine.words, *words])
        return [with_readings if one is mine else one for one in found if not alike(one)]


CHANGE = ObjectSize()
