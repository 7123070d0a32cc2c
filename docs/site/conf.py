"""Sphinx's settings; docs/tools/build_site.py puts the sources of the site together and calls Sphinx with these."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

import hexservo

project = "hexservo"
author = "The hexservo authors"
copyright = author  # noqa: A001
version = release = hexservo.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "site_extension"]
exclude_patterns: list[str] = []

# Headings have the anchors that GitHub gives them, so that the pages are the same in both places.
myst_heading_anchors = 6
myst_url_schemes = {"http": None, "https": None, "mailto": None, "source": None}
suppress_warnings = ["misc.highlighting_failure"]  # outputs in plain blocks

autodoc_typehints = "signature"
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "Complex", "Mask")}  # not NumPy's definitions
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_class_signature = "mixed"
python_maximum_signature_line_length = 80
napoleon_google_docstring = False
napoleon_use_rtype = False
default_role = "code"  # `name` in a docstring

html_theme = "furo"
html_title = f"hexservo {release}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_search_summary = False  # it reads the pages found, which a browser refuses to a page from a disk
html_domain_indices = False  # an index of modules, to which no page would lead
pygments_style = "default"
pygments_dark_style = "monokai"
