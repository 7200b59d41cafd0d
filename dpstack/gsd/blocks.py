"""What stands between an opening and a closing keyword, while it is read: one class for each kind of block.

A block has a table of handlers by keyword and, at its end, gives what it has collected to the block around it. A
statement's ``item`` keeps what was made of its text: False where it is wrong, so that each occurrence is told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final, TypeAlias

from dpstack.gsd.findings import Findings
from dpstack.gsd.lexer import Statement, first_number, number, ranges, ranges_only, string
from dpstack.gsd.model import PrmKind, PrmType, Ranges, Raw, Slot, in_ranges, ranges_text

#: (block, statement, line)
Handler: TypeAlias = Callable[[Any, Statement, int], None]


class Block:
    """``title`` as the file writes it, ``end``: closing keyword, ``nested``: blocks that may stand inside."""

    title: ClassVar[str] = ""
    end: str = "\n"  # no keyword is like this: nothing ends a file but its end
    nested: ClassVar[frozenset[str]] = frozenset()
    handlers: ClassVar[Mapping[str, Handler]] = {}

    def __init__(self, line: int, findings: Findings) -> None:
        self.line = line
        self.findings = findings

    def other(self, statement: Statement, line: int) -> bool:
        """A keyword without a handler; True when the block knows what to do with it."""
        return False

    def give(self, inner: Block) -> None:
        """A block inside has ended."""

    def finish(self, complete: bool) -> None:
        """The end of the block; not ``complete``: its closing keyword is missing."""


def text_item(block: Block, statement: Statement, line: int, what: str) -> tuple[int, str] | None:
    """(number, text) of ``Text(3) = "on"`` and its like; None and a warning where it is none."""
    item = statement.item
    if item is None:
        text, _, closed = string(statement.value)
        at = number(statement.index) if statement.index else None
        if text is None and statement.value and statement.equals:
            text = statement.value
        if at is None or text is None or not closed:
            statement.item = False
        else:
            item = statement.item = (at, text.strip())
            return item
    if isinstance(item, tuple):
        return item
    _tell_text(block, statement, line, what)
    return None


def _tell_text(block: Block, statement: Statement, line: int, what: str) -> None:
    text, _, closed = string(statement.value)
    if text is not None and not closed:
        problem = "the text has no closing quote"
    elif text is None:
        problem = "a text in quotes is missing"
    else:
        problem = f"{statement.index or 'nothing'} in parentheses is no number"
    block.findings.warning(line, statement.column, f"{statement.written}: {problem}; this {what} is left out")


class PrmTextBlock(Block):
    """PrmText = n."""

    title = "PrmText"
    end = "endprmtext"

    def __init__(self, line: int, findings: Findings, ref: int) -> None:
        super().__init__(line, findings)
        self.ref = ref
        self.texts: dict[int, str] = {}

    def text(self, statement: Statement, line: int) -> None:
        """Text(n) = "..."."""
        item = text_item(self, statement, line, "value")
        if item is not None:
            at, text = item
            if self.texts.get(at, text) != text:
                message = f"Text({at}) stands twice in PrmText {self.ref}; the last one counts"
                self.findings.warning(line, statement.column, message)
            self.texts[at] = text

    handlers = {"text": text}


_SIZES: Final = {
    "unsigned8": (PrmKind.UNSIGNED8, 1),
    "unsigned16": (PrmKind.UNSIGNED16, 2),
    "unsigned32": (PrmKind.UNSIGNED32, 4),
    "signed8": (PrmKind.SIGNED8, 1),
    "signed16": (PrmKind.SIGNED16, 2),
    "signed32": (PrmKind.SIGNED32, 4),
}
_WHOLE: Final = {key: PrmType(kind, 0, 8 * size - 1, size) for key, (kind, size) in _SIZES.items()}
#: more than this no bit of a parameter can be in
_LAST_BIT: Final = 31

#: type, default, allowed values, what is wrong (empty: nothing)
_TypeItem: TypeAlias = tuple[PrmType, int, Ranges, str]


class ParameterBlock(Block):
    """ExtUserPrmData = n "name"."""

    title = "ExtUserPrmData"
    end = "endextuserprmdata"

    def __init__(self, line: int, findings: Findings, ref: int, name: str) -> None:
        super().__init__(line, findings)
        self.ref = ref
        self.name = name
        self.type: PrmType | None = None
        self.default = 0
        self.allowed: Ranges = ()
        self.text_ref: int | None = None
        self.changeable = True
        self.visible = True

    def typed(self, statement: Statement, line: int) -> None:
        """``Unsigned8 0 0-255``, ``Bit(3) 1 0-1``, ``BitArea(0-2) 0 0,1,5``."""
        item = statement.item
        if item is None:
            item = statement.item = _type_item(statement)
        if isinstance(item, str):
            self.findings.warning(line, statement.column, f"{self.title} {self.ref}: {item}")
        elif isinstance(item, tuple):
            self.type, self.default, self.allowed, problem = item
            if problem:
                self.findings.warning(line, statement.column, f"{self.title} {self.ref}: {problem}")

    def prm_text_ref(self, statement: Statement, line: int) -> None:
        """Prm_Text_Ref = n."""
        self.text_ref = _number_or_tell(self, statement, line)

    def is_changeable(self, statement: Statement, line: int) -> None:
        """Changeable = 0 or 1."""
        self.changeable = _number_or_tell(self, statement, line) != 0

    def is_visible(self, statement: Statement, line: int) -> None:
        """Visible = 0 or 1."""
        self.visible = _number_or_tell(self, statement, line) != 0

    handlers = {
        **dict.fromkeys((*_SIZES, "bit", "bitarea"), typed),
        "prm_text_ref": prm_text_ref,
        "prmtextref": prm_text_ref,
        "changeable": is_changeable,
        "visible": is_visible,
    }


def _number_or_tell(block: Block, statement: Statement, line: int) -> int | None:
    value = number(statement.value)
    if value is None:
        message = f"{statement.written} = {statement.value or 'nothing'} is no number; left out"
        block.findings.warning(line, statement.column, message)
    return value


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
    allowed = ranges(rest)
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
    """``Bit(0)  0-1``: the default is 0, or the lowest value where 0 is not allowed."""
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
    """SlotDefinition."""

    title = "SlotDefinition"
    end = "endslotdefinition"

    def __init__(self, line: int, findings: Findings) -> None:
        super().__init__(line, findings)
        #: by number, the last one of each
        self.slots: dict[int, Slot] = {}

    def slot(self, statement: Statement, line: int) -> None:
        """``Slot(1) = "name" default allowed`` (module references)."""
        at = number(statement.index) if statement.index else None
        name, rest, _ = string(statement.value)
        name = (name or "").strip()
        default, rest = first_number(rest)
        allowed = ranges(rest)
        if at is None or allowed is None:
            self.findings.warning(line, statement.column, f"{statement.written}: cannot be read; the slot is left out")
            return
        if default is not None and not allowed:
            allowed = ((default, default),)
        if default is not None and not any(low <= default <= high for low, high in allowed):
            message = f"Slot({at}): the default module {default} is not among those allowed ({ranges_text(allowed)})"
            self.findings.warning(line, statement.column, message)
        if at in self.slots:
            self.findings.warning(line, statement.column, f"Slot({at}) stands twice; the last one counts")
        self.slots[at] = Slot(at, name, default, allowed, line)

    handlers = {"slot": slot}


class RawBlock(Block):
    """A block without a meaning here: everything in it is kept as it stands."""

    title = "block"

    def __init__(self, line: int, findings: Findings, opening: Statement, end: str) -> None:
        super().__init__(line, findings)
        self.name = opening.written
        self.end = end
        self.raws = [Raw(line, opening.written, opening.index, opening.value, opening.written)]

    def other(self, statement: Statement, line: int) -> bool:
        """Keep everything."""
        self.raws.append(Raw(line, statement.written, statement.index, statement.value, self.name))
        return True
