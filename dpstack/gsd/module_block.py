"""Modules and devices while they are read: identifier octets, user parameters, settings."""

from __future__ import annotations

from typing import Final

from dpstack.gsd.blocks import Block, ParameterBlock, PrmTextBlock, RawBlock, SlotBlock
from dpstack.gsd.diag_blocks import DiagBlock, DiagTypeBlock
from dpstack.gsd.findings import Findings
from dpstack.gsd.keywords import BLOCKS, RAW_BLOCKS
from dpstack.gsd.lexer import Statement, number, numbers, string
from dpstack.gsd.model import Diagnosis, Module, PrmBlock, PrmConst, PrmRef, Slot

#: octets a Set_Prm can carry behind the seven fixed ones
MAX_USER_PRM: Final = 237


class PrmUser(DiagBlock):
    """What devices and modules have in common: parts of user parameters."""

    def __init__(self, line: int, findings: Findings, used: dict[int, int]) -> None:
        super().__init__(line, findings)
        self.consts: list[PrmConst] = []
        self.refs: list[PrmRef] = []
        self.prm_line = 0
        #: number of a parameter -> line of its first use, for the whole file
        self.used = used

    def ref(self, statement: Statement, line: int) -> None:
        """Ext_User_Prm_Data_Ref(offset) = number."""
        item = statement.item
        if item is None:
            item = statement.item = _ref_item(statement)
        if isinstance(item, PrmRef):
            self.refs.append(item)
            self.used.setdefault(item.number, line)
        else:
            self._unreadable(statement, line)

    def const(self, statement: Statement, line: int) -> None:
        """Ext_User_Prm_Data_Const(offset) = octets."""
        item = statement.item
        if item is None:
            item = statement.item = _const_item(statement)
        if isinstance(item, PrmConst):
            self.consts.append(item)
            self.prm_line = self.prm_line or line
        else:
            self._unreadable(statement, line)

    def _unreadable(self, statement: Statement, line: int) -> None:
        written = f"{statement.written}({statement.index or ''}) = {statement.value}"
        message = f"{_short(written)} cannot be read; it is left out"
        self.findings.warning(line, statement.column, message)

    handlers = {**DiagBlock.handlers, "ext_user_prm_data_ref": ref, "ext_user_prm_data_const": const}


def _ref_item(statement: Statement) -> PrmRef | bool:
    offset = number(statement.index) if statement.index else None
    target = number(statement.value)
    if offset is None or target is None or not 0 <= offset < MAX_USER_PRM:
        return False
    return PrmRef(offset, target)


def _const_item(statement: Statement) -> PrmConst | bool:
    offset = number(statement.index) if statement.index else None
    octets = octets_of(statement.value)
    if offset is None or octets is None or not 0 <= offset < MAX_USER_PRM:
        return False
    return PrmConst(offset, octets[: MAX_USER_PRM - offset])


def octets_of(text: str) -> bytes | None:
    """A list of octets; None where it is none. A comma too many at the end does not matter."""
    values = numbers(text.rstrip(" \t,"))
    if values is None or any(not 0 <= value <= 255 for value in values):
        return None
    return bytes(values)


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


class ModuleBlock(PrmUser):
    """Module = "name" octets."""

    title = "Module"
    end = "endmodule"
    nested = DiagBlock.nested | RAW_BLOCKS.keys()

    def __init__(self, line: int, findings: Findings, used: dict[int, int], name: str, config: bytes) -> None:
        super().__init__(line, findings, used)
        self.name = name
        self.config = config
        self.reference: int | None = None
        self.length: int | None = None
        self.info = ""
        self.preset = False
        self.complete = True

    def prm_len(self, statement: Statement, line: int) -> None:
        """Ext_Module_Prm_Data_Len = n."""
        length = number(statement.value)
        if length is None or not 0 <= length <= MAX_USER_PRM:
            message = f"{statement.written} = {_short(statement.value)} is no length of 0..{MAX_USER_PRM}; left out"
            self.findings.warning(line, statement.column, message)
        else:
            self.length = length
            self.prm_line = line

    def info_text(self, statement: Statement, line: int) -> None:
        """Info_Text = "..."."""
        text, _, _ = string(statement.value)
        self.info = statement.value if text is None else text

    def is_preset(self, statement: Statement, line: int) -> None:
        """Preset = 1."""
        self.preset = number(statement.value) not in (0, None)

    def other(self, statement: Statement, line: int) -> bool:
        """A number on a line of its own is the module reference."""
        reference = number(statement.keyword)
        if reference is None or statement.equals or statement.value:
            return False
        if self.reference not in (None, reference):
            message = f"module {self.name!r} has two references, {self.reference} and {reference}; the last one counts"
            self.findings.warning(line, 1, message)
        self.reference = reference
        return True

    def give(self, inner: Block) -> None:
        """Areas and raw blocks inside."""
        if isinstance(inner, RawBlock):
            self.raws += inner.raws
        else:
            super().give(inner)

    def finish(self, complete: bool) -> None:
        """Nothing may be taken for whole that is not."""
        self.complete = complete

    def module(self) -> Module:
        """What was read."""
        if self.length is None and not self.consts and not self.refs:
            prm = NO_PRM
        else:
            prm = PrmBlock(self.length, tuple(self.consts), tuple(self.refs), self.prm_line or self.line)
        return Module(
            self.name,
            self.config,
            self.reference,
            self.info,
            self.preset,
            prm,
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


NO_PRM: Final = PrmBlock()


class DeviceBlock(PrmUser):
    """The file itself: what stands outside of all blocks, and what the blocks gave."""

    title = "file"
    nested = frozenset(BLOCKS) | RAW_BLOCKS.keys()

    def __init__(self, findings: Findings) -> None:
        super().__init__(0, findings, {})
        #: keyword -> (statement, line), the last one
        self.settings: dict[str, tuple[Statement, int]] = {}
        self.modules: list[Module] = []
        self.slots: list[Slot] = []
        self.parameters: dict[int, ParameterBlock] = {}
        self.prm_texts: dict[int, PrmTextBlock] = {}
        self.diag_types: list[Diagnosis] = []

    def other(self, statement: Statement, line: int) -> bool:
        """Every other ``keyword = value`` is a setting."""
        if not statement.equals or statement.index is not None or not statement.keyword:
            return False
        before = self.settings.get(statement.keyword)
        # User_Prm_Data may be written in pieces, Revision once as text and once as number in old files
        if before is not None and before[0].value != statement.value and statement.keyword != "revision":
            message = f"{statement.written} stands twice (first on line {before[1]}); the last one counts"
            self.findings.warning(line, 1, message)
        self.settings[statement.keyword] = (statement, line)
        return True

    def give(self, inner: Block) -> None:
        """A block of the file has ended."""
        match inner:
            case ModuleBlock():
                self.modules.append(inner.module())
            case ParameterBlock():
                self._twice(inner, self.parameters.get(inner.ref), inner.ref)
                self.parameters[inner.ref] = inner
            case PrmTextBlock():
                before = self.prm_texts.get(inner.ref)
                if before is None or before.texts != inner.texts:
                    self._twice(inner, before, inner.ref)
                self.prm_texts[inner.ref] = inner
            case SlotBlock():
                self.slots += inner.slots.values()
            case DiagTypeBlock():
                self.diag_types.append(inner.diagnosis(inner.number))
                self.raws += inner.raws
            case RawBlock():
                self.raws += inner.raws
            case _:
                super().give(inner)

    def _twice(self, block: Block, before: Block | None, ref: int) -> None:
        if before is not None:
            message = f"{block.title} {ref} stands twice (first on line {before.line}); the last one counts"
            self.findings.warning(block.line, 1, message)

    handlers = PrmUser.handlers
