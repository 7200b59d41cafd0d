"""Random sequences of orders and faults on the wire: every service that was taken has exactly one end.

Losses, damaged telegrams, late answers, wrong answers, refusals, tokens lost, the port gone and back, cancellations.
"""

from __future__ import annotations

from class2_kit import MS, Class2Bus
from hypothesis import given
from hypothesis import strategies as st
from octet_slave import RR, RS, SC, OctetSlave, Say, sd1, sd2
from property_kit import examples

from dpstack.dp.acyclic.class2 import ChangeAddress, ReadService, Service
from dpstack.dp.acyclic.job import CancelService, ServiceFailure
from dpstack.errors import UsageError
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.machine import LineDown, LineUp

_READS = (Service.DIAGNOSIS, Service.CONFIG, Service.INPUTS, Service.OUTPUTS)
#: what each service has to give when it gives anything
_TRUE = {Service.CONFIG: b"\x21", Service.INPUTS: b"\xaa\xbb", Service.OUTPUTS: b"\xcc"}
_ODD: dict[str, Say] = {
    "silence": lambda octets: None,
    "refusal": lambda octets: sd1(2, octets[4] & 0x7F, RS),
    "busy": lambda octets: sd1(2, octets[4] & 0x7F, RR),
    "SC": lambda octets: SC,
    "other SAPs": lambda octets: sd2(2, octets[4] & 0x7F, 0x08, 62, 51, b"\x99"),
    "other station": lambda octets: sd2(2, 99, 0x08, 62, octets[7], b"\x99"),
    "rubbish": lambda octets: b"\x68\x00\xff",
}

_reads = st.tuples(st.just("read"), st.sampled_from((4, 126, 77)), st.sampled_from(_READS))
_changes = st.tuples(st.just("change"), st.sampled_from((126, 4, 77)), st.sampled_from((4, 5, 6)))
_runs = st.tuples(st.just("run"), st.integers(1, 200), st.none())
_faults = st.tuples(st.just("odd"), st.sampled_from(sorted(_ODD)), st.sampled_from((*_READS, Service.SET_ADDRESS)))
_delays = st.tuples(st.just("delay"), st.sampled_from((11, 190, 230, 600)), st.none())
_losses = st.tuples(st.just("loss"), st.integers(0, 3), st.none())
_others = st.tuples(st.sampled_from(("down", "up", "offline", "online", "cancel", "well")), st.none(), st.none())


@examples(120)
@given(
    st.lists(st.one_of(_reads, _reads, _changes, _runs, _runs, _faults, _delays, _losses, _others), max_size=20),
    st.sampled_from(("whole", "octets", "chunk")),
)
def test_every_service_has_exactly_one_end(steps: list[tuple[str, object, object]], mode: str) -> None:
    kit = Class2Bus(mode=mode)
    owned = OctetSlave(kit.bus, 4, master=1, inputs=_TRUE[Service.INPUTS], outputs=_TRUE[Service.OUTPUTS])
    free = OctetSlave(kit.bus, 126)
    taken = 0
    lost = [0]
    kit.bus.drop = lambda sent: lost[0] > 0 and sent.octets[0] != 0xDC and not lost.__setitem__(0, lost[0] - 1)
    for what, first, second in steps:
        match what, first, second:
            case "read", int(address), Service() as service:
                command: ReadService | ChangeAddress = ReadService(taken, address, service, timeout_ns=400 * MS)
            case "change", int(old), int(new):
                command = ChangeAddress(taken, old, new, timeout_ns=1_500 * MS)
            case "cancel", _, _:
                kit.send(CancelService(taken // 2))
                continue
            case "run", int(times), _:
                kit.bus.run(times * MS // 4)
                continue
            case "odd", str(kind), Service() as service:
                owned.says[service] = free.says[service] = _ODD[kind]
                continue
            case "delay", int(bits), _:
                owned.delay = free.delay = bits
                continue
            case "loss", int(count), _:
                lost[0] = count
                continue
            case "well", _, _:
                owned.says.clear()
                free.says.clear()
                continue
            case _:
                orders = {"down": LineDown("out"), "up": LineUp(), "offline": GoOffline(), "online": GoOnline()}
                kit.send(orders[what])
                continue
        try:
            kit.send(command)
        except UsageError:
            assert isinstance(command, ChangeAddress)
            assert command.old == command.new
        else:
            taken += 1
    end = kit.bus.now + 1_600 * MS
    while kit.acyclic.waiting and kit.bus.now < end:
        kit.bus.run(10 * MS)
    assert sorted(done.token for done in kit.done) == list(range(taken))
    assert kit.acyclic.waiting == 0
    for done in kit.done:
        outcome = done.outcome
        assert (outcome.failure is None) or ("; " in outcome.text or "was cancelled" in outcome.text), outcome.text
        if outcome.failure is None and done.address == 4 and done.service in _TRUE:
            # what begins with SC or an empty answer may be "no data": else only the truth counts
            assert outcome.data in (_TRUE[done.service], b"")
        assert outcome.failure is None or isinstance(outcome.failure, ServiceFailure)
