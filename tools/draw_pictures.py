"""Draws the Mermaid pictures of the documents as SVG files for the book, with graphviz (`dot`).

Plain viewers of Markdown draw Mermaid themselves; the book shows docs/pictures/NAME.svg in place of a block below
``<!-- picture: NAME -->``. The book needs no graphviz: the files are in the project. Each has the Mermaid text that it
was made from as its description, and a test compares the two.
"""

from __future__ import annotations

import re
import subprocess
import textwrap
from html import escape
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

FOLDER: Final = Path(__file__).resolve().parent.parent / "docs" / "pictures"
_NODE: Final = re.compile(r'(\w+)\["(.+)"\]')
_ARROW: Final = re.compile(r"(\[\*\]|\w+) (<?-->) (\w+)(?:: (.+))?")
_HEAD: Final = """digraph {
  graph [rankdir=TB, nodesep=0.35, ranksep=0.45, pad=0.25, bgcolor=transparent]
  node [shape=box, style="rounded,filled", fillcolor="#f1f3f5", color="#57606a", fontcolor="#1b1f24"]
  node [fontname="Helvetica,Arial,sans-serif", fontsize=14, margin="0.18,0.09", height=0.35]
  edge [color="#57606a", fontcolor="#1b1f24", fontname="Helvetica,Arial,sans-serif", fontsize=12, arrowsize=0.8]
"""
_BEGIN: Final = '  begin [shape=circle, style=filled, fillcolor="#1b1f24", label="", width=0.16, height=0.16]'
_SVG: Final = "http://www.w3.org/2000/svg"
#: characters in a line of a label; a longer one makes the picture wide
_WIDTH: Final = 24


def dot(mermaid: str) -> str:
    """A flowchart or state diagram of tools/make_pictures.py as a graph for graphviz."""
    lines = []
    for line in mermaid.splitlines()[1:]:
        if node := _NODE.fullmatch(line.strip()):
            lines.append(f'  {node[1]} [label="{_wrapped(node[2])}"]')
        elif arrow := _ARROW.fullmatch(line.strip()):
            source, kind, target, label = arrow.groups()
            if source == "[*]":
                lines.append(_BEGIN)
                source = "begin"
            both = ", dir=both" if kind == "<-->" else ""
            lines.append(f'  {source} -> {target} [label="{_wrapped(label or "")}"{both}]')
        else:
            raise ValueError(f"neither a node nor an arrow: {line!r}")
    return _HEAD + "\n".join(lines) + "\n}\n"


def _wrapped(label: str) -> str:
    return "\\n".join(f" {line} " for line in textwrap.wrap(label, _WIDTH))


def svg(mermaid: str, title: str) -> str:
    """The picture as the text of an SVG file. Raises FileNotFoundError if graphviz is not installed."""
    done = subprocess.run(["dot", "-Tsvg"], input=dot(mermaid), capture_output=True, text=True, check=True)
    drawn = re.search(r"<svg[^>]*?viewBox=\"0\.00 0\.00 ([\d.]+) ([\d.]+)\"[^>]*>\n(.*)</svg>", done.stdout, re.DOTALL)
    assert drawn is not None, done.stdout
    width, height = (round(float(size)) for size in drawn.groups()[:2])
    body = re.sub(r"<!--.*?-->\n|<title>.*?</title>\n", "", drawn[3], flags=re.DOTALL)
    return (
        f'<svg xmlns="{_SVG}" viewBox="0 0 {width} {height}" width="{width}" height="{height}" role="img" '
        f'aria-labelledby="t d">\n<title id="t">{escape(title)}</title>\n<desc id="d">{escape(mermaid)}</desc>\n'
        f'<rect width="{width}" height="{height}" rx="8" fill="#ffffff"/>\n{body}</svg>\n'
    )


def path_of(name: str) -> Path:
    return FOLDER / f"{name}.svg"


def source_of(name: str) -> str:
    """The Mermaid text that the file of a picture was made from; empty if there is no such file."""
    if not path_of(name).exists():
        return ""
    return ElementTree.parse(path_of(name)).findtext(f"{{{_SVG}}}desc") or ""


def write(name: str, mermaid: str, title: str) -> None:
    """Draw a picture anew if its source has changed."""
    if source_of(name) == mermaid:
        return
    try:
        path_of(name).write_text(svg(mermaid, title), encoding="utf-8")
    except FileNotFoundError:
        raise SystemExit("drawing pictures needs graphviz: apt-get install graphviz") from None
