"""Sphinx: these pages as a site, with the references of Python packages and C header (`make docs`)."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
project = "AMINN"
copyright = "the AMINN authors"
version = release = re.search(r'^version = "(.+)"', (ROOT / "pyproject.toml").read_text(), re.M)[1]

extensions = ["myst_parser", "breathe", "sphinx.ext.autodoc", "sphinx.ext.autosummary"]
exclude_patterns = ["conf.py"]
myst_enable_extensions = ["attrs_inline"]
myst_heading_anchors = 4
# What pages link to beside each other lies in the repository, which the site does not hold.
suppress_warnings = ["myst.xref_missing", "misc.highlighting_failure"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "separated"

breathe_projects = {"aminn": str(ROOT / "build" / "docs" / "doxygen" / "xml")}
breathe_default_project = "aminn"
breathe_domain_by_extension = {"h": "c"}

html_theme = "furo"
html_title = f"AMINN {version}"
