"""``dpstack doctor`` and ``dpstack ports``: made-up computers, and the one the tests run on; ``--measure``: nothing
is sent unasked, no telegram is begun, the figures are those of the loop."""

from __future__ import annotations

import os
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from cli_kit import Cli
from fake_adapter import plug_in
from far_ends import PtyFarEnd
from msgspec import structs

from dpstack.api import doctor
from dpstack.api import measure as measuring
from dpstack.api.doctor import AdapterInfo, Check, Computer, Grade, examine
from dpstack.api.measure import measure
from dpstack.cli.commands import doctor as doctor_command
from dpstack.cli.commands import ports as ports_command
from dpstack.errors import PortBusyError, PortError, UsageError
from dpstack.ports.adapters import Abilities
from dpstack.ports.kernel_drivers import kernel_driver
from dpstack.service import host_setup
from dpstack.units import BAUD_RATES

ALL = Abilities(
    parity=True, low_latency=True, rs485=False, counters=True, marks=True, latency_ms=1, rates=list(BAUD_RATES)
)
Out = pytest.CaptureFixture[str]


def adapter(path: Path) -> AdapterInfo:
    return AdapterInfo(path=str(path), by_id=None, chip="", driver=None, usb=None, serial=None, holder=None)


@pytest.fixture
def port(tmp_path: Path) -> Path:
    path = tmp_path / "ttyUSB0"
    path.touch()
    return path


@pytest.fixture
def computer(tmp_path: Path, port: Path) -> Computer:
    """A computer without findings, with one FTDI adapter."""
    plug_in(tmp_path / "sys", "ttyUSB0", usb="0403:6014")
    (tmp_path / "proc").mkdir()
    return Computer(
        platform="linux",
        adapters=lambda: [adapter(port)],
        probe=lambda _path: ALL,
        limit=lambda _name: None,
        is_root=False,
        access=lambda _path, _how: True,
        sysfs=tmp_path / "sys",
        proc=tmp_path / "proc",
    )


def told(checks: list[Check], level: Grade) -> list[tuple[str, str]]:
    return [(check.text, check.todo) for check in checks if check.level is level]


def test_where_all_is_well_nothing_is_to_be_done(computer: Computer) -> None:
    checks = examine(computer=computer)
    assert {check.level for check in checks} == {Grade.OK}
    assert [check.text for check in checks] == [
        "real-time priorities are allowed (any)",
        "memory may be locked",
        "none is isolated: other programs can delay the bus process if they have a higher priority; isolcpus=1 "
        "nohz_full=1 on the command line of the kernel isolates one",
        "no sleep states are known: as in most virtual machines, the host decides",
        "USB 0403:6014, FTDI FT232H, driver ftdi_sio; its maker promises 12 Mbit/s at most",
        "may be opened",
        "its latency timer is 16 ms; dpstack sets it to 1 ms while it runs",
        "takes every rate of PROFIBUS",
        "low-latency mode: there",
        "error counters: there",
        "marks of damaged octets: there",
        "RS-485 mode: the adapter's own",
        "a damaged octet is dropped with its USB packet: up to three wrong bits in a telegram are always noticed "
        "(Hamming distance 4)",
        "a converter that RTS switches drives the bus for the instant in which a program opens the port, until the "
        "program drops RTS: this test, `capture`, `monitor` and `baud` do so at once, and send nothing",
        "its driver ftdi_sio marks all octets of a USB packet as damaged where one of them is; captures say so at such "
        "octets",
    ]


def test_rights_for_real_time(computer: Computer) -> None:
    limits = {"RLIMIT_RTPRIO": 0, "RLIMIT_MEMLOCK": 8 << 20}
    found = told(examine(computer=replace(computer, limit=limits.get)), Grade.FINDING)
    assert [text.partition(":")[0] for text, _ in found] == [
        "no real-time priority is allowed (RLIMIT_RTPRIO 0)",
        "only 8192 KiB may be locked in memory (RLIMIT_MEMLOCK)",
    ]
    assert all("`dpstack doctor --fix`" in todo for _, todo in found)
    assert not told(examine(computer=replace(computer, limit=limits.get, is_root=True)), Grade.FINDING)
    granted = examine(computer=replace(computer, limit={"RLIMIT_RTPRIO": 50}.get))
    assert granted[0].text == "real-time priorities are allowed (up to 50)"


def test_isolated_processors_sleep_states_and_interrupts(computer: Computer, tmp_path: Path) -> None:
    cpus = tmp_path / "sys/devices/system/cpu"
    (cpus / "cpu0/cpuidle/state1").mkdir(parents=True)
    (cpus / "cpu0/cpuidle/state1/latency").write_text("133\n")
    (cpus / "isolated").write_text("2-3\n")
    dma = str(computer.cpu_dma_latency)
    assert dma == "/dev/cpu_dma_latency"
    checks = examine(computer=computer)
    assert [(c.text, c.todo) for c in checks if c.topic == "processors"] == [
        ("isolated from other programs: 2-3", "[bus] cpu = 2 puts the bus process there"),
        ("may be kept from sleep states (up to 133 us to wake up) while a fixed cycle runs", ""),
    ]
    refused = examine(computer=replace(computer, access=lambda path, _how: path != dma))
    ((text, todo),) = told(refused, Grade.NOTE)
    assert text == f"may not be kept from sleep states: each wake-up may take up to 133 us ({dma})"
    assert "`dpstack doctor --fix`" in todo
    assert 'KERNEL=="cpu_dma_latency", GROUP="dialout"' in (FILES / "99-dpstack.rules").read_text()
    (tmp_path / "sys/devices/irq").write_text("27\n")  # of the controller above usb1
    (tmp_path / "proc/irq/27").mkdir(parents=True)
    goes_to = tmp_path / "proc/irq/27/smp_affinity_list"
    goes_to.write_text("0-3\n")
    ((text, todo),) = told(examine(computer=computer), Grade.NOTE)
    assert text == "interrupts of its USB controller devices (27) go to processors 0-3, where other programs run"
    assert todo == "beside the bus process, as root: echo 2 > /proc/irq/27/smp_affinity_list"
    goes_to.write_text("2\n")
    assert not told(examine(computer=computer), Grade.NOTE)


def test_no_adapter_no_port_no_permission(computer: Computer, port: Path) -> None:
    ((text, todo),) = told(examine(computer=replace(computer, adapters=list)), Grade.FINDING)
    assert text == "no serial adapter is plugged in"
    assert "virtual" in todo
    ((text, _),) = told(examine("/dev/ttyUSB99", computer), Grade.FINDING)
    assert text == "no such port"
    ((text, todo),) = told(examine(str(port), replace(computer, access=lambda _p, _h: False)), Grade.FINDING)
    assert text == "no permission"
    assert "usermod" in todo or "udev" in todo


def test_a_latency_timer_is_tried_before_it_is_judged(computer: Computer, tmp_path: Path) -> None:
    """The low-latency mode sets it for a user who may not write to its file."""
    timer = str(tmp_path / "sys/bus/usb-serial/devices/ttyUSB0/latency_timer")
    read_only = replace(computer, access=lambda path, _how: path != timer)
    assert not told(examine(computer=read_only), Grade.FINDING)
    stuck = replace(read_only, probe=lambda _path: structs.replace(ALL, latency_ms=16))
    ((text, todo),) = told(examine(computer=stuck), Grade.FINDING)
    assert text.startswith("its latency timer is 16 ms and may not be changed")
    assert "`dpstack doctor --fix`" in todo
    Path(timer).write_text("1\n")
    assert not told(examine(computer=stuck), Grade.FINDING)


def test_a_held_port_is_left_alone(computer: Computer, port: Path, tmp_path: Path) -> None:
    def never(path: str) -> Abilities:
        raise AssertionError(path)

    holder = tmp_path / "proc" / "41"
    (holder / "fd").mkdir(parents=True)
    (holder / "comm").write_text("minicom\n")
    (holder / "fd" / "3").symlink_to(port)
    ((text, todo),) = told(examine(computer=replace(computer, probe=never)), Grade.NOTE)
    assert text == "is held by minicom (pid 41)"
    assert todo == "end it to have the rest checked"
    (holder / "cmdline").write_text("\0".join(["python3", "-P", "-m", "dpstack", "run", "plant.toml"]))
    ((text, todo),) = told(examine(computer=replace(computer, probe=never)), Grade.NOTE)
    assert text == "is held by `dpstack run plant.toml` (pid 41)"
    assert f"dpstack ctl {port} status" in todo
    other = tmp_path / "proc" / "42"
    (other / "fd").mkdir(parents=True)
    (other / "comm").write_text("cat\n")
    (other / "fd" / "3").symlink_to(port)
    assert told(examine(computer=replace(computer, probe=never)), Grade.FINDING) == [
        (
            "cat (pid 42) has it open, too, and takes octets away from `dpstack run plant.toml` (pid 41)",
            "end that program",
        )
    ]
    shutil.rmtree(other)
    (holder / "cmdline").write_text("/usr/sbin/ModemManager")
    (holder / "comm").write_text("ModemManager\n")
    ((_, todo),) = told(examine(computer=replace(computer, probe=never)), Grade.NOTE)
    assert todo == (
        "it opens adapters by itself; this line in /etc/udev/rules.d/99-own.rules keeps it off: "
        'SUBSYSTEM=="tty", SUBSYSTEMS=="usb", ATTRS{idVendor}=="0403", ATTRS{idProduct}=="6014", '
        'ENV{ID_MM_PORT_IGNORE}="1"'
    )


def test_a_port_that_cannot_be_opened(computer: Computer) -> None:
    def busy(path: str) -> Abilities:
        raise PortBusyError(f"{path} is held by x")

    def broken(path: str) -> Abilities:
        raise PortError(f"{path}: no device behind it")

    assert told(examine(computer=replace(computer, probe=busy)), Grade.NOTE)[0][0].endswith("is held by x")
    assert told(examine(computer=replace(computer, probe=broken)), Grade.FINDING)[0][0].endswith("no device behind it")


def test_missing_abilities_of_an_adapter_are_told(computer: Computer, port: Path, tmp_path: Path) -> None:
    poor = Abilities(rates=[9600, 19200])
    checks = examine(computer=replace(computer, probe=lambda _path: poor, sysfs=tmp_path / "nothing"))
    assert [text for text, _ in told(checks, Grade.FINDING)] == ["has no parity bit: only check sums protect the data"]
    notes = [text for text, _ in told(checks, Grade.NOTE)]
    assert notes[0].startswith("takes 9.6 kbit/s, 19.2 kbit/s; not 31.25 kbit/s, ")
    assert notes[1:] == [
        "low-latency mode: not in its driver",
        "error counters: not in its driver",
        "marks of damaged octets: not in its driver",
        "RS-485 mode: not in its driver",
    ]
    assert all(todo for _, todo in told(checks, Grade.NOTE))
    none = replace(computer, probe=lambda _path: Abilities(parity=True))
    assert ("takes none of PROFIBUS's rates", "take another adapter") in told(examine(computer=none), Grade.FINDING)


def test_an_unknown_chip_and_another_system(computer: Computer, tmp_path: Path) -> None:
    plug_in(tmp_path / "other", "ttyUSB0", usb="1111:2222", driver="cdc_acm", latency=None)
    checks = examine(computer=replace(computer, sysfs=tmp_path / "other"))
    assert checks[4].text == "USB 1111:2222, an unknown chip, driver cdc_acm"
    notes = told(checks, Grade.NOTE)
    assert [text for text, _ in notes] == [
        "accepts every rate, and its driver cdc_acm does not say which of them the adapter makes",
        kernel_driver("cdc_acm", usb=True).protection,
    ]
    assert "FTDI (ftdi_sio)" in notes[1][1]
    (check,) = examine(computer=replace(computer, platform="win32"))
    assert (check.level, check.topic) == (Grade.NOTE, "system")


def test_doctor_of_a_pty_on_this_computer(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_real_time", lambda _here: [])
    monkeypatch.setattr(doctor, "_processors", lambda _here: [])
    far = PtyFarEnd()
    data = cli.json("doctor", "--port", far.path)
    assert data["findings"] == 0
    assert [check["level"] for check in data["checks"]] == ["ok", "ok", "note"]
    assert {check["topic"] for check in data["checks"]} == {far.path}
    assert "a pty: no parity" in cli.out("doctor", "--port", far.path)
    assert "finding  /dev/ttyUSB99: no such port" in cli.out("doctor", "--port", "/dev/ttyUSB99", code=1)
    far.hang_up()


def test_ports(cli: Cli, monkeypatch: pytest.MonkeyPatch, port: Path) -> None:
    monkeypatch.setattr(ports_command, "list_adapters", lambda: [adapter(port)])
    assert str(port) in cli.out("ports")
    (entry,) = cli.json("ports")["ports"]
    names = ["path", "by_id", "chip", "driver", "usb", "serial", "holder", "marks", "hamming_distance", "max_baud"]
    assert list(entry) == names
    ch340 = structs.replace(adapter(port), usb="1a86:7523", kernel_driver=kernel_driver("ch341-uart", usb=True))
    monkeypatch.setattr(ports_command, "list_adapters", lambda: [ch340])
    assert cli.out("ports").splitlines()[-4:] == [
        "  damaged octets: its driver ch341-uart passes no parity error on: only the check sum protects the data, one "
        "wrong bit in a telegram is noticed, two may pass as good data (Hamming distance 2)",
        "  rates: up to 3 Mbit/s",
        "  delay: USB frames of 1 ms",
        "  RS-485: the adapter switches its direction itself",
    ]
    assert cli.json("ports")["ports"][0]["hamming_distance"] == 2
    monkeypatch.setattr(ports_command, "list_adapters", list)
    assert cli.out("ports") == "no serial adapter is plugged in\n"


FILES = Path(host_setup.__file__).parent


def test_the_set_up_script(tmp_path: Path) -> None:
    script = str(host_setup.SCRIPT)

    def call(*args: str) -> subprocess.CompletedProcess[str]:
        environment = {"PATH": os.environ["PATH"], "DESTDIR": str(tmp_path), "DPSTACK": "/opt/plant/bin/dpstack"}
        return subprocess.run([script, *args], env=environment, capture_output=True, text=True, check=False)

    assert call("--print", "anna").returncode == 0
    assert list(tmp_path.iterdir()) == []
    assert call("anna").returncode == 0
    rules = tmp_path / "etc/udev/rules.d/99-dpstack.rules"
    assert rules.read_text() == (FILES / "99-dpstack.rules").read_text()
    limits = tmp_path / "etc/security/limits.d/99-dpstack.conf"
    assert limits.read_text() == "@dialout - rtprio 50\n@dialout - nice -20\n@dialout - memlock unlimited\n"
    unit = (tmp_path / "etc/systemd/system/dpstack@.service").read_text()
    assert "\nExecStart=/opt/plant/bin/dpstack run /etc/dpstack/%i.toml\n" in unit
    assert "@DPSTACK@" not in unit
    assert call("--wrong").returncode == 2


def test_the_set_up_script_says_what_it_would_do() -> None:
    script = str(host_setup.SCRIPT)
    said = subprocess.run([script, "--print", "anna"], capture_output=True, text=True, check=True).stdout
    assert "+ usermod -aG dialout anna" in said
    assert "+ udevadm control --reload" in said
    triggers = [line.removeprefix("+ ") for line in said.splitlines() if "udevadm trigger" in line]
    # the rule of the latency timer is for "add" and "bind"; its comment has the same commands
    assert triggers[-1] == "udevadm trigger --action=add --subsystem-match=usb-serial"
    assert all(trigger in (FILES / "99-dpstack.rules").read_text() for trigger in triggers)
    assert "plug the adapter in again" not in said


@pytest.fixture
def all_is_well(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_command, "examine", lambda _port: [Check("real time", Grade.OK, "memory may be locked")])


def installed(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


@pytest.mark.usefixtures("all_is_well")
def test_fix_prints_the_steps_and_changes_nothing(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DESTDIR", str(tmp_path))
    monkeypatch.setenv("SUDO_USER", "anna")
    lines = cli.out("doctor", "--fix").splitlines()
    assert lines[:2] == ["ok       real time: memory may be locked", lines[1]]
    assert f"  cp {FILES}/99-dpstack.rules {tmp_path}/etc/udev/rules.d/99-dpstack.rules" in lines
    assert lines[-1].startswith("to carry them out: sudo ")
    assert lines[-1].endswith("dpstack doctor --fix --yes")
    data = cli.json("doctor", "--fix")
    assert [f"  {step}" for step in data["steps"]] == lines[2:-1]
    assert (data["done"], data["findings"]) == (False, 0)
    assert list(tmp_path.iterdir()) == []


def test_fix_with_yes_carries_the_steps_out(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DESTDIR", str(tmp_path))
    data = cli.json("doctor", "--fix", "--yes")
    assert data["done"] is True
    assert installed(tmp_path) == [
        "etc/security/limits.d/99-dpstack.conf",
        "etc/systemd/system/dpstack@.service",
        "etc/udev/rules.d/99-dpstack.rules",
    ]
    shutil.rmtree(tmp_path / "etc/udev")
    (tmp_path / "etc/udev").touch()  # no folder can be made there
    err = cli.err("doctor", "--fix", "--yes", code=1)
    assert err.startswith(f"dpstack: the set-up failed at mkdir -p {tmp_path}/etc/udev/rules.d")
    assert err.count("\n") == 1


def test_fix_with_yes_needs_root(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DESTDIR", raising=False)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(subprocess, "run", None)  # nothing is started
    assert cli.err("doctor", "--fix", "--yes").startswith("dpstack: --yes needs root: sudo ")
    assert cli.err("doctor", "--yes") == "dpstack: --yes carries out what --fix prints: give both\n"


def test_needs_of_other_masters_are_told_beside_the_named_adapter(computer: Computer, port: Path) -> None:
    ((text, todo),) = told(examine(str(port), computer), Grade.NOTE)
    assert text == (
        "other masters on its bus need T_SL above its delay (20 ms until a run has measured it): "
        "3825 at 187.5 kbit/s, 10115 at 500 kbit/s, and none is enough above 500 kbit/s"
    )
    assert "set t_sl on all masters" in todo


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measuring, "_LISTEN_S", 0.0)
    monkeypatch.setattr(measuring, "_LOST_S", 0.05)
    monkeypatch.setattr(measuring, "_BLOCK_NS", 2_000_000)


@contextmanager
def answering(far: PtyFarEnd, answer: Callable[[bytes], bytes]) -> Iterator[bytearray]:
    """The other end of the line is a thread; yields the octets that it got."""
    got, over = bytearray(), threading.Event()

    def run() -> None:
        while not over.wait(0.0002):
            octets = far.take()
            got.extend(octets)
            if octets:
                os.write(far.fd, answer(octets))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield got
    finally:
        over.set()
        thread.join()


@pytest.fixture
def far() -> Iterator[PtyFarEnd]:
    end = PtyFarEnd()
    kept = os.open(end.path, os.O_RDWR | os.O_NOCTTY)  # the pty has an opener between two of the measurement
    yield end
    os.close(kept)
    end.hang_up()


def test_an_echo_gives_turn_around_and_rate_and_begins_no_telegram(far: PtyFarEnd) -> None:
    with answering(far, lambda octets: octets) as got:
        found = measure(far.path, "", rounds=10, rates=(187_500, 500_000))
    assert (found["loop"], found["rounds"], found["refused"], found["marks"]) == ("echo", 10, {}, None)
    rates = found["rates"]
    assert isinstance(rates, list)
    assert [one["baud"] for one in rates] == [187_500, 500_000]
    for one in rates:
        assert one["lost"] == 0
        assert 0 < one["turn_around_us"]["p50"] <= one["turn_around_us"]["p999"]
        assert one["octets_per_s"] > 0
    assert rates[0]["wanted_octets_per_s"] == 17_045
    # SD1, SD2, SD3, SD4, SC begin no telegram here
    assert got
    assert not set(got) & {0x10, 0x68, 0xA2, 0xDC, 0xE5}


def test_a_line_that_gives_nothing_back_has_no_figures(far: PtyFarEnd) -> None:
    found = measure(far.path, "", rounds=10, rates=(500_000,))
    assert found["rates"] == [
        {
            "baud": 500_000,
            "turn_around_us": None,
            "lost": 4,
            "octets_per_s": None,
            "wanted_octets_per_s": 45_455,
        }
    ]


def test_without_a_loop_nothing_is_sent(far: PtyFarEnd) -> None:
    found = measure(far.path, None, rates=(187_500,))
    assert found["rates"] == [{"baud": 187_500}]
    assert far.take() == b""


def test_octets_that_come_unasked_are_a_bus(far: PtyFarEnd, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "sleep", lambda _s: far.send(b"\xdc\x02\x02"))
    with pytest.raises(UsageError, match="3 octets came although nothing was sent: this is a bus"):
        measure(far.path, "", rates=(187_500,))
    assert far.take() == b""


def test_the_command_sends_only_with_yes(cli: Cli, far: PtyFarEnd) -> None:
    assert "say so with --yes" in cli.err("doctor", "--measure", "--port", far.path, "--loop")
    assert "--measure needs --port P" in cli.err("doctor", "--measure")
    assert "--loop needs --measure" in cli.err("doctor", "--port", far.path, "--loop", "--yes")
    assert far.take() == b""
    found = cli.json("doctor", "--measure", "--port", far.path)
    assert (found["port"], found["loop"]) == (far.path, None)
    assert far.take() == b""
