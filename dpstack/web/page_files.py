"""The files of the page, and the headers of every response."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

FOLDER: Final = Path(__file__).parent / "page"
INDEX: Final = "index.html"
_KINDS: Final = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".ico": "image/x-icon",
    ".json": "application/json",
    ".txt": "text/plain; charset=utf-8",
    ".woff2": "font/woff2",
}
#: Nothing from elsewhere, no script or style in the markup itself, no frame of others around the page, no form. So a
#: text of a device that became markup by a defect of the page could still run nothing.
_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; font-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS: Final[Mapping[str, str]] = {
    "Content-Security-Policy": _POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Server": "dpstack",
}


class PageFile(NamedTuple):
    content_type: str
    octets: bytes


def read_page(folder: Path = FOLDER) -> dict[str, PageFile]:
    """The files below ``folder`` by their path in a URL, ``/app.js``; the index is ``/``, too.

    They are read once: a request never leads to a file. Files of other kinds than a page has are left out.
    """
    found = {}
    for path in sorted(folder.rglob("*")):
        kind = _KINDS.get(path.suffix)
        if kind is not None and path.is_file():
            found[f"/{path.relative_to(folder).as_posix()}"] = PageFile(kind, path.read_bytes())
    if f"/{INDEX}" in found:
        found["/"] = found[f"/{INDEX}"]
    return found
