"""Expressions of a `@wp.func` in C++ (kernels/lanes.py)."""

import ast
import re
from dataclasses import replace
from enum import IntEnum
from typing import Any

from warpsar.kernels.lane_kinds import BOOL, FLOAT, INT, Kind, cast, join

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
_RANDOM = {"rand_init": Kind("wp::uint32"), "randf": FLOAT}  # of one ray alone: its state changes


class Expressions:
    """The text of an expression, and its kind. Names, functions and structs are the concern of whoever inherits."""

    function: Any  # the `@wp.func`
    kinds: dict[str, Kind]  # of its variables
    scopes: list[set[str]]  # variables declared, of the outermost block first

    def unknown(self, node: ast.AST) -> NotImplementedError:
        line = self.function.adj.fun_lineno + getattr(node, "lineno", 1) - 1
        return NotImplementedError(
            f"{self.function.adj.filename}:{line}: {ast.unparse(node)!r} cannot be written in lanes"
        )

    def variable(self, name: str) -> str:
        raise NotImplementedError

    def translated(self, function: Any, kinds: tuple[Kind, ...]) -> tuple[str, Kind]:
        raise NotImplementedError

    def made(self, struct: Any) -> Kind:
        raise NotImplementedError

    def declared(self, name: str) -> bool:
        return any(name in scope for scope in self.scopes)

    def static(self, node: ast.expr) -> Any:
        """The value of a name from outside of the function; None for a variable."""
        match node:
            case ast.Name(name) if name not in self.kinds:
                return self.function.func.__globals__.get(name)
            case ast.Attribute(of, name):
                return getattr(self.static(of), name, None)
        return None

    def value(self, node: ast.expr) -> tuple[str, Kind]:
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
            case ast.Subscript(of, at):
                index = at.value if isinstance(at, ast.Constant) else self.static(at)
                if isinstance(index, int):
                    text, kind = self.value(of)
                    return f"{text}.c[{int(index)}]", replace(kind, size=0)
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
                return f"{a} {_COMPARISONS[type(sign)]} {b}", Kind("bool", one.lanes or other.lanes)
            case ast.Call():
                return self.call(node)
        raise self.unknown(node)

    def arithmetic(self, left: ast.expr, sign: ast.operator, right: ast.expr) -> tuple[str, Kind]:
        (a, one), (b, other) = self.value(left), self.value(right)
        joined = join(one, other)
        rank = _PRECEDENCE[type(sign)]
        a = f"({a})" if _rank(left) < rank else a
        b = f"({b})" if _rank(right) <= rank else b
        if (one.size or other.size) and not (one.lanes or other.lanes):
            return f"wp::{_OF_VECTORS_ALIKE[type(sign)]}({a}, {b})", one if one.size else other
        if one.size or other.size:
            wide = Kind("float", True, max(one.size, other.size))
            if one.size and other.size:
                a, b = cast(a, one, wide), cast(b, other, wide)
            elif other.size:  # the number second, as the operators have it
                a, b = cast(b, other, wide), cast(a, one, Kind("float", True))
            else:
                a, b = cast(a, one, wide), cast(b, other, Kind("float", True))
            return f"{a} {_SIGNS[type(sign)]} {b}", wide
        if joined.lanes and joined.base == "float":
            a, b = (cast(x, k, joined) if k.base == "int" and k.lanes else x for x, k in ((a, one), (b, other)))
        return f"{a} {_SIGNS[type(sign)]} {b}", joined

    def logic(self, both: bool, values: list[ast.expr]) -> tuple[str, Kind]:
        found = [self.value(each) for each in values]
        kind = Kind("bool", any(kind.lanes for _, kind in found))
        sign = ("&", "|") if kind.lanes else ("&&", "||")
        return f" {sign[not both]} ".join(f"({cast(text, k, kind)})" for text, k in found), kind

    def call(self, node: ast.Call) -> tuple[str, Kind]:
        if isinstance(node.func, ast.Call):  # type(x)(1.0)
            return self.value(node.args[0])
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        called = self.static(node.func)
        if hasattr(called, "native_name"):
            kind = self.made(called)
            return f"{kind.cpp}{{}}", kind
        found = [self.value(each) for each in node.args]
        if name in ("float", "int"):
            (text, kind), wanted = found[0], Kind(name, found[0][1].lanes)
            if kind.lanes and kind.base != name:
                return f"__builtin_convertvector({text}, {wanted.cpp})", wanted
            return (text if kind.base == name else f"wp::{name}32({text})"), wanted
        if getattr(called, "func", None) is not None:
            inner, kind = self.translated(called, tuple(kind for _, kind in found))
            return f"{inner}({', '.join(text for text, _ in found)})", kind
        return self.word(node, node.func.attr if isinstance(node.func, ast.Attribute) else name, found)

    def word(self, node: ast.Call, name: str, found: list[tuple[str, Kind]]) -> tuple[str, Kind]:
        """A function or type of Warp's own."""
        lanes = any(kind.lanes for _, kind in found)
        scope = "" if lanes else "wp::"
        texts = [text for text, _ in found]
        if re.fullmatch(r"vector|vec[2-9]i?", name):
            kind = Kind("int" if name.endswith("i") else "float", lanes, len(found))
            if name != "vector" and name[3] != str(kind.size):
                raise self.unknown(node)
            texts = [cast(text, k, replace(kind, size=0)) for text, k in found]
            return f"{kind.cpp}{{{', '.join(texts)}}}" if not lanes else f"{kind.cpp}{{{{{', '.join(texts)}}}}}", kind
        if name in _RANDOM and not lanes:
            return f"wp::{name}({', '.join(texts)})", _RANDOM[name]
        if name in _SAME:
            kind = Kind("int" if all(k.base == "int" for _, k in found) else "float", lanes)
            if lanes and kind.base == "int":
                raise self.unknown(node)
        elif name in _OF_VECTORS:
            kind = Kind("float", lanes, 0 if name in ("dot", "length") else found[0][1].size)
            wide = Kind("float", lanes, found[0][1].size)
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


def _literal(value: bool | int | float) -> tuple[str, Kind]:
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
