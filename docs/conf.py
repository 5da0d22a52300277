"""Settings of ``make docs``, which needs xbus and its extra ``docs``."""

import re
import sys
from enum import Enum
from pathlib import Path
from typing import Any

from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx

import xbus

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "xbus"
author = "the xbus authors"
copyright = "the xbus authors"  # noqa: A001 - Sphinx's name
release = version = xbus.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "protocol", "figures"]
exclude_patterns = ["_build"]

# A name in single backticks in a docstring is a link if its target is documented.
default_role = "py:obj"
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_type_aliases = {name: name for name in ("Source", "Key", "OutputConfiguration")}
python_use_unqualified_type_names = True
myst_enable_extensions = ["deflist"]
myst_heading_anchors = 3

html_theme = "furo"
html_title = f"xbus {release}"
html_static_path = ["_static"]
html_css_files = ["tables.css"]
templates_path = ["_templates"]
html_sidebars = {
    "**": [
        "sidebar/brand.html",
        "versions.html",
        "sidebar/search.html",
        "sidebar/scroll-start.html",
        "sidebar/navigation.html",
        "sidebar/scroll-end.html",
    ]
}
# Of ``make linkcheck``: addresses of examples, and a site that answers programs with an error.
linkcheck_ignore = [r"https?://127\.0\.0\.1", r"https://www\.movella\.com"]
linkcheck_timeout = 20


def aliases_by_name(*event: Any) -> tuple[str | None, str | None]:
    """Shows the name of a type alias where autodoc shows its representation."""
    signature, returns = (
        re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text or "") for text in event[-2:]
    )
    return signature or None, returns or None


def is_field(*event: Any) -> bool | None:
    """Skips fields of dataclasses: the signature and the docstring already list them."""
    _, what, _, member, *_ = event
    has_own_entry = isinstance(member, Enum | property) or callable(member)
    return True if what == "class" and not has_own_entry else None


#: Pages that include a file in the root of the repository, by the name of the file.
ROOT_PAGES = {
    "CHANGELOG.md": "changelog",
    "CONTRIBUTING.md": "contributing",
    "SECURITY.md": "security",
}


def link_root_pages(_app: Sphinx, document: Any) -> None:
    """Makes links between files in the root of the repository lead to their pages."""
    for reference in document.findall(pending_xref):
        if page := ROOT_PAGES.get(reference.get("reftarget")):
            reference["refdomain"], reference["reftarget"] = "doc", page
            reference["reftargetid"] = None


def setup(app: Sphinx) -> None:
    app.connect("doctree-read", link_root_pages)
    app.connect("autodoc-process-signature", aliases_by_name)
    app.connect("autodoc-skip-member", is_field)
