"""Parser of GSD files: octets in, the model and diagnostics out. No file content raises an exception.

The order of statements is free in GSD files (definitions may follow their use). So the parser collects everything
first and :mod:`dpstack.gsd.joining` builds the model at the end. Only damage of the structure is an error: a block
that never ends, a file that is no GSD file.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping
from typing import Final

from dpstack.errors import GsdError
from dpstack.gsd.blocks import (
    AreaBlock,
    Block,
    DeviceBlock,
    DiagBlock,
    DiagTypeBlock,
    ModuleBlock,
    ParameterBlock,
    PrmTextBlock,
    RawBlock,
    SlotBlock,
    octets_of,
)
from dpstack.gsd.findings import Findings
from dpstack.gsd.joining import join
from dpstack.gsd.keywords import BLOCKS, CLOSING, KNOWN, RAW_BLOCKS, may_open
from dpstack.gsd.lexer import Statement, first_number, lex, number, ranges, string
from dpstack.gsd.model import Device, Diagnostic, GsdFile, Raw
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
#: blocks that stand in no other block. Where one begins inside an unknown block, the end of that block is missing.
_OUTERMOST: Final = frozenset({"module", "prmtext", "extuserprmdata", "slotdefinition", "unitdiagtype"})
_MISSING: Final = Statement("", None, False, "", "")


def load_gsd(octets: bytes, name: str = "GSD file") -> GsdFile:
    """Like :func:`parse_gsd`, but raises GsdError where the file cannot be used at all."""
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
            findings.info(1, 1, f"the text before #Profibus_DP on line {text.line_of(mark)} is skipped")
    elif any(_LOOKS.match(line) for line in text.lines):
        findings.warning(1, 1, "no line #Profibus_DP, which begins a GSD file; read from its first line")
    else:
        return _nothing(name, "no GSD file: no line #Profibus_DP; give the .gsd (or .gse, .gsg) file of the device")
    if len(text.lines) - start > MAX_LINES:
        findings.error(text.line_of(start + MAX_LINES), 1, f"more than {MAX_LINES} lines: the rest is not read")
    if text.cut:
        message = f"the continued line here has more than {MAX_LOGICAL} characters; it was ended"
        findings.error(text.cut, 1, message)
    reader = _Reader(text, findings)
    reader.run(start)
    device = join(reader.device, findings)
    fatal = None
    if device.ident is None and not device.modules:
        why = "nothing to use: neither Ident_Number nor a module is in it; get a whole copy of the file"
        fatal = Diagnostic(1, 1, Severity.ERROR, why)
    return GsdFile(name, device, findings.all(), text.encoding, fatal)


def _refused(octets: bytes) -> str:
    """Why ``octets`` can be no GSD file, judged by length and first octets; empty: they may be one."""
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
        self.device = DeviceBlock(0, findings, {})
        self._block: Block = self.device
        self._outer: list[Block] = []
        self._reported: set[str] = set()
        self._endings: frozenset[str] | None = None

    def run(self, start: int) -> None:
        lines = self._text.lines[start : start + MAX_LINES]
        numbers = self._text.numbers
        counted = itertools.count(start + 1) if numbers is None else iter(numbers[start:])
        known: dict[str, Statement | None] = {}
        for at, line in zip(counted, lines, strict=False):
            statement = known.get(line, _MISSING)
            if statement is _MISSING:
                statement = known[line] = lex(line)
            if statement is None:
                continue
            block = self._block
            keyword = statement.keyword
            handler = block.handlers.get(keyword)
            if handler is not None:
                handler(block, statement, at)
            elif keyword == block.end:
                self._close(True)
            else:
                self._structure(statement, at)
        while self._outer:
            self._broken_off("the end of the file")

    def _structure(self, statement: Statement, line: int) -> None:
        """Handle a keyword unknown to the open block: it opens a block, closes an outer block, or is kept raw."""
        block, keyword = self._block, statement.keyword
        if keyword in _OPENING and (keyword in _OUTERMOST or not isinstance(block, RawBlock)):
            self._open_known(statement, line)
        elif keyword in CLOSING:
            self._end_of_outer(statement, line)
        elif not self._open_raw(statement, line):
            self._keep(statement, line)

    def _open_known(self, statement: Statement, line: int) -> None:
        keyword = statement.keyword
        while keyword not in self._block.nested and self._outer:
            self._broken_off(f"{statement.written} on line {line}")
        block = _OPENING[keyword](self, statement, line)
        if block is None:
            block = self._raw(statement, line)
        self._open(block, BLOCKS[keyword].lower())

    def _open_raw(self, statement: Statement, line: int) -> bool:
        """Open a block that dpstack has no use for, if the file has its closing keyword too."""
        keyword, block = statement.keyword, self._block
        if isinstance(block, RawBlock) or statement.index is not None or not keyword[:1].isalpha():
            return False
        if keyword in KNOWN and keyword not in RAW_BLOCKS:
            return False
        if self._endings is None:
            matches = (_ENDINGS.match(line.strip()) for line in self._text.lines)
            self._endings = frozenset(match[1].lower() for match in matches if match)
        end = may_open(keyword, self._endings)
        if end is None or end in map(str.lower, BLOCKS.values()):
            return False
        if keyword not in RAW_BLOCKS:
            self._unknown(statement, line)
        self._open(self._raw(statement, line), end)
        return True

    def _raw(self, statement: Statement, line: int) -> RawBlock:
        block = RawBlock(line, self._findings, statement.written)
        block.other(statement, line)
        return block

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
        message = f"{title_of(block)} never ends: {CLOSING.get(block.end, block.end)} is missing before {before}"
        self._findings.error(block.line, 1, message)
        self._close(False)

    def _end_of_outer(self, statement: Statement, line: int) -> None:
        if any(block.end == statement.keyword for block in self._outer):
            while self._block.end != statement.keyword:
                self._broken_off(f"{statement.written} on line {line}")
            self._close(True)
        else:
            self._findings.warning(line, 1, f"{statement.written} ends nothing here; it is skipped")

    def _keep(self, statement: Statement, line: int) -> None:
        block = self._block
        known = statement.keyword in KNOWN
        if not block.other(statement, line):
            name = "" if block is self.device else block.title
            raw = Raw(line, statement.written, statement.index, statement.value, name)
            (block if isinstance(block, DiagBlock) else self.device).raws.append(raw)
            if known or not statement.keyword:
                where = "outside of all blocks" if block is self.device else f"in {title_of(block)}"
                what = statement.written or statement.value[:20]
                self._findings.warning(line, 1, f"{what} does not belong here ({where}); kept as it stands")
                return
        elif isinstance(block, (RawBlock, ModuleBlock)):
            return
        if not known:
            self._unknown(statement, line)

    def _unknown(self, statement: Statement, line: int) -> None:
        if statement.keyword not in self._reported:
            self._reported.add(statement.keyword)
            self._findings.info(line, 1, f"{statement.written[:60]} has no meaning here; kept as it stands")

    # the methods of _OPENING; None: the head of the block cannot be parsed, so that its inside is kept raw

    def numbered(self, statement: Statement, line: int) -> Block | None:
        """PrmText = n, UnitDiagType = n."""
        value = number(statement.value)
        if value is None:
            self._unreadable(statement, line, "a number")
            return None
        kind = PrmTextBlock if statement.keyword == "prmtext" else DiagTypeBlock
        return kind(line, self._findings, value)

    def parameter(self, statement: Statement, line: int) -> Block | None:
        """ExtUserPrmData = n "name"."""
        ref, rest = first_number(statement.value)
        name, _, closed = string(rest)
        if ref is None or name is None or not closed:
            self._unreadable(statement, line, "a number and a name in quotes")
            return None
        return ParameterBlock(line, self._findings, ref, name.strip())

    def module(self, statement: Statement, line: int) -> Block | None:
        """Module = "name" octets."""
        name, rest, closed = string(statement.value)
        if name is None or not closed:
            self._unreadable(statement, line, "a name in quotes")
            return None
        config = octets_of(rest)
        if config is None:
            message = f"module {name!r}: {rest[:40]} is no list of identifier octets; the module cannot be used"
            self._findings.error(line, statement.column, message)
            return _Unusable(line, self._findings, self.device.used, name.strip(), b"")
        return ModuleBlock(line, self._findings, self.device.used, name.strip(), config)

    def slots(self, statement: Statement, line: int) -> Block:
        return SlotBlock(line, self._findings)

    def area(self, statement: Statement, line: int) -> Block | None:
        """Unit_Diag_Area = a-b."""
        bits = ranges(statement.value)
        if not bits or not 0 <= bits[0][0] <= bits[-1][1] < 8 * 244:
            self._unreadable(statement, line, "bits like 0-7")
            return None
        return AreaBlock(line, self._findings, bits[0][0], bits[-1][1])

    def _unreadable(self, statement: Statement, line: int, wanted: str) -> None:
        shown = statement.value[:40] or "nothing"
        message = f"{statement.written} = {shown} is not {wanted}; the block is kept as it stands"
        self._findings.warning(line, statement.column, message)


class _Unusable(ModuleBlock):
    """A module whose identifier octets cannot be read."""

    def finish(self, complete: bool) -> None:
        super().finish(False)


_OPENING: Final[Mapping[str, Callable[[_Reader, Statement, int], Block | None]]] = {
    "prmtext": _Reader.numbered,
    "extuserprmdata": _Reader.parameter,
    "module": _Reader.module,
    "slotdefinition": _Reader.slots,
    "unit_diag_area": _Reader.area,
    "x_unit_diag_area": _Reader.area,
    "unitdiagtype": _Reader.numbered,
}


def title_of(block: Block) -> str:
    """A block for people: ``Module 'x'``, ``PrmText 3``."""
    match block:
        case ModuleBlock():
            return f"Module {block.name!r}"
        case PrmTextBlock() | ParameterBlock():
            return f"{block.title} {block.ref}"
        case RawBlock():
            return block.name
        case _:
            return block.title
