"""Random telegrams are lost on the wire: every alarm is delivered once, in order, and acknowledged."""

from __future__ import annotations

from alarm_kit import ALL, AlarmBus, block, refusing
from hypothesis import given, note
from hypothesis import strategies as st
from property_kit import examples

from dpstack.dp.pdu.dpv1_status import Dpv1

_KINDS = st.sampled_from([1, 2, 3, 4, 5, 6, 32, 126])
#: few slots and data, so that equal ones follow each other often
_ALARMS = st.lists(
    st.tuples(_KINDS, st.integers(0, 1), st.integers(0, 3), st.sampled_from(["", "00"])), min_size=3, max_size=8
)
_LOSSES = st.lists(st.sampled_from(["", "", "", "r", "a"]), min_size=20, max_size=60)
_MODES = st.sampled_from([(0, 0), (1, 2), (3, 8), (7, 32)])


@examples(25)
@given(
    _MODES, _ALARMS, _LOSSES, st.integers(-1, 5), st.booleans(), st.booleans(), st.lists(st.integers(0, 9), max_size=8)
)
def test_alarms_with_lost_telegrams(
    mode: tuple[int, int],
    alarms: list[tuple[int, int, int, str]],
    losses: list[str],
    polls: int,
    refuses: bool,
    offers_again: bool,
    pauses: list[int],
) -> None:
    number, limit = mode
    kit = AlarmBus(dpv1=Dpv1(alarms=ALL, alarm_mode=number, c1_response_timeout_ns=20_000_000))
    slave = kit.alarm_slave
    slave.at_a_time, slave.polls = limit, polls
    slave.offers_again = offers_again
    if refuses:
        slave.on_stray = refusing("B0")
    slave.lose(losses)
    blocks = [
        block(kind, slot, specifier, at % 32 if limit else 0, data)
        for at, (kind, slot, specifier, data) in enumerate(alarms)
    ]
    waits = list(pauses)
    for entry in blocks:
        slave.raises(entry)
        kit.run(waits.pop(0) if waits else 0)
    note(f"{[entry.hex(' ') for entry in blocks]}")
    kit.until(lambda: len(kit.ends) == len(blocks))
    kit.run(150)  # longer than anything could come of what stands in the diagnosis
    assert kit.blocks == blocks
    assert sorted(slave.taken) == sorted(blocks)
    assert not slave.open
    assert sorted(end.number for end in kit.ends if end.outcome.failure is None) == [*range(1, len(blocks) + 1)]
