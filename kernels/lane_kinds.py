"""What a value is where kernels/lanes.py writes it in C++: of one lane or of all, a number, a vector or a struct."""

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import warp as wp


@dataclass(frozen=True)
class LaneKind:
    """`base`: float, int, bool, or the name of a struct; `size` of a vector, 0 of a number."""

    base: str
    lanes: bool = False  # one value for each lane, else one for all
    size: int = 0
    struct: Any = None  # the `wp.struct`
    parts: tuple["LaneKind", ...] = ()  # of a function's several results
    array: Any = None  # of an array: its dtype, and how many axes it has
    thread: bool = False  # the number of the thread: in the lanes one after the other

    @property
    def cpp(self) -> str:
        if self.array is not None:
            return f"wp::array_t<{self.element().cpp}>"
        if self.struct is not None or self.parts:
            return self.base
        if self.lanes:
            return f"V{self.size}" if self.size else {"float": "V"}.get(self.base, "I")
        return f"wp::vec_t<{self.size}, wp::{self.base}32>" if self.size else self.base

    @property
    def by_reference(self) -> bool:
        return bool(self.size or self.struct or self.array is not None)

    def field(self, name: str) -> "LaneKind":
        return given(self.struct.vars[name].type, self.lanes)

    def element(self) -> "LaneKind":
        """Of an array."""
        return given(self.array[0], False)


FLOAT, INT, BOOL = LaneKind("float"), LaneKind("int"), LaneKind("bool")


def given(annotation: Any, lanes: bool) -> LaneKind:
    """Kind of an argument or a field by its Warp type; `Any` is a float. An array is one for all lanes."""
    if isinstance(annotation, wp.array):
        return LaneKind("array", array=(annotation.dtype, annotation.ndim))
    if hasattr(annotation, "native_name"):  # a wp.struct
        return LaneKind(annotation.native_name, lanes, struct=annotation)
    size = annotation._length_ if isinstance(annotation, type) and issubclass(annotation, ctypes.Array) else 0
    scalar = getattr(annotation, "_wp_scalar_type_", annotation)
    return LaneKind("int" if scalar in (int, wp.int32) else "float", lanes, size)


def join(a: LaneKind | None, b: LaneKind) -> LaneKind:
    """Kind of a variable that takes values of both kinds."""
    if a is None or a.struct or a.parts or a.array is not None:
        return a or b
    base = "float" if "float" in (a.base, b.base) else a.base
    return replace(a, base=base, lanes=a.lanes or b.lanes, thread=a.thread and b.thread)


def cast(text: str, kind: LaneKind, wanted: LaneKind) -> str:
    """A value of one kind as one of another; what holds for all lanes becomes the same in each."""
    if kind.lanes == wanted.lanes and (kind.base == wanted.base or kind.struct or not wanted.lanes):
        return text
    if wanted.size:
        return f"V{wanted.size}::of({text})"
    if not kind.lanes:
        return f"(I)-wp::int32({text})" if wanted.base == "bool" else f"({wanted.cpp})({text})"
    return f"__builtin_convertvector({text}, V)" if (kind.base, wanted.base) == ("int", "float") else text


def struct_text(name: str, fields: Mapping[str, LaneKind]) -> str:
    inside = "".join(f"    {kind.cpp} {field};\n" for field, kind in fields.items())
    return f"struct {name} {{\n{inside}}};\n"
