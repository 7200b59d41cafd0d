"""Blocks that hold texts of the diagnosis: areas, the types of DP-V1 blocks, and what devices and modules share."""

from __future__ import annotations

from typing import Final

from dpstack.gsd.blocks import Block, text_item
from dpstack.gsd.findings import Findings
from dpstack.gsd.lexer import Statement
from dpstack.gsd.model import DiagArea, Diagnosis, Raw

_FIELDS: Final = {
    "unit_diag_bit": "bits",
    "unit_diag_bit_help": "bit_helps",
    "unit_diag_not_bit": "not_bits",
    "unit_diag_not_bit_help": "not_bit_helps",
    "unit_diag_!bit": "not_bits",  # two vendors' spelling
    "unit_diag_!bit_help": "not_bit_helps",
    "channel_diag": "channel",
    "channel_diag_help": "channel_helps",
}
_X: Final = "x_"
_NAMES: Final = tuple(dict.fromkeys(_FIELDS.values()))


class AreaBlock(Block):
    """Unit_Diag_Area = a-b, X_Unit_Diag_Area."""

    title = "Unit_Diag_Area"

    def __init__(self, line: int, findings: Findings, end: str, first: int, last: int) -> None:
        super().__init__(line, findings)
        self.end = end
        self.first = first
        self.last = last
        self.values: dict[int, str] = {}
        self.helps: dict[int, str] = {}

    def value(self, statement: Statement, line: int) -> None:
        """Value(n) = "..."."""
        self._keep(self.values, statement, line)

    def help(self, statement: Statement, line: int) -> None:
        """Value_Help(n) = "..."."""
        self._keep(self.helps, statement, line)

    def _keep(self, texts: dict[int, str], statement: Statement, line: int) -> None:
        item = text_item(self, statement, line, "value")
        if item is None:
            return
        at, text = item
        if at >> (self.last - self.first + 1):
            message = f"{statement.written}({at}) does not fit bits {self.first}..{self.last}; it can never be shown"
            self.findings.warning(line, statement.column, message)
        texts[at] = text

    def area(self) -> DiagArea:
        """What was read."""
        return DiagArea(self.first, self.last, self.values, self.helps, self.line)

    handlers = {"value": value, "x_value": value, "value_help": help, "x_value_help": help}


class DiagBlock(Block):
    """A block in which diagnosis texts may stand."""

    nested = frozenset({"unit_diag_area", "x_unit_diag_area"})

    def __init__(self, line: int, findings: Findings) -> None:
        super().__init__(line, findings)
        self.texts: dict[str, dict[int, str]] = {}
        self.areas: list[DiagArea] = []
        self.raws: list[Raw] = []

    def diag_text(self, statement: Statement, line: int) -> None:
        """Unit_Diag_Bit(n) = "..." and its like."""
        item = text_item(self, statement, line, "text")
        if item is None:
            return
        at, text = item
        texts = self.texts.setdefault(statement.keyword, {})
        if texts.get(at, text) != text:
            message = f"{statement.written}({at}) stands twice with different texts; the last one counts"
            self.findings.warning(line, statement.column, message)
        texts[at] = text

    def give(self, inner: Block) -> None:
        """An area has ended."""
        if isinstance(inner, AreaBlock):
            self.areas.append(inner.area())

    def diagnosis(self, type_number: int | None = None) -> Diagnosis:
        """What was read; of a plain and an X_ text with one number the X_ one (it is of DP-V1) counts."""
        if not self.texts and not self.areas and type_number is None:
            return EMPTY
        merged: dict[str, dict[int, str]] = {name: {} for name in _NAMES}
        for keyword, texts in sorted(self.texts.items(), key=lambda kept: kept[0].startswith(_X)):
            merged[_FIELDS[keyword.removeprefix(_X)]].update(texts)
        return Diagnosis(**merged, areas=tuple(self.areas), type=type_number, line=self.line)

    handlers = dict.fromkeys((*_FIELDS, *(_X + keyword for keyword in _FIELDS)), diag_text)


EMPTY: Final = Diagnosis()


class DiagTypeBlock(DiagBlock):
    """UnitDiagType = n."""

    title = "UnitDiagType"
    end = "endunitdiagtype"

    def __init__(self, line: int, findings: Findings, number: int) -> None:
        super().__init__(line, findings)
        self.number = number
