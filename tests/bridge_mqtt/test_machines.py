"""Births, deaths and sequence numbers stay right, and history is whole, under cuts, SIGKILL, restarts of broker and
computer, jumps of the clock and whatever a host sends."""

from __future__ import annotations

import itertools
import tempfile
from pathlib import Path
from typing import Final, NamedTuple

from edge_node_rig import Rig
from history_rig import MEMORY, HistoryRig
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from plant_items import PLANT
from property_kit import examples

from dpstack.bridge.mqtt.plant_node import Phase


class EdgeNodeMachine(RuleBasedStateMachine):
    """An edge node without a primary host."""

    PRIMARY_HOST = ""

    def __init__(self) -> None:
        super().__init__()
        self._folder = tempfile.TemporaryDirectory(prefix="dpspb")
        pauses = itertools.cycle((0.0, 1.9, 0.1))
        folder = Path(self._folder.name) / "state"
        self.rig = Rig(folder, primary_host=self.PRIMARY_HOST, pause=lambda: next(pauses))
        self.rig.give_plant()
        self.rig.connect()
        self.host_time = 1000

    def teardown(self) -> None:
        self.rig.settle()
        if self.PRIMARY_HOST:
            self._say_online(10_000_000)
            self.rig.settle()
        self.rig.check()
        self.rig.close()
        self._folder.cleanup()

    def _say_online(self, time: int) -> None:
        self.host_time = time
        self.rig.state(online=True, time_ms=time)

    # --- the network ----------------------------------------------------------------------------------------------

    @rule()
    def cut(self) -> None:
        self.rig.cut()

    @rule(sent=st.integers(0, 3))
    def cut_among_messages(self, sent: int) -> None:
        self.rig.pump(sent)
        self.rig.cut()

    @rule()
    def broker_finds_out(self) -> None:
        if self.rig.connection is None:
            self.rig.publish_wills()

    @precondition(lambda self: self.rig.connection is None)
    @rule(late=st.booleans())
    def connect(self, late: bool) -> None:
        """``late``: a host gets the will of the last session after the births of this one (6.4.20)."""
        rig = self.rig
        wills = list(rig.wills)
        if late:
            rig.wills.clear()
        rig.connect()
        if late:
            rig.pump()
            for will in wills:
                assert rig.number_of(will) != rig.host.number or not rig.host.online
                rig.host.feed(will.topic, will.payload, qos=1)

    @rule()
    def kill_gateway(self) -> None:
        self.rig.kill()

    @rule()
    def kill_broker(self) -> None:
        self.rig.broker_dies()

    @rule()
    def ordered_end(self) -> None:
        rig = self.rig
        was_online = rig.host.online and rig.node.phase is Phase.ONLINE
        rig.node.end("the test wants it")
        rig.pump()
        if was_online:
            assert rig.connection is None
            assert not rig.host.online

    # --- time -----------------------------------------------------------------------------------------------------

    @rule(seconds=st.sampled_from([0.0, 0.1, 1.0, 3.0]), stream=st.booleans())
    def wait(self, seconds: float, stream: bool) -> None:
        self.rig.wait(seconds, stream=stream)

    @rule(seconds=st.sampled_from([-3600.0, -5.0, 0.5, 7.0, 1e6]))
    def clock_jumps(self, seconds: float) -> None:
        self.rig.offset += seconds

    @rule(most=st.sampled_from([1, 2, 10_000]))
    def send(self, most: int) -> None:
        self.rig.pump(most)

    # --- the plant ------------------------------------------------------------------------------------------------

    @rule(address=st.sampled_from(["3", "8"]), state=st.sampled_from(["offline", "data_exchange"]))
    def slave(self, address: str, state: str) -> None:
        self.rig.values[address]["state"] = state
        self.rig.give_values()

    @rule(level=st.sampled_from([1.0, 2.0, -40.0, None]), lamp=st.booleans(), age=st.sampled_from([1.0, 500.0]))
    def inputs(self, level: float | None, lamp: bool, age: float) -> None:
        self.rig.values["8"]["fields"] |= {"level": level, "lamp": lamp}
        self.rig.values["8"]["inputs_age_ms"] = age
        self.rig.give_values()

    @rule(name=st.sampled_from(["valves", "valves 2"]), there=st.booleans())
    def configure(self, name: str, there: bool) -> None:
        """Another name, or one slave less."""
        rig = self.rig
        if there:
            rig.plant["slaves"]["8"] = PLANT["slaves"]["8"] | {"name": name}
        else:
            rig.plant["slaves"].pop("8", None)
        rig.give_plant()

    @rule()
    def another_run(self) -> None:
        self.rig.plant["started"] += 500.0
        self.rig.stream = 0.0
        self.rig.give_plant()

    @rule()
    def bus_ends(self) -> None:
        self.rig.take(self.rig.tree.apply({"end": {"text": "stopped"}}, self.rig.clock))

    # --- the host -------------------------------------------------------------------------------------------------

    @rule()
    def rebirth(self) -> None:
        self.rig.rebirth()

    @invariant()
    def the_host_and_the_edge_node_agree(self) -> None:
        rig = self.rig
        if rig.connection is None:
            assert rig.node.phase is Phase.OFFLINE
        if not rig.host.online:
            assert not rig.host.alive


class EdgeNodeWithPrimaryHostMachine(EdgeNodeMachine):
    """Births wait for a primary host."""

    PRIMARY_HOST = "scada"

    @rule(online=st.booleans(), back=st.sampled_from([0, 0, 0, 500]), retained=st.booleans())
    def host_says(self, online: bool, back: int, retained: bool) -> None:
        """``back``: a message that is older than the last one."""
        rig = self.rig
        if rig.connection is None:
            return
        self.host_time += 100
        before = self.phase()
        rig.state(online=online, time_ms=self.host_time - back, retained=retained)
        if back:
            assert before is not Phase.ONLINE or self.phase() is Phase.ONLINE
        elif online:
            assert before is not Phase.WAITING or self.phase() is Phase.ONLINE
        elif before is Phase.ONLINE:
            rig.pump()
            assert not self.connected()
            assert not rig.host.online

    def connected(self) -> bool:
        return self.rig.connection is not None

    def phase(self) -> Phase:
        return self.rig.node.phase

    @rule(host=st.sampled_from(["scada2", "Scada", "scada/x"]))
    def another_host_says(self, host: str) -> None:
        phase = self.rig.node.phase
        self.rig.state(online=phase is Phase.WAITING, time_ms=10**9, host=host)
        assert self.rig.node.phase is phase

    @rule(payload=st.sampled_from([b"", b"ONLINE", b"{}", b"[]", b'{"online": 1, "timestamp": 1}', b"\xff" * 2000]))
    def host_says_nonsense(self, payload: bytes) -> None:
        phase = self.rig.node.phase
        if self.rig.connection is not None:
            self.rig.receive("spBv1.0/STATE/scada", payload)
            assert self.rig.node.phase is phase


EdgeNodeMachine.TestCase.settings = settings(examples(20, soak=1500), stateful_step_count=25)
EdgeNodeWithPrimaryHostMachine.TestCase.settings = settings(examples(20, soak=1500), stateful_step_count=25)

TestEdgeNode = EdgeNodeMachine.TestCase
TestEdgeNodeWithPrimaryHost = EdgeNodeWithPrimaryHostMachine.TestCase


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
        rig.join()
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
