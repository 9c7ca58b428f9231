"""Hostile files through every reader, counted: read, refused in one message, or anything worse.

    python benchmarks/hostile.py -o OUT [--cases 500] [--seed 0] [--readers "mesh OBJ" ...] [--command-line 100]

Every reader meets its crafted attacks and then mutations of a sound file until it has had CASES of them
(`hostile_cases.py`). They run in one worker process under a limit on its address space; the parent watches the clock,
and starts another worker when one is killed or dies. After each case the worker looks at what was raised, at the peak
of its memory, at what was written to stdout, stderr and the folder, and at what was run (pickles, programs, sockets).
OUT/cases.jsonl holds every case and a run that was interrupted goes on from it; what went wrong stays in OUT/wrong.
OUT/hostile.json and OUT/hostile.md are the counts. A sample also goes through the command line (command_line.jsonl).
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import random
import re
import resource
import select
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import tables

GOOD = ("read", "refused")
BAD = {
    "traceback": "another exception than the program's own",
    "noisy": "more on stdout or stderr than the message",
    "unclear": "a message that names no file, holds control characters, or never ends",
    "accepted": "an attack that must be refused was read",
    "half-written": "a refusal that leaves files or changes the scene file",
    "escaped": "a pickle was loaded, a program started or a socket opened",
    "memory": "memory over the bound",
    "hang": "over the time limit",
    "crash": "the process died",
}
MEMORY_GIB = 0.75
"""Growth of resident memory that a case may cause; all sound files here are a few kilobytes."""
ADDRESS_SPACE_GIB = 4.0
"""What an allocation may ask for in all: one that is made and never touched shows here."""
TIME_S = 15.0
LONGEST_MESSAGE = 20_000
_FORBIDDEN = ("pickle.find_class", "socket.connect", "socket.getaddrinfo", "subprocess.Popen", "os.system", "os.exec")
_FORBIDDEN += ("os.posix_spawn", "os.fork", "os.forkpty", "urllib.Request", "webbrowser.open")


# ---- the worker ----


def _status(key: str) -> int:
    """A line of /proc/self/status in bytes."""
    found = re.search(rf"^{key}:\s+(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
    return 1024 * int(found[1]) if found else 0


def _exhausted(error: BaseException | None) -> bool:
    """Whether memory ran out anywhere below an exception."""
    seen = 0
    while error is not None and seen < 20:
        if isinstance(error, MemoryError) or re.search(r"bad_alloc|[Oo]ut of memory|[Uu]nable to allocate", str(error)):
            return True
        error, seen = error.__cause__ or error.__context__, seen + 1
    return False


class Case:
    """The worker's side of a case: its folder, what was said while it was read, and what was tried that must not be."""

    def __init__(self) -> None:
        from hostile_cases import readers

        self.readers, self.events, self.armed = readers(), [], False
        self.home = Path(tempfile.mkdtemp(prefix="hostile-"))
        self.folder = self.home / "case"
        self.capture = os.open(self.home / "output", os.O_RDWR | os.O_CREAT | os.O_APPEND)
        os.dup2(self.capture, 1)
        os.dup2(self.capture, 2)
        for reader in self.readers.values():  # everything lazy is imported and set up before anything is measured
            reader.lay_out(self.folder)
            reader.read(self.folder)
        sys.addaudithook(self.watch)

    def watch(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.armed and event.startswith(_FORBIDDEN):
            self.events.append(event)

    def read(self, reader: Any) -> BaseException | None:
        """What the reader raises."""
        self.armed = True
        try:
            reader.read(self.folder)
        except Exception as raised:
            return raised
        finally:
            self.armed = False
        return None

    def run(self, name: str, index: int, seed: int, content: str | None = None) -> dict[str, Any]:
        """The case `index`; or `content`, in hexadecimal digits, as the attacked file."""
        reader = self.readers[name]
        reader.lay_out(self.folder)
        attack = reader.spoil(self.folder, index, seed) if content is None else None
        if content is not None:
            (self.folder / reader.target).write_bytes(bytes.fromhex(content))
        before = _contents(self.folder)
        os.chdir(self.folder)
        os.ftruncate(self.capture, 0)
        self.events.clear()
        Path("/proc/self/clear_refs").write_text("5")  # the peak starts again
        resident, started = _status("VmRSS"), time.perf_counter()
        error = self.read(reader)
        spent, grown = time.perf_counter() - started, _status("VmHWM") - resident
        sys.stdout.flush()
        sys.stderr.flush()
        outcome, detail = _judge(error, os.pread(self.capture, 4000, 0).decode("utf-8", "replace"), self.folder, before)
        if self.events or (self.folder / "unpickled").exists():
            outcome, detail = "escaped", f"{sorted(set(self.events))}; {detail}"
        elif outcome == "read" and attack is not None and not attack.accepted:
            outcome = "accepted"
        if grown > MEMORY_GIB * 2**30 or _exhausted(error):
            outcome, detail = "memory", f"{grown / 2**30:.2f} GiB: {detail}"
        cause = error.__cause__ if error is not None else None
        os.chdir(self.home)
        return {
            "reader": name,
            "index": index,
            "attack": attack.name if attack else None,
            "outcome": outcome,
            "detail": detail[-2000:],
            "cause": type(cause).__name__ if cause is not None else None,
            "seconds": round(spent, 4),
            "grown_mib": round(grown / 2**20, 1),
        }


def work() -> None:
    """Read lines of `Case.run`'s arguments as JSON from stdin, answer each with what happened."""
    import warnings

    answers = os.fdopen(os.dup(1), "w")
    case = Case()
    warnings.filterwarnings("always", category=UserWarning)
    warnings.filterwarnings("always", category=RuntimeWarning)
    bound = _status("VmSize") + int(ADDRESS_SPACE_GIB * 2**30)
    resource.setrlimit(resource.RLIMIT_AS, (bound, bound))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    print(json.dumps("ready"), file=answers, flush=True)
    for line in sys.stdin:
        print(json.dumps(case.run(*json.loads(line))), file=answers, flush=True)


def _contents(folder: Path) -> dict[str, Any]:
    """Names, and when each was changed last."""
    return {path.name: (path.lstat().st_mtime_ns, path.lstat().st_size) for path in folder.iterdir()}


def _judge(error: BaseException | None, said: str, folder: Path, before: dict[str, Any]) -> tuple[str, str]:
    from warpsar.errors import InputError

    if error is None:
        return ("noisy", said) if said else ("read", "")
    if not isinstance(error, InputError):
        return "traceback", "".join(traceback.format_exception(error))
    message = str(error)
    if said:
        return "noisy", f"{message}\n--- and ---\n{said}"
    if _contents(folder) != before:
        return "half-written", f"{sorted(_contents(folder))}: {message}"
    if not (str(folder) in message and len(message) <= LONGEST_MESSAGE and message.replace("\n", "").isprintable()):
        return "unclear", message
    return "refused", message


# ---- the parent ----


class Worker:
    """A process that runs cases; `run` says what became of one, whatever became of the process."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[str] | None = None

    def start(self) -> subprocess.Popen[str]:
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "WARPSAR_THREADS"), "1")
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, **threads},
            start_new_session=True,
        )
        if self._answer(300.0) != "ready":
            raise RuntimeError("the worker does not start: run with --worker to see why")
        return self.process

    def _answer(self, seconds: float) -> Any:
        assert self.process is not None
        assert self.process.stdout is not None
        if not select.select([self.process.stdout], [], [], seconds)[0]:
            return "hang"
        line = self.process.stdout.readline()
        return json.loads(line) if line else "crash"

    def run(self, name: str, index: int, seed: int, content: bytes | None = None) -> dict[str, Any]:
        """What became of the case `index`, or of a file of this `content`."""
        process = self.process or self.start()
        assert process.stdin is not None
        given = [name, index, seed] if content is None else [name, index, seed, content.hex()]
        process.stdin.write(json.dumps(given) + "\n")
        process.stdin.flush()
        answer = self._answer(TIME_S)
        if isinstance(answer, dict):
            if answer["outcome"] == "memory":  # a library may not be itself after that
                self.stop()
            return answer
        self.stop()
        detail = f"exit status {process.returncode}" if answer == "crash" else f"over {TIME_S:g} s"
        return {"reader": name, "index": index, "attack": None, "outcome": answer, "detail": detail, "cause": None,
                "seconds": TIME_S if answer == "hang" else 0.0, "grown_mib": 0.0}  # fmt: skip

    def stop(self) -> None:
        if self.process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
            self.process = None


def run(cases: Iterable[tuple[str, int]], seed: int) -> Iterator[dict[str, Any]]:
    """What becomes of each case (reader, index)."""
    worker = Worker()
    try:
        for name, index in cases:
            yield worker.run(name, index, seed)
    finally:
        worker.stop()


def _keep(folder: Path, name: str, index: int, seed: int) -> None:
    """The file of a case that went wrong, to look at."""
    from hostile_cases import readers

    reader = readers()[name]
    with tempfile.TemporaryDirectory() as made:
        case = Path(made) / "case"
        reader.lay_out(case)
        reader.spoil(case, index, seed)
        source = case / reader.target
        if source.is_file() and not source.is_symlink() and source.stat().st_size < 2**22:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{name.replace(' ', '-')}-{index}-{reader.target}").write_bytes(source.read_bytes())


# ---- the command line ----


def command_line(count: int, cases: int, seed: int, skip: int = 0) -> Iterator[dict[str, Any]]:
    """`count` cases through `python -m warpsar`, drawn evenly over the readers, less the first `skip`: exit 2 and one
    message, or exit 0."""
    from hostile_cases import readers

    draw = random.Random(seed)
    able = [reader for reader in readers().values() if reader.command is not None]
    for number in range(count):
        reader = able[number % len(able)]
        index = draw.randrange(cases)
        if number < skip:
            continue
        with tempfile.TemporaryDirectory() as made:
            folder = Path(made) / "case"
            reader.lay_out(folder)
            reader.spoil(folder, index, seed)
            before = _contents(folder)
            assert reader.command is not None
            words = [sys.executable, "-m", "warpsar", *reader.command(folder)]
            try:
                done = subprocess.run(words, capture_output=True, text=True, timeout=300, errors="replace")
                outcome, detail = _judge_command(done, folder, before)
            except subprocess.TimeoutExpired:
                outcome, detail = "hang", "over 300 s"
        yield {"reader": reader.name, "index": index, "outcome": outcome, "detail": detail[-2000:]}


def _judge_command(done: subprocess.CompletedProcess[str], folder: Path, before: dict[str, Any]) -> tuple[str, str]:
    said = done.stderr
    if "Traceback" in said:
        return "traceback", said
    if done.returncode < 0:
        return "crash", f"signal {-done.returncode}: {said}"
    if done.returncode == 0:
        return "read", said
    if done.returncode != 2:
        return "traceback", f"exit status {done.returncode}: {said}"
    after = {name: kept for name, kept in _contents(folder).items() if name != "out"}
    left = sorted(path.name for path in (folder / "out").glob("*"))
    if after != before or left:
        return "half-written", f"{sorted(after)} {left}: {said}"
    # `Error:` begins the message; before it, `device:` and warnings of the program itself may stand; after it, the list
    # of what is wrong, indented, and click's own `Usage:` before it.
    lines = [line for line in said.splitlines() if not line.startswith(("  ", "device: ", "warning: ", "note: "))]
    lines = [line for line in lines if line and not line.startswith(("Usage: ", "Try "))]
    if len(lines) != 1 or not lines[0].startswith("Error: ") or done.stdout:
        return "noisy", f"{done.stdout}\n---\n{said}"
    return "refused", said


# ---- the table ----


def table(results: list[dict[str, Any]], command: list[dict[str, Any]]) -> str:
    """Markdown: a line per reader, and what went wrong, by kind."""

    def row(label: str, mine: list[dict[str, Any]]) -> list[Any]:
        counts = Counter(result["outcome"] for result in mine)
        wrong = sum(counts[kind] for kind in BAD)
        longest = f"{max(r['seconds'] for r in mine):.1f}" if "seconds" in mine[0] else ""
        most = f"{max(0.0, *(r['grown_mib'] for r in mine)):.0f}" if "grown_mib" in mine[0] else ""
        return [label, len(mine), counts["read"], counts["refused"], wrong, longest, most]

    rows = []
    for name in dict.fromkeys(result["reader"] for result in results):
        rows.append(row(name, [result for result in results if result["reader"] == name]))
    if results:
        rows.append(row("**all**", results))
    if command:
        rows.append(row("command line", command))
    header = ["reader", "cases", "read", "refused", "wrong", "longest [s]", "most memory [MiB]"]
    return tables.markdown(header, rows)


def kinds(results: list[dict[str, Any]]) -> str:
    """What went wrong, by kind."""
    counts = Counter(result["outcome"] for result in results)
    return "\n".join(f"- {kind}: {counts[kind]} ({meaning})" for kind, meaning in BAD.items())


def logged(path: Path) -> list[dict[str, Any]]:
    """Results of an earlier run."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []


def read_all(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Every case through its reader; those in OUT/cases.jsonl are not run again."""
    from hostile_cases import readers

    log = options.out / "cases.jsonl"
    results = logged(log)
    done = {(result["reader"], result["index"]) for result in results}
    cases = itertools.product(options.readers or list(readers()), range(options.cases))
    with log.open("a") as stream:
        for result in run([case for case in cases if case not in done], options.seed):
            results.append(result)
            stream.write(json.dumps(result) + "\n")
            stream.flush()
            if result["outcome"] in BAD:
                _keep(options.out / "wrong", result["reader"], result["index"], options.seed)
                last = result["detail"].strip().splitlines()[-1:] or [""]
                print(
                    f"{result['reader']} {result['index']} ({result['attack']}): {result['outcome']}: {last[0][:200]}"
                )
    return results


def command_all(options: argparse.Namespace) -> list[dict[str, Any]]:
    """A sample of the cases through the command line; those in OUT/command_line.jsonl are not run again."""
    log = options.out / "command_line.jsonl"
    results = logged(log)
    with log.open("a") as stream:
        for result in command_line(options.command_line, options.cases, options.seed, len(results)):
            results.append(result)
            stream.write(json.dumps(result) + "\n")
            stream.flush()
            if result["outcome"] in BAD:
                print(f"command line: {result['reader']} {result['index']}: {result['outcome']}: {result['detail']}")
    return results


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path)
    parser.add_argument("--cases", type=int, default=500, help="per reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--readers", nargs="+")
    parser.add_argument("--command-line", type=int, default=0, help="so many cases also through the command line")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    tables.add_write(parser)
    options = parser.parse_args()
    if options.worker:
        work()
        return 0
    out: Path = options.out
    out.mkdir(parents=True, exist_ok=True)
    if not (out / "made.json").is_file():  # a run that goes on is as old as its first case
        tables.save(out / "made.json", tables.made())
    results, command = read_all(options), command_all(options)
    causes = {
        name: dict(Counter(r["cause"] for r in results if r["reader"] == name and r["cause"] is not None))
        for name in dict.fromkeys(r["reader"] for r in results)
    }
    counts = dict(Counter(r["outcome"] for r in results))
    report = {"made": tables.stored(out / "made.json"), "seed": options.seed, "cases": len(results), "counts": counts}
    report |= {"causes": causes, "command_line": command}
    tables.save(out / "hostile.json", report)
    body = table(results, command)
    wrong = kinds([*results, *command])
    (out / "hostile.md").write_text(f"{body}\n\n{wrong}\n")
    tables.publish({"hostile": body}, report, options.write)
    print(f"\n{wrong}")
    return 1 if any(r["outcome"] in BAD for r in [*results, *command]) else 0


if __name__ == "__main__":
    sys.exit(main())
