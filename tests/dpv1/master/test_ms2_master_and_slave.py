"""MS1 and MS2 together, master and slaves of ours in a world with loss, damage and services that overtake each other.

Every Initiate, Read, Write and Data_Transport has exactly one end, no answer is taken for another one's, and no
connection is left at either end.
"""

from __future__ import annotations

from collections import Counter

from bus_kit import SimBus, setup
from hypothesis import given, note
from hypothesis import strategies as st
from ms2_kit import connections_of
from property_kit import examples
from support import present, wire_log

from dpstack.dp.acyclic.job import ServiceFailure
from dpstack.dp.acyclic.queue import CancelService
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.orders import (
    CloseConnection,
    CloseConnections,
    ConnectionOver,
    InitiateDone,
    OpenConnection,
    RecordDone,
    RecordOrder,
)
from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.pdu.read_write import Function
from dpstack.dpv1.slave.resource_manager import ms2_of
from dpstack.errors import UsageError
from dpstack.fdl.commands import GoOffline
from dpstack.params import BusParams
from dpstack.sim.transmission import Transmission
from dpstack.sim.world import World
from tests.dpv1.master.fault_steps import fault_step
from tests.dpv1.master.patient_kit import CONNECTIONS, Patient

MS = 1_000_000
S = 1_000 * MS
LIMIT = 60 * MS
#: function and data of the services over MS1 and class 2 connections
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
