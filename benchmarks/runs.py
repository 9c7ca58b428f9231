"""Studies of many runs: each run is a line of JSON in its folder's runs.jsonl, and none is made twice.

A study has the commands `run` and `table`. Their options, and what both do with the file, are here.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

import click
import tables
from scipy.stats import beta

from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.runtime import console

Row = dict[str, Any]
Bodies = Callable[[list[Row]], Mapping[str, str]]
FOLDER = click.Path(file_okay=False, path_type=Path)

out = click.option("-o", "--out", required=True, type=FOLDER, help="Folder of the runs.")
first = click.option("--first", type=click.IntRange(min=0), default=0, show_default=True, help="Number of the first.")
max_time = click.option("--max-time", type=float, default=float("inf"), help="Start no run after so many seconds.")
draws = click.option("--draws", type=int, default=DiagnoseOptions.draws, show_default=True, help="Of the bootstrap.")
device = click.option("--device")
write = click.option("--write", is_flag=True, help="Put the tables into their page in docs/, dated by the oldest run.")


def scenes(default: int) -> Any:
    return click.option("--scenes", type=click.IntRange(min=1), default=default, show_default=True, help="How many.")


def jobs(default: int) -> Any:
    return click.option(
        "--jobs", type=click.IntRange(min=1), default=default, show_default=True, help="Runs side by side."
    )


def minutes(default: float) -> Any:
    return click.option("--minutes", type=float, default=default, show_default=True, help="Limit of one search.")


def table(main: click.Group) -> Callable[[Bodies], Bodies]:
    """Adds the command `table` to a study: of the stored runs the decorated function makes tables, by their names."""

    def decorate(bodies: Bodies) -> Bodies:
        @main.command(name="table", help=bodies.__doc__)
        @out
        @write
        def command(out: Path, write: bool) -> None:
            rows = stored(out)
            tables.publish(bodies(rows), oldest(rows), write)

        return bodies

    return decorate


def stored(folder: Path) -> list[Row]:
    """All runs of a folder."""
    path = folder / "runs.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []


def oldest(rows: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """What `tables.publish` dates a table of these runs by: the oldest of them, or one that does not say."""
    dates = [{key: row.get(key, tables.UNKNOWN) for key in ("date", "commit")} for row in rows]
    undated = [one for one in dates if tables.UNKNOWN in one.values()]
    return {"made": undated[0] if undated else min(dates, key=lambda one: str(one["date"]))}


def bounds(count: int, of: int) -> str:
    """95 % of Clopper and Pearson about a share."""
    low = 0.0 if count == 0 else float(beta.ppf(0.025, count, of - count + 1))
    high = 1.0 if count == of else float(beta.ppf(0.975, count + 1, of - count))
    return f"{100 * low:.1f} to {100 * high:.1f} %"


def append(
    folder: Path,
    keys: Iterable[Any],
    work: Callable[..., Row],
    words: Callable[[Row], str],
    *options: Any,
    jobs: int = 1,
    max_time: float = float("inf"),
    key_of: Callable[[Row], Any] = lambda row: row["number"],
) -> None:
    """`work(key, *options)` of every key that no stored run has, as a line of the folder's file; `words` of it on
    stderr.

    So many `jobs` at a time, in processes of their own; none is begun after `max_time` seconds. `key_of` a stored run.
    """
    folder.mkdir(parents=True, exist_ok=True)
    done = {key_of(row) for row in stored(folder)}
    left = [key for key in keys if key not in done]
    bar = console.progress(len(left), "runs", "run")
    when, end = tables.made(), time.perf_counter() + max_time
    failed = 0
    for row in side_by_side(left, jobs, end, options, work):
        if isinstance(row, Exception):  # the other runs are worth having
            traceback.print_exception(row)
            failed += 1
            continue
        with (folder / "runs.jsonl").open("a") as stream:
            stream.write(json.dumps(row | when) + "\n")
        bar.update()
        click.echo(words(row), err=True)
    bar.close()
    if failed:
        raise click.ClickException(f"{failed} runs failed; they are not stored")


def side_by_side(
    keys: Sequence[Any], jobs: int, end: float, options: tuple[Any, ...], work: Callable[..., Row]
) -> Iterator[Row | Exception]:
    """`work` of every key as it is done, or what it raised, `jobs` at a time; none is begun after the time `end`."""
    left = iter(keys)
    at_work: set[Future[Row]] = set()
    if jobs > 1:  # a core for each; the children read it when they import NumPy
        os.environ.update(dict.fromkeys(("WARPSAR_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1"))
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        while True:
            while len(at_work) < jobs and time.perf_counter() < end and (key := next(left, None)) is not None:
                at_work.add(pool.submit(work, key, *options))
            if not at_work:
                break
            ready, at_work = wait(at_work, return_when=FIRST_COMPLETED)
            for one in ready:
                raised = one.exception()
                yield raised if isinstance(raised, Exception) else one.result()
