"""The order of kernels' arguments (docs/contributing.md), and of what launches hand to them. Nothing is compiled."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property

import pytest
from conftest import ROOT

HEADINGS = ("In", "Room", "In and out", "Out")
"""In their order; what stands under `In` is read alone."""
TELLING = 3  # letters from which a name says what it is: corners a, b, c and p0, p1, p2 may go round
ATOMIC = re.compile(r"wp\.atomic_\w+$")


@dataclass
class Function:
    """A kernel, a function of kernels, or a native one. `under`: each parameter's heading, "" for none. `written`: the
    parameters that it stores into; a native function says so by `_out`."""

    path: str
    node: ast.FunctionDef
    kind: str
    under: dict[str, str]
    written: set[str] = field(default_factory=set)

    @cached_property
    def names(self) -> list[str]:
        return list(self.under)

    @cached_property
    def calls(self) -> list[tuple[str, ast.Call]]:
        return [(ast.unparse(n.func), n) for n in ast.walk(self.node) if isinstance(n, ast.Call)]

    @cached_property
    def stored(self) -> set[str]:
        """The variables with an element that the function itself stores into."""
        if self.kind == "wp.func_native":
            return {name for name in self.names if name.endswith("_out")}
        stored = [n for n in ast.walk(self.node) if isinstance(n, ast.Subscript) and isinstance(n.ctx, ast.Store)]
        return {variable(n) for n in [*stored, *(call.args[0] for name, call in self.calls if ATOMIC.match(name))]}


def functions_in(path: str, text: str) -> list[Function]:
    """The Warp functions of a file, those inside other functions too."""
    lines, found = text.splitlines(), []
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.FunctionDef):
            continue
        kinds = {ast.unparse(d).split("(")[0] for d in node.decorator_list} & {"wp.kernel", "wp.func", "wp.func_native"}
        if not kinds:
            continue
        under, heading, at = {}, "", node.lineno
        for argument in node.args.args:
            for line in lines[at : argument.lineno - 1]:
                if said := re.match(r"\s*# (\w[\w ]*?)(, [^:]*)?:", line):
                    heading = said[1]
            under[argument.arg], at = heading, argument.lineno
        if heading:  # what stands before the first one is read
            under = {name: said or "In" for name, said in under.items()}
        found.append(Function(path, node, kinds.pop(), under))
    mark_written(found)
    return found


@cache
def kernels() -> tuple[Function, ...]:
    """All Warp functions of kernels/."""
    paths = sorted((ROOT / "kernels").rglob("*.py"))
    found = [f for path in paths for f in functions_in(str(path.relative_to(ROOT)), path.read_text(encoding="utf-8"))]
    mark_written(found)
    return tuple(found)


def by_name(found: Sequence[Function]) -> dict[str, list[Function]]:
    """All but kernels, by what they are called."""
    known: dict[str, list[Function]] = {}
    for function in found:
        if function.kind != "wp.kernel":
            known.setdefault(function.node.name, []).append(function)
    return known


def called(name: str, path: str, known: dict[str, list[Function]]) -> list[Function]:
    """The functions that a name may mean in a file: its own, or else those of others."""
    every = known.get(name, [])
    return [f for f in every if f.path == path] or every


def mark_written(found: Sequence[Function]) -> None:
    """Fill in what each function stores into, by itself and through those that it calls."""
    known = by_name(found)
    changed = True
    while changed:
        changed = False
        for function in found:
            stored = set(function.stored)
            for name, call in function.calls:
                for other in called(name, function.path, known):
                    stored |= {variable(a) for n, a in zip(other.names, call.args, strict=False) if n in other.written}
            stored &= set(function.names)
            changed |= stored != function.written
            function.written = stored


def variable(node: ast.expr) -> str:
    """The variable that an expression such as `hits.face[i]` starts from."""
    while isinstance(node, ast.Subscript | ast.Attribute):
        node = node.value
    return node.id if isinstance(node, ast.Name) else ""


def faults(kernel: Function) -> list[str]:
    """What is wrong with the order of a kernel's arguments."""
    names, written, under = kernel.names, kernel.written, kernel.under
    said = []
    if any(under.values()):
        headings = list(dict.fromkeys(under.values()))
        if [h for h in HEADINGS if h in headings] != headings or list(under.values()) != sorted(
            under.values(), key=headings.index
        ):
            said.append(f"its headings are {headings}; allowed are {list(HEADINGS)}, in this order")
        for name in names:
            if (under[name] == "In") == (name in written):
                said.append(f"{name} stands under {under[name]}, and is {'' if name in written else 'not '}written")
            if (under[name] == "Out") != name.endswith("_out"):
                said.append(f"{name} stands under {under[name]}; names under Out end in _out, and no others")
    else:
        if [n in written for n in names] != sorted(n in written for n in names):
            said.append(f"{sorted(written)} are written; they stand last")
        if len(names) > 4:
            said.append("it has more than four arguments, and no headings # In: and # Out:")
    return [f"{kernel.path}:{kernel.node.lineno} {kernel.node.name}: {one}" for one in said]


def plain(name: str) -> str:
    """A name without what says only whose it is or which way it goes."""
    return re.sub(r"^_+|_(in|out)$", "", name)


def swapped(callee: Function, arguments: Sequence[ast.expr], first: int, end: int) -> list[str]:
    """Of the arguments for the parameters from `first` to the one before `end`: those with the name of another one."""
    names = {plain(name): at for at, name in enumerate(callee.names) if first <= at < end}
    said = []
    for at, argument in enumerate(arguments, first):
        name = plain(argument.id if isinstance(argument, ast.Name) else getattr(argument, "attr", ""))
        if len(name) >= TELLING and name in names and plain(callee.names[at]) != name:
            said.append(f"{name} stands at {callee.names[at]} of {callee.node.name}")
    return said


def kernel_of(node: ast.expr, imports: dict[str, str], known: Sequence[Function]) -> Function | None:
    """The kernel that a launch names as `module.name_kernel` or `name_kernel`; None where it is chosen otherwise."""
    module, _, name = ast.unparse(node).rpartition(".")
    module = imports.get(module, "") if module else imports.get(name, "").rpartition(".")[0]
    path = module.replace("warpsar.", "").replace(".", "/") + ".py"
    return next((f for f in known if f.kind == "wp.kernel" and (f.path, f.node.name) == (path, name)), None)


def imported(tree: ast.AST) -> dict[str, str]:
    """What the names that a file imports from kernels/ stand for."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("warpsar.kernels"):
            found |= {a.asname or a.name: f"{node.module}.{a.name}" for a in node.names}
    return found


def list_of(
    node: ast.expr | None, before: int, assigned: Sequence[ast.Assign | ast.AugAssign]
) -> list[ast.expr] | None:
    """The elements of a list, or of the one that a variable was given last; None where it is made otherwise."""
    if isinstance(node, ast.List):
        return node.elts
    if not isinstance(node, ast.Name):
        return None
    last: ast.expr | None = None
    for each in (a for a in assigned if a.lineno < before):
        target = each.targets[0] if isinstance(each, ast.Assign) else each.target
        pairs = [(target, each.value)]
        if isinstance(target, ast.Tuple) and isinstance(each.value, ast.Tuple):
            pairs = list(zip(target.elts, each.value.elts, strict=False))
        for name, value in pairs:
            if isinstance(name, ast.Name) and name.id == node.id:
                last = value if isinstance(each, ast.Assign) else None
    return last.elts if isinstance(last, ast.List) else None


@dataclass
class Launched:
    """A launch whose kernel, inputs and outputs are written out where it is made."""

    kernel: Function
    line: int
    inputs: list[ast.expr]
    outputs: list[ast.expr]

    @property
    def faults(self) -> list[str]:
        """What it hands to the kernel otherwise than the kernel takes it."""
        kernel, inputs, outputs = self.kernel, self.inputs, self.outputs
        names, starred = kernel.names, [isinstance(a, ast.Starred) for a in outputs]
        known = inputs[: next((i for i, a in enumerate(inputs) if isinstance(a, ast.Starred)), len(inputs))]
        if any(starred):
            return swapped(kernel, known, 0, len(names))
        if len(known) == len(inputs) and len(inputs) + len(outputs) != len(names):
            return [f"{kernel.node.name} takes {len(names)} arguments; found {len(inputs) + len(outputs)}"]
        first, reads = len(names) - len(outputs), sum(heading == "In" for heading in kernel.under.values())
        if reads and first != reads:
            return [f"{kernel.node.name} reads {reads} arguments, which are its inputs; found {first}"]
        return swapped(kernel, known, 0, first) + swapped(kernel, outputs, first, len(names))


def launches(text: str, known: Sequence[Function]) -> Iterator[Launched]:
    tree = ast.parse(text)
    imports = imported(tree)
    for scope in (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)):
        assigned = [n for n in ast.walk(scope) if isinstance(n, ast.Assign | ast.AugAssign)]
        assigned.sort(key=lambda n: n.lineno)
        for call in (n for n in ast.walk(scope) if isinstance(n, ast.Call) and n.args):
            function = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
            kernel = kernel_of(call.args[0], imports, known) if function in ("launch", "Launch", "mapped") else None
            if kernel is not None:
                given = {k.arg: k.value for k in call.keywords}
                both = call.args[2:4] if len(call.args) > 3 else (given.get("inputs"), given.get("outputs"))
                if function == "mapped":  # `Program.mapped` makes the one output itself
                    both = (call.args[2], ast.List([ast.Name("result")]))
                inputs, outputs = (list_of(one, call.lineno, assigned) for one in both)
                if inputs is not None and outputs is not None:
                    yield Launched(kernel, call.lineno, inputs, outputs)


def test_arguments_stand_in_one_order() -> None:
    """What is read, then what is read and written, then what is written alone."""
    said = [one for function in kernels() if function.kind == "wp.kernel" for one in faults(function)]
    assert len(kernels()) > 100
    assert not said, "\n".join(said)


def test_functions_get_what_they_name() -> None:
    """Inside of kernels: an argument that has the name of a parameter stands at that parameter."""
    known, said = by_name(kernels()), []
    for function in kernels():
        for name, call in function.calls:
            for callee in called(name, function.path, known):
                n = len(callee.names)
                if n == len(call.args):
                    said += [f"{function.path}:{call.lineno}: {one}" for one in swapped(callee, call.args, 0, n)]
    assert not said, "\n".join(said)


def test_launches_hand_over_what_kernels_name() -> None:
    said, seen = [], 0
    for path in sorted((ROOT / "warpsar").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        for launched in launches(text, kernels()) if "warpsar.kernels" in text else ():
            seen += 1
            said += [f"{path.relative_to(ROOT)}:{launched.line}: {one}" for one in launched.faults]
    assert seen > 40
    assert not said, "\n".join(said)


KERNEL = """
@wp.kernel
def made_kernel(
    # In:
    weight: wp.array(dtype=float),
    image: wp.array(dtype=float),
    # Out:
    sum_out: wp.array(dtype=float),
):
    add(sum_out, weight[wp.tid()] * image[0])

@wp.func
def add(total: wp.array(dtype=float), value: float):
    wp.atomic_add(total, 0, value)
"""


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (("add(sum_out, ", "add(image, "), "image stands under In, and is written"),
        (("add(sum_out, ", "add(other, "), "sum_out stands under Out, and is not written"),
        (("sum_out", "total"), "total stands under Out; names under Out end in _out"),
        (("# In:", "# Out:"), "weight stands under Out, and is not written"),
        (("# Out:", "# Outputs:"), "its headings are ['In', 'Outputs']"),
        (("    # In:\n", ""), ""),
    ],
)
def test_a_wrong_order_is_found(change: tuple[str, str], fault: str) -> None:
    assert not faults(functions_in("made.py", KERNEL)[0])
    said = "; ".join(faults(functions_in("made.py", KERNEL.replace(*change))[0]))
    assert fault in said
    assert bool(said) == bool(fault)


@pytest.mark.parametrize(
    ("launch", "fault"),
    [
        ("wp.launch(made_kernel, 3, inputs=[self.weight, image], outputs=[total])", ""),
        ("wp.launch(made_kernel, 3, inputs=[self.image, weight], outputs=[total])", "image stands at weight"),
        ("wp.launch(made_kernel, 3, inputs=[weight], outputs=[total])", "takes 3 arguments; found 2"),
        ("wp.launch(made_kernel, 3, inputs=[weight], outputs=[image, total])", "reads 2 arguments"),
        ("program.launch(made_kernel, 3, [image, *rest], [total])", "image stands at weight"),
        ("inputs = [image, weight]\n    inputs += [more]\n    program.launch(made_kernel, 3, inputs, [total])", ""),
        ("inputs = [image, weight]\n    Launch(made_kernel, 3, inputs, [total])", "image stands at weight"),
        ("return program.mapped(made_kernel, weight, [weight, image])", ""),
        ("return program.mapped(made_kernel, weight, [image, weight])", "image stands at weight"),
    ],
)
def test_a_wrong_launch_is_found(launch: str, fault: str) -> None:
    text = f"from warpsar.kernels.made import made_kernel\ndef run():\n    {launch}\n"
    found = list(launches(text, functions_in("kernels/made.py", KERNEL)))
    said = "; ".join(one for launched in found for one in launched.faults)
    assert fault in said
    assert bool(said) == bool(fault)
