"""C++ for many hits or rays at once, written from the `@wp.func`s that CUDA and the derivatives use.

Warp's CPU code takes one hit after the other, and its compiler finds no vector registers in it. So this module walks
the syntax tree of a Warp function and writes the same steps in vectors of clang's, one element (lane) to a hit. What
is the same for all lanes (the grid of rays, the polarization) stays a plain number, and an `if` on it stays a branch.
An `if` on something that differs between lanes becomes a choice lane by lane. Every lane takes the same steps in the
same order as one hit does alone, so the numbers do not depend on where in a vector a hit lies.

Numbers are float32. Understood: arithmetic, comparisons, vectors whose indices are fixed or the number of a loop, `if`,
`for` over a range, structs, calls of further `@wp.func`s. Anything else raises `NotImplementedError` with its line.
"""

import ast
import inspect
import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from enum import IntEnum
from typing import Any

from warpsar.kernels import lane_words
from warpsar.kernels.codes import PAGE
from warpsar.kernels.lane_expressions import Expressions
from warpsar.kernels.lane_kinds import INT, LaneKind, cast, given, join, struct_text


def source(lanes: int, functions: Mapping[Any, Collection[str] | None]) -> str:
    """A C++ struct `Lanes` for the body of a `@wp.func_native`, with a static function for each of `functions`.

    `functions`: a `@wp.func`, and which of its arguments are the same for all `lanes` (None: all are). `Lanes::V` and
    `Lanes::I` hold a float and an int of every lane, `Lanes::V3` three floats (`.c[0]` to `.c[2]`); a `wp.struct` of
    lanes has an s after its name. The text is the same in every run.
    """
    unit = Unit()
    unit.add(functions)
    return unit.text(lanes)


def enum(codes: type[IntEnum]) -> str:
    """The codes' names for native code."""
    return f"enum {{ {', '.join(f'{code.name} = {code.value}' for code in codes)} }};\n"


_BY_HAND: dict[Any, tuple[str, Mapping[Any, Collection[str] | None]]] = {}


def by_hand(function: Any, text: str, calls: Mapping[Any, Collection[str] | None]) -> None:
    """Let `text`, a static function of C++, stand for a `@wp.func` in lanes: one that reads memory in a way of its own.

    It has the function's name and result, and may call the functions `calls`, given as those of `source`.
    """
    _BY_HAND[function] = text, calls


class Unit:
    """The functions and structs of one text, each once for each kind of its arguments."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self.structs: dict[str, str] = {}
        self._known: dict[tuple[Any, tuple[LaneKind, ...]], tuple[str, LaneKind]] = {}
        self._several: dict[tuple[str, tuple[LaneKind, ...]], int] = {}

    def add(self, functions: Mapping[Any, Collection[str] | None]) -> None:
        """Each of the functions, as `source` says."""
        for function, uniform in functions.items():
            kinds = []
            for name, parameter in inspect.signature(function.func).parameters.items():
                kind = given(parameter.annotation, uniform is not None and name not in uniform)
                kinds.append(self.struct(kind.struct, True) if kind.struct and kind.lanes else kind)
            self.translated(function, tuple(kinds))

    def translated(self, function: Any, kinds: tuple[LaneKind, ...]) -> tuple[str, LaneKind]:
        """The function's name in C++ and the kind of its result. C++ tells its versions apart by their arguments."""
        kinds = tuple(replace(kind, thread=False) for kind in kinds)
        key = (function, kinds)
        if key not in self._known and function in _BY_HAND:
            self._known[key] = function.func.__name__, given(function.func.__annotations__["return"], True)
            text, calls = _BY_HAND[function]
            self.add(calls)
            self.texts.append(text)
        elif key not in self._known:
            written = Function(self, function, kinds)
            self._known[key] = written.name, written.result
            self.texts.append(written.text)
        return self._known[key]

    def text(self, lanes: int) -> str:
        """All of them as the C++ struct `Lanes`."""
        body = "".join(self.structs.values()) + "\n".join(self.texts)
        sizes = sorted({int(n) for n in re.findall(r"\bV(\d+)\b", body)})
        vectors = "".join(lane_words.vector(n) for n in sizes)
        if re.search(r"\b(gather|store)\(", body):
            vectors += "".join(lane_words.memory(n) for n in sizes if n <= PAGE or n % PAGE == 0)
        return lane_words.struct(lanes, vectors + body)

    def struct(self, struct: Any, lanes: bool) -> LaneKind:
        """A `wp.struct` that a function makes; of lanes it is called after the many that it holds."""
        kind = LaneKind(struct.key + "s" * lanes, lanes, struct=struct)
        self.structs[kind.base] = struct_text(kind.base, {name: kind.field(name) for name in struct.vars})
        return kind

    def results(self, function: str, parts: tuple[LaneKind, ...]) -> LaneKind:
        """Several results of one function, as a struct."""
        number = self._several.setdefault((function, parts), sum(name == function for name, _ in self._several))
        kind = LaneKind(f"{function}_results{number or ''}", parts=parts)
        self.structs[kind.base] = struct_text(kind.base, {f"part{i}": part for i, part in enumerate(parts)})
        return kind


class Function(Expressions):
    """One `@wp.func` in C++. The first passes only find which variables differ between lanes; the last one counts."""

    def __init__(self, unit: Unit, function: Any, kinds: tuple[LaneKind, ...]) -> None:
        self.unit, self.function = unit, function
        self.tree: ast.FunctionDef = function.adj.tree.body[0]  # parsed by Warp, and not changed
        self.name = self.tree.name
        self.lanes = any(kind.lanes for kind in kinds)  # of the structs that it makes
        self.called = set(re.findall(r"(\w+)\(", function.adj.source))
        self.arguments = [a.arg for a in self.tree.args.args]
        self.kinds = dict(zip(self.arguments, kinds, strict=True))
        self.returned: LaneKind | None = None
        self.settled = False
        while not self.settled:
            self.settled = True
            self.lines: list[str] = []
            self.scopes = [set(self.arguments)]
            self.masks: list[tuple[str, int]] = []  # lanes that a branch is for, and how many scopes lie outside
            self.early: list[tuple[str, str]] = []  # lanes that have returned, and what
            self.numbers: dict[str, int] = {}
            self.block(self.tree.body)
        self.result = self.ended()
        arguments = ", ".join(
            f"{f'const {kind.cpp}&' if kind.by_reference else kind.cpp} {self.variable(name)}"
            for name, kind in zip(self.arguments, kinds, strict=True)
        )
        head = f"// {function.func.__module__}.{self.name}\n[[gnu::always_inline]] static {self.result.cpp} {self.name}"
        self.text: str = f"{head}({arguments})\n{{\n" + "".join(f"    {line}\n" for line in self.lines) + "}\n"

    def ended(self) -> LaneKind:
        """The kind of the result."""
        if self.returned is None:
            raise self.unknown(self.tree)
        return self.returned

    def translated(self, function: Any, kinds: tuple[LaneKind, ...]) -> tuple[str, LaneKind]:
        return self.unit.translated(function, kinds)

    def made(self, struct: Any) -> LaneKind:
        return self.unit.struct(struct, self.lanes)

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
                case ast.Expr(ast.Call(ast.Name("write_vec4"), [array, at, value])):
                    self.store(array, at, value)
                case ast.Assign([ast.Subscript(array, at)], value) if self.is_array(array):
                    self.store(array, at, value)
                case ast.Assign([ast.Tuple(names)], value):
                    self.unpack(names, value)
                case ast.Assign([target], value):
                    self.assign(target, *self.value(value))
                case ast.AugAssign(target, sign, value):
                    read = ast.copy_location(ast.BinOp(target, sign, value), statement)
                    self.assign(target, *self.value(read))
                case ast.If(ast.Constant(known)):  # a `wp.static`
                    self.block(statement.body if known else statement.orelse)
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

    def assign(self, target: ast.expr, text: str, kind: LaneKind) -> None:
        if not isinstance(target, ast.Name):  # a field, or an element of a vector
            place, known = self.value(target)
            text = cast(text, kind, known)
            self.emit(f"{place} = {f'choose({self.masks[-1][0]}, {text}, {place})' if self.masks else text};")
            return
        name = target.id
        mask, outside = self.masks[-1] if self.masks else ("", 0)
        blended = any(name in scope for scope in self.scopes[:outside])
        joined = join(self.kinds.get(name), replace(kind, lanes=True) if blended else kind)
        an_argument = name in self.arguments and joined != self.kinds[name]
        if joined.size != kind.size or (blended and joined.struct) or an_argument:
            raise self.unknown(target)
        self.settled &= self.kinds.setdefault(name, joined) == joined
        self.kinds[name] = joined
        text = cast(text, kind, joined)
        variable = self.variable(name)
        if blended:
            self.emit(f"{variable} = choose({mask}, {text}, {variable});")
        elif self.declared(name):
            self.emit(f"{variable} = {text};")
        else:
            self.scopes[-1].add(name)
            self.emit(f"{joined.cpp} {variable} = {text};")

    def store(self, array: ast.expr, at: ast.expr, value: ast.expr) -> None:
        (data, of), (place, index), (text, kind) = self.value(array), self.value(at), self.value(value)
        wanted = replace(of.element(), lanes=True)
        if not index.lanes or wanted.base != "float":
            raise self.unknown(at)
        mask = f"{self.masks[-1][0]}, " if self.masks else ""
        self.emit(f"store({data}.data, {place}, count, {mask}{cast(text, kind, wanted)});")

    def unpack(self, names: list[ast.expr], value: ast.expr) -> None:
        text, kind = self.value(value)
        found = self.fresh("found")
        self.emit(f"const {kind.cpp} {found} = {text};")
        for i, (name, part) in enumerate(zip(names, kind.parts, strict=True)):
            self.assign(name, f"{found}.part{i}", part)

    def repeat(self, name: str, bounds: list[ast.expr], body: list[ast.stmt]) -> None:
        ends = [self.value(bound) for bound in bounds]
        if len(ends) > 2 or any(kind.lanes for _, kind in ends):
            raise self.unknown(bounds[-1])
        first, last = ("0", ends[0][0]) if len(ends) == 1 else (ends[0][0], ends[1][0])
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
            if len(self.scopes) > 1:
                raise self.unknown(last)
            early = self.fresh("early")
            self.emit(f"V {early} = 0.0f;")
            self.early.append((mask, early))
            self.returned = self.kinds[early] = LaneKind("float", True)
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
        joined = join(self.returned, kind)
        if joined.size != kind.size:
            raise self.unknown(value)
        self.settled &= self.returned in (None, joined)
        self.returned = joined
        text = cast(text, kind, self.returned)
        for mask, early in reversed(self.early):
            text = f"choose({mask}, {early}, {text})"
        self.emit(f"return {text};")


def _takes_long(body: list[ast.stmt]) -> bool:
    """A function that is called, or two divisions: less is done before it is known which way a branch goes."""
    parts = [part for statement in body for part in ast.walk(statement)]
    called = {ast.unparse(part.func).removeprefix("wp.") for part in parts if isinstance(part, ast.Call)}
    light = re.compile(r"type\(.*|vec.*|float|int|abs|min|max|clamp|dot|floor")
    return sum(isinstance(p, ast.Div) for p in parts) > 1 or any(not light.fullmatch(name) for name in called)
