"""Runs of several processes on this machine, as torchrun starts them, and blows to them."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

# one thread each: what is tested is that processes agree, not how fast they are
ENVIRONMENT = {"WARPSAR_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def start(size: int, *command: object, restarts: int = 0) -> subprocess.Popen[str]:
    """`command` (a script, or -m and a module, and arguments) in `size` processes under torchrun."""
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(size)]
    return subprocess.Popen(
        [*torchrun, "--max-restarts", str(restarts), "--monitor-interval", "0.1", *map(str, command)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **ENVIRONMENT},
    )


def finish(run: subprocess.Popen[str], expected: int = 0) -> tuple[str, str]:
    """stdout and stderr of a run that has to end with `expected`."""
    stdout, stderr = run.communicate(timeout=600)
    assert run.returncode == expected, stderr
    return stdout, stderr


def workers(run: subprocess.Popen[str]) -> list[int]:
    """The processes that torchrun has started and that live, by their ids."""
    found = []
    for children in Path(f"/proc/{run.pid}/task").glob("*/children"):
        for pid in map(int, children.read_text().split()):
            command = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
            if b"warpsar" in command:
                found.append(pid)
    return sorted(found)


def strike(
    run: subprocess.Popen[str], ready: Callable[[], bool], delay: float, which: int, blow: int = signal.SIGKILL
) -> None:
    """Send a signal to worker `which` (modulo their number) `delay` seconds after `ready` says so."""
    while not ready():
        assert run.poll() is None, f"ended before it could be struck: {run.communicate()}"
        time.sleep(0.005)
    time.sleep(delay)
    alive = workers(run)
    assert alive, f"ended before it could be struck: {run.communicate()}"
    os.kill(alive[which % len(alive)], blow)
