"""A driver that is held up for longer than a slave's watchdog lets no old output out, wherever it stood still.

The slave is made of octets: its watchdog takes its outputs back, and it writes down every output it is given.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import pytest
from kernel_kit import Driven, Kernel, held_up_at
from octet_slave import SC, frame, sd1, sd2

from dpstack.boottime import suspended_ns
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import Blocked, SlaveState, Stalled
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.slave_params import SlaveParams
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.params import BusParams
from dpstack.phy.patience import HOST
from dpstack.units import NS_PER_MS, NS_PER_US, chars_to_ns

BAUD: Final = 500_000
RUN: Final = b"\x04\x7f"
WATCHDOG_NS: Final = 200 * NS_PER_MS


class Plant:
    """A master on the line of a kernel with one slave of two octets each way, in Operate with the outputs RUN."""

    def __init__(self, kind: str, *, after_stall: str = "safe", asleep_ms: int = 0) -> None:
        self.kernel = Kernel()
        self.kernel.asleep = asleep_ms * NS_PER_MS
        self.kernel.far = self._far
        self.given: list[tuple[int, bytes]] = []  # outputs, and when they arrived
        self.controls: list[tuple[int, int]] = []  # control octet of Global_Control, and when
        self.mute = False
        self._heard = 0
        self._state = "wait_prm"
        self._free_at = 0
        setup = SlaveParams(address=3, name="s3", ident=0x0696, config=b"\x31", initial=RUN)
        params = BusParams.preset(BAUD, address=2, gap=0)
        self.master = Master(params, [setup], MasterSettings(safe_after_stall=after_stall == "safe"))
        self.station = ActiveStation(params, [self.master], patience=HOST, now=self.kernel.now)
        self.patch = pytest.MonkeyPatch()
        self.driven = Driven(kind, self.station, self.kernel, self.patch)
        self.driven.runtime.command(GoOnline())
        self.driven.runtime.command(SetMode(Mode.OPERATE))
        self.run(300)
        assert self.given[-1][1] == RUN

    def run(self, ms: int) -> None:
        self.driven.run(self.kernel.now + ms * NS_PER_MS)

    def close(self) -> None:
        self.driven.close()
        self.patch.undo()

    @property
    def stalls(self) -> list[Stalled]:
        return [event for event in self.driven.events if isinstance(event, Stalled)]

    def _far(self, octets: bytes, now: int) -> None:
        self._free_at = max(now, self._free_at) + chars_to_ns(len(octets), BAUD)
        if octets[0] not in (0x10, 0x68):
            return
        answer = self._answer(octets, self._free_at)
        if answer is not None and not self.mute:
            at = self._free_at + 22 * NS_PER_US
            self._free_at = at + chars_to_ns(len(answer), BAUD)
            self.kernel.arrive(self._free_at, answer)

    def _answer(self, octets: bytes, now: int) -> bytes | None:
        if octets[0] == 0x10:
            return sd1(2, 3, 0x03)
        da = octets[4] & 0x7F
        if octets[4] & 0x80 and octets[7] == 58:
            self.controls.append((octets[9], now))
            return None
        if da != 3:
            return None
        if now - self._heard > WATCHDOG_NS:
            self._state = "wait_prm"
        self._heard = now
        if not octets[4] & 0x80:
            self.given.append((now, octets[7:-2]))
            return frame(b"\x02\x03\x08\x00\x00") if self._state == "data_exchange" else sd1(2, 3, 0x03)
        match octets[7]:
            case 60:
                ready = self._state == "data_exchange"
                return sd2(2, 3, 0x08, 62, 60, bytes.fromhex("000C00020696" if ready else "020500FF0696"))
            case 61:
                self._state = "wait_cfg"
                return SC
            case 62:
                self._state = "data_exchange"
                return SC
        return sd1(2, 3, 0x03)


@pytest.mark.parametrize("what", ["nothing", "octets", "write", "woken"])
@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_stopped_anywhere_nothing_old_goes_out(kind: str, what: str, number: int) -> None:
    plant = Plant(kind)
    began = plant.kernel.now
    plant.kernel.held_up = held_up_at({(what, number): 900})
    plant.run(1_800)  # a read that finds nothing comes every 200 ms, after a Global_Control
    plant.close()
    resumed = max((b for a, b in gaps(plant) if b - a > 800 * NS_PER_MS), default=0)
    assert resumed > began
    assert plant.master.mode is Mode.CLEAR
    assert {octets for at, octets in plant.given if at >= resumed} == {bytes(2)}
    assert {control & 0x02 for control, at in plant.controls if at >= resumed} == {0x02}
    (stall,) = plant.stalls
    assert stall.blocked is Blocked.PROGRAM
    assert stall.gap_ns is not None
    assert 890 * NS_PER_MS < stall.gap_ns < 1_000 * NS_PER_MS


@pytest.mark.parametrize("what", ["nothing", "octets", "write", "woken"])
@pytest.mark.parametrize("number", [1, 2, 3])
def test_suspended_anywhere_nothing_old_goes_out(kind: str, what: str, number: int) -> None:
    """CLOCK_MONOTONIC stands still, also between the beginning of a step and its write; CLOCK_BOOTTIME goes on."""
    plant = Plant(kind)
    kernel = plant.kernel
    pause = held_up_at({(what, number): 900})

    def asleep(done: str) -> int:
        ns = pause(done)
        kernel.behind += ns
        kernel.asleep += ns
        return ns

    kernel.held_up = asleep
    plant.run(1_500)
    plant.close()
    resumed = max(b for a, b in gaps(plant) if b - a > 800 * NS_PER_MS)
    assert plant.master.mode is Mode.CLEAR
    assert {octets for at, octets in plant.given if at >= resumed} == {bytes(2)}
    (stall,) = plant.stalls
    assert stall.blocked is Blocked.SUSPENDED


def test_a_slave_lost_by_a_stall_is_not_held_for_one_that_flaps(kind: str) -> None:
    """It had been in data exchange for less than a second, yet it is brought up again at once."""
    plant = Plant(kind, after_stall="resume")
    plant.kernel.held_up = held_up_at({("woken", 5): 900})
    plant.run(1_000)
    plant.close()
    resumed = max(b for a, b in gaps(plant) if b - a > 800 * NS_PER_MS)
    assert plant.given[-1] == (plant.given[-1][0], RUN)
    assert plant.master.handlers[3].state is SlaveState.DATA_EXCHANGE
    assert plant.master.handlers[3].since - resumed < 50 * NS_PER_MS


@pytest.mark.parametrize(("ms", "mode"), [(40, Mode.OPERATE), (400, Mode.CLEAR), (3_000, Mode.CLEAR)])
def test_a_port_that_takes_nothing_is_a_stall(kind: str, ms: int, mode: Mode) -> None:
    """The driver runs, and the machine believes that it asks its slave; nothing is on the wire."""
    plant = Plant(kind)
    port = plant.driven.port
    write = port._send

    def refuse(_octets: bytes) -> int:
        raise BlockingIOError

    port._send = refuse
    plant.run(ms)
    port._send = write
    resumed = plant.kernel.now
    plant.run(1_500)
    plant.close()
    assert plant.master.mode is mode
    given = {octets for at, octets in plant.given if at >= resumed}
    assert given == {RUN if mode is Mode.OPERATE else bytes(2)}
    assert [stall.blocked for stall in plant.stalls] == [Blocked.PORT] * (mode is Mode.CLEAR)


def gaps(plant: Plant) -> list[tuple[int, int]]:
    """Ends of neighbouring telegrams to the slave and to all."""
    at = sorted([at for at, _ in plant.given] + [at for _, at in plant.controls])
    return list(pairwise(at))


def test_a_request_whose_answer_was_lost_meanwhile_is_not_repeated(kind: str) -> None:
    """Held up while the answer is waited for, and no answer is there afterwards: the repetition would be old."""
    plant = Plant(kind)
    plant.mute = True
    plant.kernel.held_up = held_up_at({("write", 1): 900})
    begin = len(plant.given)
    plant.run(950)
    plant.mute = False
    plant.run(1_500)
    plant.close()
    assert [octets for _, octets in plant.given[begin:]].count(RUN) <= 1  # the one before it was held up
    assert plant.master.mode is Mode.CLEAR
    assert plant.given[-1][1] == bytes(2)


@pytest.mark.parametrize("ms", [20, 100, 150])
def test_a_shorter_pause_changes_nothing(kind: str, ms: int) -> None:
    plant = Plant(kind)
    plant.kernel.held_up = held_up_at({("woken", 5): ms})
    plant.run(1_000)
    plant.close()
    assert plant.master.mode is Mode.OPERATE
    assert plant.given[-1][1] == RUN
    assert not plant.stalls


def test_resume_sends_the_old_outputs_again(kind: str) -> None:
    plant = Plant(kind, after_stall="resume")
    plant.kernel.held_up = held_up_at({("woken", 5): 900})
    plant.run(2_000)
    plant.close()
    assert plant.master.mode is Mode.OPERATE
    assert plant.given[-1][1] == RUN
    assert not plant.stalls


def test_a_suspended_computer(kind: str) -> None:
    """CLOCK_MONOTONIC stands still meanwhile, CLOCK_BOOTTIME goes on."""
    plant = Plant(kind, asleep_ms=5_000)
    plant.kernel.asleep += 3_600_000 * NS_PER_MS
    resumed = plant.kernel.now
    plant.run(1_000)
    plant.close()
    assert {octets for at, octets in plant.given if at > resumed + NS_PER_MS} == {bytes(2)}
    (stall,) = plant.stalls
    assert stall.blocked is Blocked.SUSPENDED
    assert "the computer was suspended for 3600000 ms" in stall.text
    assert stall.gap_ns is not None
    assert 3_600_000 * NS_PER_MS <= stall.gap_ns < 3_600_050 * NS_PER_MS


def test_a_short_sleep_changes_nothing(kind: str) -> None:
    plant = Plant(kind)
    for _ in range(5):
        plant.kernel.asleep += 150 * NS_PER_MS
        plant.run(100)
    plant.close()
    assert not plant.stalls
    assert plant.given[-1][1] == RUN


def test_the_time_of_system_sleep_never_runs_backwards() -> None:
    """However long the computer slept: the value never becomes smaller."""
    first = suspended_ns()
    assert first > -50 * NS_PER_MS
    assert suspended_ns() - first < 1_000 * NS_PER_MS
