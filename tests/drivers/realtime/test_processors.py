"""Processors for the bus process, sleep states, interrupts of a port: over made-up /sys, /proc and /dev."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from fake_adapter import plug_in

from dpstack.drivers.realtime import processors
from dpstack.drivers.realtime.processors import (
    AwakeProcessors,
    Interrupts,
    interrupts_of,
    isolated,
    listed,
    run_on,
    text_of,
)
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
