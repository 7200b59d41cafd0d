"""A bus process and its computer: processors, sleep states, interrupts of a port, over made-up /sys, /proc
and /dev; real-time rights where permitted, else a line that says what is missing."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from fake_adapter import plug_in

from dpstack.drivers.realtime import processors, rights
from dpstack.drivers.realtime.processors import (
    AwakeProcessors,
    Interrupts,
    interrupts_of,
    isolated,
    listed,
    run_on,
    text_of,
)
from dpstack.drivers.realtime.rights import MEMORY, PRIORITY, Rights, become_real_time
from dpstack.errors import ConfigError


def put(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.mark.parametrize(
    ("text", "numbers"),
    [("0-3,6\n", {0, 1, 2, 3, 6}), ("2\n", {2}), ("\n", set()), ("(null)\n", set()), ("0-x,4", {4})],
)
def test_lists_of_the_kernel(tmp_path: Path, text: str, numbers: set[int]) -> None:
    put(tmp_path / "list", text)
    assert listed(tmp_path / "list") == numbers


def test_a_missing_list_is_empty(tmp_path: Path) -> None:
    assert listed(tmp_path / "isolated") == set()
    assert isolated(tmp_path) == set()


@pytest.mark.parametrize(("numbers", "text"), [((3, 1, 2, 6), "1-3,6"), ((4,), "4"), ((), "none")])
def test_processors_in_words(numbers: tuple[int, ...], text: str) -> None:
    assert text_of(numbers) == text


# --- sleep states ---


def test_awake_writes_a_wake_up_time_of_zero_as_long_as_it_is_wanted(tmp_path: Path) -> None:
    path = tmp_path / "cpu_dma_latency"
    path.write_bytes(b"")
    awake = AwakeProcessors(path)
    awake.hold(False)
    assert not awake.is_held()
    before = len(os.listdir("/proc/self/fd"))
    awake.hold(True)
    awake.hold(True)
    assert awake.is_held()
    assert path.read_bytes() == bytes(4)  # s32, once
    assert len(os.listdir("/proc/self/fd")) == before + 1
    awake.hold(False)
    assert not awake.is_held()
    assert len(os.listdir("/proc/self/fd")) == before


def test_awake_without_the_right_holds_nothing_and_does_not_try_again(tmp_path: Path) -> None:
    path = tmp_path / "cpu_dma_latency"
    awake = AwakeProcessors(path)
    awake.hold(True)
    path.write_bytes(b"")
    awake.hold(True)
    assert not awake.is_held()
    awake.hold(False)
    awake.hold(True)  # the next fixed cycle
    assert awake.is_held()
    awake.hold(False)


def test_awake_closes_a_file_that_takes_no_number() -> None:
    before = len(os.listdir("/proc/self/fd"))
    awake = AwakeProcessors(Path("/dev/full"))
    awake.hold(True)
    assert not awake.is_held()
    assert len(os.listdir("/proc/self/fd")) == before


# --- [bus] cpu ---


@pytest.fixture
def affinity(monkeypatch: pytest.MonkeyPatch) -> set[int]:
    """The processors that the kernel has, and permits, 0 to 3; those of this process afterwards."""
    mine = {0, 1, 2, 3}

    def take(_pid: int, wanted: set[int]) -> None:
        if not wanted & {0, 1, 2, 3}:
            raise OSError(22, "Invalid argument")
        mine.clear()
        mine.update(wanted & {0, 1, 2, 3})

    monkeypatch.setattr(os, "sched_setaffinity", take)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: set(mine))
    return mine


def test_the_process_runs_on_the_processors_it_is_given(tmp_path: Path, affinity: set[int]) -> None:
    put(tmp_path / "devices/system/cpu/online", "0-7\n")
    run_on((2, 3), tmp_path)
    assert affinity == {2, 3}


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        ((1, 9), r"cpu = 1,9: processor 9 is not there \(online: 0-7\)$"),
        (
            (3, 5),
            r"cpu = 3,5: this process may not run on processor 5 \(permitted: 3\); a container or a control group",
        ),
        ((5,), r"cpu = 5: this process may not run on processor 5 \(permitted: 0-3\); a container"),
    ],
)
def test_a_processor_that_is_not_there_or_not_permitted(
    tmp_path: Path, affinity: set[int], wanted: tuple[int, ...], said: str
) -> None:
    put(tmp_path / "devices/system/cpu/online", "0-7\n")
    with pytest.raises(ConfigError, match=said):
        run_on(wanted, tmp_path)


# --- interrupts ---


def on_a_controller(root: Path) -> Path:
    """An adapter below the USB bus of a PCI controller; returns the folder of the controller."""
    port = plug_in(root, "ttyUSB0")
    pci = root / "devices/pci0000:00/0000:00:14.0"
    pci.mkdir(parents=True)
    (root / "devices/usb1").rename(pci / "usb1")
    moved = pci / port.relative_to(root / "devices")
    for link in (root / "class/tty/ttyUSB0/device", root / "bus/usb-serial/devices/ttyUSB0"):
        link.unlink()
        link.symlink_to(moved)
    return pci


def test_interrupts_of_the_usb_controller(tmp_path: Path) -> None:
    pci = on_a_controller(tmp_path / "sys")
    for number, where in (("27", "0-3\n"), ("28", "2\n")):
        put(pci / "msi_irqs" / number, "msi\n")
        put(tmp_path / "proc/irq" / number / "smp_affinity_list", where)
    found = interrupts_of("/dev/ttyUSB0", tmp_path / "sys", tmp_path / "proc")
    assert found == Interrupts("0000:00:14.0", (27, 28), frozenset({0, 1, 2, 3}))


@pytest.mark.parametrize("by_name", [False, True])
def test_interrupts_without_msi(tmp_path: Path, by_name: bool) -> None:
    """One number in the file irq, or, for a controller that is no PCI device, a line of /proc/interrupts."""
    pci = on_a_controller(tmp_path / "sys")
    if by_name:
        lines = (
            "  CPU0  CPU1",
            " 19:  1  0  GIC  dwc2_hsotg:usb11",
            " 40:  9  7  GIC-0  xhci-hcd:usb1",
            "NMI:  0 0",
            "",
        )
        put(tmp_path / "proc/interrupts", "\n".join(lines))
    else:
        put(pci / "irq", "40\n")
    put(tmp_path / "proc/irq/40/smp_affinity_list", "1\n")
    assert interrupts_of("/dev/ttyUSB0", tmp_path / "sys", tmp_path / "proc") == Interrupts(
        "0000:00:14.0", (40,), frozenset({1})
    )


def test_no_interrupts_are_known(tmp_path: Path) -> None:
    on_a_controller(tmp_path / "sys")
    assert interrupts_of("/dev/ttyUSB0", tmp_path / "sys", tmp_path / "proc") is None
    assert interrupts_of("/dev/ttyS0", tmp_path / "sys", tmp_path / "proc") is None


def test_the_slowest_sleep_state(tmp_path: Path) -> None:
    assert processors.slowest_wake_up_us(tmp_path) is None
    for state, us in enumerate(("0\n", "133\n", "10\n")):
        put(tmp_path / f"devices/system/cpu/cpu0/cpuidle/state{state}/latency", us)
    assert processors.slowest_wake_up_us(tmp_path) == 133


SCRIPT = """
import ctypes, json, os, platform, resource, struct, sys
from dpstack.drivers.realtime import rights
as_nobody, priority = int(sys.argv[1]), int(sys.argv[2])
if priority >= 0:
    resource.setrlimit(resource.RLIMIT_RTPRIO, (priority, priority))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (8 << 20, 8 << 20))
if as_nobody and os.geteuid() == 0:
    os.setuid(65534)
notices = rights.become_real_time()
child = os.fork()
if not child:
    os._exit(os.sched_getscheduler(0))
status = open("/proc/self/status").read()
number = {"x86_64": 315, "aarch64": 275, "riscv64": 275}.get(platform.machine())  # sched_getattr(2)
of_process = ctypes.create_string_buffer(48)
if number is None or ctypes.CDLL(None).syscall(number, 0, of_process, 48, 0):
    slice_ns = 0
else:  # sched_runtime: since Linux 6.12 the slice of an ordinary process, before that 0
    (slice_ns,) = struct.unpack_from("Q", of_process, 24)
print(json.dumps({
    "notices": notices,
    "fifo": os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO,
    "priority": os.sched_getparam(0).sched_priority,
    "locked": "VmLck:\\t       0 kB" not in status,
    "slice_ns": slice_ns,
    "slack": ctypes.CDLL(None).prctl(30, 0, 0, 0, 0),
    "of_child": os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]),
}))
"""


def ask(as_nobody: bool, priority: int) -> dict[str, Any]:
    root = Path(__file__).parents[3]
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(int(as_nobody)), str(priority)],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=True,
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_without_rights_each_refusal_names_a_remedy() -> None:
    found = ask(as_nobody=True, priority=0)
    notices = found["notices"]
    assert [notice.split(":")[0] for notice in notices] == [
        "no real-time priority is allowed (RLIMIT_RTPRIO 0)",
        "only 8192 KiB may be locked in memory (RLIMIT_MEMLOCK)",
    ]
    for notice in notices:
        assert "`dpstack doctor --fix`" in notice
        assert "--cap-add SYS_NICE" in notice
    assert not found["fifo"]
    assert not found["locked"]


def test_without_rights_too_an_ordinary_process_has_the_shortest_slice() -> None:
    """A kernel before 6.12 knows no slices of processes and tells 0."""
    assert ask(as_nobody=True, priority=0)["slice_ns"] in {0, 100_000}


def test_a_priority_within_the_limit_is_taken() -> None:
    hard = resource.getrlimit(resource.RLIMIT_RTPRIO)[1]
    most = 10 if hard == resource.RLIM_INFINITY else min(10, hard)  # nobody may go beyond the hard one
    found = ask(as_nobody=True, priority=most)
    assert found["fifo"] == bool(most)
    assert found["priority"] == most


def test_each_right_is_taken_or_its_refusal_reported() -> None:
    found = ask(as_nobody=False, priority=-1)
    notices = " ".join(found["notices"])
    assert found["fifo"] or "real-time priority" in notices
    assert found["locked"] or "memory" in notices
    assert found["fifo"] or found["slack"] == 1
    assert found["of_child"] == os.SCHED_OTHER  # it is not handed down


@pytest.mark.parametrize(
    ("rights", "priority", "memory"),
    [
        (Rights(False, 0, 0), True, True),
        (Rights(False, 1, MEMORY), False, False),
        (Rights(False, None, None), False, False),
        (Rights(False, 99, MEMORY - 1), False, True),
        (Rights(True, 0, 0), False, False),
    ],
)
def test_rights(rights: Rights, priority: bool, memory: bool) -> None:
    assert bool(rights.no_priority()) == priority
    assert bool(rights.no_memory()) == memory


def test_a_container_may_have_taken_roots_rights_away(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    status = tmp_path / "status"
    monkeypatch.setattr(rights, "_STATUS", status)
    for capabilities, privileged in (
        ("000001ffffffffff", True),
        ("00000000a80425fb", False),
        ("0000000000804000", True),
    ):
        status.write_text(f"Name:\tpython\nCapEff:\t{capabilities}\n")
        assert rights.is_privileged() is privileged
    status.unlink()
    assert rights.is_privileged() is (os.geteuid() == 0)


@pytest.mark.parametrize(("limit", "taken"), [(10, 10), (99, PRIORITY), (None, PRIORITY)])
def test_no_more_priority_than_the_limit_allows(monkeypatch: pytest.MonkeyPatch, limit: int | None, taken: int) -> None:
    asked: list[int] = []
    monkeypatch.setattr(rights, "rights", lambda: Rights(False, limit, None))
    monkeypatch.setattr(os, "sched_setscheduler", lambda _pid, _policy, param: asked.append(param.sched_priority))
    assert rights.set_priority() == ""
    assert asked == [taken]


def test_refusals_of_the_system_in_spite_of_the_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_args: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(rights, "rights", lambda: Rights(False, 50, None))
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    notice = rights.set_priority()
    assert f"SCHED_FIFO {PRIORITY} is refused (Operation not permitted) although the limits allow it" in notice


def test_in_front_of_a_pty_it_is_preferred_and_stays_an_ordinary_process(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int, int]] = []
    monkeypatch.setattr(os, "setpriority", lambda *given: asked.append(given))
    monkeypatch.setattr(rights, "set_priority", lambda: "not to be asked for")
    monkeypatch.setattr(rights, "lock_memory", lambda: "")
    monkeypatch.setattr(rights, "exact_timers", lambda: "")
    sliced: list[bool] = []
    monkeypatch.setattr(rights, "shorten_slice", lambda: sliced.append(True))
    assert become_real_time(pty=True) == []
    assert asked == [(os.PRIO_PROCESS, 0, -20)]
    assert sliced == [True]
    monkeypatch.setattr(rights, "is_real_time", lambda: True)
    assert become_real_time(pty=True) == []
    assert sliced == [True]  # a real-time process has no slice, and would become an ordinary one

    def refuse(*_args: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "setpriority", refuse)
    (notice,) = become_real_time(pty=True)
    assert "no niceness of -20 ([Errno 13] Permission denied)" in notice
    assert "`dpstack doctor --fix`" in notice
