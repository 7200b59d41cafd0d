"""tshark: its dissector against our own decoder, telegram by telegram; it runs our extcap program, installed by
``dpstack wireshark``, on a live segment."""

from __future__ import annotations

import os
import random
import struct
import subprocess
import unicodedata
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import pytest
from bus_kit import IDENT, PPO1, SimBus, setup
from programs import Starter, plant_of
from recordings import ASM754, LOGO_TD, WHOLE, completed
from step7_kit import PLANT
from support import MS, S

from dpstack.capture.listener import Listener
from dpstack.capture.pcapng import PROFIBUS_DL
from dpstack.capture.transmission import Damage, Transmission
from dpstack.cli.main import main
from dpstack.decode.telegram import explain
from dpstack.dp.pdu.alarm_blocks import Alarm, ModuleState, Status, module_status
from dpstack.dp.pdu.dpv1_status import ALARMS, Dpv1
from dpstack.dpv1.master.alarm_orders import AlarmRaised, CloseConnection
from dpstack.dpv1.master.orders import InitiateDone, OpenConnection, RecordDone, RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.dpv1.slave.alarms import AlarmServer, AlarmSupport
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.dpv1.slave.record_table import RecordTable
from dpstack.fdl.codec import encode_sd1, encode_sd2, encode_token
from dpstack.params import BusParams
from dpstack.sim.world import World
from tests.decode import test_decode_ppi as ppi
from tests.strangers.stranger_kit import HANGS_S, program
from tests.strangers.wireshark_kit import (
    differences,
    dissected,
    dissected_by_lua,
    environment,
    explained,
    field_names,
    tshark,
    write_capture,
)

pytestmark = pytest.mark.strangers

#: telegrams of real CPUs
REAL: Final = (
    ppi.QB0,
    ppi.POLL,
    ppi.QB0_IS_0,
    ppi.QW0,
    ppi.QW0_IS_0,
    ppi.SEVEN,
    ppi.SEVEN_VALUES,
    ppi.TWELVE,
    ppi.TWELVE_OCTETS,
    ppi.WRITE,
    ppi.WRITTEN,
    ppi.RUN,
    ppi.MODE_DONE,
    ppi.STOP,
    ppi.MODE_DONE,
    ppi.TIMERS,
    ppi.TIMER_VALUES,
    ppi.FIRST,
    ppi.RR,
)
EPOCH: Final = 1_790_000_000 * S + 123_456_789


def _hear(world: World, baud: int) -> list[Transmission]:
    """All transmissions of ``world`` from now on."""
    heard: list[Transmission] = []
    world.add(Listener(world.now, heard.append, baud=baud, epoch_ns=EPOCH), name="listener")
    return heard


class _Device(MirrorDevice):
    """Has records, class 2 connections, and raises alarms."""

    def __init__(self) -> None:
        super().__init__(IDENT, PPO1)
        self.alarm_server = self.server = AlarmServer(AlarmSupport(frozenset(ALARMS), 32), 238)
        self.records = RecordTable({(0, 1): b"\x11\x22\x33", (1, 2): b"\xaa"}, [(1, 2)])
        self.ms2 = 2


def _bring_up() -> Iterator[Transmission]:
    """Slaves of DP-V0 and DP-V1, one that is not there, one that refuses its configuration."""
    world = World(referee=False)
    heard = _hear(world, 1_500_000)
    other = setup(5, config=bytes.fromhex("C1 C3 83 01 40 41 10 20 B1"))
    absent = setup(9)
    slaves = [setup(3, Dpv1(alarms=("process",), alarm_mode=2), user_prm=bytes(3)), setup(4), other, absent]
    bus = SimBus(world, BusParams.preset(1_500_000, address=2, hsa=12), slaves, silent={9})
    bus.until_exchanging()
    world.run_for(50 * MS)
    return iter(heard)


def _alarms() -> Iterator[Transmission]:
    world = World(referee=False)
    heard = _hear(world, 187_500)
    device = _Device()
    dpv1 = Dpv1(alarms=tuple(ALARMS), alarm_mode=1, c1_response_timeout_ns=60 * MS)
    bus = SimBus(
        world, BusParams.preset(187_500, address=2, gap=0), [setup(4, dpv1)], devices={4: device}, watchdog_ms=2000
    )
    bus.until_exchanging()
    for number, kind in enumerate((1, 2, 3, 4, 6, 32)):
        device.server.alarm(Alarm(kind, 1, number % 4, data=bytes(number)))
        world.run_for(100 * MS)
    device.server.status(Status(1, 3, 1, b"\x05"))
    device.server.status(module_status((ModuleState.OK, ModuleState.WRONG, ModuleState.MISSING)))
    world.run_for(200 * MS)
    assert sum(isinstance(event, AlarmRaised) for event in bus.events) == 6
    return iter(heard)


def _class_2() -> Iterator[Transmission]:
    """Records by both classes, refused ones too, and a connection from Initiate to Abort."""
    world = World(referee=False)
    heard = _hear(world, 187_500)
    dpv1 = Dpv1(c1_response_timeout_ns=60 * MS)
    bus = SimBus(
        world, BusParams.preset(187_500, address=2, gap=0), [setup(4, dpv1)], devices={4: _Device()}, watchdog_ms=2000
    )
    bus.until_exchanging()
    bus.send(OpenConnection(1, 4))
    world.run_for(500 * MS)
    (opened,) = [event for event in bus.events if isinstance(event, InitiateDone)]
    token = 2
    for where in ({"address": 4}, {"connection": opened.token}):
        for function, slot, index, data in (
            (Function.READ, 0, 1, b""),
            (Function.READ, 7, 7, b""),
            (Function.WRITE, 1, 2, b"\x55"),
            (Function.WRITE, 0, 1, b"\x55\x66"),
        ):
            bus.send(RecordOrder(token, function, slot, index, data=data, **where))
            token += 1
            world.run_for(300 * MS)
    bus.send(RecordOrder(token, Function.DATA_TRANSPORT, 0, 0, data=b"abc", connection=opened.token))
    world.run_for(3 * S)  # long enough for Idle
    bus.send(CloseConnection(opened.token))
    world.run_for(200 * MS)
    assert sum(isinstance(event, RecordDone) for event in bus.events) == 9
    return iter(heard)


def _noise() -> Iterator[Transmission]:
    world = World(seed=5, referee=False)
    heard = _hear(world, 500_000)
    bus = SimBus(world, BusParams.preset(500_000, address=2), [3, 4])
    bus.until_exchanging()
    world.faults.noise(1e-3)
    world.run_for(1 * S)
    assert sum(bool(one.damage) for one in heard) > 100
    return iter(heard)


def _two_masters() -> Iterator[Transmission]:
    world = World(seed=1, referee=False)
    heard = _hear(world, 500_000)
    for address, slave in ((2, 20), (4, 21)):
        SimBus(world, BusParams.preset(500_000, address=address, hsa=10), [slave], watchdog_ms=2000)
    world.run_for(1 * S)
    world.faults.noise(2e-4)
    world.run_for(1 * S)
    return iter(heard)


def _recorded() -> Iterator[Transmission]:
    """Of real devices, one after another, 30 us apart; with other start octets, and telegrams that share the frame."""
    octets = [octets for recording in WHOLE for _, octets in recording.lines]
    octets += [completed(octets) if octets[0] == 0x68 else octets for _, octets in ASM754.lines]
    octets += LOGO_TD
    at = EPOCH
    for one in octets:
        yield Transmission(one, at, 500_000)
        at += len(one) * 22_000 + 30_000


_WORDS: Final = (0x00, 0x01, 0x02, 0x04, 0x08, 0x10, 0x20, 0x40, 0x48, 0x51, 0x56, 0x57, 0x58, 0x5C, 0x5E, 0x5F, 0x80,
                 0x81, 0xA0, 0xB7, 0xC2, 0xC9, 0xD7, 0xD8, 0xDE, 0xDF, 0xF0, 0xFE, 0xFF)  # fmt: skip


#: link table, subscriber table, filter block of SINAMICS
_LINKS = [
    bytes.fromhex(block)
    for block in (
        "09 03 00 00 01 07 03 01 02",
        "0B 07 00 00 01 07 03 01 02 01 02",
        "0C E2 00 00 E2 01 03 07 03 01 02 02",
    )
]


def _block(chance: random.Random) -> bytes:
    """A block of type 2, 4 or 8, whose values are possible ones, or any."""
    kind, size = chance.choice(((2, 4), (4, 24), (8, 10), (8, 2)))
    data = chance.randbytes(size)
    if kind == 4 and chance.random() < 0.6:
        bases = [chance.choice((375, 1500, 12_000, 7)) for _ in range(2)]
        low = [chance.choice((0, 1, 8, 40)) for _ in range(5)]
        data = struct.pack(">BIHBIHHIHH", 1, bases[0], low[0], low[1], bases[1], low[2], low[3], 4800, low[4], 0)
    return bytes((4 + size, kind, 0, chance.choice((0, 0x18, 0x1B)))) + data


def _any_units() -> Iterator[Transmission]:
    """Requests and answers at every service access point, with data units that are right, nearly right, and wrong."""
    chance = random.Random(20)
    at = EPOCH
    for number in range(5000):
        slave = chance.choice((*range(46, 64), 50, 51, 51, 51, 49, 58, 59, 60, 60, 60, 61, 61, 62, None))
        master = chance.choice((62, 62, 51, 50, 50, 54, None))
        size = chance.choice((0, 1, 2, 3, 4, 4, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 24, 28, 33, 60, 200))
        pick: tuple[Callable[[], int], ...] = (
            lambda: chance.randrange(256),
            lambda: chance.choice(_WORDS),
            lambda: chance.randrange(8),
        )
        draw = chance.choice(pick)
        unit = bytearray(draw() for _ in range(size))
        if size > 3 and chance.random() < 0.5:  # a service of DP-V1, its length is right or for a request
            unit[0] = chance.choice(_WORDS)
            unit[3] = chance.choice((size - 4, size - 4, 240))
        if size in (16, 20, 24, 28) and chance.random() < 0.5:  # Initiate, with network addresses and without
            first = 12 if number % 3 else 8  # of type and length of both addresses, in a request and in an answer
            left = size - first - 4
            unit[0] = 0x57
            source = 2 if left < 10 else 8 if left < 16 else left - 8
            other = max(left - source, 0)
            unit[first : first + 4] = bytes((source > 2, source, other > 2, other))
        if size > 14 and chance.random() < 0.5:  # structured parameters
            kind = chance.choice((2, 3, 4, 7, 8, 0x81))
            unit[7:14] = bytes((0x84, unit[8], 0x08, size - 10, kind, 1, 0))
        if slave == 60 and size > 9 and chance.random() < 0.7:  # diagnosis blocks whose lengths are right
            unit[6] = chance.choice((size - 6, 0x40 | size - 6, 0x80 | 5, 0xC0, 4)) & 0xFF
            unit[7] = chance.choice((1, 2, 0x81, 0x82, 0x9E, 0x9F, 0x20, 0xA0, 0xFE, unit[7]))
        if number % 60 == 10:  # Set_Prm with links to publishers
            slave, master = 61, 62
            unit = bytearray(unit[:7].ljust(7, b"\x88") + b"\x84\x00\x08" + chance.choice(_LINKS))
        if number % 30 == 4:  # Set_Prm with blocks of redundancy, isochronous mode and clock
            slave, master = 61, 62
            status = chance.choice((0x00, 0x10, 0x08, 0x18, 0x88, 0x98))
            blocks = b"".join(_block(chance) for _ in range(chance.randrange(4)))
            unit = bytearray(unit[:7].ljust(7, b"\x88") + bytes((0x84, 0, status)) + blocks)
        data = bytes(unit)
        if number % 50 == 7:  # Clock_Value, with and without the time before, of both eras; Time_Event
            stamp = chance.randbytes(chance.choice((18, 18, 18, 17, 1)))
            octets = encode_sd2(127, 2, 0xC0, stamp[:8] + bytes(8) + stamp[16:] if number % 100 == 7 else stamp)
        elif number % 50 == 11:  # Request Ident, sometimes Request LSAP Status, and their answers
            octets = encode_sd1(3, 2, 0x4E if number % 200 != 11 else 0x4F)
        elif number % 50 == 12:
            lengths = bytes(chance.choice((0, 1, 2, 5, 9)) for _ in range(4))
            texts = chance.randbytes(max(0, sum(lengths) - (number % 150 == 12)))
            octets = encode_sd2(2, 3, 8, (lengths + texts)[: 2 if number % 250 == 12 else None])
        elif number % 3:
            octets = encode_sd2(3, 2, 0x5D ^ (number % 2 * 0x20), data, slave, master) if data or slave else b"\xe5"
        else:
            status = chance.choice((0, 2, 3, 8, 8, 8, 9, 10, 1, 12, 5))
            octets = encode_sd2(2, 3, status, data, master, slave) if data or slave else b"\xe5"
        yield Transmission(octets, at, 500_000)
        at += len(octets) * 22_000 + chance.choice((30_000, 30_000, 2_000_000))


def _clock(chance: random.Random) -> bytes:
    """The octets of a clock: a time, or any."""
    if chance.random() < 0.3:
        return chance.randbytes(10)
    when = (
        0x19,
        chance.choice((0x05, 0x90, 0x89, 0x00)),
        chance.choice((1, 2, 0x12)),
        chance.choice((1, 0x28, 0x29, 0x30)),
    )
    return bytes((0, *when, 0x23, 0x59, 0x59, 0x99, chance.choice((0x91, 0xF1))))


def _items(chance: random.Random) -> list[bytes]:
    """Addresses in requests: of each area and size, and impossible ones."""
    areas = (
        (0x84, 1),
        (0x83, 0),
        (0x81, 0),
        (0x82, 0),
        (5, 0),
        (4, 0),
        (6, 0),
        (7, 0),
        (0x1F, 0),
        (0x1E, 0),
        (0x84, 5),
        (9, 0),
    )
    found = []
    for _ in range(chance.choice((0, 1, 1, 1, 2, 3, 9, 12))):
        area, block = chance.choice(areas)
        size = chance.choice((1, 2, 2, 4, area))
        where = chance.choice((0, 8, 0x320, 0x12345, 37))
        found.append(
            struct.pack(
                ">BBBBHHBBH",
                0x12,
                0x0A,
                0x10,
                size,
                chance.choice((1, 1, 2, 4, 20)),
                block,
                area,
                where >> 16,
                where & 0xFFFF,
            )
        )
    return found


def _values(chance: random.Random, count: int, good: int) -> bytes:
    """The data of items: with codes, kinds and lengths that fit, and others."""
    data = b""
    for _ in range(count):
        code = chance.choice((good, good, good, good, 5, 0x0A, 0x77))
        octets = chance.choice(
            (b"\1", b"\0\xfa", bytes.fromhex("45208000"), bytes.fromhex("FFFF8000"), chance.randbytes(5), bytes(17))
        )
        kind, length = chance.choice(((4, 8 * len(octets)), (3, 1), (9, len(octets)), (0, len(octets))))
        if code not in (0, 0xFF):
            kind, length, octets = 0, 0, b""
        size = (length + 7) // 8 if kind in (3, 4) else length
        data += struct.pack(">BBH", code, kind, length) + octets[:size] + bytes(size % 2)
    return data[: -1 if chance.random() < 0.05 and data else None]


def _pdu(kind: int, sequence: int, parameter: bytes, data: bytes = b"", error: int | None = None) -> bytes:
    head = struct.pack(">BBHHHH", 0x32, kind, 0, sequence, len(parameter), len(data))
    return head + (b"" if error is None else error.to_bytes(2, "big")) + parameter + data


def _conversation(chance: random.Random, sequence: int) -> tuple[bytes, bytes]:
    """The PDUs of a request and of its answer."""
    what = chance.randrange(10)
    if what < 4:
        items = _items(chance)
        function, count = bytes((4 if what < 2 else 5,)), bytes((len(items),))
        data = b"" if what < 2 else _values(chance, len(items), 0)
        asks = _pdu(1, sequence, function + count + b"".join(items), data)
        if what < 2:
            return asks, _pdu(3, sequence, function + count, _values(chance, len(items), 0xFF), 0)
        codes = bytes(chance.choice((0xFF, 0xFF, 3, 0x55)) for _ in items)
        return asks, _pdu(3, sequence, function + count, codes, 0)
    if what == 4:
        mode = bytes.fromhex(chance.choice(("28 000000000000FD 0000 095F50", "29 0000000000 095F50")))
        return _pdu(1, sequence, mode), _pdu(3, sequence, b"\x29", b"", chance.choice((0, 0, 0x8001)))
    if what == 5:
        length = bytes.fromhex("F0 00 0001 0001 03C0")[: chance.choice((8, 8, 7))]
        return _pdu(1, sequence, length), _pdu(3, sequence, length, b"", 0)
    if what < 8:
        order = chance.choice((1, 2, 3))
        asks = bytes((0, 1, 0x12, 4, 0x11, chance.choice((0x47, 0x47, 0x42)), order, 0))
        told = bytes((0, 1, 0x12, 8, 0x12, 0x87, order, 0, 0, 0)) + chance.choice((bytes(2), bytes(2), b"\x81\x04"))
        clocks = [b"\xff\x09\x00\x0a" + _clock(chance) if chance.random() < 0.6 else b"\x0a\0\0\0" for _ in range(2)]
        return _pdu(7, sequence, asks, clocks[0]), _pdu(7, sequence, told, clocks[1])
    if what == 8:
        return _pdu(1, sequence, b"\x1a\x00"), _pdu(2, sequence, b"", b"", chance.choice((0, 0x8104, 0x1234)))
    return chance.randbytes(14), b"\x32" + chance.randbytes(14)


def _ppi() -> Iterator[Transmission]:
    """Two masters and S7-200 CPUs, beside a DP slave whose outputs look like PDUs; PDUs that are right, nearly right,
    and wrong; polls, "not yet", answers that are late, damaged or without their request."""
    chance = random.Random(22)
    telegrams = [bytes.fromhex(one) for one in (*REAL, "E5")]
    telegrams.append(encode_sd2(5, 0, 0x5D, bytes.fromhex("80 00 00 0B 12 34 00"), 61, 62))
    fcb = 0
    for number in range(900):
        cpu, master = chance.choice((2, 2, 3, 5)), chance.choice((0, 0, 1))
        pdus = _conversation(chance, number if chance.random() < 0.9 else 7)
        asks, told = (pdu[:246] for pdu in pdus)
        fcb ^= 0x20
        telegrams.append(encode_sd2(cpu, master, 0x5C ^ fcb, asks))
        if chance.random() < 0.8:
            telegrams.append(b"\xe5")
        if chance.random() < 0.2:
            telegrams.append(encode_sd1(cpu, master, 0x49))
        if chance.random() < 0.2:
            telegrams += [encode_sd1(cpu, master, 0x7C ^ fcb), encode_sd1(master, cpu, 2)]
        fcb ^= 0x20
        if chance.random() < 0.9:
            telegrams.append(encode_sd1(cpu, master, 0x5C ^ fcb))
        if chance.random() < 0.1:
            telegrams.append(encode_token(master, master))
        if chance.random() < 0.05:
            telegrams.append(b"\x10\x02")
        telegrams.append(encode_sd2(master, cpu, 8, told))
    at = EPOCH
    for octets in telegrams:
        yield Transmission(octets, at, 187_500)
        at += len(octets) * 58_667 + 100_000


def _any_octets() -> Iterator[Transmission]:
    """Damaged telegrams, marked and not, with comments, cut off, with octets after them, address extensions."""
    chance = random.Random(21)
    good = [octets for recording in WHOLE for _, octets in recording.lines] + [b"\xe5", encode_token(2, 3)]
    marks = [*Damage, Damage.FCS | Damage.TOO_SHORT, Damage(0)]
    at = EPOCH
    for number in range(2000):
        octets = bytearray(chance.choice(good))
        what = number % 6
        if what == 1:
            octets[chance.randrange(len(octets))] ^= 1 << chance.randrange(8)
        elif what == 2:
            octets = octets[: chance.randrange(1, len(octets) + 1)]
        elif what == 3:
            octets += bytes(chance.randrange(256) for _ in range(chance.randrange(1, 5)))
        elif what == 4:
            octets = bytearray(chance.randrange(256) for _ in range(chance.randrange(1, 20)))
        elif what == 5:
            body = bytearray(chance.randrange(256) for _ in range(chance.randrange(3, 12)))
            body[2] = chance.choice((0x5D, 0x7D, 0x08, 0x49, 0xC0, 0x40, 0x0A, 0x6C))
            octets = bytearray((0x68, len(body), len(body), 0x68, *body, sum(body) & 0xFF, 0x16))
        note = "the port was lost for 2 s" if number % 50 == 7 else "from 50 octets" if number % 20 == 9 else ""
        yield Transmission(bytes(octets), at, 500_000, note, marks[number % len(marks)] if what in (1, 2) else 0)
        at += 1_000_000


@pytest.mark.parametrize(
    "traffic",
    [_bring_up, _alarms, _class_2, _noise, _two_masters, _recorded, _any_units, _any_octets, _ppi],
    ids=lambda make: make.__name__.strip("_"),
)
def test_all_fields_are_those_of_our_own_decoder(traffic: Callable[[], Iterator[Transmission]], tmp_path: Path) -> None:
    path = write_capture(tmp_path / "bus.pcapng", traffic())
    ours = explained(path)
    assert len(ours) > 40
    wrong = differences(dissected(path), ours)
    assert not wrong, f"{len(wrong)} of {len(ours)} packets, at first:\n" + "\n".join(wrong[:20])


@pytest.mark.parametrize(
    "traffic", [_bring_up, _class_2, _noise, _any_units, _any_octets, _ppi], ids=lambda make: make.__name__.strip("_")
)
def test_the_dissector_in_the_lua_of_newer_versions(traffic: Callable[[], Iterator[Transmission]]) -> None:
    sent = [one._replace(note="", damage=0) for one in traffic()]
    wrong = differences(dissected_by_lua(sent), list(explain(sent)))
    assert not wrong, f"{len(wrong)}, at first:\n" + "\n".join(wrong[:20])


def test_every_field_of_a_data_unit_was_compared(tmp_path: Path) -> None:
    captures = (write_capture(tmp_path / f"{make.__name__}.pcapng", make()) for make in (_any_units, _ppi))
    found = {name for path in captures for packet in dissected(path) for name in packet}
    assert [name for name in field_names() if name.startswith("profibus.dp.") and name not in found] == []


def test_only_link_type_147_is_dissected(tmp_path: Path) -> None:
    for linktype in (PROFIBUS_DL, 148):
        path = write_capture(tmp_path / f"{linktype}.pcapng", _recorded(), linktype)
        assert set(tshark("-r", path, "-T", "fields", "-e", "profibus.kind").split()) == set()


POLL: Final = bytes.fromhex("68 04 04 68 03 02 5D 07 69 16")  # Data_Exchange 2 -> 3, FCV=1 FCB=0
ANSWER: Final = bytes.fromhex("68 04 04 68 02 03 08 AA B7 16")
TOKEN: Final = bytes.fromhex("DC 02 02")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Path:
    """A home folder in which ``dpstack wireshark install`` has been."""
    folder = tmp_path / "home"
    folder.mkdir()
    for name, value in environment(folder).items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    assert main(["wireshark", "install"]) == 0
    assert "installed" in capsys.readouterr().out
    return folder


@pytest.fixture
def segment(tmp_path: Path) -> Iterator[Path]:
    """The folder of a live segment, on which a run has its three slaves, simulated by a sim, in data exchange."""
    folder = tmp_path / "bus"
    plant = plant_of(tmp_path, folder / "1")
    logs = tmp_path / "logs"
    logs.mkdir()
    start = Starter(logs)
    try:
        start.segment(folder)
        start("sim", str(plant), "--port", str(folder / "0")).wait_for(str(folder / "0"))
        start("run", str(plant), "--json").wait_for_slaves(3)
        yield folder
    finally:
        start.close()


def test_tshark_captures_from_a_live_segment_and_from_the_run_on_it(home: Path, segment: Path, tmp_path: Path) -> None:
    listed = tshark("-D", home=home)
    assert f"dpstack:{segment} (PROFIBUS: segment on {segment})" in listed
    assert f"dpstack:{segment / '1'} (PROFIBUS: run on {segment / '1'})" in listed
    for number, port in enumerate((segment, segment / "1")):
        file = tmp_path / f"{number}.pcapng"
        tshark("-i", f"dpstack:{port}", "-a", "packets:400", "-w", file, home=home)
        ours = explained(file)
        assert len(ours) >= 400
        assert {"Data_Exchange", "token"} <= {one.service for one in ours}
        assert {one.telegram.da for one in ours if one.telegram and one.telegram.is_request} >= {3, 4, 9}
        assert differences(dissected(file), ours) == []
    lines = tshark("-i", f"dpstack:{segment}", "-a", "packets:50", home=home).splitlines()
    assert any("Data_Exchange request 2 -> 3" in line for line in lines)


def test_a_port_that_is_not_there_ends_with_a_line(home: Path) -> None:
    done = subprocess.run(
        [program("tshark"), "-i", "dpstack:/nowhere", "-a", "packets:1"],
        capture_output=True,
        text=True,
        timeout=HANGS_S,
        check=False,
        env=dict(os.environ),
    )
    assert done.returncode != 0
    assert "/nowhere" in done.stderr


def test_it_is_gone_when_it_is_removed(home: Path) -> None:
    assert "dpstack-profibus" in tshark("-G", "plugins", home=home)
    assert main(["wireshark", "remove"]) == 0
    assert "dpstack-profibus" not in tshark("-G", "plugins", home=home)


def _course(path: Path) -> Path:
    """A poll with its answer, one that is repeated and answered, one in vain, a late answer, a damaged telegram, a poll
    of the GAP."""
    gap = bytes.fromhex("10 05 02 49 50 16")  # FDL_Status 2 -> 5
    octets = [TOKEN, POLL, ANSWER, POLL, POLL, ANSWER, POLL, TOKEN, ANSWER, POLL[:-1] + b"\x17", gap, TOKEN]
    sent, at = [], 1_790_000_000_000_000_123
    for one in octets:
        damage = Damage.FCS if one[-1] == 0x17 else 0
        sent.append(Transmission(one, at, 500_000, "", damage))
        at += len(one) * 22_000 + 30_500
    return write_capture(path, sent)


def _column(path: Path, name: str, *more: str) -> list[str]:
    return tshark("-2", "-r", path, "-T", "fields", "-e", name, *more).split("\n")[:-1]


def test_requests_answers_and_their_times(tmp_path: Path) -> None:
    path = _course(tmp_path / "course.pcapng")
    assert _column(path, "profibus.response_in") == ["", "3", "", "", "6", "", "9", *[""] * 5]
    assert _column(path, "profibus.response_to") == ["", "", "2", "", "", "5", "", "", "7", "", "", ""]
    assert _column(path, "profibus.retry_of") == ["", "", "", "", "4", *[""] * 7]
    assert _column(path, "profibus.response_time")[2] == "0.000030500"
    assert _column(path, "profibus.pair") == ["", *["2-3"] * 6, "", "2-3", "", "2-5", ""]
    assert _column(path, "frame.number", "-Y", "profibus.late") == ["9"]
    assert _column(path, "frame.number", "-Y", "profibus.sa == 2 && profibus.service == \"Data_Exchange\"") == [
        "2", "4", "5", "7",
    ]  # fmt: skip


def test_expert_infos(tmp_path: Path) -> None:
    path = _course(tmp_path / "course.pcapng")

    def frames(name: str) -> list[str]:
        return _column(path, "frame.number", "-Y", f"profibus.expert.{name}")

    assert frames("retry") == ["5"]
    assert frames("lost") == ["4", "8"]
    assert frames("late") == ["9"]
    assert frames("damaged") == ["10"]
    assert frames("refused") == []
    shown = tshark("-r", path, "-q", "-z", "expert")
    assert "Retry of telegram 4" in shown
    assert "no telegram: the end octet is not 16" in shown
    assert _column(path, "profibus.damage")[9] == "check sequence"


def test_the_table_by_master_and_slave(tmp_path: Path) -> None:
    path = _course(tmp_path / "course.pcapng")
    title, head, row, sums, polls = tshark("-q", "-o", "profibus.table:TRUE", "-r", path).strip().splitlines()
    assert title == "PROFIBUS by master and slave"
    assert head.split() == [
        "master", "slave", "requests", "answers", "retries", "no", "answer", "late", "min", "us", "mean", "us", "max",
        "us",
    ]  # fmt: skip
    assert row.split() == ["2", "3", "4", "2", "1", "2", "1", "30.5", "30.5", "30.5"]
    assert sums == "12 telegrams, 3 of them tokens, 1 damaged, 0 answers without a request"
    assert polls == "1 requests FDL_Status (GAP), 0 of them answered"


def test_comments_in_a_file_never_reach_a_terminal_raw(tmp_path: Path) -> None:
    evil = "\x1b]0;owned\x07\x9b31m\x7f\x85\u202eevil\u2066\u200b\ufeff\u2028\u061c\U000e0001 lost\nx"
    path = write_capture(tmp_path / "a.pcapng", [Transmission(b"\xe5", 1_000, 500_000, evil)])
    for shown in (tshark("-r", path), tshark("-r", path, "-T", "fields", "-e", "profibus.text")):
        assert "lost?x" in shown
        assert not [sign for sign in shown.rstrip("\n") if unicodedata.category(sign) in ("Cc", "Cf", "Zl")]


def test_the_rate_may_come_from_the_user(tmp_path: Path) -> None:
    sent = [Transmission(POLL, 1_000_000, 0), Transmission(ANSWER, 1_000_000 + 220_000 + 30_000, 0)]
    path = write_capture(tmp_path / "a.pcapng", sent)
    assert _column(path, "profibus.response_time") == ["", ""]
    assert _column(path, "profibus.response_time", "-o", "profibus.baud:500000") == ["", "0.000030000"]


def test_the_names_of_an_imported_plant(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plant.cfg").write_bytes(PLANT.encode("cp1252"))
    plant, names = tmp_path / "plant.toml", tmp_path / "plant.names"
    assert main(["import", str(tmp_path / "plant.cfg"), "--out", str(plant)]) == 0
    assert main(["wireshark", "names", str(plant), "--out", str(names)]) == 0
    capsys.readouterr()
    inputs = bytes.fromhex("12 34 FF FE 00 00 00 00 08")
    sent = [encode_sd2(10, 2, 0x7D, b"\x81"), encode_sd2(2, 10, 0x08, inputs), encode_sd2(12, 2, 0x7D, b"\0")]
    path = write_capture(tmp_path / "bus.pcapng", [Transmission(one, EPOCH + n * MS) for n, one in enumerate(sent)])
    given = ("-o", f"profibus.names:{names}", "-T", "fields", "-E", "aggregator=;")
    shown = tshark("-r", path, *given, "-e", "_ws.col.Source", "-e", "profibus.station", "-e", "profibus.value")
    assert shown.splitlines() == [
        "2\tHauptschrank\tH8_EBE = yes;Horn = yes",
        "10 Hauptschrank\tHauptschrank\tFüllstand = 4660;H19_N_IST = -2;NA_INT = yes;NA_EXT = no",
        "2\tHalle 2\t",
    ]
    wrong = tshark("-r", path, "-V", "-o", f"profibus.names:{plant}")
    assert f"Names of the plant: {plant} is no file of `dpstack wireshark names`" in wrong
    missing = tshark("-r", path, "-V", "-o", "profibus.names:/nowhere")
    assert "Names of the plant: /nowhere cannot be read" in missing


def test_the_named_values_of_a_cpu_are_those_of_our_own_decoder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plant, names = tmp_path / "plant.toml", tmp_path / "plant.names"
    plant.write_text(ppi.PLANT)
    assert main(["wireshark", "names", str(plant), "--out", str(names)]) == 0
    capsys.readouterr()
    sent = list(_ppi())[:800]
    path = write_capture(tmp_path / "bus.pcapng", sent)
    given = ("-2", "-o", f"profibus.names:{names}", "-T", "fields", "-E", "aggregator=;", "-e", "profibus.value")
    shown = [
        {one.partition(" = ")[0] for one in line.split(";") if one} for line in tshark("-r", path, *given).split("\n")
    ]
    expected = []
    for one in explain(sent, ppi.plant_names()):
        items = one.fields.get("items", [])
        assert isinstance(items, list)
        expected.append({name for item in items for name in item.get("values", {})})
    assert shown[:-1] == expected
    # of recipe only a part is read
    assert {name for found in expected for name in found} == ppi.plant_names().cpus[2].values.keys() - {"recipe"}
    # scale, unit and octets of telegrams of real CPUs
    texts = tshark("-r", path, *given).split("\n")[: len(REAL)]
    assert [text for text in texts if text][:5] == [
        "outputs = 0;pump = no",
        "outputs = 0;pump = no",  # in QW0
        "outputs = 9;pump = yes;mode = 0;count = 4653166",
        "flow = 236.600372 l/min;level = 71.73 cm",
        "flow = 2568 l/min",
    ]
