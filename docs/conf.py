"""
The documentation site: how Sphinx makes pages of `docs/`, `notebooks/` and the Markdown files here.

Sphinx reads from the repository's root, so that a link between two files leads to the same place on
the site as on a code host. `make docs` builds it.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs" / "_ext"))

project = "treelod"
author = "The treelod authors"
copyright = author  # noqa: A001

root_doc = "docs/README"
include_patterns = [
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "docs/**.md",
    "notebooks/*.ipynb",
]
# what holds no page is not even looked through
exclude_patterns = [".*", "target", "src", "fuzz", "tests", "python", "dist", "demo"]

extensions = [
    "gallery",
    "mathml",
    "myst_nb",
    "names",
    "numpydoc",
    "sphinx.ext.autodoc",
]

# Markdown
myst_enable_extensions = ["dollarmath"]
myst_dmath_double_inline = False
myst_heading_anchors = 4
# a notebook is shown as it was executed and committed
nb_execution_mode = "off"

# a block that names no language has none
highlight_language = "none"

# API
autodoc_member_order = "bysource"
autodoc_typehints = "none"
numpydoc_show_class_members = False
default_role = "name"
nitpicky = True
# what the types of our type aliases are made of is not documented here
nitpick_ignore_regex = [("py:class", r"(collections\.abc|numpy)\..*")]

# the page
html_theme = "pydata_sphinx_theme"
html_title = "treelod"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_extra_path = ["_root"]
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_show_copyright = False
html_theme_options = {
    "show_prev_next": True,
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "navbar_align": "left",
    "header_links_before_dropdown": 6,
    "footer_start": ["copyright"],
    "footer_end": [],
}


def without_signature(
    _app: "Sphinx", what: str, _name: str, value: Any, *_rest: Any
) -> tuple[str, None] | None:
    """Show no arguments of classes that are made by `build` or by a loader, never by a call."""
    from treelod import Plant
    from treelod.techniques import Technique

    is_made_elsewhere = what == "class" and issubclass(value, (Plant, Technique))
    return ("", None) if is_made_elsewhere else None


def setup(app: "Sphinx") -> None:
    """Register what is above."""
    app.connect("autodoc-process-signature", without_signature)
