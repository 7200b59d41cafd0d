"""The program that holds a port, from a made-up /proc and from the real one."""

from __future__ import annotations

import os
from pathlib import Path

from far_ends import PtyFarEnd
from process_kit import SPEC, VALVES, bus_on, octet_slaves, runtime_of

from dpstack.ports.holders import holder_of_path, is_dpstack, keep_off, other_openers


def program(proc: Path, pid: int, name: str, *opened: str) -> None:
    (proc / str(pid) / "fd").mkdir(parents=True)
    (proc / str(pid) / "comm").write_text(name + "\n")
    for number, path in enumerate(opened):
        (proc / str(pid) / "fd" / str(number)).symlink_to(path)


def test_the_lock_counts_first(tmp_path: Path) -> None:
    proc, port = tmp_path / "proc", tmp_path / "ttyUSB0"
    port.touch()
    program(proc, 41, "reader", str(port))
    program(proc, 42, "minicom")
    info = port.stat()
    inode = f"{os.major(info.st_dev):02x}:{os.minor(info.st_dev):02x}:{info.st_ino}"
    (proc / "locks").write_text(
        "1: POSIX  ADVISORY  READ 40 00:18:5 0 EOF\n"
        f"2: -> FLOCK  ADVISORY  WRITE 43 {inode} 0 EOF\n"
        f"3: FLOCK  ADVISORY  WRITE 42 {inode} 0 EOF\n"
    )
    assert holder_of_path(str(port), proc) == "minicom (pid 42)"
    (proc / "locks").write_text(f"3: FLOCK  ADVISORY  WRITE 99 {inode} 0 EOF\n")
    assert holder_of_path(str(port), proc) == "pid 99"


def test_without_a_lock_an_open_descriptor_does(tmp_path: Path) -> None:
    proc, port, link = tmp_path / "proc", tmp_path / "ttyUSB0", tmp_path / "by-id"
    port.touch()
    link.symlink_to(port)
    program(proc, 40, "other", "/dev/null")
    program(proc, 41, "reader", "/dev/null", str(port))
    assert holder_of_path(str(link), proc) == "reader (pid 41)"
    assert holder_of_path(str(tmp_path / "ttyUSB1"), proc) is None


def test_other_programs_than_this_one_and_its_children(tmp_path: Path) -> None:
    proc, port = tmp_path / "proc", tmp_path / "ttyUSB0"
    port.touch()
    for pid, parent in ((os.getpid(), os.getppid()), (70_001, os.getpid()), (70_002, os.getppid())):
        program(proc, pid, "reader", str(port))
        (proc / str(pid) / "stat").write_text(f"{pid} (reader) S {parent} 1 1 0 -1")
    # a shell has started this program and the other one
    assert other_openers(str(port), proc) == ["reader (pid 70002)"]
    (proc / str(os.getpid()) / "cmdline").write_text("python\0-P\0-m\0dpstack.drivers.process\0007")
    assert other_openers(str(port), proc) == []  # its parent is the application of this bus process


def test_dpstack_as_a_module_is_dpstack(tmp_path: Path) -> None:
    proc, port = tmp_path / "proc", tmp_path / "ttyUSB0"
    port.touch()
    program(proc, 41, "python3", str(port))
    (proc / "41" / "cmdline").write_text("\0".join(["python3", "-P", "-m", "dpstack", "run", "plant.toml"]) + "\0")
    holder = holder_of_path(str(port), proc)
    assert holder == "`dpstack run plant.toml` (pid 41)"
    assert is_dpstack(holder)
    assert not is_dpstack("minicom (pid 42)")


def test_programs_that_open_adapters_by_themselves_are_kept_off() -> None:
    for name in ("ModemManager", "gpsd", "brltty"):
        assert keep_off(f"{name} (pid 7)", "0403:6001").startswith("it opens adapters by itself; ")
    assert keep_off("gpsd (pid 7)", "0403:6001").endswith(
        'keeps it off: SUBSYSTEM=="tty", SUBSYSTEMS=="usb", ATTRS{idVendor}=="0403", ATTRS{idProduct}=="6001", '
        'ENV{SYSTEMD_WANTS}=""'
    )
    assert "/etc/udev/rules.d/85-brltty.rules" in keep_off("brltty (pid 7)")
    assert keep_off("minicom (pid 7)") == ""


def test_a_command_of_dpstack_is_named_with_its_configuration(tmp_path: Path) -> None:
    proc, port = tmp_path / "proc", tmp_path / "ttyUSB0"
    port.touch()
    program(proc, 41, "dpstack", str(port))
    words = ["/venv/bin/python", "/venv/bin/dpstack", "run", "plant.toml"]
    (proc / "41" / "cmdline").write_text("\0".join(words) + "\0")
    assert holder_of_path(str(port), proc) == "`dpstack run plant.toml` (pid 41)"
    (proc / "41" / "cmdline").write_text("\0".join([*words, "x" * 200]) + "\0")
    told = holder_of_path(str(port), proc)
    assert told is not None
    assert told.endswith("xxx...` (pid 41)")
    assert len(told) == 111


def test_behind_a_bus_process_the_application_is_named(tmp_path: Path) -> None:
    """The user knows the application and may end it; the bus process has no name of its own."""
    proc, port = tmp_path / "proc", tmp_path / "ttyUSB0"
    port.touch()
    program(proc, 41, "python", str(port))
    (proc / "41" / "cmdline").write_text(
        "\0".join(["python", "-P", "-m", "dpstack.drivers.process", "12", "13", "7"]) + "\0"
    )
    (proc / "41" / "stat").write_text("41 (python (3)) S 40 41 41 0 -1")
    assert holder_of_path(str(port), proc) == "pid 40"
    program(proc, 40, "dpstack")
    (proc / "40" / "cmdline").write_text("\0".join(["python", "/bin/dpstack", "run", "plant.toml"]) + "\0")
    assert holder_of_path(str(port), proc) == "`dpstack run plant.toml` (pid 40)"
    (proc / "41" / "stat").write_text("41 (py")
    assert holder_of_path(str(port), proc) == "python (pid 41)"


async def test_behind_a_real_bus_process_too() -> None:
    """Its command line is the one that the system shows for ``python -m``."""
    with octet_slaves(SPEC) as (path, _):
        async with bus_on(path, "process", VALVES) as bus:
            assert runtime_of(bus).pid != os.getpid()
            assert holder_of_path(path) == f"this program itself (pid {os.getpid()})"


def test_the_real_one(far: PtyFarEnd) -> None:
    assert holder_of_path(far.path) is None
    fd = os.open(far.path, os.O_RDWR | os.O_NOCTTY)
    assert holder_of_path(far.path) == f"this program itself (pid {os.getpid()})"
    os.close(fd)
