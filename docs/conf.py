"""How the documentation becomes a site: `sphinx-build -W --keep-going docs out/site`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

import warpsar

project = "warpsar"
author = "The warpsar authors"
version = release = warpsar.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_click", "scene_file", "whole_site"]

# Pages are Markdown, so that they also read well in a repository's own viewer.
myst_heading_anchors = 3

smartquotes = False  # `--option` keeps its two hyphens

# Docstrings write code as `code`, once.
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 80
add_module_names = False

html_theme = "furo"
html_title = "warpsar"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_show_copyright = False
html_copy_source = False
# Furo fetches nothing: no web font, no script from elsewhere. `whole_site` holds the built pages to that.
