"""The error numbers of PROFIdrive's parameter access and their texts, for PKW and for record 47 alike.

Sources: LS CPDP-S100 manual 6.2.1; ABB RETA-02 manual p87 and p88; Siemens G130 manual p230 (16, of its own; what goes
with a number), G120C manual p225 (12 and Siemens' own) and SINAMICS manual p100 (127 to 133); PI's sample of a
PROFIdrive 4.2 drive (33 to 35). 101 and above are the maker's: the same number is another error with each.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

#: the usual additional information behind an error number in record 47
SUBINDEX: Final = "subindex"


class ErrorText(NamedTuple):
    """``info``: meaning of the additional information, "" if the sources name none."""

    text: str
    info: str = ""


ILLEGAL_NUMBER, READ_ONLY, LIMITS, BAD_SUBINDEX, NO_ARRAY, BAD_TYPE, ONLY_RESET = range(7)
NO_DESCRIPTION, NO_RIGHTS, NO_TEXT, OPERATING_STATE = 0x09, 0x0B, 0x0F, 0x11
NO_SERVICE, TOO_MANY, ONE_ONLY = 0x21, 0x22, 0x23
NOT_PERMITTED, TOO_LONG, BAD_ADDRESS, BAD_FORMAT, BAD_COUNT, NO_OBJECT = 0x14, 0x15, 0x16, 0x17, 0x18, 0x19

_ROWS: Final[Mapping[int, ErrorText]] = {
    ILLEGAL_NUMBER: ErrorText("illegal parameter number"),
    READ_ONLY: ErrorText("the value cannot be modified", SUBINDEX),
    LIMITS: ErrorText("low or high limit exceeded", SUBINDEX),
    BAD_SUBINDEX: ErrorText("invalid subindex", SUBINDEX),
    NO_ARRAY: ErrorText("no array"),
    BAD_TYPE: ErrorText("wrong data type"),
    ONLY_RESET: ErrorText("can only be reset", SUBINDEX),
    0x07: ErrorText("the description cannot be changed", SUBINDEX),
    NO_DESCRIPTION: ErrorText("no description"),
    NO_RIGHTS: ErrorText("no operation priority"),
    0x0C: ErrorText("the keyword is missing"),
    NO_TEXT: ErrorText("no text array"),
    0x10: ErrorText("reading is refused, the parameter is protected"),
    OPERATING_STATE: ErrorText("not in this operating mode"),
    NOT_PERMITTED: ErrorText("value not permitted", SUBINDEX),
    TOO_LONG: ErrorText("response too long"),
    BAD_ADDRESS: ErrorText("parameter address not permitted"),
    BAD_FORMAT: ErrorText("illegal format"),
    BAD_COUNT: ErrorText("number of values inconsistent"),
    NO_OBJECT: ErrorText("there is no such drive object"),
    0x20: ErrorText("the text cannot be changed", SUBINDEX),
    NO_SERVICE: ErrorText("the service is not supported"),
    TOO_MANY: ErrorText("too many parameters in one request"),
    ONE_ONLY: ErrorText("only one parameter a request is possible"),
}
#: Siemens' own (SINAMICS): what most drives in the field mean by these numbers
SIEMENS: Final[Mapping[int, str]] = {
    0x65: "the parameter is switched off in this mode",
    0x66: "the channel is too small for the response",
    0x68: "the parameter takes only certain values",
    0x6A: "there is no such request",
    0x6B: "no change while the controller is enabled",
    0x7F: "can be changed in device commissioning only (p0009 is not 0)",
    0x81: "no change during a download",
    0x82: "the master control cannot be transferred (BI: p0806)",
    0x83: "this BICO interconnection is not possible",
    0x84: "the change is inhibited (p0300, p0400, p0922)",
    0x85: "there is no access method",
    0x86: "can be changed in commissioning only (p0010 = 15)",
    0x87: "protected as know-how",
    0xC8: "below the limit that is valid now",
    0xC9: "above the limit that is valid now",
    0xCC: "no change without the access code",
}

#: texts by number
PARAMETER_ERRORS: Final[Mapping[int, str]] = {number: row.text for number, row in _ROWS.items()}
#: numbers from here on are the manufacturer's
MAKERS_FROM: Final = 0x65


def error_text(number: int, info: int | None = None, makers: Mapping[int, str] | None = None) -> str:
    """For people: ``error 2, low or high limit exceeded (subindex 3)``.

    ``makers``: texts of the drive's own; None if its maker is not known.
    """
    own = {} if makers is None else makers
    row = ErrorText(own[number]) if number in own else _ROWS.get(number)
    if row is None:
        at_siemens = f" (Siemens: {SIEMENS[number]})" if makers is None and number in SIEMENS else ""
        row = ErrorText(
            f"the maker's own{at_siemens}" if number >= MAKERS_FROM else "which the profile does not define"
        )
    if info is None:
        return f"error {number}, {row.text}"
    return f"error {number}, {row.text} ({row.info or 'additional information'} {info})"
