"""Writes docs/reference/dp-v0.md: every service, option and diagnosis bit of DP-V0 at both ends with the tests that
show it, from tools/dp_v0_rows.toml and the table of bits; a test holds the page to them and looks whether the tests
exist.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from dpstack.dp.pdu.diag_bits import FLAGS, Flag, Reaction

TARGET: Final = Path(__file__).resolve().parent.parent / "docs" / "reference" / "dp-v0.md"
ROWS: Final = Path(__file__).resolve().with_name("dp_v0_rows.toml")

_HEAD: Final = """# DP-V0

Written by `tools/make_dp_v0_docs.py`; a test holds this page to the program and looks whether the tests named here
exist. Modules are under `dpstack/`, tests under `tests/`.
"""


def render() -> str:
    columns = "| | the master | shown by | the slave | shown by |\n|---|---|---|---|---|"
    parts, rows = [_HEAD], tomllib.loads(ROWS.read_text(encoding="utf-8"))
    for title, kind in (("Services", "service"), ("Options and what follows from them", "option")):
        lines = [f"| {row['name']} | {_end(row['master'])} | {_end(row.get('slave'))} |" for row in rows[kind]]
        parts.append("\n".join([f"## {title}\n", columns, *lines]) + "\n")
    parts.append("\n".join([_BITS, *map(_bit, FLAGS), *_REST]) + "\n")
    return "\n".join(parts)


def _end(end: Mapping[str, Any] | None) -> str:
    """Two cells: what it does with its module, the tests."""
    if end is None:
        return "(the master's) |"
    return f"{end['what']} (`{end['module']}`) | {', '.join(f'`{test}`' for test in end['tests'])}"


_BITS: Final = """## The diagnosis, bit by bit

The table says what the master does after Set_Prm and Chk_Cfg (bring-up) and in data exchange. If several bits are
set, the most serious one counts. Some bits only a master sets, in the diagnosis that it keeps for its user; if a slave
sets one of them, the master ignores it and reports it once. These tests cover every row:
`dp/master/test_master_dp_v0.py::test_transcript_of_the_bring_up_for_each_bit`,
`dp/master/test_master_dp_v0.py::test_each_bit_in_data_exchange` and
`dp/master/test_master_dp_v0.py::test_the_bits_a_master_sets`.

| octet, bit | name | set by | the master in the bring-up | the master in data exchange | details | message |
|---|---|---|---|---|---|---|"""

_REST: Final = (
    "| 2, 2 | (always 1) | slave | "
    + f"{Reaction.REPORTS.value} | {Reaction.REPORTS.value} | if it is missing, this is reported once | |",
    "| octet 4 | Master_Add | slave | another master's slave is never parameterised (fault `locked`) | the same | "
    "own address + 128 and the address of the asking master are tolerated | is owned by master 7 |",
    "| octets 5, 6 | Ident | slave | another device is never parameterised (fault `wrong_ident`) | the same | "
    '`ident = "ask"` accepts the ident number found; `ident = { configured, adapts }` is for devices that take over '
    "the number in Set_Prm | is another device: ident 0x1234 instead of 0x0696 |",
)


def _bit(flag: Flag) -> str:
    says = f"{flag.text}; {flag.remedy}" if flag.remedy else flag.text
    bring_up, exchange = (does.value if does else "ignores it" for does in (flag.bring_up, flag.exchange))
    place = f"{flag.octet}, {flag.mask.bit_length() - 1}"
    return f"| {place} | `{flag.name}` | {flag.set_by.value} | {bring_up} | {exchange} | {flag.note} | {says} |"


def main() -> None:
    TARGET.write_text(render(), encoding="utf-8")


if __name__ == "__main__":
    main()
