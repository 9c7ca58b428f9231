"""README's links lead to files; those of docs/ are held by the site's build."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_readme_links_lead_to_files() -> None:
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", (ROOT / "README.md").read_text(encoding="utf-8"))
    inside = [link for link in links if "://" not in link]
    assert len(inside) >= 10
    assert [link for link in inside if not (ROOT / link).is_file()] == []
