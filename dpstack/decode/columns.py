"""The columns of a table of telegrams (``decode --parquet``), and the cells of a telegram in them.

docs/reference/telegram-table.md describes them. The judgements are those of :mod:`dpstack.decode.telegram`, which
``decode --json`` prints; nothing is judged here.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from dpstack.capture.transmission import damage_text
from dpstack.decode.telegram import Explained
from dpstack.fdl.telegram import FC_FCB, FC_FCV, FC_REQUEST, Kind

#: version of the columns below; it rises when one changes its meaning or goes, not when one is added at the end
VERSION: Final = 1


class Column(NamedTuple):
    """A column. ``type``: timestamp (ns, UTC), int64, int32, uint16, uint8, bool, or string."""

    name: str
    type: str


#: of the capture and the transmission, one value for each row
OF_ROW: Final = (Column("time", "timestamp"), Column("number", "int64"))
#: of the octets and their source: equal telegrams have equal cells, see :func:`fixed_cells`
FIXED: Final = (
    Column("port", "string"),
    Column("baud", "int32"),
    Column("kind", "string"),
    Column("da", "uint8"),
    Column("sa", "uint8"),
    Column("station", "uint8"),
    Column("dsap", "uint8"),
    Column("ssap", "uint8"),
    Column("service", "string"),
    Column("function", "string"),
    Column("fc", "uint8"),
    Column("fcb", "bool"),
    Column("fcv", "bool"),
    Column("size", "uint16"),
    Column("damage", "string"),
    Column("error", "string"),
)
#: of the course of the bus: names of :class:`~dpstack.decode.course.Step`, but for t_sdr_ns, which is response_us in ns
OF_STEP: Final = (
    Column("t_sdr_ns", "int64"),
    Column("answer_to", "int64"),
    Column("late", "bool"),
    Column("retry_of", "int64"),
    Column("repeated_poll_of", "int64"),
    Column("unanswered", "int64"),
)
#: the name of the capture, one value in a file
CAPTURE: Final = Column("capture", "string")
COLUMNS: Final = (*OF_ROW, *FIXED, *OF_STEP, CAPTURE)

#: what the types can hold
_MOST_BAUD: Final = 1 << 31
_MOST_SIZE: Final = 0xFFFF

Cells = tuple[object, ...]


def fixed_cells(one: Explained, port: str) -> Cells:
    """The cells of the columns :data:`FIXED`; None if a telegram has no such value."""
    telegram, sent, request = one.telegram, one.transmission, one.step.request
    kind = da = sa = station = dsap = ssap = fc = fcb = fcv = None
    if telegram is not None:
        kind = telegram.kind.name
        if telegram.kind is Kind.SC:  # it names nobody
            station = None if request is None else request.da
        else:
            da, sa = telegram.da, telegram.sa
            if telegram.kind is not Kind.SD4:
                fc, dsap, ssap = telegram.fc, telegram.dsap, telegram.ssap
                if fc & FC_REQUEST:
                    station, fcb, fcv = da, bool(fc & FC_FCB), bool(fc & FC_FCV)
                else:
                    station = sa
    return (
        port or None,
        sent.baud if 0 < sent.baud < _MOST_BAUD else None,  # a file may claim any rate
        kind,
        da,
        sa,
        station,
        dsap,
        ssap,
        one.service or None,
        one.function,
        fc,
        fcb,
        fcv,
        min(len(sent.octets), _MOST_SIZE),
        damage_text(sent.damage) or None,
        one.error,
    )
