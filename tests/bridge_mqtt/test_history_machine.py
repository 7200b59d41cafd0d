"""Store and forward under cuts, SIGKILL, restarts of the computer and clocks that are set: every number of a counter
arrives, with its time, or is counted as lost. The file is a real one; the host knows only the specification."""

from __future__ import annotations

import tempfile
from pathlib import Path

from history_rig import MEMORY, HistoryRig
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule
from property_kit import examples


class HistoryMachine(RuleBasedStateMachine):
    """A gateway whose connection comes and goes."""

    MEMORY = 20_000

    def __init__(self) -> None:
        super().__init__()
        self._folder = tempfile.TemporaryDirectory(prefix="dpsph", dir=MEMORY)
        self.rig = HistoryRig(Path(self._folder.name) / "state", memory=self.MEMORY)
        self.rig.give_plant()

    def teardown(self) -> None:
        try:
            if self.rig.wall < 1.6e9:
                self.rig.offset = 1.75e9
            self.rig.settle()
            self.rig.check_numbers()
            assert self.rig.file is not None
            assert self.rig.file.count == 0
        finally:
            self.rig.close()
            self._folder.cleanup()

    @rule(times=st.integers(1, 6))
    def count(self, times: int) -> None:
        for _ in range(times):
            self.rig.count()

    @precondition(lambda self: self.rig.connection is None)
    @rule()
    def connect(self) -> None:
        self.rig.connect()

    @rule(sent=st.sampled_from([1, 2, 3, 10_000]), delivered=st.sampled_from([0, 1, 2, 10_000]))
    def exchange(self, sent: int, delivered: int) -> None:
        self.rig.pump(sent)
        self.rig.deliver(delivered)

    @rule(comes_back=st.booleans())
    def round_trip(self, comes_back: bool) -> None:
        self.rig.round_trip(comes_back=comes_back)

    @rule()
    def disk(self) -> None:
        self.rig.step_disk()

    @rule()
    def cut(self) -> None:
        self.rig.cut()
        self.rig.publish_wills()

    @rule()
    def kill(self) -> None:
        self.rig.publish_wills()
        self.rig.kill()

    @rule()
    def ordered_end(self) -> None:
        self.rig.node.end("the run has ended")
        self.rig.pump()

    @rule(off_s=st.sampled_from([1.0, 5000.0]))
    def reboot(self, off_s: float) -> None:
        self.rig.publish_wills()
        self.rig.reboot(off_s=off_s, wall=None)

    @rule(seconds=st.sampled_from([-3600.0, 7.0, 1e6]))
    def clock_is_set(self, seconds: float) -> None:
        self.rig.offset += seconds
        self.rig.wait(0.1)
        self.rig.step_disk()  # an end of the computer within this second would date what is there by the old clock

    @rule(state=st.sampled_from(["offline", "data_exchange"]))
    def slave(self, state: str) -> None:
        self.rig.values["8"]["state"] = state
        self.rig.wait(0.1)

    @rule()
    def rebirth(self) -> None:
        if self.rig.connection is not None:
            self.rig.rebirth()
            self.rig.wait(1.0)


class SmallMemoryMachine(HistoryMachine):
    """Memory is full before the disk takes it."""

    MEMORY = 12


SmallMemoryMachine.TestCase.settings = settings(examples(5, soak=200), stateful_step_count=30)
TestSmallMemory = SmallMemoryMachine.TestCase
HistoryMachine.TestCase.settings = settings(examples(15, soak=400), stateful_step_count=30)
TestHistory = HistoryMachine.TestCase
