"""Which tables of the docs are older than the code they measure, and how to make them again.

    python benchmarks/refresh.py                                # every table: command, date, commit, state
    python benchmarks/refresh.py --check                        # those older than their code; exit status 1 if any
    python benchmarks/refresh.py --run experiments.table3 ...   # runs their commands, which write them

A table is `older` where the files that it measures differ from those of its commit. Every difference counts: a comment
or a docstring, too, and changes that are not committed; files that git does not know yet do not count. A table is
`unknown` where that cannot be told: no commit stands beside it, the commit is not in this clone (a shallow one), or
the code had changes that were not committed when it was made.
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from tables import DIRTY, ROOT, UNKNOWN, MarkedTable, found, git, markdown

DEFAULT = ("warpsar", "kernels")
# What a table measures, where it is more than that: by its name, or by what its name begins with.
MEASURES = {
    "experiments.table3": (*DEFAULT, "data/table3"),
    "experiments.table4": (*DEFAULT, "data/table4"),
    "experiments.table6": (*DEFAULT, "data/table4"),
    "experiments.in_domain": (*DEFAULT, "data/in_domain"),
    "experiments.fields": (*DEFAULT, "data/fields"),
    "forecast": (*DEFAULT, "cli", "data/example"),
    "startup": (*DEFAULT, "cli", "data/example"),
    "effects": (*DEFAULT, "data/example"),
}


def measures(name: str) -> tuple[str, ...]:
    """The paths that a table measures."""
    return next((paths for key, paths in MEASURES.items() if name == key or name.startswith(f"{key}.")), DEFAULT)


def state(table: MarkedTable, root: Path = ROOT) -> tuple[str, str]:
    """`fresh`, `older` or `unknown`, and why."""
    commit = table.commit.removesuffix(DIRTY)
    if commit == UNKNOWN:
        return "unknown", "no commit was recorded"
    if git(root, "rev-parse", "--git-dir") is None:
        return "unknown", "there is no git repository here"
    if git(root, "cat-file", "-e", f"{commit}^{{commit}}") is None:
        return "unknown", f"commit {commit} is not in this clone"
    changed = git(root, "diff", "--name-only", commit, "--", *measures(table.name))
    if changed is None:
        return "unknown", f"commit {commit} cannot be compared here"
    if changed:
        return "older", f"{len(changed.splitlines())} files of {', '.join(measures(table.name))} have changed"
    if table.commit.endswith(DIRTY):
        return "unknown", "the code had changes that were not committed"
    return "fresh", ""


def listed(tables: Sequence[MarkedTable], root: Path = ROOT) -> str:
    rows = []
    for table in tables:
        said = ": ".join(filter(None, state(table, root)))
        page = str(table.page.relative_to(root))
        rows.append([table.name, page, f"`{table.command}`", table.date, table.commit, said])
    return markdown(["table", "page", "command", "date", "commit", "state"], rows)


def check(tables: Sequence[MarkedTable], root: Path = ROOT) -> int:
    """Says which tables are older than their code, and of which it cannot be told; 1 if any is older."""
    states = {table: state(table, root) for table in tables}
    for table, (word, why) in states.items():
        if word != "fresh":
            print(f"{table.name} ({table.page.relative_to(root)}, {table.date}): {word}: {why}")
    words = [word for word, _ in states.values()]
    print(f"{len(words)} tables: {', '.join(f'{words.count(w)} {w}' for w in ('fresh', 'older', 'unknown'))}")
    return 1 if "older" in words else 0


def run(tables: Sequence[MarkedTable], names: Sequence[str], root: Path = ROOT) -> int:
    """Runs the commands of the named tables, each once; 1 if one fails, 2 if one cannot be run."""
    by_name = {table.name: table for table in tables}
    unknown = [name for name in names if name not in by_name]
    if unknown:
        print(f"no table is called {', '.join(unknown)}; there are {', '.join(by_name)}", file=sys.stderr)
        return 2
    for command in dict.fromkeys(by_name[name].command for name in names):
        words = [os.path.expandvars(word) for word in shlex.split(command)]
        unset = [word for word in words if word.startswith("$")]
        if unset or words[0] != "python":
            print(f"{command}: {f'set {unset[0]} first' if unset else 'is no command to run'}", file=sys.stderr)
            return 2
        print(f"{command} --write", file=sys.stderr)
        if subprocess.run([sys.executable, *words[1:], "--write"], cwd=root, check=False).returncode:
            return 1
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--check", action="store_true", help="only those not fresh; exit status 1 if one is older")
    what.add_argument("--run", nargs="+", metavar="NAME", help="run the commands of these tables")
    options = parser.parse_args()
    tables = found()
    if options.run:
        return run(tables, options.run)
    if options.check:
        return check(tables)
    print(listed(tables))
    return 0


if __name__ == "__main__":
    sys.exit(main())
