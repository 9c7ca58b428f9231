"""benchmarks/refresh.py and tables.py: which tables are older than the code they measure, in a small repository."""

import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import ROOT, benchmark

from warpsar.effects.registry import declared, get, names, validate

PAGE = """# A page

<!-- table: first | python benchmarks/first.py | {first} -->

| a |
|---|
| 1 |

<!-- /table -->

Between them.

<!-- table: second.part | python benchmarks/second.py $DATA | {second} -->
<!-- /table -->
"""


refresh, scenes, tables = benchmark("refresh"), benchmark("scenes"), benchmark("tables")


def git(root: Path, *words: str) -> str:
    identity = ("-c", "user.name=a", "-c", "user.email=a@b")
    done = subprocess.run(["git", "-C", root, *identity, *words], check=True, capture_output=True, text=True)
    return done.stdout.strip()


def commit(root: Path, path: str, text: str) -> str:
    (root / path).parent.mkdir(exist_ok=True)
    (root / path).write_text(text)
    git(root, "add", "-A")
    git(root, "commit", "-qm", path)
    return git(root, "rev-parse", "--short=7", "HEAD")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A repository with a module, and a page whose tables have no commit yet."""
    git(tmp_path, "init", "-q")
    commit(tmp_path, "warpsar/a.py", "one = 1\n")
    commit(tmp_path, "docs/page.md", PAGE.format(first="2026-01-01 | unknown", second="2026-01-02 | unknown"))
    return tmp_path


def states(root: Path) -> dict[str, str]:
    return {table.name: refresh.state(table, root)[0] for table in tables.found(root)}


def test_a_table_is_fresh_until_its_code_changes(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tables.put("first", "| b |\n|---|\n| 2 |", tables.made(root), root)
    tables.put("second.part", "", tables.made(root), root)
    commit(root, "docs/other.md", "a page is no code")
    assert states(root) == {"first": "fresh", "second.part": "fresh"}
    assert refresh.check(tables.found(root), root) == 0
    now = commit(root, "warpsar/a.py", "one = 1  # a comment counts\n")
    tables.put("second.part", "", tables.made(root), root)
    assert states(root) == {"first": "older", "second.part": "fresh"}
    assert tables.found(root)[1].commit == now
    capsys.readouterr()
    assert refresh.check(tables.found(root), root) == 1
    said = capsys.readouterr().out
    assert "first (docs/page.md" in said
    assert "second.part" not in said
    assert "1 fresh, 1 older, 0 unknown" in said


def test_a_change_that_is_not_committed_makes_a_table_older(root: Path) -> None:
    tables.put("first", "", tables.made(root), root)
    (root / "warpsar" / "a.py").write_text("one = 2\n")
    assert states(root)["first"] == "older"


def test_only_the_paths_that_a_table_measures_count(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(refresh.MEASURES, "second", ("cli",))
    for name in ("first", "second.part"):
        tables.put(name, "", tables.made(root), root)
    commit(root, "cli/main.py", "")
    assert states(root) == {"first": "fresh", "second.part": "older"}
    assert refresh.measures("secondary") == refresh.DEFAULT


def test_what_is_measured_is_there() -> None:
    assert all((ROOT / path).exists() for paths in refresh.MEASURES.values() for path in paths)


def test_only_the_named_table_is_replaced(root: Path) -> None:
    before = (root / "docs" / "page.md").read_text()
    tables.put("first", "| b |\n|---|\n| 2 |", {"date": "2026-02-03", "commit": "abcdef0"}, root)
    said = "Made by `python benchmarks/first.py` on 2026-02-03, commit `abcdef0`."
    after = before.replace("| a |\n|---|\n| 1 |", f"| b |\n|---|\n| 2 |\n\n{said}")
    after = after.replace("2026-01-01 | unknown", "2026-02-03 | abcdef0")
    assert (root / "docs" / "page.md").read_text() == after


def test_what_is_said_of_a_table_does_not_pile_up(root: Path) -> None:
    for _ in range(2):
        tables.put("first", "| b |\n|---|\n| 2 |", {"date": "2026-02-03", "commit": "abcdef0"}, root)
    assert (root / "docs" / "page.md").read_text().count("Made by") == 1


def test_a_table_without_a_place_is_refused(root: Path) -> None:
    before = (root / "docs" / "page.md").read_text()
    with pytest.raises(LookupError, match="'third' has 0 places"):
        tables.put("third", "", tables.made(root), root)
    (root / "docs" / "copy.md").write_text(before)
    with pytest.raises(LookupError, match="'first' has 2 places"):
        tables.put("first", "", tables.made(root), root)
    assert (root / "docs" / "page.md").read_text() == before


@pytest.mark.parametrize("comment", ["<!-- /table -->", "<!-- table: first | python benchmarks/first.py |"])
def test_a_comment_without_its_other_end_is_refused(root: Path, comment: str) -> None:
    page = root / "docs" / "page.md"
    page.write_text(page.read_text().replace(comment, "", 1))
    with pytest.raises(ValueError, match=r"page\.md"):
        tables.found(root)


def test_a_commit_that_is_not_here_is_said_to_be_unknown(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tables.put("first", "", {"date": "2026-01-01", "commit": "abcdef0"}, root)
    assert refresh.check(tables.found(root), root) == 0  # nothing is known to be older
    said = capsys.readouterr().out
    assert "commit abcdef0 is not in this clone" in said
    assert "no commit was recorded" in said
    assert "0 fresh, 0 older, 2 unknown" in said


def test_a_shallow_clone_says_what_it_cannot_tell(root: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    tables.put("first", "", tables.made(root), root)
    commit(root, "warpsar/a.py", "one = 2\n")
    tables.put("second.part", "", tables.made(root), root)
    commit(root, "docs/other.md", "")
    shallow = tmp_path_factory.mktemp("shallow") / "clone"
    git(root, "clone", "-q", "--depth", "1", f"file://{root}", str(shallow))
    assert states(shallow) == {"first": "unknown", "second.part": "unknown"}
    assert states(root) == {"first": "older", "second.part": "fresh"}


def test_a_changed_tree_marks_the_table(root: Path) -> None:
    (root / "docs" / "page.md").write_text((root / "docs" / "page.md").read_text() + "More.\n")
    assert "-dirty" not in tables.made(root)["commit"]  # a page is no code
    (root / "kernels").mkdir()
    (root / "kernels" / "new.py").write_text("")
    tables.put("first", "", tables.made(root), root)
    assert tables.found(root)[0].commit.endswith("-dirty")
    (root / "kernels" / "new.py").unlink()
    table = tables.found(root)[0]
    assert refresh.state(table, root) == ("unknown", "the code had changes that were not committed")


def test_a_copy_without_git_is_told_its_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    monkeypatch.delenv("WARPSAR_COMMIT", raising=False)
    assert tables.made(tmp_path)["commit"] == "unknown"
    monkeypatch.setenv("WARPSAR_COMMIT", "abcdef0")
    assert tables.made(tmp_path)["commit"] == "abcdef0"


def test_the_command_of_a_named_table_runs_and_writes(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (root / "benchmarks").mkdir()
    (root / "benchmarks" / "second.py").write_text("import sys; open('said', 'w').write(' '.join(sys.argv[1:]))")
    monkeypatch.delenv("DATA", raising=False)
    assert refresh.run(tables.found(root), ["second.part"], root) == 2
    assert refresh.run(tables.found(root), ["third"], root) == 2
    monkeypatch.setenv("DATA", "folder")
    assert refresh.run(tables.found(root), ["second.part"], root) == 0
    assert (root / "said").read_text() == "folder --write"
    assert refresh.run(tables.found(root), ["first"], root) == 1  # there is no such script


def test_a_run_is_kept_dated_and_taken_up_again(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    made = tables.result_of(tables.parser("").parse_args(["--out", str(path)]), lambda: {"seconds": 2.0})
    assert made["seconds"] == 2.0
    assert set(made["made"]) == {"date", "commit"}
    again = tables.parser("").parse_args(["--from", str(path)])
    assert tables.result_of(again, lambda: pytest.fail("it was measured again")) == made


def test_the_tables_of_this_checkout_can_be_read() -> None:
    """Names are unique, and every command is a script of benchmarks/ that takes --write."""
    here = tables.found()
    assert len({table.name for table in here}) == len(here) > 20
    for table in here:
        python, script = table.command.split()[:2]
        assert python == "python"
        source = (ROOT / script).read_text()
        assert any(way in source for way in ("tables.parser(", "@runs.table(", "@runs.write", '"--write"')), script


# ---- what the pictures and the rates of the docs ask of an effect ----


@pytest.mark.parametrize("name", names())
@pytest.mark.parametrize(("table", "views"), [("example", 2), ("rate_case", 4)])
def test_every_effect_declares_a_sound_table_that_does_something(name: str, table: str, views: int) -> None:
    values = getattr(get(name), table)
    names = [f"v{i}" for i in range(views)]
    validate(name, values, f"{name}.{table}", names)
    scene = scenes.example_with(None, 1.0)
    found = [scene.views[0].model_copy(update={"name": view}) for view in names]
    scene = replace(scene, views=found, effects={name: values})
    assert any(declared(scene, view) for view in found)  # effects at neutral are left out
