"""The last telegrams to a slave, read from octets without the project's codec.

``told`` makes words of telegrams: outputs of Data_Exchange in hex, "clear" and "operate" of Global_Control.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pytest
from support_responder import Responder

#: octet 1 of Global_Control by what it says; the other bits are SYNC and FREEZE
CLEAR = 0x02
ENDS: Final = Path(__file__).parents[3] / "docs" / "explanation" / "ends.md"


def table(heading: str, first: str) -> Iterator[tuple[str, list[str]]]:
    """The rows of docs/explanation/ends.md under ``heading``, whose first column is ``first``: the name in code font,
    the cells.

    A row without a name belongs to the one above.
    """
    section = ENDS.read_text(encoding="utf-8").partition(f"## {heading}")[2].partition("\n## ")[0]
    name = ""
    for line in section.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| ") and cells[0] != first:
            named = re.findall(r"\(`(\w+)`\)", cells[0])
            name = named[-1] if named else name
            yield name, cells


def told(telegrams: Iterable[bytes], address: int) -> list[str]:
    """The telegrams to the slave at ``address`` in words, in order, without repetitions."""
    words: list[str] = []
    for octets in telegrams:
        if octets[:1] != b"\x68" or not octets[6] & 0x40:
            continue
        word = None
        if octets[4] == address:  # no SAP: Data_Exchange
            word = octets[7:-2].hex()
        elif octets[4] in (0xFF, 0x80 | address) and octets[7] == 58:
            word = "clear" if octets[9] & CLEAR else "operate"
        if word is not None and words[-1:] != [word]:
            words.append(word)
    return words


@contextmanager
def heard(there: Responder, address: int = 4) -> Iterator[list[str]]:
    """The telegrams to the slave at ``address`` of ``there`` from now on, in words."""
    words: list[str] = []
    take = there.request

    def request(body: bytes) -> bytes:
        words.extend(told([b"\x68\0\0\x68" + body + b"\0\x16"], address))
        return take(body)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(there, "request", request)
        yield words


def after_live(words: list[str], live: str) -> tuple[list[str], list[str]]:
    """The words after the last ``live`` outputs: outputs up to the first Clear, and all from there on.

    Operate is repeated every 200 ms, with safe values too, up to Clear.
    """
    after = words[len(words) - words[::-1].index(live) :]
    cut = after.index("clear") if "clear" in after else len(after)
    return [word for word in after[:cut] if word != "operate"], after[cut:]


def is_in_order(words: list[str], *, live: str, safe: str) -> bool:
    """Safe values after the live ones, then Clear, then nothing of Operate."""
    before, rest = after_live(words, live)
    return before[:1] == [safe] and bool(rest) and set(before + rest) <= {safe, "00" * (len(safe) // 2), "clear"}
