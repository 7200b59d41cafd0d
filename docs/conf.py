"""The book: Sphinx with furo, of the Markdown pages in docs/ and of the docstrings. `make docs` builds and serves it.

The pages are read on plain viewers of Markdown too, so they have no directives: an index page (README.md) is a list of
links, and the tree of the book follows from these links (:func:`add_tree`).
"""

from __future__ import annotations

import posixpath
import re
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.highlighting import lexer_classes
from sphinx.transforms import SphinxTransform
from sphinx.util import logging

logger = logging.getLogger(__name__)

project = "dpstack"
author = copyright = "The dpstack authors"
release = version = installed("dpstack")

extensions = ["myst_parser", "sphinx.ext.autodoc"]
root_doc = "README"
exclude_patterns = ["conf.py"]
myst_heading_anchors = 6
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "undoc-members": True, "show-inheritance": True}
autodoc_typehints_format = "short"
add_module_names = False
#: ``type[...]`` in an annotation could mean several attributes with the name "type"
suppress_warnings = ["ref.python", "misc.highlighting_failure"]  # DuckDB has literals that SQL does not
python_maximum_signature_line_length = 100

html_theme = "furo"
html_title = f"dpstack {release}"
html_show_sphinx = False
html_copy_source = False
html_static_path = ["static"]
html_css_files = ["book.css"]

_LINK = re.compile(r"\]\((?P<target>[\w./-]+\.md)\)")
_PICTURE = re.compile(r"<!-- picture: ([\w-]+) -->")
_ANCHOR = re.compile(r'<a id="([\w-]+)">')
_CELL = re.compile(r"<td\b.*?</td>", re.DOTALL)
_NAME = re.compile(r'(?<=<span class="pre">)[^<]+')
_LONGEST_VALUE = 80
#: beside each README.html, so that the folder's own address leads to it
_TO_README = """<!doctype html>
<meta charset="utf-8"><meta http-equiv="refresh" content="0; url=README.html"><title>dpstack</title>
"""


def add_tree(app: Sphinx, docname: str, source: list[str]) -> None:
    """Append a hidden toctree to an index page: the pages below its folder, in the order of the page's links."""
    if posixpath.basename(docname) != "README":
        return
    linked = (posixpath.normpath(match["target"]) for match in _LINK.finditer(source[0]))
    below = dict.fromkeys(target.removesuffix(".md") for target in linked if not target.startswith(".."))
    own = [page for page in below if "/" not in page or page.endswith("/README")]
    source[0] += "\n\n```{toctree}\n:hidden:\n\n" + "\n".join(own) + "\n```\n"


def link_outside(app: Sphinx, docname: str, source: list[str]) -> None:
    """SECURITY.md and its like beside docs/ are not of the book: the link gives the file."""
    up = "../" * (docname.count("/") + 1)
    source[0] = re.sub(rf"\]\((?={re.escape(up)}\w+\.md\))", "](path:", source[0])


class HtmlAnchors(SphinxTransform):
    """``<a id="...">`` in a page is a place that links lead to, like a heading."""

    default_priority = 870  # before myst_parser.mdit_to_docutils.transforms.ResolveAnchorIds

    def apply(self, **kwargs: Any) -> None:
        raw = "".join(node.astext() for node in self.document.findall(nodes.raw))
        found = {name: (0, name, name) for name in _ANCHOR.findall(raw)}
        if found:
            slugs = {**getattr(self.document, "myst_slugs", {}), **found}
            self.document.myst_slugs = slugs  # type: ignore[attr-defined]  # myst_parser puts its own there
            self.env.metadata[self.env.docname]["myst_slugs"] = slugs


class Pictures(SphinxTransform):
    """A Mermaid block below ``<!-- picture: NAME -->`` becomes pictures/NAME.svg (tools/draw_pictures.py)."""

    default_priority = 400

    def apply(self, **kwargs: Any) -> None:
        for block in list(self.document.findall(nodes.literal_block)):
            if block.get("language") != "mermaid":
                continue
            above = block.previous_sibling()
            mark = _PICTURE.fullmatch(above.astext().strip()) if isinstance(above, nodes.raw) else None
            if mark is None:
                logger.warning("no picture is named above this block", location=block)
                continue
            image = nodes.image(uri=f"/pictures/{mark[1]}.svg", alt=mark[1])
            block.replace_self(nodes.container("", image, classes=["picture"]))


class LongValues(SphinxTransform):
    """The value of an attribute in the reference is left out where it fills the page, like a table of texts."""

    default_priority = 400

    def apply(self, **kwargs: Any) -> None:
        for node in list(self.document.findall(addnodes.desc_annotation)):
            if node.astext().startswith(" =") and len(node.astext()) > _LONGEST_VALUE:
                node.replace_self(addnodes.desc_annotation("", " = ..."))


def break_names(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: object) -> None:
    """A long name in a cell breaks behind ``_``, not within a word."""
    if "body" in context:
        context["body"] = _CELL.sub(
            lambda cell: _NAME.sub(lambda name: re.sub(r"(?<=\w)_(?=\w)", "_<wbr>", name[0]), cell[0]), context["body"]
        )


def write_redirects(app: Sphinx, exception: Exception | None) -> None:
    if exception is None and app.builder.format == "html":
        for page in Path(app.outdir).rglob("README.html"):
            page.with_name("index.html").write_text(_TO_README, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    lexer_classes["mermaid"] = lexer_classes["none"]  # plain viewers draw it, the book has pictures
    app.add_transform(HtmlAnchors)
    app.add_transform(Pictures)
    app.add_transform(LongValues)
    app.connect("source-read", add_tree)
    app.connect("source-read", link_outside)
    app.connect("html-page-context", break_names)
    app.connect("build-finished", write_redirects)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
