"""The output of ``dpstack decode`` for a stream of octets: each line is plain, and so is each object in JSON."""

from __future__ import annotations

import argparse
import contextlib
import io
import json
from functools import cache
from typing import Final

from dpstack.capture.cutter import split
from dpstack.capture.transmission import Transmission
from dpstack.cli.listening.telegram_lines import names_of, show
from dpstack.decode.filter import parse_filter
from dpstack.decode.names import NO_NAMES, Names
from dpstack.decode.telegram import Explainer
from dpstack.fdl.telegram import Kind
from tests.fuzz.frame import Target, assert_plain

_FILTER: Final = parse_filter("station 3 and (retry or error)")


@cache
def _names() -> Names:
    return names_of(argparse.Namespace(config=None, gsd=[]))


def run(octets: bytes) -> None:
    """The first octet chooses the names, the others are what was on the line."""
    how = octets[0] if octets else 0
    explainer = Explainer(_names() if how & 1 else NO_NAMES)
    lines = io.StringIO()
    with contextlib.redirect_stdout(lines):
        for number, one in enumerate(split(octets[1:]), 1):
            told = explainer.add(Transmission(one, number * 1_000_000 if how & 2 else None), number)
            assert isinstance(_FILTER(told), bool)
            show(told, json=bool(how & 4), flush=False)
    text = lines.getvalue()
    assert_plain(text, lines=True)
    if how & 4:
        for line in text.splitlines():
            json.loads(line)


#: heads of the services, so that a few changed octets reach one: SAPs of the master and of the slave, function codes
_SERVICES: Final = tuple(
    bytes.fromhex(text)
    for text in (
        "83 82 6D 3C 3E",  # Slave_Diag
        "82 83 08 3E 3C 02 05 00 FF 12 34",  # its answer
        "83 82 5D 3D 3E B8 01 01 0B 12 34 00",  # Set_Prm
        "83 82 7D 3E 3E 20 10",  # Chk_Cfg
        "FF 82 46 3A 3E 00 00",  # Global_Control
        "83 82 5D 37 3E 05 12 34 00",  # Set_Slave_Add
        "03 02 7D 01 02",  # Data_Exchange
        "02 03 08 01 02",
        "83 82 6D 3B 3E",  # Get_Cfg
        "82 83 08 3E 3B 20 10",
        "83 82 5D 33 33 5E 01 2F F0",  # Read
        "82 83 08 33 33 5E 01 2F 04 01 01 00 01",
        "83 82 5D 33 33 5F 01 2F 0A 01 01 00 01 10 00 00 01 00 00",  # Write of record 47
        "82 83 08 33 33 DF 80 B5 00",
        "83 82 5D 32 33 5C 01 02 08",  # Alarm_Ack
        "83 82 5D 31 32 57 00 00 00 00 64 01 00 00 00 00 00 00 02 00 02 00 00 00 00",  # Initiate
        "82 83 08 32 31 56 30 00 64",  # Resource_Manager
        "83 82 5D 30 32 58 00 13",  # Abort
        "83 82 5D 33 33 5F 00 FF 04 08 00 FD E8",  # I&M0
    )
)


def repair(octets: bytes) -> bytes:
    """Give each frame that begins with a start octet its LE, FCS and ED, and SD2 a known service where it has none."""
    out = bytearray(octets)
    at = 1
    while at < len(out):
        start = out[at]
        if start == Kind.SD2 and at + 9 <= len(out):
            le = max(4, min(out[at + 1], 249, len(out) - at - 6))
            out[at + 1 : at + 4] = bytes((le, le, start))
            at = _checked(out, at + 4, le)
        elif start == Kind.SD1 and at + 6 <= len(out):
            at = _checked(out, at + 1, 3)
        else:
            at += 1
    return bytes(out)


def _checked(out: bytearray, at: int, size: int) -> int:
    """FCS and ED behind ``size`` octets; returns the place behind them."""
    stop = at + size
    out[stop : stop + 2] = bytes((sum(out[at:stop]) & 0xFF, 0x16))
    return stop + 2


def framed(body: bytes) -> bytes:
    """An SD2 telegram of ``body``, from DA to the last octet of the data."""
    head = bytes((0x68, len(body), len(body), 0x68))
    return head + body + bytes((sum(body) & 0xFF, 0x16))


TARGET = Target(
    run,
    covers=("dpstack.decode", "dpstack.capture.cutter", "dpstack.cli.listening.telegram_lines"),
    max_len=110,
    repair=repair,
    words=(b"\xe5", b"\xdc\x02\x01", b"\x10\x03\x02\x49\x4e\x16", *map(framed, _SERVICES)),
)
