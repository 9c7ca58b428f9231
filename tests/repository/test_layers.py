"""How the house stands: rooms in one order, imports downward, no circle, lazy imports of heavy libraries alone.

Every import counts: at the top of a file, inside a function, under TYPE_CHECKING, and by string (`import_module`, or
tables of "module:attribute").
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

ROOMS = (
    "errors",
    "version",
    "kernels",
    "runtime",
    "speckle",
    "io",
    "models",
    "world",
    "trace",
    "surface",
    "effects",
    "parameters",
    "scene",
    "products",
    "formats",
    "measured",
    "render",
    "simulation",
    "coherent",
    "collection",
    "calibration",
    "terrain",
    "curves",
    "compare",
    "differentiable",
    "learning",
    "evaluation",
    "diagnosis",
    "viewer",
    "cli",
    "__init__",
    "__main__",
)
"""From the ground up: a room imports its own files and those of rooms below. docs/design.md says what lives in each."""

SLOW = {"warp", "matplotlib", "trimesh", "OpenImageIO", "PIL", "scipy.signal", "scipy.stats"}
EXTRAS = {
    "rasterio",
    "pyproj",
    "affine",
    "shapely",
    "torch",
    "jax",
    "h5py",
    "sarkit",
    "lxml",
    "xatlas",
    "xarray",
    "h5netcdf",
    "zarr",
}
HEAVY = SLOW | EXTRAS
"""Slow to import, or in an extra that may be missing: they alone may be imported inside a function."""


REGISTRIES = ("effects", "models", "formats", "simulation.formats", "diagnosis.geometry")
"""Folders of which `registry.py` finds the files by name."""

PROCESSES = "warpsar.runtime.distributed"
ONCE = "warpsar.runtime.once"
"""What everybody else asks. To all others a run is one program, whose work is shared by whoever is there."""
READS_TORCHRUN = {f"warpsar.runtime.{name}" for name in ("busy", "console", "devices", "memory", "threads")}
"""They read of the environment how many processes share this host's cores, and which of them speaks."""


@dataclass(frozen=True)
class Arrow:
    """`importer` takes something from `imported`, both dotted names of modules; `lazy`: not at the top of the file."""

    importer: str
    imported: str
    lazy: bool


def sources(root: Path) -> dict[str, Path]:
    """Every module of the package, by the name that it is imported under."""
    found = {}
    for folder, package in (("warpsar", "warpsar"), ("kernels", "warpsar.kernels"), ("cli", "warpsar.cli")):
        for path in (root / folder).rglob("*.py"):
            parts = path.relative_to(root / folder).with_suffix("").parts
            found[".".join([package, *(part for part in parts if part != "__init__")])] = path
    return found


def _nodes(tree: ast.AST) -> Iterator[tuple[ast.AST, bool]]:
    """Every node below `tree`, and whether it runs later than the file: in a function, or for types alone."""
    waiting = [(tree, False)]
    while waiting:
        node, lazy = waiting.pop()
        type_only = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        lazy = lazy or type_only or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        below = [(child, lazy) for child in ast.iter_child_nodes(node)]
        yield from below
        waiting += below


def _named(text: str, whole: bool, modules: dict[str, Path]) -> list[str]:
    """The modules that a string names: itself, or, of the beginning of a name, all that begin so."""
    name = text.partition(":")[0]
    if whole:
        return [name] if name in modules and name != "warpsar" else []
    return [m for m in modules if re.fullmatch(r"warpsar(\.\w+)*\.", name) and m.startswith(name)]


def imports(path: Path, name: str, modules: dict[str, Path]) -> Iterator[tuple[str, bool]]:
    """What a file imports: names of this package's modules, or of other libraries, and whether lazily."""
    nodes = list(_nodes(ast.parse(path.read_text(encoding="utf-8"))))
    pieces = {part for node, _ in nodes if isinstance(node, ast.JoinedStr) for part in node.values}
    for node, lazy in nodes:
        if isinstance(node, ast.Import):
            yield from ((alias.name, lazy) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: a relative import; write the module's whole name"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield (inner if inner in modules else str(node.module)), lazy
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.startswith("warpsar."):
            begins = node in pieces and node.value.endswith(".")
            yield from ((found, True) for found in _named(node.value, not begins, modules) if found != name)


def arrows(root: Path) -> list[Arrow]:
    modules = sources(root)
    return [
        Arrow(name, imported, lazy) for name, path in modules.items() for imported, lazy in imports(path, name, modules)
    ]


def prefixes(module: str) -> set[str]:
    """The module's name, and those of all that it lies in."""
    parts = module.split(".")
    return {".".join(parts[:k]) for k in range(1, len(parts) + 1)}


def room(module: str) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


def upward(found: list[Arrow]) -> list[str]:
    own = [a for a in found if a.imported.split(".")[0] == "warpsar"]
    return [
        f"{a.importer} -> {a.imported}" for a in own if ROOMS.index(room(a.imported)) > ROOMS.index(room(a.importer))
    ]


def circles(found: list[Arrow]) -> list[list[str]]:
    """Modules that reach themselves through others, a circle each (Tarjan 1972)."""
    below: dict[str, set[str]] = {}
    for arrow in found:
        below.setdefault(arrow.importer, set()).add(arrow.imported)
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    rings: list[list[str]] = []

    def visit(module: str) -> None:
        index[module] = low[module] = len(index)
        stack.append(module)
        for other in below.get(module, ()):
            if other not in index:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in stack:
                low[module] = min(low[module], index[other])
        if low[module] == index[module]:
            ring = stack[stack.index(module) :]
            del stack[stack.index(module) :]
            if len(ring) > 1 or module in below.get(module, ()):
                rings.append(sorted(ring))

    for module in below:
        if module not in index:
            visit(module)
    return rings


@pytest.fixture(scope="session")
def found() -> list[Arrow]:
    """The arrows of this house: every file is parsed once for all tests, not once for each."""
    return arrows(ROOT)


def test_no_arrow_runs_up(found: list[Arrow]) -> None:
    assert upward(found) == []


def test_no_circle(found: list[Arrow]) -> None:
    assert circles(found) == []


def test_no_circle_between_the_folders_of_a_room(found: list[Arrow]) -> None:
    """A folder inside a room counts as one module. Two folders that need each other are one folder."""
    modules = sources(ROOT)
    folder = {name: name.rpartition(".")[0] if name.count(".") > 2 else name for name in modules}
    between = [
        Arrow(folder[a.importer], folder[a.imported], a.lazy)
        for a in found
        if a.imported in folder and folder[a.importer] != folder[a.imported]
    ]
    assert circles(between) == []


def test_every_room_has_its_place() -> None:
    assert {room(module) for module in sources(ROOT)} == set(ROOMS)


def test_the_design_page_lists_the_rooms_in_their_order() -> None:
    page = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`\S+?`(?:, `\S+?`)*) \|", page, re.MULTILINE)
    named = [name.removesuffix("/").removesuffix(".py") for row in rows for name in re.findall(r"`(\S+?)`", row)]
    assert [name for name in named if name in ROOMS] == [
        r for r in ("errors", "version", *ROOMS[2:]) if not r.startswith("__")
    ]


def test_each_folder_says_what_its_files_do() -> None:
    """By name, in its `__init__.py`. What a registry finds by looking into its folder needs no list."""
    folders = ("effects", "models", "formats", "simulation/formats", "render/ways", "diagnosis/geometry")
    found = [ROOT / "warpsar" / folder for folder in folders]
    unlisted = []
    for text in (*(ROOT / "warpsar").glob("*/**/__init__.py"), ROOT / "kernels" / "coherent" / "__init__.py"):
        if text.parent in found:
            continue
        said = set(re.findall(r"\w+", text.read_text(encoding="utf-8")))
        unlisted += [path for path in text.parent.glob("*.py") if path != text and path.stem not in said]
    assert unlisted == []


def test_lazy_imports_are_of_heavy_libraries(found: list[Arrow]) -> None:
    """cli/ apart, whose commands import their work when they are called: help needs no engine; and the faces of the
    package, which name by string what is imported when it is asked for."""
    by_string = {"warpsar", "warpsar.runtime.devices"}
    by_string |= {f"warpsar.{folder}.registry" for folder in REGISTRIES}
    by_string |= {"warpsar.kernels.scatter", "warpsar.render.models"}  # what a backscatter model has, by its name
    lazy = [a for a in found if a.lazy and room(a.importer) != "cli" and a.importer not in by_string]
    assert [f"{a.importer} -> {a.imported}" for a in lazy if not HEAVY & prefixes(a.imported)] == []


def test_no_command_waits_for_distributions(found: list[Arrow]) -> None:
    """scipy.special has all that the rooms which every command imports need of them, and loads in no time."""
    top = [a for a in found if not a.lazy and {"scipy.signal", "scipy.stats"} & prefixes(a.imported)]
    assert {room(a.importer) for a in top} <= {"calibration"}


def test_extras_are_never_imported_at_the_top(found: list[Arrow]) -> None:
    """A plain installation has none of them; and nothing is imported that pyproject.toml does not ask for."""
    asked = (
        {"click", "lazy_loader", "numpy", "pydantic", "scipy", "tomlkit", "tqdm", "warpsar"}
        | SLOW
        | set(sys.stdlib_module_names)
    )
    top = [a for a in found if not a.lazy]
    assert [f"{a.importer} -> {a.imported}" for a in top if a.imported.split(".")[0] not in asked] == []


def knowing(found: list[Arrow]) -> dict[str, set[str]]:
    """By module of the package for several processes: who outside of it imports it."""
    inside: dict[str, set[str]] = {}
    for a in found:
        if (a.imported + ".").startswith(PROCESSES + ".") and not (a.importer + ".").startswith(PROCESSES + "."):
            inside.setdefault(a.imported.removeprefix(PROCESSES).removeprefix("."), set()).add(a.importer)
    return inside


def ranked(path: Path) -> set[str]:
    """What a file names of several processes: an argument or attribute that is a process's rank, torch's package,
    torchrun's environment."""
    names = set()
    ranks = {"ranks", "_ranks", "torch.distributed", "RANK", "LOCAL_RANK", "WORLD_SIZE"}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        of_node = [getattr(node, key, None) for key in ("attr", "arg", "name", "value")]
        names |= ranks.intersection(name for name in of_node if isinstance(name, str))
        names |= {"rank"} if isinstance(node, ast.Attribute) and node.attr == "rank" else set()
    return names


def test_files_are_written_by_commands() -> None:
    """A command knows which process writes; what it calls makes values. A checkpoint and the maps of a learned scene
    are written while a run goes on."""
    writing = set()
    for name, path in sources(ROOT).items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and ast.unparse(node) in ("once.write", "once.restarts"):
                writing.add(name)
    assert "warpsar.io.checkpoint" in writing
    commands = {name for name in writing if name.endswith(".command") or name.startswith("warpsar.cli.")}
    batch = {"warpsar.simulation.batch", "warpsar.simulation.index"}
    assert writing - commands == {"warpsar.io.checkpoint", "warpsar.learning.learn"} | batch


def test_processes_are_known_where_work_is_shared(found: list[Arrow]) -> None:
    assert knowing(found) == {"processes": {ONCE}, "torchrun": READS_TORCHRUN}
    naming = {name for name, path in sources(ROOT).items() if ranked(path) and not name.startswith(PROCESSES)}
    assert naming == {ONCE}  # `number` is the process's rank
    for path in (*ROOT.glob("benchmarks/**/*.py"), *ROOT.glob("examples/**/*.py")):
        assert PROCESSES not in path.read_text(encoding="utf-8"), path


@pytest.fixture
def house(tmp_path: Path) -> Path:
    """A small house in good order."""
    for name, text in {
        "warpsar/errors.py": "",
        "warpsar/world/mesh.py": "from warpsar.errors import InputError",
        "warpsar/scene/scene.py": "from warpsar.world.mesh import Mesh",
        "kernels/trace.py": "",
        "cli/main.py": "",
    }.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path


UP = {
    "at the top": "from warpsar.scene.scene import Scene",
    "in a function": "def load():\n    from warpsar.scene import scene",
    "for types": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import warpsar.scene.scene",
    "by string": "from importlib import import_module\nimport_module('warpsar.scene.scene')",
    "by the beginning of a string": "from importlib import import_module\nimport_module(f'warpsar.scene.{name}')",
}


@pytest.mark.parametrize("how", UP)
def test_an_arrow_up_is_found(house: Path, how: str) -> None:
    assert upward(arrows(house)) == circles(arrows(house)) == []
    (house / "warpsar/world/mesh.py").write_text(UP[how])
    assert upward(arrows(house)) == ["warpsar.world.mesh -> warpsar.scene.scene"]
    assert circles(arrows(house)) == [["warpsar.scene.scene", "warpsar.world.mesh"]]


def test_a_circle_inside_a_room_is_found(house: Path) -> None:
    (house / "warpsar/world/frame.py").write_text("from warpsar.world import mesh")
    (house / "warpsar/world/mesh.py").write_text("def use():\n    from warpsar.world.frame import axes")
    assert upward(arrows(house)) == []
    assert circles(arrows(house)) == [["warpsar.world.frame", "warpsar.world.mesh"]]


@pytest.mark.parametrize("how", UP)
def test_who_knows_of_processes_is_found(house: Path, how: str) -> None:
    path = house / "warpsar/runtime/distributed/processes.py"
    path.parent.mkdir(parents=True)
    path.write_text("import torch.distributed\n\nclass Sharing:\n    rank = 0\n    size = int(environ['WORLD_SIZE'])")
    assert knowing(arrows(house)) == {}
    assert ranked(path) == {"torch.distributed", "WORLD_SIZE"}
    text = UP[how].replace("warpsar.scene.scene", f"{PROCESSES}.processes")
    (house / "warpsar/world/mesh.py").write_text(
        text.replace("warpsar.scene", PROCESSES).replace("import scene", "import processes")
    )
    assert knowing(arrows(house))["processes"] == {"warpsar.world.mesh"}
    (house / "warpsar/world/frame.py").write_text("def fit(problem, ranks=None):\n    return problem.ranks.size")
    assert ranked(house / "warpsar/world/frame.py") == {"ranks"}
