"""Store and forward under cuts, SIGKILL, restarts of the computer and clocks that are set: every number of a counter
arrives, with its time, or is counted as lost. The file is a real one; the host knows only the specification."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Final, NamedTuple

from history_rig import MEMORY, HistoryRig
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples


class Traffic(NamedTuple):
    """The plant counts, and values go out: each time some messages are sent, of which some arrive; then perhaps a round
    trip, during which the plant goes on. ``disk``: the thread works before."""

    counts: int
    sent: int
    delivered: int
    confirmed: str
    ends: bool
    disk: bool


#: most of the course: the connection works, or breaks among messages
TRAFFIC: Final = st.builds(
    Traffic,
    counts=st.integers(1, 3),
    sent=st.sampled_from([10_000, 1, 2]),
    delivered=st.sampled_from([10_000, 0, 1, 2]),
    confirmed=st.sampled_from(["yes", "no", "lost"]),
    ends=st.sampled_from([False, False, True]),
    disk=st.booleans(),
)
EVENTS: Final = ("kill", "reboot", "reboot late", "end", "back", "on", "far on", "lost", "there", "rebirth")
#: the connection is tried and the disk is looked at between
STEPS: Final = st.lists(
    st.one_of(TRAFFIC, TRAFFIC, TRAFFIC, st.just("disk"), st.sampled_from(EVENTS)), min_size=10, max_size=30
)


def traffic(rig: HistoryRig, step: Traffic) -> None:
    if rig.connection is None:
        rig.connect()
        rig.pump()
    if step.disk:
        rig.step_disk()
    for _ in range(step.counts):
        rig.count()
    rig.pump(step.sent)
    rig.deliver(step.delivered)
    if step.confirmed != "no" and rig.connection is not None:
        number = rig.begin_round()
        rig.count()
        rig.pump(step.sent)
        if step.confirmed == "yes":
            rig.end_round(number)
    if step.ends:
        rig.cut()
        rig.publish_wills()
        rig.count()


def event(rig: HistoryRig, what: str) -> None:
    match what:
        case "kill":
            rig.publish_wills()
            rig.kill()
        case "reboot" | "reboot late":
            rig.publish_wills()
            rig.reboot(off_s=1.0 if what == "reboot" else 5000.0, wall=None)
        case "end":
            rig.node.end("the run has ended")
            rig.pump()
        case "back" | "on" | "far on":
            rig.offset += {"back": -3600.0, "on": 7.0, "far on": 1e6}[what]
            rig.wait(0.1)
            rig.step_disk()  # an end of the computer within this second would date what is there by the old clock
        case "lost" | "there":
            rig.values["8"]["state"] = "offline" if what == "lost" else "data_exchange"
            rig.wait(0.1)
        case "rebirth" if rig.connection is not None:
            rig.rebirth()
            rig.wait(1.0)


def course(steps: list[Traffic | str], *, memory: int) -> HistoryRig:
    """Carry out ``steps``; all is delivered at the end."""
    with tempfile.TemporaryDirectory(prefix="dpsph", dir=MEMORY) as folder:
        rig = HistoryRig(Path(folder) / "state", memory=memory)
        try:
            rig.give_plant()
            for step in steps:
                if isinstance(step, Traffic):
                    traffic(rig, step)
                elif step == "disk":
                    rig.step_disk()
                else:
                    event(rig, step)
            rig.settle()
            rig.check_numbers()
            assert rig.file is not None
            assert rig.file.count == 0
            return rig
        finally:
            rig.close()


@examples(15, soak=1000)
@given(STEPS)
def test_every_number_arrives_or_was_in_the_memory_of_a_process_that_was_killed(steps: list[Traffic | str]) -> None:
    rig = course(steps, memory=20_000)
    assert rig.history is not None
    assert rig.dropped + rig.history.dropped == 0


@examples(5, soak=300)
@given(STEPS)
def test_numbers_for_which_memory_has_no_room_are_counted(steps: list[Traffic | str]) -> None:
    course(steps, memory=12)
