"""Sphinx extension: every link of the built pages leads somewhere in the site, and no page fetches anything."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from sphinx.util import logging

if TYPE_CHECKING:
    from sphinx.application import Sphinx

# What a style sheet fetches from elsewhere.
OUTSIDE = re.compile(r"(?:url\(|@import)\s*[\"']?((?:https?:)?//[^\"')\s]+)")
FETCHED = {("script", "src"), ("link", "href"), ("img", "src"), ("iframe", "src"), ("source", "src")}
log = logging.getLogger(__name__)


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("build-finished", _check)
    return {"parallel_read_safe": True}


class _Page(HTMLParser):
    """A page's anchors, links, and what a browser would fetch for it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors: set[str] = {""}
        self.links: set[str] = set()
        self.fetched: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for key, value in attrs:
            if key == "id":
                self.anchors.add(value or "")
            elif value and key in ("href", "src"):
                self.links.add(value)
                if (tag, key) in FETCHED:
                    self.fetched.add(value)


def _check(app: Sphinx, problem: Exception | None) -> None:
    if problem is not None or app.builder.format != "html":
        return
    top = Path(app.outdir)
    pages = {path: _Page(path) for path in sorted(top.rglob("*.html"))}
    for path, page in pages.items():
        where = path.relative_to(top)
        for link in sorted(page.fetched):
            if urlsplit(link).netloc:
                log.warning("%s fetches %s", where, link)
        for link in sorted(page.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:  # not ours to hold: the build has no network
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.is_file():
                log.warning("%s links to %s, which is not in the site", where, link)
            elif target in pages and unquote(parts.fragment) not in pages[target].anchors:
                log.warning("%s links to %s, which is no place on that page", where, link)
    for path in sorted(top.rglob("*.css")):
        for url in OUTSIDE.findall(path.read_text(encoding="utf-8")):
            log.warning("%s fetches %s", path.relative_to(top), url)
