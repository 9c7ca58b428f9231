"""What the pages name is there for whoever reads them: files of the project, or data whose source is given."""

import re
from pathlib import Path

import pytest
from conftest import ROOT, benchmark

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))]
# A command, and a commit that has its program.
OF_A_COMMIT = re.compile(r"`python (\S+\.py)[^`]*`[^`|]{1,40}\bcommit\s`(\w+)[`-]")
OWN = r"\b(?:benchmarks|cli|data|docs|examples|kernels|tests|warpsar)/[\w./-]*\w"
TO_BE_WRITTEN = {"add-an-effect.md": "azimuth_drift", "add-a-model.md": "lambert"}  # what a reader of a page writes
SOURCES = {
    "$DATA": "measured.md#where-the-data-come-from",
    "$CASES": "experiments.md#a-case-of-an-independent-renderer",
}
"""Folders that are not part of the project, and where the pages say what they are."""
FOR_USERS = ("Tutorials", "How-to guides", "Concepts")


def pages_for_users() -> list[str]:
    """Those under the captions of the index that are for users: they carry no checks."""
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    trees = re.findall(r"^```{toctree}\n:hidden:\n:caption: ([^\n]*)\n\n(.*?)^```$", index, re.MULTILINE | re.DOTALL)
    lines = [line for caption, tree in trees if caption in FOR_USERS for line in tree.splitlines()]
    return [re.sub(r".*<(.*)>", r"\1", line) for line in lines]


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def plain(text: str) -> str:
    """A page without its addresses."""
    return re.sub(r"https?://\S+", "", text)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_files_of_the_project_are_there(page: Path) -> None:
    text = OF_A_COMMIT.sub("", plain(page.read_text(encoding="utf-8")))
    named = re.findall(rf"(?<![\w/$.-]){OWN}", text)  # after a folder or a variable it is another file's name
    if page.name in TO_BE_WRITTEN:
        named = [each for each in named if TO_BE_WRITTEN[page.name] not in each and not each.endswith("/test_")]
    missing = [each for each in named if not (ROOT / each).exists() and not (page.parent / each).exists()]
    assert missing == []


def test_programs_stood_at_the_commits_that_are_named() -> None:
    """A table keeps its command when the program has gone: `git show COMMIT:PROGRAM`. Shallow clones cannot tell."""
    git = benchmark("tables").git
    named = {each for page in PAGES for each in OF_A_COMMIT.findall(page.read_text(encoding="utf-8"))}
    gone = [(program, commit) for program, commit in named if not (ROOT / program).exists()]
    known = [each for each in gone if git(ROOT, "cat-file", "-e", f"{each[1]}^{{commit}}") is not None]
    assert gone
    assert [each for each in known if git(ROOT, "cat-file", "-e", f"{each[1]}:{each[0]}") is None] == []


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_other_folders_have_a_source(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert re.findall(r"\.\./shared|/home/|/tmp/|(?<![$\w/])cases/", text) == []
    for variable in set(re.findall(r"\$[A-Z]{2,}", text)) & set(SOURCES):
        where, _, anchor = SOURCES[variable].partition("#")
        if page.name == where:
            titles = [title.lower().replace(" ", "-") for title in re.findall(r"^## (.*)$", text, re.MULTILINE)]
            assert anchor in titles
        else:
            assert SOURCES[variable] in text
    # a folder that a reader must have is written as a variable with a source
    assert re.findall(r"\b[A-Z]+_FOLDER\b", text) == []


@pytest.mark.parametrize("name", pages_for_users())
def test_pages_for_users_carry_no_checks(name: str) -> None:
    """No test, no dated table of a run, no commit: those are on the pages of method."""
    text = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    found = re.findall(r"pytest|tests/\w+/test_|<!-- table:|\bcommits?\b", text)
    assert found == []


def test_there_are_pages_for_users() -> None:
    assert len(pages_for_users()) > 20
