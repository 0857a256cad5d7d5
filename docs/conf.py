"""How Sphinx builds the documentation: `make docs`, every warning an error."""

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
