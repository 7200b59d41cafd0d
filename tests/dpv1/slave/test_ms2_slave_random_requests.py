"""Random requests of class 2 masters: nothing raises, no connection is lost, each request is answered once, and only to
its master."""

from __future__ import annotations

from collections import Counter

from hypothesis import given, note
from hypothesis import strategies as st
from octet_class2 import ABORT, IDLE, INITIATE, OPENED, RS, SC, Class2
from octet_wire import MS, Wire
from property_kit import examples
from slave_kit import Recorder, make_slave

from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.pdu.read_write import DataTransport
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.resource_manager import ConnectionClosed, ConnectionOpened, ms2_of
from dpstack.params import BusParams

COUNT = 3
#: the server SAP that the master was given last
OWN = -1
S = 1_000 * MS


class Serial:
    """Records whose answers begin with a number of their own; ``later``: given out when somebody says so."""

    def __init__(self) -> None:
        self.asked: list[RecordRequest] = []
        self.dropped: Counter[int] = Counter()

    def ask(self, request: RecordRequest) -> None:
        number = len(self.asked)
        self.asked.append(request)
        request.abandoned = lambda: self.dropped.update([number])
        if not isinstance(request.service, DataTransport) and request.service.index == 0:
            raise ZeroDivisionError("a record that is broken")
        if request.service.index == 1:
            self.answer(number)

    def answer(self, number: int) -> None:
        request = self.asked[number]
        request.answer(bytes((number & 0xFF, request.asker.master)))


_PDUS = st.one_of(
    st.sampled_from(
        [
            "",
            "",
            "",
            INITIATE,
            INITIATE[:-3],
            "5E 00 01 F0",
            "5E 00 02 F0",
            "5E 00 00 F0",
            "5F 00 02 01 55",
            "51 00 01 01 55",
            "51 00 02 01 55",
            "5E 00 01 FF",
            "5F 00 01 05 55",
            "51 FF 01 00",
            IDLE,
            ABORT,
            "58",
            "56 30 00 C8",
            "5C 00 01 00",
            "D7 80 00 00",
        ]
    ),
    st.binary(max_size=24).map(lambda octets: octets.hex(" ")),
)
_STEPS = st.one_of(
    st.tuples(st.just("say"), st.integers(0, 2), st.sampled_from((OWN, OWN, OWN, OWN, 49, 48, 47, 45)), _PDUS),
    st.tuples(st.just("say"), st.integers(0, 2), st.just(OWN), st.sampled_from(("", "", "5E 00 01 F0", "51 00 02 00"))),
    st.tuples(st.sampled_from(("connect", "read")), st.integers(0, 2), st.just(0), st.just("")),
    st.tuples(st.just("answer"), st.integers(0, 8), st.just(0), st.just("")),
    st.tuples(st.sampled_from(("wait", "restart", "rate lost")), st.integers(0, 5), st.just(0), st.just("")),
)


@examples(150)
@given(st.lists(_STEPS, max_size=40), st.booleans())
def test_any_sequence_from_three_masters(steps: list[tuple[str, int, int, str]], at_once: bool) -> None:
    device, serial = Recorder(), Serial()
    device.records = serial
    device.transport = serial.ask
    device.ms2, device.ms2_at_once = COUNT, at_once
    station = make_slave(8, device, BusParams.preset(500_000))
    app = station.responder
    assert isinstance(app, SlaveApp)
    wire = Wire(station)
    masters = [Class2(wire, sa) for sa in (1, 3, 5)]
    got: list[tuple[int, str]] = []
    own: dict[int, int] = {}
    for what, number, sap, data in steps:
        match what:
            case "say":
                master = masters[number]
                got.append((master.sa, master.ask(own.get(master.sa, 48) if sap == OWN else sap, data)))
            case "read":
                master = masters[number]
                sap = own.get(master.sa, 48)
                got.extend((master.sa, master.ask(sap, data)) for data in ("5E 00 01 F0", "", "", ""))
            case "connect":
                master = masters[number]
                if master.ask(49, INITIATE) != RS:
                    own[master.sa] = master.manager()
                    assert master.ask(own[master.sa]) == OPENED
            case "answer":
                if number < len(serial.asked):
                    serial.answer(number)
            case "wait":
                wire.pass_time((0, 1, 1, 2, 3, 9)[number] * S)
            case "restart":
                app.restart(wire.now)
            case "rate lost":
                app.rate_lost(wire.now)
        assert 0 <= len(ms2_of(app).connections) <= COUNT
        assert ms2_of(app).free == COUNT - len(ms2_of(app).connections)
    note(str(got))
    # each answer once, and to who asked for it
    answers = Counter(octets[12:] for _, octets in got if octets[:2] in ("5E", "51") and octets[9:11] == "02")
    assert all(count == 1 for count in answers.values())
    for sa, octets in got:
        if octets[:2] in ("5E", "51") and octets[9:11] == "02":
            assert octets[15:17] == f"{sa:02X}"
    # everything comes back: nobody says anything any more
    wire.pass_time(3_000 * S)
    wire.pass_time(3_000 * S)
    assert ms2_of(app).connections == ()
    assert app.wake_at() > wire.now + 3_000 * S
    events = station.take_events()
    opened = Counter(event.sap for event in events if isinstance(event, ConnectionOpened))
    assert opened == Counter(event.sap for event in events if isinstance(event, ConnectionClosed))
    assert app.stats.connections == app.stats.closed == opened.total()
    # who worked at something that nobody wants any more was told, once
    assert all(count == 1 for count in serial.dropped.values())
    for number, request in enumerate(serial.asked):
        assert not request.asker.open
        assert (request.response is None) is (number in serial.dropped)
    for master in masters:
        sap = master.connect() if not at_once else int(master.ask(49, INITIATE)[3:5], 16)
        assert master.ask(sap, ABORT) in (SC, "")
        assert len(ms2_of(app).connections) == 0
