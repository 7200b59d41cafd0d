"""Random answers of slaves in random order: every service over a class 2 connection has exactly one end, every
connection that was open, too, and none is kept.
"""

from __future__ import annotations

from collections import Counter

from bus_kit import SimBus, setup
from hypothesis import given, note
from hypothesis import strategies as st
from ms2_kit import DL, MS, SC, Ms2Bus, connections_of, sd1, sd2
from octet_slave import NR, RR, RS, UE
from property_kit import examples
from support import present, wire_log

from dpstack.dp.acyclic.job import CancelService, ServiceFailure
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.alarm_orders import CloseConnection, CloseConnections, ConnectionOver
from dpstack.dpv1.master.orders import InitiateDone, OpenConnection, RecordDone, RecordOrder
from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.pdu.read_write import Function
from dpstack.dpv1.slave.resource_manager import ms2_of
from dpstack.errors import UsageError
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.machine import LineDown, LineUp
from dpstack.params import BusParams
from dpstack.sim.transmission import Transmission
from dpstack.sim.world import World
from tests.dpv1.master.fault_steps import fault_step
from tests.dpv1.master.patient_kit import CONNECTIONS, Patient

LIMIT = 60 * MS


def pdu(text: str, fc: int = DL) -> bytes:
    """From the SAP that is asked: 99 stands for it."""
    return sd2(2, 4, fc, 50, 99, bytes.fromhex(text))


#: telegrams, or parts of one: lengths that lie, functions that do not exist, answers to others, ends of all kinds
_ODD = st.sampled_from(
    [
        None,
        None,
        SC,
        *(sd1(2, 4, code) for code in (0x00, NR, RR, UE, RS, 0x0C, 0x07)),
        *(
            pdu(text)
            for text in (
                "5E 01 02 02 01 02",
                "5E 01 03 01 55",
                "5F 01 02 02",
                "51 01 02 00",
                "5E 01 02 F0 55",
                "DE 80 B5 00",
                "DF 80 C2 00",
                "D1 80 B5 00",
                "D7 80 C3 00",
                "57 00",
                "57 F0 01 00 00 00 00 00 00 02 00 02 00 00 00 00",
                "56 2F 00 0A",
                "56 30 00 0A",
                "56 63 00 0A",
                "48 01",
                "48",
                "58 00 13",
                "58",
                "00",
                "5E 01 02 F1" + " 55" * 240,
            )
        ),
        pdu("5E 01 02 01 66", 0x0C),
        pdu("48 01", 0x0A),
        b"\x68\x00\xff",
    ]
)
_ORDERS = st.sampled_from("ooorrrwtxcmud.....l")


@examples(60)
@given(st.lists(_ODD, max_size=40), st.lists(_ORDERS, max_size=20), st.integers(0, 8))
def test_slaves_that_answer_anything(answers: list[bytes | None], steps: list[str], good: int) -> None:
    kit = Ms2Bus((4, 5))
    queue = list(answers)
    slave = kit.slaves[4]

    def says(octets: bytes) -> bytes | None:
        """``good`` requests as they should be, then anything, then as they should be."""
        if len(slave.requests) <= good or not queue:
            return slave.usual(octets)
        answer = queue.pop(0)
        if answer is None or len(answer) < 9:
            return answer
        sap = octets[7]
        return answer[:8] + bytes((sap,)) + answer[9:-2] + bytes(((answer[-2] + sap - 99) & 0xFF, 0x16))

    slave.says = dict.fromkeys(range(50), says)
    opened: list[int] = []
    ordered: Counter[int] = Counter()

    def order(command: object, token: int) -> None:
        try:
            kit.send(command)
        except UsageError:  # the connection is over, or 32 wait
            return
        ordered[token] += 1

    for step in steps:
        token = kit.next_token()
        ref = opened[token % len(opened)] if opened else 0
        match step:
            case "o":
                opened.append(token)
                order(OpenConnection(token, 4, InitiateReq(200 * MS), LIMIT, timeout_ns=1_000 * MS), token)
            case "r":
                order(RecordOrder(token, Function.READ, 1, 2, 8, connection=ref, timeout_ns=1_000 * MS), token)
            case "w":
                order(
                    RecordOrder(token, Function.WRITE, 1, 2, data=b"\1\2", connection=ref, timeout_ns=1_000 * MS), token
                )
            case "t":
                order(
                    RecordOrder(token, Function.DATA_TRANSPORT, 1, 2, data=b"\1", connection=ref, timeout_ns=100 * MS),
                    token,
                )
            case "x":
                kit.send(CloseConnection(ref))
            case "c":
                kit.send(CancelService(token - 1))
            case "m" | "u":
                slave.mute = step == "m"
            case "d":
                kit.send(LineDown("out"))
                kit.run(3)
                kit.send(LineUp())
            case "l":
                kit.send(GoOffline())
                kit.run(5)
                kit.send(GoOnline())
            case _:
                kit.run(7)
    for ref in opened:
        kit.send(CloseConnection(ref))
    end = kit.bus.now + 1_500 * MS
    while (kit.acyclic.waiting or connections_of(kit.acyclic)) and kit.bus.now < end:
        kit.run(10)
    note("\n".join(kit.bus.octets()[-60:]))
    assert kit.acyclic.waiting == connections_of(kit.acyclic) == 0
    done = [event for event in kit.bus.events if isinstance(event, (InitiateDone, RecordDone))]
    assert Counter(event.token for event in done) == ordered
    were_open = [e.token for e in done if isinstance(e, InitiateDone) and e.outcome.failure is None]
    assert Counter(event.connection for event in kit.events_of(ConnectionOver)) == Counter(were_open)
    for event in done:
        outcome = event.outcome
        assert (outcome.failure is None) or "slave 4" in outcome.text
        if isinstance(event, RecordDone) and outcome.failure is None and event.function is Function.READ:
            assert outcome.data in (b"\1\2", b"\x66")
        if outcome.failure is ServiceFailure.NEGATIVE:
            assert outcome.codes is not None
    # the other slave noticed nothing, and the bus goes on
    slave.mute = False
    token = kit.open(5).token
    assert kit.read(token).outcome.data == b"\1\2"


# --- MS1 and MS2 together --------------------------------------------------------------------------------------------
# Master and slaves of ours in a world with loss, damage and services that overtake each other: every Initiate, Read,
# Write and Data_Transport has exactly one end, no answer is taken for another one's, and no connection is left at
# either end.


MS = 1_000_000
S = 1_000 * MS  #: function and data of the services over MS1 and class 2 connections
FUNCTIONS = {
    "read": (Function.READ, b""),
    "write": (Function.WRITE, b"\1"),
    "carry": (Function.DATA_TRANSPORT, b"\1\2"),
}


class Both(SimBus):
    """Station 2, slaves 3 and 4 in data exchange; services by token."""

    def __init__(self, seed: int) -> None:
        devices = {address: Patient() for address in (3, 4)}
        dpv1 = Dpv1(c1_response_timeout_ns=LIMIT)
        params = BusParams.preset(187_500, address=2, gap=0)
        super().__init__(World(seed=seed), params, [setup(address, dpv1) for address in devices], devices=devices)
        self.world.run_for(200 * MS)
        self.tokens = 0
        #: service, slot and index of the orders that were accepted, by token
        self.accepted: dict[int, tuple[str, int, int]] = {}
        self.opened: list[int] = []

    def order(self, what: str, number: int, slot: int, index: int) -> None:
        """Order a service; an impossible one is refused at once and has no end."""
        self.tokens += 1
        token = self.tokens
        connection = self.opened[number % len(self.opened)] if self.opened else 0
        address = 3 + number % 2
        if what == "open":
            order: object = OpenConnection(token, address, InitiateReq(S), LIMIT, timeout_ns=S)
        else:
            function, data = FUNCTIONS[what.split()[0]]
            way = {"connection": connection} if what.endswith("over") else {"address": address}
            order = RecordOrder(token, function, slot, index, 3, data, timeout_ns=S, **way)
        try:
            self.send(order)
        except UsageError:
            assert what.endswith("over")
            return
        self.accepted[token] = (what, slot, index)
        if what == "open":
            self.opened.append(token)

    def done(self) -> list[RecordDone | InitiateDone]:
        return [one for one in self.events if isinstance(one, RecordDone | InitiateDone)]


SERVICES = ("open", "open", "read", "write", "read over", "read over", "write over", "carry over")
_orders = st.tuples(st.sampled_from(SERVICES), st.integers(0, 3), st.integers(0, 2), st.sampled_from((0, 1, 5, 98, 99)))
_runs = st.tuples(st.just("run"), st.integers(1, 200), st.just(0), st.just(0))
_faults = st.tuples(
    st.sampled_from(("lose", "damage", "lose all", "noise", "quiet", "cancel", "close", "line", "restart", "off")),
    st.integers(1, 4),
    st.just(0),
    st.just(0),
)


def _acyclic(sent: Transmission) -> bool:
    """A telegram of MS1 or MS2."""
    return sent.octets[0] == 0x68 and len(sent.octets) > 9 and {50, 51} & set(sent.octets[7:9]) != set()


@examples(16)
@given(st.lists(st.one_of(_orders, _orders, _runs, _faults), min_size=8, max_size=30), st.integers(0, 10_000))
def test_every_service_ends_once_with_lost_telegrams(steps: list[tuple[str, int, int, int]], seed: int) -> None:
    both = Both(seed)
    world = both.world
    both.order("open", 0, 0, 0)
    both.order("open", 1, 0, 0)
    world.run_for(50 * MS)
    for what, number, slot, index in steps:
        match what:
            case "run":
                world.run_for(number * MS // 4)
            case "cancel":
                both.send(CancelService(both.tokens))
            case "close":
                if both.opened:
                    both.send(CloseConnection(both.opened[number % len(both.opened)]))
            case "restart":
                both.apps[number % 2].restart(world.now)
            case _ if what in SERVICES:
                both.order(what, number, slot, index)
            case _:
                fault_step(world, both.station, what, number, _acyclic)
    world.faults.noise(0)
    end = world.now + 1_100 * MS
    while both.acyclic.waiting and world.now < end:
        world.run_for(10 * MS)
    both.send(CloseConnections())
    world.run_for(300 * MS)
    note(wire_log(world, 80))
    # one end each
    done = both.done()
    assert Counter(one.token for one in done) == Counter(list(both.accepted))
    assert both.acyclic.waiting == connections_of(both.acyclic) == 0
    opened = [one.token for one in done if isinstance(one, InitiateDone) and one.outcome.failure is None]
    over = Counter(one.connection for one in both.events if isinstance(one, ConnectionOver))
    assert over == Counter(opened)
    # no answer for two services, or for one that it does not belong to
    serials: dict[int, list[int]] = {address: [] for address in both.devices}
    for one in done:
        if isinstance(one, InitiateDone):
            continue
        what, slot, index = both.accepted[one.token]
        assert (one.slot, one.index) == (slot, index)
        if one.outcome.failure is ServiceFailure.NEGATIVE:
            assert index == 98
            serials[one.address].append(present(one.outcome.codes)[2])
        elif one.outcome.failure is None:
            assert index not in (98, 99)
            if "write" not in what:
                assert one.outcome.data[1:] == bytes((slot, index))
                serials[one.address].append(one.outcome.data[0])
    for found in serials.values():
        assert len(found) == len(set(found))
    # the cycle goes on, and no slave keeps anything once all is silent
    end = world.now + 3 * S  # one that was restarted is taken up again
    while not both.exchanging and world.now < end:
        world.run_for(50 * MS)
    assert both.exchanging
    both.send(GoOffline())
    world.run_for(30 * S)
    assert [ms2_of(app).free for app in both.apps] == [CONNECTIONS] * 2
    assert [ms2_of(app).connections for app in both.apps] == [(), ()]
    assert all(app.stats.connections == app.stats.closed for app in both.apps)
