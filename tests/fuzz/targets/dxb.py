"""Data exchange broadcast: filters, link status messages, and a subscriber that hears any broadcasts of publishers.

The first octet chooses: the octets of a block of structured parameters, of a link status message, or a course: Set_Prm
with a filter, broadcasts of any length at any time, Clear, Operate, Data_Exchange, MSRD, silence. Judged: octets that
were read are built again; texts are printable; a subscribed output is the safe value or the octet of a valid broadcast
of its publisher within the watchdog time, and of nobody else; no exception in the slave.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Final

from msgspec.structs import replace

from dpstack.dp.pdu.alarm_blocks import Status, StatusType, parse_block
from dpstack.dp.pdu.dxb import SINAMICS_FILTER, Link, block_of, filter_of, link_problem, links_of
from dpstack.dp.pdu.prm_blocks import PrmBlock, parse_blocks
from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave.events import DeviceFailed
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.dxb_links import DxbSupport, links_of_slave
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.errors import PduError
from dpstack.fdl.passive.station import PassiveStation
from dpstack.params import BROADCAST, BusParams
from tests.fuzz.frame import Cutter, Target, assert_plain, parsed
from tests.fuzz.octet_line import Line, sd2

MS: Final = 1_000_000
BAUD: Final = 500_000
PARAMS: Final = BusParams.preset(BAUD)
ADDRESS: Final = 9
#: 3 octets of inputs in slot 1, 4 of outputs in slot 2, 2 in slot 3
CFG: Final = bytes.fromhex("12 23 21")
SAFE: Final = bytes(range(0xA0, 0xA6))
#: the master's own outputs
OWN: Final = bytes(range(1, 7))
#: WD_Fact_1 x WD_Fact_2 x 10 ms
WATCHDOG_NS: Final = 50 * MS
PUBLISHERS: Final = (7, 8, 120)
LENGTHS: Final = (3, 4, 1)


def run(octets: bytes) -> None:
    """The first octet chooses the part."""
    if octets:
        _PARTS[octets[0] % len(_PARTS)](octets[1:])


def _blocks(octets: bytes) -> None:
    found = parsed(parse_blocks, octets, PduError)
    if found is None:
        return
    links = links_of(found)
    for link in links:
        assert_plain(link.text)
    problem = link_problem(links)
    assert_plain(problem or "")
    for block in found:
        table = filter_of(block)
        if table is not None:
            assert filter_of(PrmBlock(block.type, block.slot, table.data)) == table
    if problem is None and links:
        _build(links)


def _build(links: tuple[Link, ...]) -> None:
    """Links that can be one filter are the same ones when they are built and read again."""
    for sinamics in (False, True):
        if sinamics and any(link.slot is not None or link.to is None for link in links):
            continue
        if not sinamics and len({(link.slot is None, link.to is None) for link in links}) != 1:
            continue
        try:
            block = block_of(links, sinamics=sinamics)
        except PduError as error:
            assert_plain(str(error))
            continue
        again = links_of(parse_blocks(block.octets))
        if sinamics:
            assert sorted(map(repr, again)) == sorted(map(repr, links))
        elif links[0].slot is not None:
            assert again == links
        else:
            assert again == tuple(replace(link, to=None) for link in links)


def _status(octets: bytes) -> None:
    block = bytes((4 + len(octets), 0x80 | StatusType.DXB_LINK, 0, 0)) + octets
    found = parsed(parse_block, block, PduError)
    if isinstance(found, Status):
        assert_plain(found.full_text)
        assert len(found.links) in (0, len(octets) // 2)
        assert found.build() == block


@functools.cache
def _kind() -> SlaveDescription:
    support = DxbSupport(publisher=True, links=5, octets=12)
    return SlaveDescription(ident=0x1234, name="axis", configs=(CFG,), dpv1=True, dxb=support, fail_safe=True)


class Course:
    """A subscriber and what it hears. ``heard``: the last valid broadcast of a publisher, and its time."""

    def __init__(self, octets: bytes) -> None:
        self.script = Cutter(octets)
        self.app = SlaveApp(DpSlave(_kind(), lambda outputs, _: bytes(3), safe=SAFE), address=ADDRESS)
        self.station = PassiveStation(ADDRESS, self.app, PARAMS)
        self.line = Line(self.station, BAUD, lambda _octets, _end: None)
        self.fc = 0x6D
        self.links: tuple[Link, ...] = ()
        self.heard: dict[int, tuple[bytes, int]] = {}
        self.exchanged = self.operates = False

    def ask(self, dsap: int | None, data: bytes, *, function: int = 0x0D) -> None:
        fc = 0x40 | function | (self.fc & 0x30)
        self.fc = 0x50 | (~self.fc & 0x20)
        self.say(sd2(ADDRESS, 2, fc, data, None if dsap is None else (dsap, 62)))
        self.line.run(400_000)

    def say(self, octets: bytes) -> None:
        self.line.run(self.line.say(octets, self.line.now, 40) - self.line.now)

    def set_prm(self, block: bytes) -> None:
        head = bytes((0x88, 1, 5, 11)) + b"\x12\x34\x00"
        self.fc = 0x6D
        self.ask(61, head + b"\xa0\x00\x08" + block)
        self.ask(62, CFG)
        self.links, self.heard, self.exchanged, self.operates = (), {}, False, False
        if self.app.state is SlaveAppState.DATA_EXCH:
            self.links = links_of(parse_blocks(block))
            assert link_problem(self.links) is None
            assert len(self.links) <= 5
            assert sum(link.length for link in self.links) <= 12

    def step(self) -> None:
        script = self.script
        head = script.octet()
        match head & 15:
            case 0 | 1:
                self.set_prm(_FILTERS[head >> 4 & 7])
            case 2:
                data = script.take(script.octet() & 31)
                self.set_prm(bytes((4 + len(data), (3, 7, SINAMICS_FILTER)[head >> 4 & 1], 0, 0)) + data)
            case 3 | 4 | 5 | 6 | 7 | 8:
                self.broadcast(PUBLISHERS[(head >> 4) % 3])
            case 9:
                self.say(sd2(BROADCAST, 2, 0x46, bytes((2 * (head >> 7), 0)), (58, 62)))
                self.operates = self.app.state is SlaveAppState.DATA_EXCH and not head >> 7
            case 10 | 11 | 12:
                self.ask(None, OWN, function=(0x0D, 0x07)[head >> 4 & 1])
                self.exchanged = self.app.state is SlaveAppState.DATA_EXCH
            case 13:
                self.ask(None, b"", function=0x0D)
                self.exchanged = self.app.state is SlaveAppState.DATA_EXCH
            case 14:
                self.line.run((1 + script.octet()) * MS // 4)
            case _:
                self.ask(60, b"")
        self.judge()

    def broadcast(self, publisher: int) -> None:
        """An answer of a publisher to all: of the right length, of another, with SAPs, a refusal, or to its master."""
        script, length = self.script, LENGTHS[PUBLISHERS.index(publisher)]
        how = script.octet()
        size = script.octet() & 7 if how & 15 == 1 else length
        data = script.take(size).ljust(size, b"\x11")
        da = 2 if how & 15 == 2 else BROADCAST
        fc = 0x03 if how & 15 == 3 else (0x08, 0x0A)[how >> 4 & 1]
        saps = (20, 20) if how & 15 == 4 else None
        self.say(sd2(da, publisher, fc, data, saps))
        if (
            da != BROADCAST
            or saps is not None
            or fc == 0x03
            or not any(one.publisher == publisher for one in self.links)
        ):
            return
        wanted = next(one.publisher_length for one in self.links if one.publisher == publisher)
        if len(data) == wanted:
            self.heard[publisher] = data, self.line.now
        else:
            self.heard.pop(publisher, None)

    def judge(self) -> None:
        app = self.app
        assert app.failure is None, app.failure
        for event in self.station.take_events():
            assert not isinstance(event, DeviceFailed), event.text
            assert_plain(event.text)
        outputs = app.outputs
        if app.state is not SlaveAppState.DATA_EXCH:
            assert outputs == b""
            self.links, self.heard = (), {}
            return
        if not outputs:
            return
        for link in self.links:
            if link.to is None:
                continue
            at = link.to + (0 if link.slot in (None, 0, 2) else 4)
            found, seen = outputs[at : at + link.length], self.heard.get(link.publisher)
            allowed = {SAFE[at : at + link.length], bytes(link.length)}
            if seen is not None and self.operates and self.exchanged and self.line.now - seen[1] <= WATCHDOG_NS + MS:
                allowed.add(seen[0][link.offset : link.offset + link.length])
            assert found in allowed, (link, found, seen)
        for one in links_of_slave(app):
            assert one.good is (one.publisher in self.heard) or not one.good, one

    def run(self) -> None:
        self.line.pump()
        while self.script.at < len(self.script.octets):
            self.step()


#: subscriber tables and link tables that this slave takes, and some that it refuses
_FILTERS: Final = tuple(
    bytes.fromhex(text)
    for text in (
        "0B 07 00 00 01 07 03 01 02 01 02",
        "11 07 00 00 01 07 03 00 02 00 03 08 04 03 02 03 01",
        "17 07 00 00 01 07 03 00 02 00 01 78 01 00 03 01 01 08 04 00 02 02 02",
        "09 03 00 00 01 07 03 00 03",
        "0C E2 00 00 E2 01 03 07 03 01 02 02",
        "0B 07 00 00 01 07 03 01 02 03 02",
        "11 07 00 00 01 07 03 00 02 00 03 08 04 00 02 02 02",
        "0B 07 00 00 01 09 03 01 02 01 02",
    )
)
_PARTS: Final[tuple[Callable[[bytes], None], ...]] = (
    _blocks,
    _status,
    lambda octets: Course(octets).run(),
    lambda octets: Course(octets).run(),
)


def repair(octets: bytes) -> bytes:
    """Give the first block its length and a type with links."""
    if len(octets) < 6 or octets[0] % len(_PARTS):
        return octets
    out = bytearray(octets)
    out[1], out[2] = min(len(out) - 1, 234), (3, 7, SINAMICS_FILTER)[out[2] % 3]
    entry = {3: 4, 7: 6}.get(out[2])
    if entry is None:
        out[5] = SINAMICS_FILTER
    elif out[1] > 5:
        out[1] -= (out[1] - 5) % entry
    return bytes(out[: 1 + out[1]])


TARGET = Target(
    run,
    covers=("dpstack.dp.pdu.dxb", "dpstack.dp.pdu.prm_contents", "dpstack.dpv1.slave.dxb_links"),
    executions=100_000,
    max_len=240,
    repair=repair,
)
