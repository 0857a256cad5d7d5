"""Configuration of Sphinx, which `make docs` runs; every warning is an error."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # api.py, declared.py

project = "phy124"
html_title = "phy124"
html_theme = "furo"
extensions = ["myst_parser", "api", "declared"]
myst_heading_anchors = 4
exclude_patterns = ["reference/generated/report.md"]
"""Included by reference/report.md."""


def setup(app):
    """Connect the functions of this file to Sphinx."""
    app.connect("html-page-context", fold_navigation, priority=400)  # before the theme at 500


def fold_navigation(app, pagename, templatename, context, doctree):
    """List only the parents and neighbours of a page in the sidebar; this halves the time."""
    toctree = context.get("toctree")
    if toctree is not None:
        context["toctree"] = lambda **options: toctree(**(options | {"collapse": True}))
