"""A kernel's work for many threads at once on the CPU, written from the kernel that CUDA and the derivatives use.

`at_once` gives a kernel of the same arguments, each thread of which does what LANES threads of the given one do. Its
C++ is kernels/lanes.py's: what it calls, and the kernel's own body, with loads of every lane's own elements and stores.
So a backscatter model or an effect is written once, as a `@wp.kernel` and its `@wp.func`s.
"""

import hashlib
import linecache
import threading
from functools import cache
from typing import Any

import warp as wp

from warpsar.kernels.lane_kinds import LaneKind, given
from warpsar.kernels.lanes import Function, Unit

LANES = 16
"""Threads of a kernel that one of `at_once` stands for."""

_KERNEL = """
@wp.func_native(native)
def work_{name}(block: int, {arguments}): ...

@wp.kernel(enable_backward=False, module="unique", module_options=options)
def {name}({arguments}):
    work_{name}(wp.tid(), {names})
"""
_writing = threading.Lock()  # views are recorded side by side


def at_once(kernel: wp.Kernel) -> wp.Kernel:
    """The kernel for LANES threads of a one-dimensional `kernel`: n of them are ceil(n / LANES) of its own.

    It knows their number by the first array of which each thread reads its own element. Raises `NotImplementedError`,
    with the line, for what lanes cannot do.
    """
    with _writing:
        return _written(kernel)


@cache
def _written(kernel: wp.Kernel) -> wp.Kernel:
    unit = Unit()
    kinds = {name: given(annotation, False) for name, annotation in kernel.adj.arg_types.items()}
    body = _Body(unit, kernel, tuple(kinds.values()))
    unit.texts.append(body.text)
    names = ", ".join(kinds)
    native = unit.text(LANES) + f"Lanes::{body.name}(block, {names});\n"
    name = f"{body.name}_{hashlib.sha256(native.encode()).hexdigest()[:12]}"
    types = {f"type_{k}": annotation for k, annotation in enumerate(kernel.adj.arg_types.values())}
    arguments = ", ".join(f"{argument}: {of}" for argument, of in zip(kinds, types, strict=True))
    text = _KERNEL.format(name=name, arguments=arguments, names=names)
    # Warp reads a function's source: it finds this one where Python's own tools look for it.
    file = f"<{__name__}.{name}>"
    linecache.cache[file] = len(text), None, text.splitlines(keepends=True), file
    found: dict[str, Any] = {"__name__": __name__, "wp": wp, "native": native, "options": _options(kernel), **types}
    exec(compile(text, file, "exec"), found)
    made: wp.Kernel = found[name]
    return made


def _options(kernel: wp.Kernel) -> dict[str, Any]:
    """Whether products may be fused into sums: all else of a module is for Warp's own code."""
    options = kernel.module.options
    return {"fuse_fp": options["fuse_fp"]} if "fuse_fp" in options else {}


class _Body(Function):
    """The body of a kernel, as a function of the block's number and the kernel's arguments."""

    def __init__(self, unit: Unit, kernel: wp.Kernel, kinds: tuple[LaneKind, ...]) -> None:
        self.counted = ""
        super().__init__(unit, kernel, kinds)
        begin = [
            f"const int begin = {LANES} * block;",
            f"const int count = wp::min({self.counted}.shape[0] - begin, {LANES});",
            # the block's threads side by side; beyond the last one, its copies
            f"I at; for (int k = 0; k < {LANES}; ++k) at[k] = begin + wp::min(k, count - 1);",
        ]
        head, _, rest = self.text.partition("{\n")
        head = head.replace(f"{self.name}(", f"{self.name}(int block, ", 1)
        self.text = head + "{\n" + "".join(f"    {line}\n" for line in begin) + rest

    def ended(self) -> LaneKind:
        if not self.counted:
            raise self.unknown(self.tree)
        return LaneKind("void")

    def by_thread(self, array: str) -> None:
        self.counted = self.counted or array

    def variable(self, name: str) -> str:
        """As in the kernel: arguments go by their names."""
        return name if name in self.arguments else super().variable(name)
