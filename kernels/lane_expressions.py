"""Expressions of a `@wp.func` in C++ (kernels/lanes.py)."""

import ast
import re
from dataclasses import replace
from enum import IntEnum
from typing import Any

from warpsar.kernels.codes import PAGE
from warpsar.kernels.lane_kinds import BOOL, FLOAT, INT, LaneKind, cast, join

_PRECEDENCE = {ast.Add: 1, ast.Sub: 1, ast.Mult: 2, ast.Div: 2}
_SIGNS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
_OF_VECTORS_ALIKE = {
    ast.Add: "add",
    ast.Sub: "sub",
    ast.Mult: "mul",
    ast.Div: "div",
}  # Warp's own, of one for all lanes
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_SAME = ("sqrt", "exp", "log", "abs", "floor", "sin", "cos", "atan2", "min", "max", "clamp")  # result as the arguments
_OF_VECTORS = ("dot", "length", "normalize", "cross")
_READS = ("read_float", "read_int", "read_vec2", "read_vec4")  # kernels/wide.py
_RANDOM = {"rand_init": LaneKind("wp::uint32"), "randf": FLOAT}  # of one ray alone: its state changes


class Expressions:
    """The text of an expression, and its kind. Names, functions and structs are the concern of whoever inherits."""

    function: Any  # the `@wp.func`
    kinds: dict[str, LaneKind]  # of its variables
    scopes: list[set[str]]  # variables declared, of the outermost block first

    def unknown(self, node: ast.AST) -> NotImplementedError:
        return NotImplementedError(f"{self.place(node)}: {ast.unparse(node)!r} cannot be written in lanes")

    def place(self, node: ast.AST) -> str:
        """File and line."""
        return f"{self.function.adj.filename}:{self.function.adj.fun_lineno + getattr(node, 'lineno', 1) - 1}"

    def variable(self, name: str) -> str:
        raise NotImplementedError

    def translated(self, function: Any, kinds: tuple[LaneKind, ...]) -> tuple[str, LaneKind]:
        raise NotImplementedError

    def made(self, struct: Any) -> LaneKind:
        raise NotImplementedError

    def declared(self, name: str) -> bool:
        return any(name in scope for scope in self.scopes)

    def static(self, node: ast.expr) -> Any:
        """The value of a name from outside of the function; None for a variable."""
        match node:
            case ast.Name(name) if name not in self.kinds:
                function = self.function.func
                enclosed = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
                return enclosed[name].cell_contents if name in enclosed else function.__globals__.get(name)
            case ast.Attribute(of, name):
                return getattr(self.static(of), name, None)
        return None

    def value(self, node: ast.expr) -> tuple[str, LaneKind]:
        constant = node.value if isinstance(node, ast.Constant) else self.static(node)
        if isinstance(constant, (bool, int, float)):
            return _literal(constant)
        match node:
            case ast.Name(name) if self.declared(name):
                return self.variable(name), self.kinds[name]
            case ast.Attribute(of, name):
                text, kind = self.value(of)
                if kind.struct is not None:
                    return f"{text}.{name}", kind.field(name)
            case ast.Subscript(ast.Attribute(array, "shape"), ast.Constant(int(axis))) if self.is_array(array):
                return f"{self.value(array)[0]}.shape[{axis}]", INT
            case ast.Subscript(of, at) if self.is_array(of):
                return self.element(of, at.elts if isinstance(at, ast.Tuple) else [at])
            case ast.Subscript(of, at):
                index = at.value if isinstance(at, ast.Constant) else self.static(at)
                text, kind = self.value(of)
                if not isinstance(index, int):  # the number of a loop
                    index, own = self.value(at)
                    if own != INT or not kind.size:
                        raise self.unknown(node)
                elif not 0 <= index < kind.size:  # Warp would read beyond the vector
                    raise NotImplementedError(f"{self.place(node)}: {ast.unparse(node)!r}: there are {kind.size}")
                return f"{text}.c[{index if isinstance(index, str) else int(index)}]", replace(kind, size=0)
            case ast.UnaryOp(ast.USub(), of):
                text, kind = self.value(of)
                return f"-{_closed(of, text)}", kind
            case ast.UnaryOp(ast.Not(), of):
                text, kind = self.value(of)
                return f"{'~' if kind.lanes else '!'}{_closed(of, text)}", kind
            case ast.BinOp(left, sign, right) if type(sign) in _SIGNS:
                return self.arithmetic(left, sign, right)
            case ast.BoolOp(sign, values):
                return self.logic(isinstance(sign, ast.And), values)
            case ast.Compare(left, [sign], [right]) if type(sign) in _COMPARISONS:
                (a, one), (b, other) = self.value(left), self.value(right)
                return f"{a} {_COMPARISONS[type(sign)]} {b}", LaneKind("bool", one.lanes or other.lanes)
            case ast.Call():
                return self.call(node)
        raise self.unknown(node)

    def is_array(self, node: ast.expr) -> bool:
        """Whether it is an array, or a struct's."""
        match node:
            case ast.Name(name) if name in self.kinds:
                return self.kinds[name].array is not None
            case ast.Attribute(ast.Name(of), name) if of in self.kinds and self.kinds[of].struct is not None:
                return self.kinds[of].field(name).array is not None
        return False

    def element(self, array: ast.expr, places: list[ast.expr]) -> tuple[str, LaneKind]:
        """An element of an array; of every lane its own where the place differs between them."""
        data, of = self.value(array)
        found = [self.value(place) for place in places]
        flat, kind = found[0][0], of.element()
        if len(found) != of.array[1] or len(found) > 2:
            raise self.unknown(array)
        if len(found) == 2:
            flat = f"({flat}) * {data}.shape[1] + {found[1][0]}"
        if not any(place.lanes for _, place in found):
            return f"{data}.data[{flat}]", kind
        if len(found) == 1 and found[0][1].thread:
            self.by_thread(data)
            if kind == FLOAT:
                return f"load({data}.data, begin, count)", replace(kind, lanes=True)
        if kind.struct is not None or (kind.size and kind.base != "float"):
            raise self.unknown(array)
        return f"gather({data}.data, {flat})", replace(kind, lanes=True)

    def by_thread(self, array: str) -> None:
        """Note an array of which each thread reads its own element."""
        raise NotImplementedError

    def arithmetic(self, left: ast.expr, sign: ast.operator, right: ast.expr) -> tuple[str, LaneKind]:
        (a, one), (b, other) = self.value(left), self.value(right)
        joined = join(one, other)
        rank = _PRECEDENCE[type(sign)]
        a = f"({a})" if _rank(left) < rank else a
        b = f"({b})" if _rank(right) <= rank else b
        if (one.size or other.size) and not (one.lanes or other.lanes):
            return f"wp::{_OF_VECTORS_ALIKE[type(sign)]}({a}, {b})", one if one.size else other
        if one.size or other.size:
            wide = LaneKind("float", True, max(one.size, other.size))
            if one.size and other.size:
                a, b = cast(a, one, wide), cast(b, other, wide)
            elif other.size:  # the number second, as the operators have it
                a, b = cast(b, other, wide), cast(a, one, LaneKind("float", True))
            else:
                a, b = cast(a, one, wide), cast(b, other, LaneKind("float", True))
            return f"{a} {_SIGNS[type(sign)]} {b}", wide
        if joined.lanes and joined.base == "float":
            a, b = (cast(x, k, joined) if k.base == "int" and k.lanes else x for x, k in ((a, one), (b, other)))
        return f"{a} {_SIGNS[type(sign)]} {b}", joined

    def logic(self, both: bool, values: list[ast.expr]) -> tuple[str, LaneKind]:
        found = [self.value(each) for each in values]
        kind = LaneKind("bool", any(kind.lanes for _, kind in found))
        sign = ("&", "|") if kind.lanes else ("&&", "||")
        return f" {sign[not both]} ".join(f"({cast(text, k, kind)})" for text, k in found), kind

    def call(self, node: ast.Call) -> tuple[str, LaneKind]:
        if isinstance(node.func, ast.Call):  # type(x)(1.0)
            return self.value(node.args[0])
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        called = self.static(node.func)
        if hasattr(called, "native_name"):
            kind = self.made(called)
            return f"{kind.cpp}{{}}", kind
        if name in _READS:
            return self.element(node.args[0], node.args[1:])
        found = [self.value(each) for each in node.args]
        if name in ("float", "int"):
            (text, kind), wanted = found[0], LaneKind(name, found[0][1].lanes)
            if kind.lanes and kind.base != name:
                return f"__builtin_convertvector({text}, {wanted.cpp})", wanted
            return (text if kind.base == name else f"wp::{name}32({text})"), wanted
        if getattr(called, "func", None) is not None:
            inner, kind = self.translated(called, tuple(kind for _, kind in found))
            return f"{inner}({', '.join(text for text, _ in found)})", kind
        return self.word(node, node.func.attr if isinstance(node.func, ast.Attribute) else name, found)

    def word(self, node: ast.Call, name: str, found: list[tuple[str, LaneKind]]) -> tuple[str, LaneKind]:
        """A function or type of Warp's own."""
        if name == "tid":
            return "at", LaneKind("int", True, thread=True)
        lanes = any(kind.lanes for _, kind in found)
        scope = "" if lanes else "wp::"
        texts = [text for text, _ in found]
        if re.fullmatch(r"vector|vec[2-9]i?", name):
            lanes = lanes or len(found) > PAGE  # Warp's own of more numbers cannot be written in one expression
            kind = LaneKind("int" if name.endswith("i") else "float", lanes, len(found))
            if name != "vector" and name[3] != str(kind.size):
                raise self.unknown(node)
            texts = [cast(text, k, replace(kind, size=0)) for text, k in found]
            return f"{kind.cpp}{{{', '.join(texts)}}}" if not lanes else f"{kind.cpp}{{{{{', '.join(texts)}}}}}", kind
        if name in _RANDOM and not lanes:
            return f"wp::{name}({', '.join(texts)})", _RANDOM[name]
        if name in _SAME:
            kind = LaneKind("int" if all(k.base == "int" for _, k in found) else "float", lanes)
            if lanes and kind.base == "int":
                raise self.unknown(node)
        elif name in _OF_VECTORS:
            kind = LaneKind("float", lanes, 0 if name in ("dot", "length") else found[0][1].size)
            wide = LaneKind("float", lanes, found[0][1].size)
            return f"{scope}{name}({', '.join(cast(text, k, wide) for text, k in found)})", kind
        elif name == "where":
            (mask, of), *pair = found
            kind = replace(join(pair[0][1], pair[1][1]), lanes=lanes)
            a, b = (cast(text, k, kind) for text, k in pair)
            if of.lanes:
                return f"choose({mask}, {a}, {b})", kind
            return f"(({mask}) ? {a} : {b})", kind
        else:
            raise self.unknown(node)
        return f"{scope}{name}({', '.join(cast(text, k, kind) for text, k in found)})", kind


def _literal(value: bool | int | float) -> tuple[str, LaneKind]:
    if isinstance(value, bool):
        return str(value).lower(), BOOL
    if isinstance(value, IntEnum):
        return f"{int(value)} /* {value.name} */", INT
    if isinstance(value, int):
        return str(value), INT
    return ("__builtin_inff()" if value == float("inf") else f"{value!r}f"), FLOAT


def _rank(node: ast.expr) -> int:
    match node:
        case ast.BinOp(_, sign, _):
            return _PRECEDENCE[type(sign)]
        case ast.Compare() | ast.BoolOp():
            return 0
    return 9


def _closed(node: ast.expr, text: str) -> str:
    return f"({text})" if _rank(node) < 9 else text
