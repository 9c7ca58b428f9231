"""C++ for many hits or rays at once, written from the `@wp.func`s that CUDA and the derivatives use.

Warp's CPU code takes one hit after the other, and its compiler finds no vector registers in it. So this module walks
the syntax tree of a Warp function and writes the same steps in vectors of clang's, one element (lane) to a hit. What
is the same for all lanes (the grid of rays, the polarization) stays a plain number, and an `if` on it stays a branch.
An `if` on something that differs between lanes becomes a choice lane by lane. Every lane takes the same steps in the
same order as one hit does alone, so the numbers do not depend on where in a vector a hit lies.

Numbers are float32. Understood: arithmetic, comparisons, vectors with fixed indices, `if`, `for` over a range,
structs, calls of further `@wp.func`s. Anything else raises `NotImplementedError` with its line.
"""

import ast
import ctypes
import inspect
import re
import textwrap
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import warp as wp

from warpsar.kernels import lane_words


@dataclass(frozen=True)
class Kind:
    """What a value is: `base` is float, int, bool, or a struct's name; `size` of a vector, else 0."""

    base: str
    lanes: bool = False  # one value for each lane, else one for all
    size: int = 0
    struct: Any = None
    parts: tuple["Kind", ...] = ()  # of several results

    @property
    def cpp(self) -> str:
        if self.struct is not None or self.parts:
            return self.base
        if self.lanes:
            return f"V{self.size}" if self.size else {"float": "V"}.get(self.base, "I")
        return f"wp::vec_t<{self.size}, wp::{self.base}32>" if self.size else self.base


FLOAT, INT, BOOL = Kind("float"), Kind("int"), Kind("bool")


def source(lanes: int, functions: Mapping[Any, Collection[str] | None]) -> str:
    """A C++ struct `Lanes` for the body of a `@wp.func_native`, with a static function for each of `functions`.

    `functions`: a `@wp.func`, and which of its arguments are the same for all `lanes` (None: all are). `Lanes::V` and
    `Lanes::I` hold a float and an int of every lane, `Lanes::V3` three floats (`.c[0]` to `.c[2]`); a `wp.struct` of
    lanes has an s after its name. The text is the same in every run.
    """
    unit = _Unit()
    for function, uniform in functions.items():
        kinds = []
        for name, parameter in inspect.signature(function.func).parameters.items():
            kind = _given(parameter.annotation, uniform is not None and name not in uniform)
            kinds.append(unit.struct(kind.struct, True) if kind.struct and kind.lanes else kind)
        unit.translated(function, tuple(kinds))
    body = "\n".join(unit.texts.values())
    sizes = sorted({int(n) for n in re.findall(r"\bV(\d)\b", body + "".join(unit.structs.values()))})
    text = "".join(lane_words.vector(n) for n in sizes) + "".join(unit.structs.values()) + body
    return lane_words.begin(lanes, text) + textwrap.indent(text, "    ") + "};\n"


def enum(codes: type[IntEnum]) -> str:
    """The codes' names for native code."""
    return f"enum {{ {', '.join(f'{code.name} = {code.value}' for code in codes)} }};\n"


def _given(annotation: Any, lanes: bool) -> Kind:
    """Kind of an argument or field from its Warp type; `Any` is a float."""
    if hasattr(annotation, "native_name"):  # a wp.struct
        return Kind(annotation.native_name, lanes, struct=annotation)
    size = annotation._length_ if isinstance(annotation, type) and issubclass(annotation, ctypes.Array) else 0
    scalar = getattr(annotation, "_wp_scalar_type_", annotation)
    return Kind("int" if scalar in (int, wp.int32) else "float", lanes, size)


def _join(a: Kind | None, b: Kind) -> Kind:
    """Kind of a variable that is given values of both kinds."""
    if a is None:
        return b
    base = "float" if "float" in (a.base, b.base) else a.base
    return replace(a, base=a.base if a.struct or a.parts else base, lanes=a.lanes or b.lanes)


class _Unit:
    """The functions and structs of one text, each once for each kind of its arguments."""

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        self.structs: dict[str, str] = {}
        self._known: dict[tuple[Any, tuple[Kind, ...]], tuple[str, Kind]] = {}

    def translated(self, function: Any, kinds: tuple[Kind, ...]) -> tuple[str, Kind]:
        """The function's name in C++ and the kind of its result. C++ tells its versions apart by their arguments."""
        key = (function, kinds)
        if key not in self._known:
            body = _Function(self, function, kinds)
            self._known[key] = body.name, body.result
            self.texts[f"{body.name} {len(self.texts)}"] = body.text
        return self._known[key]

    def struct(self, struct: Any, lanes: bool) -> Kind:
        """A `wp.struct` that a function makes; of lanes it is called after the many that it holds."""
        name = struct.key + "s" * lanes
        kind = Kind(name, lanes, struct=struct)
        fields = "".join(f"    {field(kind, each).cpp} {each};\n" for each in struct.vars)
        self.structs.setdefault(name, f"struct {name} {{\n{fields}}};\n")
        return kind

    def results(self, name: str, parts: tuple[Kind, ...]) -> Kind:
        name = f"{name}_results"
        fields = "".join(f"    {part.cpp} part{i};\n" for i, part in enumerate(parts))
        self.structs[name] = f"struct {name} {{\n{fields}}};\n"
        return Kind(name, parts=parts)


def field(kind: Kind, name: str) -> Kind:
    return _given(kind.struct.vars[name].type, kind.lanes)


_PRECEDENCE = {ast.Add: 1, ast.Sub: 1, ast.Mult: 2, ast.Div: 2}
_SIGNS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_SAME = ("sqrt", "exp", "abs", "floor", "sin", "cos", "atan2", "min", "max", "clamp")  # result as the arguments
_OF_VECTORS = ("dot", "length", "normalize", "cross")
_RANDOM = {"rand_init": Kind("wp::uint32"), "randf": FLOAT}  # of one ray alone: its state changes


class _Function:
    """One `@wp.func` in C++. The first passes only find which variables differ between lanes; the last one counts."""

    def __init__(self, unit: _Unit, function: Any, kinds: tuple[Kind, ...]) -> None:
        self.unit, self.function = unit, function
        self.tree: ast.FunctionDef = function.adj.tree.body[0]  # parsed by Warp, and not changed
        self.name = self.tree.name
        self.lanes = any(kind.lanes for kind in kinds)  # of the structs that it makes
        self.called = set(re.findall(r"(\w+)\(", function.adj.source))
        self.kinds: dict[str, Kind] = dict(zip((a.arg for a in self.tree.args.args), kinds, strict=True))
        self.returned: Kind | None = None
        self.settled = False
        while not self.settled:
            self.settled = True
            self.lines: list[str] = []
            self.scopes: list[set[str]] = [{a.arg for a in self.tree.args.args}]
            self.masks: list[tuple[str, int]] = []  # lanes that a branch is for, and how many scopes lie outside
            self.early: list[tuple[str, str]] = []  # lanes that have returned, and what
            self.numbers: dict[str, int] = {}
            self.block(self.tree.body)
        if self.returned is None:
            raise self.unknown(self.tree)
        self.result = self.returned
        arguments = ", ".join(
            f"const {kind.cpp}& {self.variable(a.arg)}" if kind.size or kind.struct else f"{kind.cpp} {self.variable(a.arg)}"
            for a, kind in zip(self.tree.args.args, kinds, strict=True)
        )
        head = f"// {function.func.__module__}.{self.name}\n[[gnu::always_inline]] static {self.result.cpp} {self.name}"
        self.text = f"{head}({arguments})\n{{\n" + "".join(f"    {line}\n" for line in self.lines) + "}\n"

    def unknown(self, node: ast.AST) -> NotImplementedError:
        line = self.function.adj.fun_lineno + getattr(node, "lineno", 1) - 1
        return NotImplementedError(
            f"{self.function.adj.filename}:{line}: {ast.unparse(node)!r} cannot be written in lanes"
        )

    # ---- statements ----

    def emit(self, line: str) -> None:
        self.lines.append("    " * (len(self.scopes) - 1) + line)

    def fresh(self, what: str) -> str:
        self.numbers[what] = self.numbers.get(what, 0) + 1
        return f"{what}{self.numbers[what]}"

    def variable(self, name: str) -> str:
        """A variable in C++, where it may not be called as a function that it is given by."""
        return f"{name}_" if name in self.called else name

    def block(self, statements: list[ast.stmt]) -> None:
        for statement in statements:
            match statement:
                case ast.Expr(ast.Constant(str())):  # what it is for
                    pass
                case ast.Assign([ast.Tuple(names)], value):
                    self.unpack(names, value)
                case ast.Assign([target], value):
                    self.assign(target, *self.value(value))
                case ast.AugAssign(target, sign, value):
                    read = ast.copy_location(ast.BinOp(target, sign, value), statement)
                    self.assign(target, *self.value(read))
                case ast.If():
                    self.branch(statement)
                case ast.For(ast.Name(name), ast.Call(ast.Name("range"), bounds)):
                    self.repeat(name, bounds, statement.body)
                case ast.Return(value) if value is not None:
                    self.leave(value)
                case _:
                    raise self.unknown(statement)

    def inside(self, head: str, statements: list[ast.stmt]) -> None:
        self.emit(f"{head} {{")
        self.scopes.append(set())
        self.block(statements)
        self.scopes.pop()
        self.emit("}")

    def assign(self, target: ast.expr, text: str, kind: Kind) -> None:
        if not isinstance(target, ast.Name):  # a field
            place, known = self.value(target)
            text = self.cast(text, kind, known)
            self.emit(f"{place} = {f'choose({self.masks[-1][0]}, {text}, {place})' if self.masks else text};")
            return
        name = target.id
        mask, outside = self.masks[-1] if self.masks else ("", 0)
        blended = any(name in scope for scope in self.scopes[:outside])
        joined = _join(self.kinds.get(name), replace(kind, lanes=True) if blended else kind)
        if joined.size != kind.size or (blended and joined.struct):
            raise self.unknown(target)
        self.settled &= self.kinds.setdefault(name, joined) == joined
        self.kinds[name] = joined
        text = self.cast(text, kind, joined)
        variable = self.variable(name)
        if blended:
            self.emit(f"{variable} = choose({mask}, {text}, {variable});")
        elif any(name in scope for scope in self.scopes):
            self.emit(f"{variable} = {text};")
        else:
            self.scopes[-1].add(name)
            self.emit(f"{joined.cpp} {variable} = {text};")

    def unpack(self, names: list[ast.expr], value: ast.expr) -> None:
        if isinstance(value, ast.Tuple):
            for name, each in zip(names, value.elts, strict=True):
                self.assign(name, *self.value(each))
            return
        text, kind = self.value(value)
        found = self.fresh("found")
        self.emit(f"const {kind.cpp} {found} = {text};")
        for i, (name, part) in enumerate(zip(names, kind.parts, strict=True)):
            self.assign(name, f"{found}.part{i}", part)

    def repeat(self, name: str, bounds: list[ast.expr], body: list[ast.stmt]) -> None:
        ends = [self.value(bound)[0] for bound in bounds]
        first, last = ("0", *ends) if len(ends) == 1 else (ends[0], ends[1])
        self.kinds[name] = INT
        i = self.variable(name)
        self.emit(f"for (int {i} = {first}; {i} < {last}; ++{i}) {{")
        self.scopes.append({name})
        self.block(body)
        self.scopes.pop()
        self.emit("}")

    def branch(self, statement: ast.If) -> None:
        text, kind = self.value(statement.test)
        if not kind.lanes:
            self.inside(f"if ({text})", statement.body)
            if statement.orelse:
                self.inside("else", statement.orelse)
            return
        outer = self.masks[-1][0] if self.masks else ""
        mask = self.fresh("when")
        self.emit(f"const I {mask} = {f'{outer} & ({text})' if outer else text};")
        self.lanes_of(mask, statement.body)
        if statement.orelse:
            other = self.fresh("when")
            self.emit(f"const I {other} = {f'{outer} & ' if outer else ''}~{mask};")
            self.lanes_of(other, statement.orelse)

    def lanes_of(self, mask: str, body: list[ast.stmt]) -> None:
        """What is done for the lanes of `mask`: left out where there are none, unless that takes longer to ask."""
        *_, last = body
        if isinstance(last, ast.Return) and last.value is not None:
            early = self.fresh("early")
            self.emit(f"V {early} = 0.0f;")
            self.early.append((mask, early))
            self.returned = self.kinds[early] = Kind("float", True)
            self.scopes[-1].add(early)
            body = [*body[:-1], ast.copy_location(ast.Assign([ast.Name(early)], last.value), last)]
        self.masks.append((mask, len(self.scopes)))
        if _takes_long(body):
            self.inside(f"if (any({mask}))", body)
        else:
            self.block(body)
        self.masks.pop()

    def leave(self, value: ast.expr) -> None:
        if self.masks:
            raise self.unknown(value)
        if isinstance(value, ast.Tuple):
            found = [self.value(each) for each in value.elts]
            kind = self.unit.results(self.name, tuple(kind for _, kind in found))
            text = "{" + ", ".join(text for text, _ in found) + "}"
        else:
            text, kind = self.value(value)
        joined = _join(self.returned, kind)
        self.settled &= self.returned in (None, joined)
        self.returned = joined
        text = self.cast(text, kind, self.returned)
        for mask, early in reversed(self.early):
            text = f"choose({mask}, {early}, {text})"
        self.emit(f"return {text};")

    # ---- expressions: the text, and what it is ----

    def cast(self, text: str, kind: Kind, wanted: Kind) -> str:
        if kind.lanes == wanted.lanes and (kind.base == wanted.base or kind.struct or not wanted.lanes):
            return text
        if wanted.size:
            return f"V{wanted.size}::of({text})"
        if not kind.lanes:
            return f"(I)-wp::int32({text})" if wanted.base == "bool" else f"({wanted.cpp})({text})"
        return f"__builtin_convertvector({text}, V)" if (kind.base, wanted.base) == ("int", "float") else text

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
            case ast.Name(name) if any(name in scope for scope in self.scopes):
                return self.variable(name), self.kinds[name]
            case ast.Attribute(of, name):
                text, kind = self.value(of)
                if kind.struct is not None:
                    return f"{text}.{name}", field(kind, name)
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
        joined = _join(one, other)
        rank = _PRECEDENCE[type(sign)]
        a = f"({a})" if _rank(left) < rank else a
        b = f"({b})" if _rank(right) <= rank else b
        if (one.size or other.size) and not (one.lanes or other.lanes):
            word = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.Div: "div"}[type(sign)]
            return f"wp::{word}({a}, {b})", one if one.size else other
        if one.size or other.size:
            wide = Kind("float", True, max(one.size, other.size))
            if one.size and other.size:
                a, b = self.cast(a, one, wide), self.cast(b, other, wide)
            elif other.size:  # the number second, as the operators have it
                a, b = self.cast(b, other, wide), self.cast(a, one, Kind("float", True))
            else:
                a, b = self.cast(a, one, wide), self.cast(b, other, Kind("float", True))
            return f"{a} {_SIGNS[type(sign)]} {b}", wide
        if joined.lanes and joined.base == "float":
            a, b = (self.cast(x, k, joined) if k.base == "int" and k.lanes else x for x, k in ((a, one), (b, other)))
        return f"{a} {_SIGNS[type(sign)]} {b}", joined

    def logic(self, both: bool, values: list[ast.expr]) -> tuple[str, Kind]:
        found = [self.value(each) for each in values]
        kind = Kind("bool", any(kind.lanes for _, kind in found))
        sign = ("&", "|") if kind.lanes else ("&&", "||")
        return f" {sign[not both]} ".join(f"({self.cast(text, k, kind)})" for text, k in found), kind

    def call(self, node: ast.Call) -> tuple[str, Kind]:
        if isinstance(node.func, ast.Call):  # type(x)(1.0)
            return self.value(node.args[0])
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        called = self.static(node.func)
        if hasattr(called, "native_name"):
            kind = self.unit.struct(called, self.lanes)
            return f"{kind.cpp}{{}}", kind
        found = [self.value(each) for each in node.args]
        if name in ("float", "int"):
            (text, kind), wanted = found[0], Kind(name, found[0][1].lanes)
            if kind.lanes and kind.base != name:
                return f"__builtin_convertvector({text}, {wanted.cpp})", wanted
            return (text if kind.base == name else f"wp::{name}32({text})"), wanted
        if getattr(called, "func", None) is not None:
            inner, kind = self.unit.translated(called, tuple(kind for _, kind in found))
            return f"{inner}({', '.join(text for text, _ in found)})", kind
        return self.word(node, node.func.attr if isinstance(node.func, ast.Attribute) else name, found)

    def word(self, node: ast.Call, name: str, found: list[tuple[str, Kind]]) -> tuple[str, Kind]:
        """A function or type of Warp's own."""
        lanes = any(kind.lanes for _, kind in found)
        scope = "" if lanes else "wp::"
        texts = [text for text, _ in found]
        if re.fullmatch(r"vector|vec[2-9]i?", name):
            kind = Kind("int" if name.endswith("i") else "float", lanes, len(found))
            texts = [self.cast(text, k, replace(kind, size=0)) for text, k in found]
            return f"{kind.cpp}{{{', '.join(texts)}}}" if not lanes else f"{kind.cpp}{{{{{', '.join(texts)}}}}}", kind
        if name in _RANDOM and not lanes:
            return f"wp::{name}({', '.join(texts)})", _RANDOM[name]
        if name in _SAME:
            kind = Kind("int" if all(k.base == "int" for _, k in found) else "float", lanes)
        elif name in _OF_VECTORS:
            kind = Kind("float", lanes, 0 if name in ("dot", "length") else found[0][1].size)
            wide = Kind("float", lanes, found[0][1].size)
            return f"{scope}{name}({', '.join(self.cast(text, k, wide) for text, k in found)})", kind
        elif name == "where":
            (mask, of), *pair = found
            kind = replace(_join(pair[0][1], pair[1][1]), lanes=lanes)
            a, b = (self.cast(text, k, kind) for text, k in pair)
            if of.lanes:
                return f"choose({mask}, {a}, {b})", kind
            return f"(({mask}) ? {a} : {b})", kind
        else:
            raise self.unknown(node)
        return f"{scope}{name}({', '.join(self.cast(text, k, kind) for text, k in found)})", kind


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


def _takes_long(body: list[ast.stmt]) -> bool:
    """A function that is called, or two divisions: less is done before it is known which way a branch goes."""
    parts = [part for statement in body for part in ast.walk(statement)]
    called = {ast.unparse(part.func).removeprefix("wp.") for part in parts if isinstance(part, ast.Call)}
    light = re.compile(r"type\(.*|vec.*|float|int|abs|min|max|clamp|dot|floor")
    return sum(isinstance(p, ast.Div) for p in parts) > 1 or any(not light.fullmatch(name) for name in called)
