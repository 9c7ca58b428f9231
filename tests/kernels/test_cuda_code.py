"""What kernels become for CUDA: NVRTC needs no device, so a machine without a GPU can hold it."""

import ast
import inspect
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from types import ModuleType

import pytest
import warp as wp

import warpsar.kernels

QUERIES = {"mesh_query_ray", "mesh_query_ray_anyhit", "mesh_query_ray_count_intersections", "mesh_query_point"}
MOST_QUERIES = 16
"""Copies of a query in a kernel: 12 of `border_kernel` take NVRTC six seconds, 444 took it more than ten minutes."""

MODULES = sorted(
    name
    for _, name, package in walk_packages(warpsar.kernels.__path__, "warpsar.kernels.")
    if not package and not name.endswith("lanes")  # those are for the CPU alone
)


def trips(loop: ast.For, scope: ModuleType) -> int:
    """How often Warp writes out the body of a loop: a loop whose count is no constant is left a loop."""
    try:
        count = len(eval(ast.unparse(loop.iter), {**vars(scope), "int": int, "range": range}))
    except (AttributeError, NameError, TypeError):
        return 1
    most = wp.get_module(scope.__name__).options.get("max_unroll", 16)
    return count if count <= most else 1


@cache
def queries(function: Callable[..., object], scope: ModuleType) -> int:
    """Copies of ray queries in a function's code, those of the functions that it calls included."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body

    def count(node: ast.AST) -> int:
        many = sum(count(child) for child in ast.iter_child_nodes(node))
        if isinstance(node, ast.For):
            return many * trips(node, scope)
        if not isinstance(node, ast.Call):
            return many
        if isinstance(node.func, ast.Attribute):
            return many + (node.func.attr in QUERIES)
        called = getattr(scope, getattr(node.func, "id", ""), None)
        if isinstance(called, wp.Function) and called.func is not None:
            return many + queries(called.func, sys.modules[called.func.__module__])
        return many

    return sum(count(part) for part in tree.body)


def kernels() -> Iterator[tuple[str, int]]:
    for name in MODULES:
        module = import_module(name)
        for kernel in vars(module).values():
            if isinstance(kernel, wp.Kernel) and kernel.func.__module__ == name:
                yield f"{name}.{kernel.func.__name__}", queries(kernel.func, module)


def test_no_kernel_holds_many_copies_of_a_ray_query() -> None:
    """CUDA's compiler puts each call's own copy into a kernel; Warp writes out loops of up to 16 rounds by itself."""
    counts = dict(kernels())
    assert counts["warpsar.kernels.trace.query_kernel"] == 1
    assert {name: count for name, count in counts.items() if count > MOST_QUERIES} == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", MODULES)
def test_modules_compile_for_cuda(name: str, tmp_path: Path) -> None:
    """The slowest takes 21 s on one core; a minute is beyond what anyone waits for at a first run."""
    if not any(isinstance(one, wp.Kernel) for one in vars(import_module(name)).values()):
        pytest.skip("no kernels")
    code = """
import importlib, sys
import warp as wp

wp.compile_aot_module(importlib.import_module(sys.argv[1]), arch=[80], module_dir=sys.argv[2], use_ptx=True)
"""
    subprocess.run([sys.executable, "-c", code, name, str(tmp_path)], check=True, capture_output=True, timeout=120)
    assert list(tmp_path.glob("*.ptx"))
