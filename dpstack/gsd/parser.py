"""Parser of GSD files: octets in, the model and diagnostics out. No file content raises an exception.

The order of statements is free in GSD files (definitions may follow their use). So the parser collects everything
first and :mod:`dpstack.gsd.joining` builds the model at the end. Only damage of the structure is an error: a block
that never ends, a file that is no GSD file.
"""

from __future__ import annotations

import functools
import re
from typing import Final

from dpstack.errors import GsdError
from dpstack.gsd.blocks import BLOCKS, RAW_BLOCKS, AreaBlock, Block, DeviceBlock, DiagBlock, ModuleBlock, RawBlock
from dpstack.gsd.joining import join
from dpstack.gsd.lexer import Statement, lex
from dpstack.gsd.model import Device, Diagnostic, Findings, GsdFile, Raw
from dpstack.gsd.settings import KEYWORDS
from dpstack.gsd.text import MAX_LINES, MAX_LOGICAL, MAX_OCTETS, Text, read_text
from dpstack.trace import Severity

_MARK: Final = re.compile(r'[^\w;"#]*+#profibus_dp', re.IGNORECASE)
_LOOKS: Final = re.compile(r"^[ \t]*(?:ident_number|gsd_revision|vendor_name)[ \t]*=", re.IGNORECASE | re.MULTILINE)
_ENDINGS: Final = re.compile(r"(end\w+|\w+_end)[ \t]*(?:;|$)", re.IGNORECASE)
#: first octets of the files that users pass in place of a GSD file
_OTHERS: Final = (
    (b"<", "an XML or HTML text, perhaps a GSDML file of PROFINET: get the device's PROFIBUS file (.gsd, .gse)"),
    (b"PK\x03\x04", "a ZIP archive: unpack it and give the .gsd file in it"),
    (b"BM", "a bitmap: give the .gsd file beside it"),
    (b"%PDF", "a PDF document: get the .gsd file from the maker"),
    (b"{\\rtf", "an RTF document: get the .gsd file from the maker"),
    (b"MZ", "a program: it may unpack a GSD file"),
)
#: closing keyword in lower case -> as files write it
_CLOSING: Final = {end.lower(): end for end in (*(end for _, end in BLOCKS.values()), *RAW_BLOCKS.values())}
#: the keywords of the GSD specification. The parser keeps all others unchanged and reports them.
_KNOWN: Final = KEYWORDS.union(
    RAW_BLOCKS, _CLOSING, BLOCKS, DeviceBlock.handlers, *(kind.handlers for kind, _ in BLOCKS.values())
)
_MISSING: Final = Statement("", "", None, False, "", "")


def load_gsd(octets: bytes, name: str = "GSD file") -> GsdFile:
    """Like :func:`parse_gsd`, but raises GsdError if the file cannot be used at all."""
    found = parse_gsd(octets, name)
    if found.fatal is not None:
        raise GsdError(f"{name}:{max(1, found.fatal.line)}: {found.fatal.message}")
    return found


def parse_gsd(octets: bytes, name: str = "GSD file") -> GsdFile:
    """Parse ``octets``. Never raises: ``diagnostics`` has all findings, ``fatal`` the reason why nothing is usable."""
    refused = _refused(octets)
    if refused:
        return _nothing(name, refused)
    text = read_text(octets)
    start, findings = 0, Findings()
    mark = next((n for n, line in enumerate(text.lines) if "#" in line and _MARK.match(line)), None)
    if mark is not None:
        start = mark + 1
        if any(line.strip() and lex(line) for line in text.lines[:mark]):
            findings.info(1, f"the text before #Profibus_DP on line {text.numbers[mark]} is skipped")
    elif any(_LOOKS.match(line) for line in text.lines):
        findings.warning(1, "no line #Profibus_DP, which begins a GSD file; read from its first line")
    else:
        return _nothing(name, "no GSD file: no line #Profibus_DP; give the .gsd (or .gse, .gsg) file of the device")
    if len(text.lines) - start > MAX_LINES:
        findings.error(text.numbers[start + MAX_LINES], f"more than {MAX_LINES} lines: the rest is not read")
    if text.cut:
        message = f"the continued line here has more than {MAX_LOGICAL} characters; it was ended"
        findings.error(text.cut, message)
    reader = _Reader(text, findings)
    reader.run(start)
    device = join(reader.device, findings)
    fatal = None
    if device.ident is None and not device.modules:
        why = "nothing to use: neither Ident_Number nor a module is in it; get a whole copy of the file"
        fatal = Diagnostic(1, 1, Severity.ERROR, why)
    return GsdFile(name, device, findings.all(), text.encoding, fatal)


def _refused(octets: bytes) -> str:
    """The reason why ``octets`` are no GSD file, by length and first octets; empty: they may be one."""
    if len(octets) > MAX_OCTETS:
        return f"no GSD file: more than {MAX_OCTETS // 1_000_000} MB; the largest known one has half of one"
    bare = octets[:4096].removeprefix(b"\xef\xbb\xbf").lstrip(b"\0 \t\r\n\x1a")
    if not bare and not octets.strip(b"\0 \t\r\n\x1a"):
        return "the file is empty; get a whole copy of it"
    for signature, what in _OTHERS:
        if bare.startswith(signature):
            return f"no GSD file but {what}"
    return ""


def _nothing(name: str, why: str) -> GsdFile:
    fatal = Diagnostic(1, 1, Severity.ERROR, why)
    return GsdFile(name, Device(), (fatal,), fatal=fatal)


class _Reader:
    """Walks over the lines: opens and closes blocks and passes each statement to the handler of the open block."""

    def __init__(self, text: Text, findings: Findings) -> None:
        self._text = text
        self._findings = findings
        self.device = DeviceBlock(findings)
        self._block: Block = self.device
        self._outer: list[Block] = []
        self._reported: set[str] = set()

    def run(self, start: int) -> None:
        lines = self._text.lines[start : start + MAX_LINES]
        known: dict[str, Statement | None] = {}
        statement_of = known.get
        block = self._block
        for at, line in zip(self._text.numbers[start:], lines, strict=False):
            statement = statement_of(line, _MISSING)
            if statement is _MISSING:
                statement = known[line] = lex(line)
            if statement is None:
                continue
            statement.line = at
            handler = block.handlers.get(statement.keyword)
            if handler is not None:
                handler(block, statement)
                continue
            if statement.keyword == block.end:
                self._close(True)
            else:
                self._structure(statement)
            block = self._block
        while self._outer:
            self._broken_off("the end of the file")

    def _structure(self, statement: Statement) -> None:
        """Handle a keyword unknown to the open block: it opens a block, closes an outer block, or is kept raw."""
        block, keyword = self._block, statement.keyword
        known = BLOCKS.get(keyword)
        if known is not None and (known[0] is not AreaBlock or not isinstance(block, RawBlock)):
            self._open_known(statement, *known)
        elif keyword in _CLOSING:
            self._end_of_outer(statement)
        elif not self._open_raw(statement):
            self._keep(statement)

    def _open_known(self, statement: Statement, kind: type[Block], end: str) -> None:
        """Open a block of ``kind``. If its head cannot be parsed, its inside is kept raw."""
        # only areas stand inside other blocks: if another block begins, the end of the open one is missing
        while self._outer and not (kind is AreaBlock and isinstance(self._block, DiagBlock)):
            self._broken_off(f"{statement.written} on line {statement.line}")
        block = kind.opened_by(statement, self._findings)
        if block is None:
            shown = statement.value[:40] or "nothing"
            message = f"{statement.written} = {shown} is not {kind.head}; the block is kept as it stands"
            self._findings.warning(statement.line, message, statement.column)
            block = RawBlock.opened_by(statement, self._findings)
        self._open(block, end.lower())

    def _open_raw(self, statement: Statement) -> bool:
        """Open a block that dpstack does not use, if the file has its closing keyword too."""
        keyword, block = statement.keyword, self._block
        if isinstance(block, RawBlock) or statement.index is not None or not keyword[:1].isalpha():
            return False
        if keyword in _KNOWN and keyword not in RAW_BLOCKS:
            return False
        end = _closing_keyword(keyword, self._endings)
        if end is None or end in (known.lower() for _, known in BLOCKS.values()):
            return False
        if keyword not in RAW_BLOCKS:
            self._unknown(statement)
        self._open(RawBlock.opened_by(statement, self._findings), end)
        return True

    @functools.cached_property
    def _endings(self) -> frozenset[str]:
        """The words of this file that may be closing keywords, in lower case."""
        matches = (_ENDINGS.match(line.strip()) for line in set(self._text.lines) if "end" in line.lower())
        return frozenset(match[1].lower() for match in matches if match)

    def _open(self, block: Block, end: str) -> None:
        block.end = end
        self._outer.append(self._block)
        self._block = block

    def _close(self, complete: bool) -> None:
        inner, self._block = self._block, self._outer.pop()
        inner.finish(complete)
        self._block.add(inner)

    def _broken_off(self, before: str) -> None:
        block = self._block
        message = f"{block.full_title} never ends: {_CLOSING.get(block.end, block.end)} is missing before {before}"
        self._findings.error(block.line, message)
        self._close(False)

    def _end_of_outer(self, statement: Statement) -> None:
        if any(block.end == statement.keyword for block in self._outer):
            while self._block.end != statement.keyword:
                self._broken_off(f"{statement.written} on line {statement.line}")
            self._close(True)
        else:
            self._findings.warning(statement.line, f"{statement.written} ends nothing here; it is skipped")

    def _keep(self, statement: Statement) -> None:
        block = self._block
        known = statement.keyword in _KNOWN
        if not block.other(statement):
            raw = Raw(statement.line, statement.written, statement.index, statement.value, block.title)
            (block if isinstance(block, DiagBlock) else self.device).raws.append(raw)
            if known or not statement.keyword:
                where = "outside of all blocks" if block is self.device else f"in {block.full_title}"
                what = statement.written or statement.value[:20]
                self._findings.warning(statement.line, f"{what} does not belong here ({where}); kept as it stands")
                return
        elif isinstance(block, (RawBlock, ModuleBlock)):
            return
        if not known:
            self._unknown(statement)

    def _unknown(self, statement: Statement) -> None:
        if statement.keyword not in self._reported:
            self._reported.add(statement.keyword)
            self._findings.info(statement.line, f"{statement.written[:60]} has no meaning here; kept as it stands")


def _closing_keyword(keyword: str, endings: frozenset[str]) -> str | None:
    """The closing keyword that an unknown ``keyword`` has among the file's ``endings``; None if it has none."""
    for ending in (f"end{keyword}", f"end_{keyword}", f"{keyword}_end", f"{keyword.removesuffix('_beg')}_end"):
        if ending in endings:
            return ending
    return None
