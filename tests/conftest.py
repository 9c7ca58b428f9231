"""What tests share: devices, measured data, cases by an independent renderer; skipped, saying so, where not there."""

import importlib
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

# Before NumPy is loaded, here or in the workers of xdist: several threads take small matrices five times as long where
# other tests run beside.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import hypothesis
import pytest

ROOT = Path(__file__).resolve().parent.parent

# A first launch compiles its kernels: no example's time says anything.
hypothesis.settings.register_profile("warpsar", deadline=None)
hypothesis.settings.register_profile("long", deadline=None, max_examples=2000)  # --hypothesis-profile long
hypothesis.settings.load_profile("warpsar")


def shared_folder(variable: str, default: str) -> Path:
    return Path(os.environ.get(variable) or ROOT.parent / "shared" / default)


MEASURED = shared_folder("WARPSAR_MEASURED", "data")
CASES = shared_folder("WARPSAR_CASES", "cases")


def benchmark(name: str) -> Any:
    """A file of benchmarks/ as a module, imported beside its neighbours."""
    folder = str(ROOT / "benchmarks")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    return importlib.import_module(name)


def pytest_configure() -> None:
    import warp as wp

    from warpsar.runtime import console

    wp.config.log_level = wp.LOG_WARNING
    console.show_messages()  # tests of library calls read what the command line would show


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """`-m unit` reads no file that marks nothing so: importing all of them took a third of its time."""
    if config.option.markexpr != "unit" or collection_path.suffix != ".py":
        return None
    return True if "pytest.mark.unit" not in collection_path.read_text(encoding="utf-8") else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Tests of seconds are left out where nobody names a file: files that are named run whole.

    `-m unit` stands in the place of pyproject's `-m`, so what that leaves out is left out here."""
    everything = {Path(arg.split("::")[0]).resolve() for arg in config.args} <= {ROOT, ROOT / "tests"}
    marked: tuple[str, ...] = ()
    if config.option.markexpr == "unit":
        marked = ("full", "slow", "measured")
    elif everything and config.option.markexpr in config.getini("addopts"):  # nobody has stated another `-m`
        marked = ("full",)
    long = [item for item in items if any(map(item.get_closest_marker, marked))]
    if long:
        config.hook.pytest_deselected(items=long)
        items[:] = [item for item in items if item not in long]


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("cuda"):
        import warp as wp

        if not wp.get_cuda_device_count():
            pytest.skip("no CUDA device here")
    if item.get_closest_marker("measured") and not MEASURED.is_dir():
        pytest.skip(f"no measured data: WARPSAR_MEASURED, or {MEASURED}, is no folder")


@pytest.fixture(autouse=True)
def aloud() -> None:
    """No test inherits `--quiet` from one before it in the same process."""
    from warpsar.runtime import console

    console.be_quiet(False)


@pytest.fixture
def listening() -> Iterator[None]:
    """To Ctrl-C, as at a terminal: what a shell runs in the background ignores it, and so do its children."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(params=["cpu", pytest.param("cuda", marks=pytest.mark.cuda)])
def device(request: pytest.FixtureRequest) -> str:
    """Each kind of device, by its Warp name."""
    return str(request.param)


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """Folder of measured radar data; for tests marked `measured`."""
    return MEASURED


@pytest.fixture(scope="session")
def independent_cases() -> Path:
    """Folder of scenes and images made by an independent renderer, truth beside them."""
    if not CASES.is_dir():
        pytest.skip(f"no independent cases: WARPSAR_CASES, or {CASES}, is no folder")
    return CASES
