"""Clock synchronisation: Clock_Value, records of time stamps, and a slave's clock that hears any masters.

The first octet chooses. Judged: octets that were read are built again; texts are printable; a slave follows one master
at a time, its clock runs with the time of the line, and nothing but that master's telegrams moves it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.dp.pdu.clock import (
    CLOCK_VALUE_LENGTH,
    ENTRY_LENGTH,
    ClockValue,
    TimeStampedAlarm,
    parse_record,
    parse_time,
    time_octets,
    time_text,
)
from dpstack.dp.pdu.prm_blocks import PrmBlock
from dpstack.dp.pdu.prm_contents import BlockType
from dpstack.dp.pdu.requests import SetPrm
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.clock_receiver import clock_of
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import PduError
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.params import BROADCAST
from dpstack.units import NS_PER_MS
from tests.fuzz.frame import Cutter, Target, assert_plain, parsed

MASTERS: Final = (2, 9, 126)
VECTOR: Final = bytes.fromhex("e81b2c8080000000e81b2c76800000000000")


def run(octets: bytes) -> None:
    """The first octet chooses the part."""
    if octets:
        _PARTS[octets[0] % len(_PARTS)](octets[1:])


def _value(octets: bytes) -> None:
    found = parsed(ClockValue.parse, octets, PduError)
    assert (found is None) == (len(octets) != CLOCK_VALUE_LENGTH)
    if found is None:
        return
    assert_plain(found.text)
    built = parsed(lambda _: found.build(), b"", PduError)  # its fraction may round up into a year that has no octets
    if built is not None and built[8:16] != bytes(8):
        assert ClockValue.parse(built) == found


def _record(octets: bytes) -> None:
    found = parsed(parse_record, octets, PduError)
    if found is not None:
        assert len(found) == len(octets) // ENTRY_LENGTH
        for one in found:
            assert_plain(f"{one.kind_text} {time_text(one.time_ns)}")
    alarm = TimeStampedAlarm.of(octets)
    if alarm is not None:
        assert_plain(alarm.text)
        assert TimeStampedAlarm.of(alarm.octets) == alarm
    if len(octets) >= 8:
        t_ns = parse_time(octets[:8])
        again = parsed(lambda _: time_octets(t_ns), b"", PduError)
        assert again is None or parse_time(again) == t_ns


def _course(octets: bytes) -> None:
    """A slave at 5 hears masters, and has new parameters."""
    script, now = Cutter(octets), 0
    app = SlaveApp(MirrorDevice(0x1234, b"\x31"), address=5)
    receiver = clock_of(app)
    while script.at < len(script.octets):
        head = script.octet()
        sender = MASTERS[(head >> 3) % 3]
        before, followed, at = receiver.plant_clock(now), receiver.plant_clock(now).master, now
        match head & 7:
            case 0 | 1:
                app.indicate(Telegram(Kind.SD1, BROADCAST, sender, 0x40), now)
            case 2 | 3:
                size = CLOCK_VALUE_LENGTH if head & 0x80 else script.octet() & 31
                data = VECTOR if head & 0x40 else script.take(size).ljust(size, b"\0")
                app.indicate(Telegram(Kind.SD2, BROADCAST, sender, 0xC0, data=data), now)
            case 4:
                now += script.octet() * NS_PER_MS
            case 5:
                now += script.word() * NS_PER_MS * 10
            case 6:
                block = PrmBlock(BlockType.TIME_AR, 0, script.take(10).ljust(10, b"\0"))
                receiver.parameterised(SetPrm(ident=0x1234, user_prm=b"\x80\0\x08" + block.octets))
            case _:
                app.indicate(Telegram(Kind.SD2, BROADCAST, sender, 0x46, 58, 62, b"\0\0"), now)
        if app.wake_at() <= now:
            app.tick(now)
        for event in app.take_events():
            assert_plain(event.text)
        clock = receiver.plant_clock(now)
        if head & 6 != 2 and before.time_ns is not None:
            assert clock.time_ns == before.time_ns + now - at
        if clock.master != followed and followed is not None:
            assert head & 6 == 2
            assert clock.master == sender
        assert app.failure is None


_PARTS: Final[tuple[Callable[[bytes], None], ...]] = (_value, _record, _course, _course)


def repair(octets: bytes) -> bytes:
    """Give a Clock_Value and a record their lengths."""
    if not octets or octets[0] % len(_PARTS) > 1:
        return octets
    entry = (CLOCK_VALUE_LENGTH, ENTRY_LENGTH)[octets[0] % len(_PARTS)]
    return octets[: 1 + max(entry, (len(octets) - 1) // entry * entry)] if len(octets) > entry else octets


TARGET = Target(run, covers=("dpstack.dp.pdu.clock", "dpstack.dpv1.slave.clock_receiver"), max_len=250, repair=repair)
