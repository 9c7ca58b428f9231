"""Tables in the pages of docs/. Each stands between two comments that say how, when and from which code it was made:

    <!-- table: NAME | COMMAND | DATE | COMMIT -->
    ...
    <!-- /table -->

The last line between them says the same to a reader. The command that makes a table puts it there itself, with
`--write`. `python benchmarks/refresh.py` lists them all.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
CODE = ("warpsar", "kernels", "cli", "benchmarks", "data")  # a change here that is not committed marks a table
UNKNOWN = "unknown"
DIRTY = "-dirty"
MARKED = re.compile(
    r"^<!-- table: (?P<name>[\w.+-]+) \| (?P<command>[^|\n]+) \| (?P<date>[\w-]+) \| (?P<commit>[\w-]+) -->\n"
    r"(?P<body>.*?)^<!-- /table -->$",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class MarkedTable:
    """A table as its page has it. `commit` ends in `-dirty` where the code had changes that were not committed."""

    name: str
    command: str
    date: str
    commit: str
    page: Path


def markdown(header: Sequence[Any], rows: Iterable[Sequence[Any]]) -> str:
    """A Markdown table, one line per row."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def marked(root: Path) -> Iterator[tuple[Path, re.Match[str]]]:
    """Page and place of every table. Raises ValueError for a comment that opens or closes nothing."""
    for page in (root / "README.md", *sorted((root / "docs").rglob("*.md"))):
        text = page.read_text(encoding="utf-8") if page.is_file() else ""
        matches = list(MARKED.finditer(text))
        broken = any("<!-- table:" in match["body"] for match in matches)
        if broken or not len(matches) == text.count("<!-- table:") == text.count("<!-- /table -->"):
            raise ValueError(f"{page}: a comment of a table is broken, or has no other end")
        yield from ((page, match) for match in matches)


def found(root: Path = ROOT) -> list[MarkedTable]:
    """Every table of every page."""
    return [MarkedTable(*match.group("name", "command", "date", "commit"), page) for page, match in marked(root)]


def git(root: Path, *words: str) -> str | None:
    """What git says; None where it fails or there is none."""
    try:
        done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


def made(root: Path = ROOT) -> dict[str, str]:
    """Date and commit of now, for JSON and for a table's first comment.

    A copy without .git takes the commit from WARPSAR_COMMIT, which whoever made the copy sets.
    """
    commit = git(root, "rev-parse", "--short=7", "HEAD")
    if commit is None:
        commit = os.environ.get("WARPSAR_COMMIT", UNKNOWN)
    elif git(root, "status", "--porcelain", "--", *CODE):
        commit += DIRTY
    return {"date": datetime.now(UTC).date().isoformat(), "commit": commit}


def put(name: str, body: str, when: Mapping[str, str], root: Path = ROOT) -> Path:
    """Puts a table between its comments, and under it its command and the date and commit of `when`; returns the page.

    Raises LookupError where no page, or more than one place, has the comments of `name`.
    """
    places = [(page, match) for page, match in marked(root) if match["name"] == name]
    if len(places) != 1:
        raise LookupError(f"table {name!r} has {len(places)} places in the pages; it must have one")
    page, match = places[0]
    text = page.read_text(encoding="utf-8")
    first = f"<!-- table: {name} | {match['command']} | {when['date']} | {when['commit']} -->"
    said = f"Made by `{match['command']}` on {when['date']}, commit `{when['commit']}`."
    block = "\n\n".join((first, body.strip(), said, "<!-- /table -->"))
    page.write_text(text[: match.start()] + block + text[match.end() :], encoding="utf-8", newline="\n")
    return page


def publish(bodies: Mapping[str, str], result: Mapping[str, Any], write: bool) -> None:
    """Prints tables by name and, with `write`, puts them into their pages; `result["made"]` says when and from what."""
    print("\n\n".join(bodies.values()))
    if write:
        for name, body in bodies.items():
            put(name, body, result.get("made", {"date": UNKNOWN, "commit": UNKNOWN}))


def parser(doc: str | None, *, stored: bool = True) -> argparse.ArgumentParser:
    """Of a benchmark: to put its tables into pages; where it has one JSON file, to write that and to start from it."""
    made = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    if stored:
        made.add_argument("--out", type=Path, help="JSON file")
        made.add_argument("--from", dest="source", type=Path, metavar="FILE", help="JSON of a run: nothing is measured")
    made.add_argument("--write", action="store_true", help="put the tables into their pages in docs/")
    return made


def result_of(options: argparse.Namespace, make: Callable[[], Mapping[str, Any]]) -> dict[str, Any]:
    """That of --from; or what `make` makes now, dated, and kept in --out."""
    if options.source is not None:
        return stored(options.source)
    result = {"made": made(), **make()}
    save(options.out, result)
    return result


def save(path: Path | None, result: Mapping[str, Any]) -> None:
    if path is not None:
        path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


def stored(path: Path) -> dict[str, Any]:
    """The JSON of an earlier run."""
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content
