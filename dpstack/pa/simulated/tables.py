"""Linearisation: characteristic curves and the table that a master loads point by point.

LIN_TYPE: 0 none, 1 table, 10 square root, 20 lying cylinder, 21 sphere. Sources:
docs/reference/decisions/pa.md#simulated-devices.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Final

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.errors import RecordRefused
from dpstack.pa.datatypes import encode_value

if TYPE_CHECKING:
    from dpstack.pa.simulated.block import Block

NONE, TABLE, ROOT, CYLINDER, SPHERE = 0, 1, 10, 20, 21
#: points of a table
LEAST, MOST = 2, 32
#: TAB_OP_CODE
_BEGIN, _END, _DELETE, _REPLACE = 1, 3, 4, 6
#: TAB_STATUS
GOOD, NOT_RISING, TOO_FEW, LOADING = 1, 2, 4, 8


class PointTable:
    """The table of a block: TAB_ENTRY chooses a point, TAB_X_Y_VALUE is it, TAB_OP_CODE begins and ends a change."""

    def __init__(self, block: Block) -> None:
        self._block = block
        self.points: list[tuple[float, float]] = [(0.0, 0.0), (100.0, 100.0)]
        self._loaded: dict[int, tuple[float, float]] | None = None
        block.put("tab_min_number", LEAST)
        block.put("tab_max_number", MOST)
        self._show(GOOD)

    def written(self, name: str) -> None:
        """A parameter of the table was written. Raises RecordRefused."""
        block = self._block
        entry = block.whole("tab_entry")
        if name == "tab_entry":
            if not 1 <= entry <= MOST:
                raise RecordRefused(Code.INVALID_RANGE)
            self._select(entry)
        elif name == "tab_op_code":
            self._operate(block.whole("tab_op_code"), entry)
        elif name == "tab_x_y_value" and self._loaded is not None:
            self._loaded[max(entry, 1)] = (block.part(name, "x"), block.part(name, "y"))
            block.put("tab_entry", min(max(entry, 1) + 1, MOST))

    def _operate(self, code: int, entry: int) -> None:
        if code == _BEGIN:
            self._loaded = {}
            self._block.put("tab_entry", 1)
            self._show(LOADING)
        elif code == _END and self._loaded is not None:
            self._take([self._loaded[at] for at in sorted(self._loaded)])
        elif code == _DELETE and 1 <= entry <= len(self.points) > LEAST:
            del self.points[entry - 1]
            self._show(GOOD)
        elif code == _REPLACE and 1 <= entry <= len(self.points):
            x, y = (self._block.part("tab_x_y_value", axis) for axis in "xy")
            self._take([*self.points[: entry - 1], (x, y), *self.points[entry:]])
        else:
            raise RecordRefused(Code.INVALID_RANGE)

    def _take(self, points: list[tuple[float, float]]) -> None:
        self._loaded = None
        if len(points) < LEAST:
            self._show(TOO_FEW)
        elif any(right[0] <= left[0] for left, right in itertools.pairwise(points)):
            self._show(NOT_RISING)
        else:
            self.points = points
            self._block.revise()
            self._show(GOOD)

    def _show(self, status: int) -> None:
        if "tab_status" in self._block.parameters:
            self._block.put("tab_status", status)
        self._block.put("tab_actual_number", len(self.points))

    def _select(self, entry: int) -> None:
        x, y = self.points[entry - 1] if entry <= len(self.points) else (0.0, 0.0)
        self._block.put_octets("tab_x_y_value", encode_value("point", {"x": x, "y": y}))

    def at(self, x: float) -> float:
        """The value of the curve in percent; beyond its ends that of the end."""
        points = self.points
        if x <= points[0][0]:
            return points[0][1]
        for (x_0, y_0), (x_1, y_1) in itertools.pairwise(points):
            if x <= x_1:
                return y_0 + (y_1 - y_0) * (x - x_0) / (x_1 - x_0)
        return points[-1][1]


def linearised(kind: int, share: float, table: PointTable | None = None) -> float:
    """The share 0..1 behind a characteristic; outside this range it is linear."""
    if kind == TABLE and table is not None:
        return table.at(share * 100) / 100
    if kind == ROOT:
        return math.copysign(math.sqrt(abs(share)), share)
    if not 0 <= share <= 1:
        return share
    if kind == CYLINDER:
        angle = math.acos(1 - 2 * share)
        return (angle - math.sin(2 * angle) / 2) / math.pi
    if kind == SPHERE:
        return share * share * (3 - 2 * share)
    return share


#: parameters of the table
OWN: Final = frozenset({"tab_entry", "tab_op_code", "tab_x_y_value"})
