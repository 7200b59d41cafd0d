"""Transcripts of the masters in troubled situations: the time and text of each event, and all requests to the slave.

One line a situation, in the snapshots of :mod:`texts.snapshot`; the slaves are scripts of octets.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from functools import partial
from itertools import groupby
from typing import Any

from alarm_kit import ALL, AlarmBus, block
from class2_kit import Class2Bus
from ms1_kit import Ms1Bus, answer, status
from ms2_kit import Ms2Bus
from octet_slave import DL, NR, RR, RS, SC, UE, OctetSlave, sd1, sd2
from scripted_link import (
    DIAG_FREE,
    DIAG_LOCKED,
    DIAG_NOT_READY,
    DIAG_PRM_FAULT,
    DIAG_READY,
    DIAG_STATIC,
    MS,
    ScriptedLink,
    ScriptedSlave,
    high,
    link,
    refuses,
    says,
    setup,
    silent,
)
from texts.snapshot import Case

from dpstack.dp.acyclic.class2 import ChangeAddress, ReadService, Service
from dpstack.dp.acyclic.job import CancelService, Outcome
from dpstack.dp.master.commands import ActivateSlave, DeactivateSlave, Mode, SendControl, SetMode
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.alarm_orders import AlarmDone, AlarmRaised, StatusTold
from dpstack.dpv1.master.orders import RecordDone, RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.errors import DpError
from dpstack.fdl.interface import Failure

_OTHER = bytes.fromhex("02 05 00 FF 12 34")
_EXT = bytes.fromhex("08 0C 00 02 06 96 42 01 03 AA BB 85 41 C6 FF")


def transcript(bus: ScriptedLink) -> str:
    """Events with their time in us, and the requests as runs of equal ones."""
    events = " | ".join(f"{event.t_ns // 1000} {type(event).__name__}: {event.text}" for event in bus.events)
    asked = ((r.da, r.dsap, f"{int(r.function):02X} {r.data.hex()}".strip()) for r in bus.requests)
    runs = ", ".join(f"{da}/{dsap} {octets}*{len(list(same))}" for (da, dsap, octets), same in groupby(asked))
    return f"{events} || {runs}"[:6000]


def _always(value: Any) -> Callable[..., Any]:
    """A function that gives ``value`` whatever it is asked."""
    return lambda *_: value


def _slow(**slave: Any) -> ScriptedLink:
    bus = link(setup(), slaves={3: ScriptedSlave(**slave)})
    bus.period = 7 * MS + 1
    return bus


def bring_ups() -> Iterator[Case]:
    """Trouble with each service, from the beginning and in data exchange."""
    answers = {
        "silent": silent,
        "garbled": lambda request: Failure.GARBLED,
        "wrong": lambda request: Failure.WRONG,
        **{f"status {code}": refuses(code) for code in (0, 1, 2, 3, 9)},
        "one octet": says(b"\1"),
        "locked": says(DIAG_LOCKED),
        "other": says(_OTHER),
    }
    for sap in (60, 61, 62, 59, None):
        for name, trouble in answers.items():
            if sap == 60 or name not in ("locked", "other"):
                bus = _slow(answers={sap: trouble})
                bus.run(1_500 * MS)
                yield f"{sap} {name}", transcript(bus)
    for name, ready in (
        ("free", DIAG_FREE),
        ("not ready", DIAG_NOT_READY),
        ("static", DIAG_STATIC),
        ("prm", DIAG_PRM_FAULT),
        ("cfg", bytes.fromhex("06 05 00 02 06 96")),
        ("not supported", bytes.fromhex("10 0C 00 02 06 96")),
        ("locked", DIAG_LOCKED),
        ("other", _OTHER),
        ("extended", _EXT),
        ("deviations", bytes.fromhex("A1 C8 80 82 06 96")),
        ("long", DIAG_READY + bytes(239)),
    ):
        bus = _slow(ready=ready)
        bus.run(1_500 * MS)
        yield f"diagnosis {name}", transcript(bus)
        bus = _slow()
        bus.run(60 * MS)
        bus.slave.answers = {None: high, 60: says(ready)}
        bus.run(1_200 * MS)
        yield f"high priority, diagnosis {name}", transcript(bus)
    bus = _slow(ready=DIAG_NOT_READY)
    bus.run(11_000 * MS)
    yield "never ready", transcript(bus)
    bus = _slow()
    bus.run(60 * MS)
    bus.slaves.clear()
    bus.run(1_500 * MS)
    bus.slaves[3] = ScriptedSlave()
    bus.run(1_500 * MS)
    yield "gone and back", transcript(bus)
    bus = _slow()
    for order in (SetMode(Mode.OPERATE), DeactivateSlave(3), ActivateSlave(3), SetMode(Mode.STOP), SetMode(Mode.CLEAR)):
        bus.run(100 * MS)
        bus.send(order)
    bus.run(100 * MS)
    yield "orders", transcript(bus)


def controls() -> Iterator[Case]:
    """Orders of SYNC and FREEZE: refused, sent, failed."""
    slaves = (
        setup(3, groups=(1,), sync=True, freeze=True),
        setup(4, groups=(2,)),
        setup(5, groups=(1, 8), sync=True),
    )
    orders: list[dict[str, Any]] = [
        {bit: True, **more}
        for bit in ("sync", "unsync", "freeze", "unfreeze")
        for more in ({}, {"groups": (1,)}, {"groups": (2,)}, {"groups": (3,)}, {"groups": (9,)}, {"groups": (0,)})
    ]
    orders += [{"sync": True, "groups": (1,), "settle": True}, {"freeze": True, "groups": (8,), "picture": True}]
    orders += [{"unsync": True, "groups": (1,), "picture": True}, {"freeze": True, "groups": (2,), "picture": True}]
    cycles: tuple[dict[str, Any], ...] = ({}, {"cycle_sync": (1,)}, {"cycle_freeze": (8,)}, {"cycle_sync": (9,)})
    for cycle in cycles:
        for mode, some in (
            (Mode.STOP, orders[:1]),
            (Mode.CLEAR, orders[:: 2 if cycle else 1]),
            (Mode.OPERATE, orders[-4:]),
        ):
            try:
                bus = link(*slaves, **cycle)
            except DpError as error:
                yield f"{cycle}", str(error)
                break
            bus.period = MS
            bus.run(30 * MS)
            bus.send(SetMode(mode))
            bus.run(10 * MS)
            for number, given in enumerate(some):
                bus.events.clear()
                bus.requests.clear()
                try:
                    bus.send(SendControl(number, **given))
                except DpError as error:
                    yield f"{cycle} {mode.name} {given}", str(error)
                    continue
                bus.run(3 * MS)
                sent = [r.data.hex() for r in bus.requests if r.dsap == 58]
                held = [sorted(one.held) for one in (bus.master.controls.sync, bus.master.controls.freeze)]
                yield f"{cycle} {mode.name} {given}", f"{sent} {held} {[event.text for event in bus.events]}"


def _ended(outcome: Outcome, more: object = "") -> str:
    failure = outcome.failure and outcome.failure.name
    return f"{failure} {outcome.status} {outcome.codes} {outcome.data.hex()} {outcome.text} {more}"


def _polled(octets: str, data: bytes) -> bytes:
    """Acknowledges a request, and answers a poll."""
    return SC if data else answer(4, octets)


def ms1_outcomes() -> Iterator[Case]:
    """The outcome of a Read and a Write of a slave with these answers at SAP 51."""
    short = Dpv1(c1_response_timeout_ns=30 * MS)
    for code in (RS, RR, UE, NR, 0, 1):
        kit = Ms1Bus(dpv1=short)
        kit.slave.ms1 = _always(status(4, code))
        yield (
            f"status {code}",
            " | ".join(_ended(one.outcome, one.text) for one in (kit.read(), kit.write(1, 2, b"\1"))),
        )
    for octets in (
        "DE80B500", "DE80B007", "DE80C200", "DEFE0102", "DF80B200", "5E01020555", "5E01020901020304050607080900",
        "00010203", "5E", "", "5E010203AABBCC", "5F010201", "5F010202", "5C010203", "DC80B000", "58000112", "480100",
        "5E01020100", "5E01030100", "5101020100",
    ):  # fmt: skip
        kit = Ms1Bus(dpv1=short)
        kit.slave.ms1 = partial(_polled, octets)
        done = [kit.read(1, 2, 8), kit.write(1, 2, b"\1\2")]
        yield octets, " | ".join(_ended(one.outcome, f"{one.text} {one.stale} {one.t_ns // 1000}") for one in done)
    for name, ms1 in (("silent", _always(None)), ("acknowledged", _always(SC))):
        for dpv1 in (Dpv1(), short) if name == "silent" else (short,):
            kit = Ms1Bus(dpv1=dpv1)
            kit.slave.ms1 = ms1
            done = [kit.read(), kit.write(1, 2, b"\1\2")]
            yield (
                f"{name} {dpv1.c1_response_timeout_ns}",
                " | ".join(
                    _ended(one.outcome, f"{one.text} {one.stale} {one.t_ns // 1000} {len(kit.slave.asked)}")
                    for one in done
                ),
            )
    kit = Ms1Bus(dpv1=None)
    token = kit.next_token()
    for call in (kit.read, lambda: kit.read(address=9), lambda: kit.read(slot=255), lambda: kit.read(index=256)):
        yield f"refused {token}", _refusal(call)
    kit = Ms1Bus()
    kit.slave.ms1 = lambda data: SC
    token = kit.order_read()
    kit.run(20)
    kit.send(CancelService(token))
    yield "cancelled", _ended(kit.end(token).outcome)


def _refusal(call: Any) -> str:
    try:
        return _ended(call().outcome)
    except DpError as error:
        return f"{type(error).__name__}: {error}"


def ms2_outcomes() -> Iterator[Case]:
    """Initiate and services of a slave with these answers at the resource manager and the server SAP."""
    for sap in (49, 48):
        for name, octets in (
            ("RS", sd1(2, 4, RS)), ("RR", sd1(2, 4, RR)), ("NR", sd1(2, 4, NR)), ("SC", SC), ("silent", None),
            *(
                (pdu, sd2(2, 4, DL, sap, 50, bytes.fromhex(pdu)))
                for pdu in (
                    "56310064", "563000", "5630FFFF", "5800 16", "580019", "58", "4801", "D780C300", "D7", "DE80B000",
                    "5E01020201", "5E0102020102", "57F001000000000000020002000000", "5701010000000000000200020000 0000",
                )
            ),
        ):  # fmt: skip
            kit = Ms2Bus()
            kit.slave.says = {sap: _always(octets)}
            opened = kit.open(response_ns=50 * MS)
            text = f"{_ended(opened.outcome)} {opened.server_sap} {opened.send_timeout_ns} {opened.max_len}"
            yield f"{sap} {name}", f"{text} {kit.bus.now // 1000}"
    for name, served in (
        ("nothing", _always(None)), ("Abort", _always(bytes.fromhex("580013"))), ("Idle", _always(b"\x48\x01")),
        *(
            (octets, _always(bytes.fromhex(octets)))
            for octets in ("DE80B500", "5E010205", "5E01020100", "5F010201", "5101020100", "58", "00", "5E0109020102")
        ),
    ):  # fmt: skip
        for service in ("read",) if name.startswith("5E") else ("read", "write"):
            kit = Ms2Bus()
            kit.open(response_ns=50 * MS)
            kit.slave.serve = served
            done = getattr(kit, service)(1, 1, 2, *([] if service == "read" else [b"\1"]))
            yield f"{name} {service}", f"{_ended(done.outcome, done.text)} {done.stale} {done.t_ns // 1000}"


def class2_outcomes() -> Iterator[Case]:
    """Reading services and changes of address with these answers."""
    reads = (Service.DIAGNOSIS, Service.CONFIG, Service.INPUTS, Service.OUTPUTS)
    for service in reads:
        for name, octets in (
            ("silent", None), ("SC", SC), *((f"status {code}", sd1(2, 4, code)) for code in (0, RS, RR, UE, NR)),
            ("1 octet", sd2(2, 4, DL, 62, int(service), b"\1")), ("6", sd2(2, 4, DL, 62, int(service), DIAG_READY)),
            ("245", sd2(2, 4, DL, 62, int(service), bytes(244))),
        ):  # fmt: skip
            for expected in (None, 1) if service is Service.INPUTS else (None,):
                kit = Class2Bus()
                slave = OctetSlave(kit.bus, 4, master=1, inputs=b"\1", outputs=b"\2")
                slave.says[int(service)] = _always(octets)
                token = kit.next_token()
                kit.send(ReadService(token, 4, service, expected))
                yield f"{service.title} {name} {expected}", _ended(kit.end(token), kit.done[-1].text)
    for change in (
        ChangeAddress(1, 4, 9, 0x0CDA), ChangeAddress(1, 4, 9, 0x1111), ChangeAddress(1, 4, 4, 1),
        ChangeAddress(1, 4, 2, 1), ChangeAddress(1, 2, 4, 1), ChangeAddress(1, 127, 4, 1), ChangeAddress(1, 4, 126, 1),
        ChangeAddress(1, 126, 9, 1), ChangeAddress(1, -1, 9, 1), ChangeAddress(1, 4, -1, 1), ChangeAddress(1, 77, 9, 1),
    ):  # fmt: skip
        kit = Class2Bus()
        OctetSlave(kit.bus, 4)
        try:
            yield repr(change), _ended(kit.change(change))
        except DpError as error:
            yield repr(change), f"{type(error).__name__}: {error}"


def alarms() -> Iterator[Case]:
    """Alarms of a slave that repeats, replaces, refuses and loses them, by seed."""
    for seed in range(10):
        dice = random.Random(seed)
        kit = AlarmBus(dpv1=Dpv1(alarms=ALL, alarm_mode=(0, 0, 1, 3)[seed % 4]))
        slave = kit.alarm_slave
        slave.at_a_time, slave.keeps = (0, 0, 2, 40)[seed % 4], dice.random() < 0.4
        for _ in range(12):
            match dice.randrange(8):
                case 0 | 1 | 2:
                    kind = dice.choice((1, 2, 2, 3, 5, 32))
                    slave.raises(block(kind, dice.choice((1, 2)), dice.choice((0, 1)), 0, dice.choice(("", "AA"))))
                case 3:
                    slave.changes(block(0x81, 1, dice.choice((0, 1)), data=dice.choice(("", "55"))))
                case 4:
                    slave.lose(dice.choice(("a", "r", "aa", "rara")))
                case 5:
                    slave.refuses.append(dice.choice(("B5", "B0", "C2")))
                case 6:
                    kit.hold(dice.random() < 0.5)
                case _:
                    kit.acknowledge(dice.randrange(1, 5))
            kit.run(dice.choice((1, 5, 30)))
        kit.run(250)
        events = [event for kind in (AlarmRaised, AlarmDone, StatusTold) for event in kit.events_of(kind)]
        told = " | ".join(f"{event.t_ns // 1000} {event.text}" for event in events)
        acks = " ".join(ack.hex() for ack in slave.acks)
        yield f"seed {seed}", f"{told} || {acks} || {kit.counts} {slave.diagnosed} {kit.remarks}"


def services_cut_short() -> Iterator[Case]:
    """Services of MS2 that are cancelled before they are sent, and after."""
    for service_time in (0, 20):
        kit = Ms2Bus()
        kit.open()
        kit.slave.serve = _always(None)
        tokens = [kit.next_token(), kit.next_token()]
        for token in tokens:
            kit.send(RecordOrder(token, Function.READ, 1, 2, connection=1))
        kit.run(service_time)
        for token in reversed(tokens):
            kit.send(CancelService(token))
        kit.run(50)
        ends = [f"{one.token} {one.stale} {_ended(one.outcome, one.text)}" for one in kit.events_of(RecordDone)]
        yield f"after {service_time} ms", " | ".join(ends)
