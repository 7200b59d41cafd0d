"""Encoding and decoding of single telegrams, beside construct.

Encoding is from fields to octets, decoding from octets to fields with everything checked; data and FCB are other ones
in every call, as on a bus. Every program first has to make the same octets, and to find the same data in them. Times
are CPU time, in Python loops; dpstack keeps the heads of telegrams it has made before, as in a running master.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final, NamedTuple, cast

import construct as c

from bench.calibration import Beside
from bench.options import count
from bench.report import Report
from dpstack.fdl.codec import decode, encode, encode_token, request_octets
from dpstack.fdl.telegram import SHORT_ACK, Kind

Call = Callable[[], object]
#: encoding (None: that is never sent) and decoding of one telegram
Coders = tuple[Call | None, Call]


class Sample(NamedTuple):
    """A telegram by its fields and as literal octets; ``da`` and ``sa`` without the extension bit, FC -1 for none."""

    title: str
    octets: bytes
    da: int = -1
    sa: int = -1
    fc: int = -1
    dsap: int | None = None
    ssap: int | None = None
    data: bytes = b""


_literal: Final = bytes.fromhex
_DATA: Final = tuple(bytes((n, 0x55, *range(10))) for n in range(4))
_EXCHANGE: Final = "SD2 Data_Exchange, PPO1"
#: what dpstack may take for the telegram of the cycle, in Python loops
_GOALS: Final = {(_EXCHANGE, "encode"): 1.0, (_EXCHANGE, "decode"): 2.0}
#: every kind of telegram that DP has; of the cyclic one those with both FCB and two contents
SAMPLES: Final = (
    Sample("SD1 FDL status", _literal("10 03 02 49 4E 16"), 3, 2, 0x49),
    *(
        Sample(_EXCHANGE, _literal(octets), 3, 2, fc, data=data)
        for fc, data, octets in (
            (0x5D, _DATA[0], "68 0F 0F 68 03 02 5D 00 55 00 01 02 03 04 05 06 07 08 09 E4 16"),
            (0x7D, _DATA[1], "68 0F 0F 68 03 02 7D 01 55 00 01 02 03 04 05 06 07 08 09 05 16"),
            (0x5D, _DATA[2], "68 0F 0F 68 03 02 5D 02 55 00 01 02 03 04 05 06 07 08 09 E6 16"),
            (0x7D, _DATA[3], "68 0F 0F 68 03 02 7D 03 55 00 01 02 03 04 05 06 07 08 09 07 16"),
        )
    ),
    Sample(
        "SD2 diagnosis",
        _literal("68 0B 0B 68 82 83 08 3E 3C 00 0C 00 02 12 34 DB 16"),
        2,
        3,
        0x08,
        62,
        60,
        _literal("00 0C 00 02 12 34"),
    ),
    Sample("SD3", _literal("A2 03 02 7D 01 02 03 04 05 06 07 08 A6 16"), 3, 2, 0x7D, data=bytes(range(1, 9))),
    Sample("SD4 token", _literal("DC 03 02"), 3, 2),
    Sample("SC", b"\xe5"),
)


def _own(sample: Sample) -> Coders:
    start = sample.octets[0]
    read = partial(decode, sample.octets)
    if start == Kind.SD3:
        return None, read  # accepted, never sent
    if start == Kind.SD4:
        return partial(encode_token, sample.da, sample.sa), read
    if start == Kind.SC:
        return partial(encode, SHORT_ACK), read
    _, _, da, sa, fc, dsap, ssap, data = sample
    return partial(request_octets, da, sa, fc, data, dsap, ssap), read


def _construct(sample: Sample) -> Coders:
    layout = _LAYOUTS[Kind(sample.octets[0])]
    _, octets, da, sa, fc, dsap, ssap, data = sample
    saps = b"" if dsap is None or ssap is None else bytes((dsap, ssap))
    bit = 0x80 if saps else 0
    fields = {"body": {"value": {"da": da | bit, "sa": sa | bit, "fc": fc, "unit": saps + data}}, "da": da, "sa": sa}
    return partial(layout.build, fields), partial(layout.parse, octets)


def _checked(*inside: Any) -> tuple[Any, ...]:
    """Fields between SD and ED, with FCS."""
    body = "body" / c.RawCopy(c.Struct("da" / c.Byte, "sa" / c.Byte, "fc" / c.Byte, *inside))
    return body, "fcs" / c.Checksum(c.Byte, lambda octets: sum(octets) & 0xFF, c.this.body.data), c.Const(b"\x16")


_LAYOUTS: Final[dict[Kind, Any]] = {
    Kind.SD1: c.Struct(c.Const(b"\x10"), *_checked()),
    Kind.SD2: c.Struct(
        c.Const(b"\x68"),
        "le" / c.Rebuild(c.Byte, lambda context: 3 + len(context.body["value"]["unit"])),
        "ler" / c.Rebuild(c.Byte, c.this.le),
        c.Check(c.this.le == c.this.ler),
        c.Const(b"\x68"),
        *_checked("unit" / c.Bytes(lambda context: context._.le - 3)),
    ),
    Kind.SD3: c.Struct(c.Const(b"\xa2"), *_checked("unit" / c.Bytes(8))),
    Kind.SD4: c.Struct(c.Const(b"\xdc"), "da" / c.Byte, "sa" / c.Byte),
    Kind.SC: c.Struct(c.Const(b"\xe5")),
}
_MAKERS: Final[dict[str, Callable[[Sample], Coders]]] = {"dpstack": _own, "construct": _construct}


class Subject(NamedTuple):
    """One measured task: a program (``who``) encodes or decodes (``does``) one kind of telegram."""

    title: str
    does: str
    who: str
    calls: tuple[Call, ...]


def subjects() -> list[Subject]:
    """All tasks. Raises RuntimeError where octets are not right."""
    found: list[Subject] = []
    titles = list(dict.fromkeys(sample.title for sample in SAMPLES))
    for who, maker in _MAKERS.items():
        coders = {title: [maker(s) for s in SAMPLES if s.title == title] for title in titles}
        for sample, (write, _) in zip(SAMPLES, (pair for pairs in coders.values() for pair in pairs), strict=True):
            if write is not None and bytes(cast(bytes, write())) != sample.octets:
                raise RuntimeError(f"{who} makes other octets of {sample.title}")
        for title, pairs in coders.items():
            if writes := tuple(write for write, _ in pairs if write is not None):
                found.append(Subject(title, "encode", who, writes))
            found.append(Subject(title, "decode", who, tuple(read for _, read in pairs)))
    return found


def run(argv: Sequence[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench codec")
    parser.add_argument("--loops", type=int, default=1_000, help="calls a round")
    parser.add_argument("--rounds", type=count, default=15, help="interleaved")
    args = parser.parse_args(argv)
    found = subjects()
    report = Report("codec")
    beside = Beside()
    rounds = [[beside(partial(_time, subject.calls, args.loops)) for subject in found] for _ in range(args.rounds)]
    report.calibrated("Python", beside.loops)
    times = dict(zip(found, zip(*rounds, strict=True), strict=True))
    own = {(s.title, s.does): each for s, each in times.items() if s.who == "dpstack"}
    for subject, each in times.items():
        name = f"{subject.title}: {subject.does}, {subject.who}"
        report.in_loops(name, each, _GOALS.get((subject.title, subject.does)) if subject.who == "dpstack" else None)
        mine = own.get((subject.title, subject.does))
        if subject.who != "dpstack" and mine is not None:
            ratios = [(a / loop) / (b / own_loop) for (a, loop), (b, own_loop) in zip(each, mine, strict=True)]
            report.measured(f"{name} to dpstack", ratios, "", more=True)
    report.notes.append("dpstack never sends SD3; construct does not judge addresses and FC")
    return report


def _time(calls: Sequence[Call], loops: int) -> float:
    """CPU time of one call in ns."""
    turns = max(1, loops // len(calls))
    begin = time.process_time_ns()
    for _ in range(turns):
        for call in calls:
            call()
    return max(1, time.process_time_ns() - begin) / (turns * len(calls))
