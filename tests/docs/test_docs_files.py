"""What the pages name is there for whoever reads them: files of the project, or data whose source is given."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))]
OWN = r"\b(?:benchmarks|cli|data|docs|examples|kernels|tests|warpsar)/[\w./-]*\w"
TO_BE_WRITTEN = {"add-an-effect.md": "azimuth_drift", "add-a-model.md": "lambert"}  # what a reader of a page writes
SOURCES = {
    "$DATA": "measured.md#where-the-data-come-from",
    "$CASES": "experiments.md#a-case-of-an-independent-renderer",
}
"""Folders that are not part of the project, and where the pages say what they are."""


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def plain(text: str) -> str:
    """A page without its addresses."""
    return re.sub(r"https?://\S+", "", text)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_files_of_the_project_are_there(page: Path) -> None:
    # after a folder or a variable it is another file's name
    named = re.findall(rf"(?<![\w/$.-]){OWN}", plain(page.read_text(encoding="utf-8")))
    if page.name in TO_BE_WRITTEN:
        named = [each for each in named if TO_BE_WRITTEN[page.name] not in each and not each.endswith("/test_")]
    missing = [each for each in named if not (ROOT / each).exists() and not (page.parent / each).exists()]
    assert missing == []


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
