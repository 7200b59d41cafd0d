"""The block classes of the GSD parser: device, module, parameter, texts, slots and diagnosis while they are read.

Each class has a table of handlers by keyword; :data:`BLOCKS` has the classes by the keyword that opens them. At its
closing keyword a block hands its content to the block around it.
A line often occurs again in a file. All its occurrences are one :class:`Statement`, which keeps the parsed value as
``item`` (False if it cannot be parsed). Each occurrence is reported.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final, Self, TypeAlias, TypeVar

from msgspec.structs import replace

from dpstack.gsd.identifiers import MAX_USER_PRM
from dpstack.gsd.lexer import (
    Statement,
    first_number,
    lex,
    number,
    numbers,
    ranges,
    ranges_only,
    string,
    without_remark,
)
from dpstack.gsd.model import (
    Diagnosis,
    DiagText,
    Findings,
    Module,
    PrmBlock,
    PrmConst,
    PrmKind,
    PrmRef,
    PrmType,
    Ranges,
    Raw,
    Slot,
    in_ranges,
    ranges_text,
)
from dpstack.text import shortened

#: (block, statement)
Handler: TypeAlias = Callable[[Any, Statement], None]


class Block:
    """``title`` as the file writes it; ``head``: the text, for messages, that must stand behind the opening keyword.

    ``end``: the closing keyword in lower case, set by the parser. The device has none: its block ends with the file.
    """

    title = ""
    head = ""
    handlers: ClassVar[Mapping[str, Handler]] = {}
    end = "\n"

    def __init__(self, line: int, findings: Findings) -> None:
        self.line = line
        self.findings = findings

    @classmethod
    def opened_by(cls, statement: Statement, findings: Findings) -> Self | None:
        """The block that ``statement`` opens; None if its :attr:`head` cannot be parsed."""
        return cls(statement.line, findings)

    @property
    def full_title(self) -> str:
        """The block in messages: ``Module 'x'``, ``PrmText 3``."""
        return self.title

    def other(self, statement: Statement) -> bool:
        """Handle a keyword that has no handler. False: this block does not use it either."""
        return False

    def add(self, inner: Block) -> None:
        """Take over the content of ``inner``, a block inside this one that has ended."""

    def finish(self, complete: bool) -> None:
        """End the block. Not ``complete``: its closing keyword is missing."""

    def warn(self, statement: Statement, message: str) -> None:
        """Report ``message`` at the value of ``statement``."""
        self.findings.warning(statement.line, message, statement.column)

    def number(self, statement: Statement) -> int | None:
        """The value of ``statement`` as one number; None for anything else."""
        return read_value(self.findings, statement, number)


def warn_of_remark(findings: Findings, statement: Statement) -> None:
    """Report a comment behind the value of ``statement`` that lacks its semicolon."""
    if statement.remark:
        message = (
            f"{statement.written}: {shortened(statement.remark)!r} behind the value is skipped as a comment; a comment "
            f"begins with a semicolon"
        )
        findings.warning(statement.line, message, statement.column)


_T = TypeVar("_T")


def read_value(
    findings: Findings, statement: Statement, parse: Callable[[str], _T | None], text: str | None = None
) -> _T | None:
    """:func:`without_remark`, and the report of a comment that lacks its semicolon."""
    found = without_remark(statement, parse, text)
    warn_of_remark(findings, statement)
    return found


def _parsed(statement: Statement, parse: Callable[[Statement], _T | None]) -> _T | None:
    """The result of ``parse``, which is called once for each text of a line. None: the statement cannot be parsed."""
    if statement.item is None:
        statement.item = parse(statement) or False
    return statement.item or None  # type: ignore[return-value]


def _index(statement: Statement) -> int | None:
    return number(statement.index) if statement.index else None


def _numbered_text(statement: Statement) -> tuple[int, str] | None:
    text, _, closed = string(statement.value)
    at = _index(statement)
    if text is None and statement.value and statement.equals:
        text = statement.value
    return None if at is None or text is None or not closed else (at, text.strip())


def text_item(block: Block, statement: Statement, what: str) -> tuple[int, str] | None:
    """(number, text) of ``Text(3) = "on"`` and similar statements; None and a warning if it cannot be parsed."""
    item = _parsed(statement, _numbered_text)
    if item is None:
        text, _, closed = string(statement.value)
        if text is not None and not closed:
            problem = "the text has no closing quote"
        elif text is None:
            problem = "a text in quotes is missing"
        else:
            problem = f"{statement.index or 'nothing'} in parentheses is no number"
        block.warn(statement, f"{statement.written}: {problem}; this {what} is left out")
    return item


class NumberedBlock(Block):
    """A block with a number that others refer to it by."""

    head = "a number"

    def __init__(self, line: int, findings: Findings, ref: int) -> None:
        super().__init__(line, findings)
        self.ref = ref

    @classmethod
    def opened_by(cls, statement: Statement, findings: Findings) -> Self | None:
        ref = read_value(findings, statement, number)
        return None if ref is None else cls(statement.line, findings, ref)

    @property
    def full_title(self) -> str:
        return f"{self.title} {self.ref}"


class PrmTextBlock(NumberedBlock):
    """PrmText = n."""

    title = "PrmText"

    def __init__(self, line: int, findings: Findings, ref: int) -> None:
        super().__init__(line, findings, ref)
        self.texts: dict[int, str] = {}

    def text(self, statement: Statement) -> None:
        item = text_item(self, statement, "value")
        if item is not None:
            at, text = item
            if self.texts.get(at, text) != text:
                self.warn(statement, f"Text({at}) stands twice in {self.full_title}; the last one counts")
            self.texts[at] = text

    handlers = {"text": text}


#: the types of whole octets by keyword: unsigned8 ... signed32
_WHOLE: Final = {
    f"{sign}{8 * size}".lower(): PrmType(PrmKind(f"{sign}{8 * size}"), 0, 8 * size - 1, size)
    for sign in ("Unsigned", "Signed")
    for size in (1, 2, 4)
}
#: the highest bit number of a parameter
_LAST_BIT: Final = 31

#: type, default, allowed values, problem (empty: none)
_TypeItem: TypeAlias = tuple[PrmType, int, Ranges, str]


class ParameterBlock(NumberedBlock):
    """ExtUserPrmData = n "name"."""

    title = "ExtUserPrmData"
    head = "a number and a name in quotes"

    def __init__(self, line: int, findings: Findings, ref: int, name: str) -> None:
        super().__init__(line, findings, ref)
        self.name = name
        #: fields of the Parameter; without ``type`` it cannot be used
        self.fields: dict[str, Any] = {}

    @classmethod
    def opened_by(cls, statement: Statement, findings: Findings) -> Self | None:
        ref, rest = first_number(statement.value)
        name, _, closed = string(rest)
        return None if ref is None or name is None or not closed else cls(statement.line, findings, ref, name.strip())

    def typed(self, statement: Statement) -> None:
        """``Unsigned8 0 0-255``, ``Bit(3) 1 0-1``, ``BitArea(0-2) 0 0,1,5``."""
        item = _parsed(statement, _type_item)
        if isinstance(item, tuple):
            kind, default, allowed, problem = item
            self.fields |= {"type": kind, "default": default, "allowed": allowed}
        else:
            problem = item or ""
        warn_of_remark(self.findings, statement)
        if problem:
            self.warn(statement, f"{self.full_title}: {problem}")

    def setting(self, statement: Statement) -> None:
        """Prm_Text_Ref = n, Changeable = 0 or 1, Visible = 0 or 1."""
        value = self.number(statement)
        if value is None:
            message = f"{statement.written} = {statement.value or 'nothing'} is no number; left out"
            self.warn(statement, message)
        if statement.keyword in ("changeable", "visible"):
            self.fields[statement.keyword] = value != 0
        else:
            self.fields["text_ref"] = value

    handlers = {
        **dict.fromkeys((*_WHOLE, "bit", "bitarea"), typed),
        **dict.fromkeys(("prm_text_ref", "prmtextref", "changeable", "visible"), setting),
    }


def prm_type_of(text: str) -> PrmType | None:
    """The type in ``text`` as a file writes it: ``Unsigned8``, ``Bit(3)``, ``BitArea(0-3)``; None for anything else."""
    statement = lex(text)
    if statement is None or statement.equals or statement.value:
        return None
    known = _WHOLE.get(statement.keyword)
    if known is not None:
        return known if statement.index is None else None
    return _bits(statement) if statement.keyword in ("bit", "bitarea") else None


def _type_item(statement: Statement) -> _TypeItem | str:
    kind = _WHOLE.get(statement.keyword) or _bits(statement)
    if kind is None:
        return (
            f"{statement.written}({statement.index or ''}) names no bits of 0..{_LAST_BIT}; the parameter is left out"
        )
    default, rest = first_number(statement.value)
    if default is None:
        return f"no default value in {statement.written} {statement.value}; the parameter is left out"
    only = ranges_only(statement.value)
    if only is not None:
        return _without_default(kind, only)
    allowed = without_remark(statement, ranges, rest)
    if allowed is None:
        return kind, default, (), f"allowed values {rest!r} cannot be read; every value of {kind.text} is allowed"
    low, high = kind.limits
    if not low <= default <= high:
        return kind, default, allowed, f"default {default} does not fit {kind.text}; its low bits are used"
    wrong = [pair for pair in allowed if not low <= pair[0] <= pair[1] <= high]
    if wrong:
        return kind, default, allowed, f"allowed values {ranges_text(tuple(wrong))} do not fit {kind.text}"
    if allowed and not any(a <= default <= b for a, b in allowed):
        return kind, default, allowed, f"default {default} is not among the allowed values {ranges_text(allowed)}"
    return kind, default, allowed, ""


def _without_default(kind: PrmType, allowed: Ranges) -> _TypeItem:
    """``Bit(0)  0-1``: the default is 0, or the lowest value if 0 is not allowed."""
    default = 0 if in_ranges(0, allowed) else min(low for low, _ in allowed)
    problem = f"no default value in front of the range {ranges_text(allowed)}; {default} is used"
    lowest, highest = kind.limits
    if any(not lowest <= low <= high <= highest for low, high in allowed):
        problem = f"allowed values {ranges_text(allowed)} do not fit {kind.text}; the default is {default}"
    return kind, default, allowed, problem


def _bits(statement: Statement) -> PrmType | None:
    pairs = ranges(statement.index or "")
    if pairs is None or len(pairs) != 1:
        return None
    first, last = sorted(pairs[0])
    if first < 0 or last > _LAST_BIT:
        return None
    kind = PrmKind.BIT if statement.keyword == "bit" and first == last else PrmKind.BIT_AREA
    size = 1 if last < 8 else 2 if last < 16 else 4
    return PrmType(kind, first, last, size)


class SlotBlock(Block):
    title = "SlotDefinition"

    def __init__(self, line: int, findings: Findings) -> None:
        super().__init__(line, findings)
        #: by number, the last one of each
        self.slots: dict[int, Slot] = {}

    def slot(self, statement: Statement) -> None:
        """``Slot(1) = "name" default allowed`` (module references)."""
        at = _index(statement)
        name, rest, _ = string(statement.value)
        name = (name or "").strip()
        default, _ = first_number(rest)
        allowed = read_value(self.findings, statement, lambda text: ranges(first_number(text)[1]), rest)
        if at is None or allowed is None:
            self.warn(statement, f"{statement.written}: cannot be read; the slot is left out")
            return
        if default is not None and not allowed:
            allowed = ((default, default),)
        if default is not None and not any(low <= default <= high for low, high in allowed):
            message = f"Slot({at}): the default module {default} is not among those allowed ({ranges_text(allowed)})"
            self.warn(statement, message)
        if at in self.slots:
            self.warn(statement, f"Slot({at}) stands twice; the last one counts")
        self.slots[at] = Slot(at, name, default, allowed, statement.line)

    handlers = {"slot": slot}


class RawBlock(Block):
    """A block that dpstack does not use. It keeps its statements unchanged."""

    def __init__(self, line: int, findings: Findings, name: str) -> None:
        super().__init__(line, findings)
        self.name = name
        self.raws: list[Raw] = []

    @classmethod
    def opened_by(cls, statement: Statement, findings: Findings) -> Self:
        block = cls(statement.line, findings, statement.written)
        block.other(statement)
        return block

    @property
    def full_title(self) -> str:
        return self.name

    def other(self, statement: Statement) -> bool:
        self.raws.append(Raw(statement.line, statement.written, statement.index, statement.value, self.name))
        return True


#: keyword -> kind of a DiagText, or of the help that belongs to it
_DIAG_KINDS: Final = {
    "unit_diag_bit": "bit",
    "unit_diag_bit_help": "bit_help",
    "unit_diag_not_bit": "not_bit",
    "unit_diag_not_bit_help": "not_bit_help",
    "unit_diag_!bit": "not_bit",  # two vendors' spelling
    "unit_diag_!bit_help": "not_bit_help",
    "channel_diag": "channel",
    "channel_diag_help": "channel_help",
}
_X: Final = "x_"


class AreaBlock(Block):
    """Unit_Diag_Area = a-b, X_Unit_Diag_Area."""

    title = "Unit_Diag_Area"
    head = "bits like 0-7"

    def __init__(self, line: int, findings: Findings, first: int, last: int) -> None:
        super().__init__(line, findings)
        self.first = first
        self.last = last
        self.values: dict[int, str] = {}
        self.helps: dict[int, str] = {}

    @classmethod
    def opened_by(cls, statement: Statement, findings: Findings) -> Self | None:
        bits = read_value(findings, statement, ranges)
        if not bits or not 0 <= bits[0][0] <= bits[-1][1] < 8 * 244:
            return None
        return cls(statement.line, findings, bits[0][0], bits[-1][1])

    def text(self, statement: Statement) -> None:
        """Value(n) = "...", Value_Help(n) = "..."."""
        item = text_item(self, statement, "value")
        if item is None:
            return
        at, text = item
        if at >> (self.last - self.first + 1):
            message = f"{statement.written}({at}) does not fit bits {self.first}..{self.last}; it can never be shown"
            self.warn(statement, message)
        (self.helps if statement.keyword.endswith("help") else self.values)[at] = text

    def diag_texts(self) -> list[DiagText]:
        return [
            DiagText("area", self.first, self.last, value, text, self.helps.get(value, ""))
            for value, text in sorted(self.values.items())
        ]

    handlers = dict.fromkeys(("value", "x_value", "value_help", "x_value_help"), text)


class DiagBlock(Block):
    """A block in which diagnosis texts may stand."""

    def __init__(self, line: int, findings: Findings) -> None:
        super().__init__(line, findings)
        self.texts: dict[str, dict[int, str]] = {}
        self.areas: list[DiagText] = []
        self.raws: list[Raw] = []

    def diag_text(self, statement: Statement) -> None:
        """Unit_Diag_Bit(n) = "..." and the other keywords of _DIAG_KINDS."""
        item = text_item(self, statement, "text")
        if item is None:
            return
        at, text = item
        texts = self.texts.setdefault(statement.keyword, {})
        if texts.get(at, text) != text:
            message = f"{statement.written}({at}) stands twice with different texts; the last one counts"
            self.warn(statement, message)
        texts[at] = text

    def add(self, inner: Block) -> None:
        if isinstance(inner, AreaBlock):
            self.areas += inner.diag_texts()
        elif isinstance(inner, (RawBlock, DiagTypeBlock)):
            self.raws += inner.raws

    def diagnosis(self, type_number: int | None = None) -> Diagnosis:
        """The texts read so far. If a plain and an X_ text have the same number, the X_ text (of DP-V1) counts."""
        if not self.texts:
            return Diagnosis(tuple(self.areas), type_number)
        merged: defaultdict[str, dict[int, str]] = defaultdict(dict)
        for keyword, texts in sorted(self.texts.items(), key=lambda item: item[0].startswith(_X)):
            merged[_DIAG_KINDS[keyword.removeprefix(_X)]].update(texts)
        found: list[DiagText] = []
        for kind, value in (("bit", 1), ("not_bit", 0)):
            for bit, text in sorted(merged[kind].items()):
                found.append(DiagText(kind, bit, bit, value, text, merged[f"{kind}_help"].get(bit, "")))
        found += self.areas
        for error, text in sorted(merged["channel"].items()):
            found.append(DiagText("channel", None, None, error, text, merged["channel_help"].get(error, "")))
        return Diagnosis(tuple(found), type_number)

    handlers = dict.fromkeys((*_DIAG_KINDS, *(_X + keyword for keyword in _DIAG_KINDS)), diag_text)


class DiagTypeBlock(DiagBlock):
    """UnitDiagType = n."""

    title = "UnitDiagType"
    head = NumberedBlock.head

    def __init__(self, line: int, findings: Findings, ref: int) -> None:
        super().__init__(line, findings)
        self.ref = ref

    @classmethod
    def opened_by(cls, statement: Statement, findings: Findings) -> Self | None:
        ref = read_value(findings, statement, number)
        return None if ref is None else cls(statement.line, findings, ref)


class PrmUser(DiagBlock):
    """A block with user parameters: the device or a module."""

    def __init__(self, line: int, findings: Findings) -> None:
        super().__init__(line, findings)
        #: number of a parameter -> line of its first use
        self.used: dict[int, int] = {}
        self.consts: list[PrmConst] = []
        self.refs: list[PrmRef] = []
        self.prm_line = 0

    def part(self, statement: Statement) -> None:
        """Ext_User_Prm_Data_Ref(offset) = number, Ext_User_Prm_Data_Const(offset) = octets."""
        item = statement.item or _parsed(statement, _prm_part)  # most lines occurred before
        if type(item) is PrmRef:
            self.refs.append(item)
            self.used.setdefault(item.number, statement.line)
        elif isinstance(item, PrmConst):
            self.consts.append(item)
            self.prm_line = self.prm_line or statement.line
        else:
            written = f"{statement.written}({statement.index or ''}) = {statement.value}"
            self.warn(statement, f"{shortened(written)} cannot be read; it is left out")
        if statement.remark:
            warn_of_remark(self.findings, statement)

    handlers = {**DiagBlock.handlers, "ext_user_prm_data_ref": part, "ext_user_prm_data_const": part}


def _prm_part(statement: Statement) -> PrmRef | PrmConst | None:
    offset = _index(statement)
    if offset is None or not 0 <= offset < MAX_USER_PRM:
        return None
    if statement.keyword == "ext_user_prm_data_ref":
        target = without_remark(statement, number)
        return None if target is None else PrmRef(offset, target)
    octets = without_remark(statement, octets_of)
    return None if octets is None else PrmConst(offset, octets[: MAX_USER_PRM - offset])


def octets_of(text: str) -> bytes | None:
    """The octets of a list of numbers. A comma at the end does not matter. None: it is no list of octets."""
    values = numbers(text.rstrip(" \t,"))
    try:
        return None if values is None else bytes(values)
    except ValueError:  # a number that is no octet
        return None


class ModuleBlock(PrmUser):
    """Module = "name" octets."""

    title = "Module"
    head = "a name in quotes"

    def __init__(self, line: int, findings: Findings, name: str, config: bytes | None) -> None:
        super().__init__(line, findings)
        self.name = name
        self.config = config or b""
        self.reference: int | None = None
        self.length: int | None = None
        self.info = ""
        self.preset = False
        self.complete = config is not None

    @classmethod
    def opened_by(cls, statement: Statement, findings: Findings) -> Self | None:
        name, rest, closed = string(statement.value)
        if name is None or not closed:
            return None
        config = read_value(findings, statement, octets_of, rest)
        if config is None:
            message = f"module {name!r}: {rest[:40]} is no list of identifier octets; the module cannot be used"
            findings.error(statement.line, message, statement.column)
        return cls(statement.line, findings, name.strip(), config)

    @property
    def full_title(self) -> str:
        return f"{self.title} {self.name!r}"

    def prm_len(self, statement: Statement) -> None:
        length = self.number(statement)
        if length is None or not 0 <= length <= MAX_USER_PRM:
            message = f"{statement.written} = {shortened(statement.value)} is no length of 0..{MAX_USER_PRM}; left out"
            self.warn(statement, message)
        else:
            self.length = length
            self.prm_line = statement.line

    def info_text(self, statement: Statement) -> None:
        text, _, _ = string(statement.value)
        self.info = statement.value if text is None else text

    def is_preset(self, statement: Statement) -> None:
        self.preset = self.number(statement) not in (0, None)

    def other(self, statement: Statement) -> bool:
        """A number on a line of its own: the module reference."""
        if statement.equals or statement.index is not None:
            return False
        reference = number(statement.keyword)
        if statement.value and reference is not None:
            reference = read_value(self.findings, statement, number, f"{statement.written} {statement.value}")
        if reference is None:
            return False
        if self.reference not in (None, reference):
            message = f"module {self.name!r} has two references, {self.reference} and {reference}; the last one counts"
            self.findings.warning(statement.line, message)
        self.reference = reference
        return True

    def finish(self, complete: bool) -> None:
        self.complete = self.complete and complete

    def module(self) -> Module:
        return Module(
            self.name,
            self.config,
            self.reference,
            self.info,
            self.preset,
            PrmBlock(self.length, tuple(self.consts), tuple(self.refs), self.prm_line or self.line),
            self.diagnosis(),
            tuple(self.raws),
            self.complete,
            self.line,
        )

    handlers = {
        **PrmUser.handlers,
        "ext_module_prm_data_len": prm_len,
        "info_text": info_text,
        "preset": is_preset,
    }


class DeviceBlock(PrmUser):
    """The file itself: the statements outside of all blocks, and the content of the blocks that have ended."""

    def __init__(self, findings: Findings) -> None:
        super().__init__(0, findings)
        #: by keyword, the last one of each
        self.settings: dict[str, Statement] = {}
        self.modules: list[Module] = []
        self.slots: list[Slot] = []
        self.parameters: dict[int, ParameterBlock] = {}
        self.prm_texts: dict[int, PrmTextBlock] = {}
        self.diag_types: list[Diagnosis] = []

    def other(self, statement: Statement) -> bool:
        """Keep every other ``keyword = value`` as a setting."""
        if not statement.equals or statement.index is not None or not statement.keyword:
            return False
        before = self.settings.get(statement.keyword)
        # old files have Revision twice: as a text and as a number
        if before is not None and before.value != statement.value and statement.keyword != "revision":
            message = f"{statement.written} stands twice (first on line {before.line}); the last one counts"
            self.findings.warning(statement.line, message)
        self.settings[statement.keyword] = replace(statement)
        return True

    def add(self, inner: Block) -> None:
        match inner:
            case ModuleBlock():
                self.modules.append(inner.module())
                for ref, line in inner.used.items():
                    self.used.setdefault(ref, line)
                return
            case ParameterBlock():
                self._replaces(inner, self.parameters.get(inner.ref))
                self.parameters[inner.ref] = inner
            case PrmTextBlock():
                before = self.prm_texts.get(inner.ref)
                if before is None or before.texts != inner.texts:
                    self._replaces(inner, before)
                self.prm_texts[inner.ref] = inner
            case SlotBlock():
                self.slots += inner.slots.values()
            case DiagTypeBlock():
                self.diag_types.append(inner.diagnosis(inner.ref))
        super().add(inner)

    def _replaces(self, block: NumberedBlock, before: NumberedBlock | None) -> None:
        if before is not None:
            message = f"{block.full_title} stands twice (first on line {before.line}); the last one counts"
            self.findings.warning(block.line, message)


#: opening keyword -> closing keyword, as files write it, of the blocks that dpstack only keeps
RAW_BLOCKS: Final[dict[str, str]] = {
    "data_area_beg": "Data_Area_End",
    "physical_interface": "End_Physical_Interface",
    "version_firmware_download": "end_version_firmware_download",
    "jokerblock_type": "endjokerblock_type",
}
#: opening keyword -> class and closing keyword, as files write it, of the blocks that dpstack uses
BLOCKS: Final[Mapping[str, tuple[type[Block], str]]] = {
    "prmtext": (PrmTextBlock, "EndPrmText"),
    "extuserprmdata": (ParameterBlock, "EndExtUserPrmData"),
    "module": (ModuleBlock, "EndModule"),
    "slotdefinition": (SlotBlock, "EndSlotDefinition"),
    "unit_diag_area": (AreaBlock, "Unit_Diag_Area_End"),
    "x_unit_diag_area": (AreaBlock, "X_Unit_Diag_Area_End"),
    "unitdiagtype": (DiagTypeBlock, "EndUnitDiagType"),
}
