"""A process that reads hostile files, under a limit on its address space, and says what became of each.

After each file it looks at what was raised, at the peak of its memory, at what was written to stdout, stderr and the
folder, and at what was run (pickles, programs, sockets). The parent watches the clock, and starts another process when
one is killed or dies.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import resource
import select
import signal
import subprocess
import sys
import tempfile
import traceback
import warnings
from pathlib import Path
from typing import Any

from warpsar.errors import InputError

from .readers import Reader, readers

GOOD = ("read", "refused")
"""All other outcomes are bad:

| | |
|---|---|
| traceback | another exception than the program's own |
| noisy | more on stdout or stderr than the message |
| unclear | a message that names no file, holds control characters, or never ends |
| accepted | an attack that must be refused was read |
| half-written | a refusal that leaves files or changes the scene file |
| escaped | a pickle was loaded, a program started or a socket opened |
| memory | memory over the bound |
| hang | over the time limit |
| crash | the process died |
"""
MEMORY_GIB = 0.75
"""Growth of resident memory that a file may cause; all sound files here are a few kilobytes."""
ADDRESS_SPACE_GIB = 4.0
"""What an allocation may ask for in all: one that is made and never touched shows here."""
TIME_S = 120.0
"""A hang never ends, and a machine with other work is slow."""
LONGEST_MESSAGE = 20_000
_FORBIDDEN = ("pickle.find_class", "socket.connect", "socket.getaddrinfo", "subprocess.Popen", "os.system", "os.exec")
_FORBIDDEN += ("os.posix_spawn", "os.fork", "os.forkpty", "urllib.Request", "webbrowser.open")


# ---- in the process ----


def _status(key: str) -> int:
    """A line of /proc/self/status in bytes."""
    found = re.search(rf"^{key}:\s+(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
    return 1024 * int(found[1]) if found else 0


def exhausted(error: BaseException | None) -> bool:
    """Whether memory ran out anywhere below an exception."""
    seen = 0
    while error is not None and seen < 20:
        if isinstance(error, MemoryError) or re.search(r"bad_alloc|[Oo]ut of memory|[Uu]nable to allocate", str(error)):
            return True
        error, seen = error.__cause__ or error.__context__, seen + 1
    return False


def contents(folder: Path) -> dict[str, Any]:
    """Names, and when each was changed last."""
    return {path.name: (path.lstat().st_mtime_ns, path.lstat().st_size) for path in folder.iterdir()}


def judge(error: BaseException | None, said: str, folder: Path, before: dict[str, Any]) -> tuple[str, str]:
    """Outcome and its words, by what was raised and said, and what lies in the folder."""
    if error is None:
        return ("noisy", said) if said else ("read", "")
    if not isinstance(error, InputError):
        return "traceback", "".join(traceback.format_exception(error))
    message = str(error)
    if said:
        return "noisy", f"{message}\n--- and ---\n{said}"
    if contents(folder) != before:
        return "half-written", f"{sorted(contents(folder))}: {message}"
    if not (str(folder) in message and len(message) <= LONGEST_MESSAGE and message.replace("\n", "").isprintable()):
        return "unclear", message
    return "refused", message


class _Desk:
    """Its folder, what was said while a file was read, and what was tried that must not be."""

    def __init__(self) -> None:
        self.events: list[str] = []
        self.armed = False
        self.home = Path(tempfile.mkdtemp(prefix="hostile-"))
        self.folder = self.home / "case"
        self.capture = os.open(self.home / "output", os.O_RDWR | os.O_CREAT | os.O_APPEND)
        os.dup2(self.capture, 1)
        os.dup2(self.capture, 2)
        for reader in readers().values():  # everything lazy is imported and set up before anything is measured
            reader.lay_out(self.folder)
            reader.read(self.folder)
        sys.addaudithook(self.watch)

    def watch(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.armed and event.startswith(_FORBIDDEN):
            self.events.append(event)

    def read(self, reader: Reader) -> BaseException | None:
        """What the reader raises."""
        self.armed = True
        try:
            reader.read(self.folder)
        except Exception as raised:
            return raised
        finally:
            self.armed = False
        return None

    def run(self, name: str, given: int | str) -> dict[str, Any]:
        """A reader's attack by its number, or a file's content in hexadecimal digits."""
        reader = readers()[name]
        reader.lay_out(self.folder)
        attack = reader.attacks[given] if isinstance(given, int) else None
        if attack is not None:
            attack.make(self.folder / reader.target)
        else:
            (self.folder / reader.target).write_bytes(bytes.fromhex(str(given)))
        before = contents(self.folder)
        os.chdir(self.folder)
        os.ftruncate(self.capture, 0)
        self.events.clear()
        Path("/proc/self/clear_refs").write_text("5")  # the peak starts again
        resident = _status("VmRSS")
        error = self.read(reader)
        grown = _status("VmHWM") - resident
        sys.stdout.flush()
        sys.stderr.flush()
        outcome, detail = judge(error, os.pread(self.capture, 4000, 0).decode("utf-8", "replace"), self.folder, before)
        if self.events or (self.folder / "unpickled").exists():
            outcome, detail = "escaped", f"{sorted(set(self.events))}; {detail}"
        elif outcome == "read" and attack is not None and not attack.accepted:
            outcome = "accepted"
        if grown > MEMORY_GIB * 2**30 or exhausted(error):
            outcome, detail = "memory", f"{grown / 2**30:.2f} GiB: {detail}"
        os.chdir(self.home)
        return {"attack": attack.name if attack else "a mutation", "outcome": outcome, "detail": detail[-2000:]}


def work() -> None:
    """Read lines of `_Desk.run`'s arguments as JSON from stdin, answer each with what happened."""
    answers = os.fdopen(os.dup(1), "w")
    desk = _Desk()
    warnings.filterwarnings("always", category=UserWarning)
    warnings.filterwarnings("always", category=RuntimeWarning)
    bound = _status("VmSize") + int(ADDRESS_SPACE_GIB * 2**30)
    resource.setrlimit(resource.RLIMIT_AS, (bound, bound))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    print(json.dumps("ready"), file=answers, flush=True)
    for line in sys.stdin:
        print(json.dumps(desk.run(*json.loads(line))), file=answers, flush=True)


# ---- in the parent ----


class Worker:
    """A process that reads; `run` says what became of a file, whatever became of the process."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[str] | None = None

    def start(self) -> subprocess.Popen[str]:
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "WARPSAR_THREADS"), "1")
        self.process = subprocess.Popen(
            [sys.executable, "-m", __name__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, **threads, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            start_new_session=True,
        )
        if self._answer(300.0) != "ready":
            raise RuntimeError(f"the process does not start: python -m {__name__} says why")
        return self.process

    def _answer(self, seconds: float) -> Any:
        assert self.process is not None
        assert self.process.stdout is not None
        if not select.select([self.process.stdout], [], [], seconds)[0]:
            return "hang"
        line = self.process.stdout.readline()
        return json.loads(line) if line else "crash"

    def run(self, name: str, given: int | bytes) -> str:
        """`read` or `refused`: what became of a reader's attack, by its number, or of a file of this content.

        Raises AssertionError for all else.
        """
        process = self.process or self.start()
        assert process.stdin is not None
        process.stdin.write(json.dumps([name, given.hex() if isinstance(given, bytes) else given]) + "\n")
        process.stdin.flush()
        answer = self._answer(TIME_S)
        if isinstance(answer, str):  # of the process
            self.stop()
            answer = {"attack": given, "outcome": answer, "detail": f"exit status {process.returncode}"}
        elif answer["outcome"] == "memory":  # a library may not be itself after that
            self.stop()
        said = f"{name} ({answer['attack']}): {answer['outcome']}: {answer['detail'][-500:]}"
        assert answer["outcome"] in GOOD, said
        return str(answer["outcome"])

    def stop(self) -> None:
        if self.process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
            self.process = None


if __name__ == "__main__":
    work()
