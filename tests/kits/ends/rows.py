"""Every way out of a program with a bus, measured: the rows of docs/explanation/ends.md.

``python tests/kits/ends`` measures them (see the package).

A program (an application of ``ends.faults``, or ``dpstack run``) has two slaves with live outputs, on a pty whose
other end is ``ends.recording_slave``: slave 4 with a watchdog of 1000 ms and safe values, slave 5 without either.
Something happens to it. The row says what the slaves were sent last, by what their outputs became safe, what was told,
and the exit code.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import json
import os
import re
import resource
import select
import signal
import subprocess
import sys
import tempfile
import termios
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from ends.telegrams import after_live
from far_ends import eventually
from plant_files import plant_text

KITS: Final = Path(__file__).resolve().parents[1]
ROOT: Final = KITS.parents[1]
DATA: Final = ROOT / "tests" / "snapshots" / "ends.json"
DRIVERS: Final = ("asyncio", "process")
LIVE, SAFE, LIVE_LAMPS = "1122", "a55a", "77"
SLAVES: Final = (f"4:1234:2111:2:2={LIVE}", f"5:1234:2010:1:1={LIVE_LAMPS}")
WATCHDOG_MS: Final = 1000
#: s: for hangs only
HANG_S: Final = 60.0
#: s after which connectors count as lost
CONNECTORS_HANG_S: Final = 5.0
#: s after which a program that a signal has not ended goes on
ALIVE_S: Final = 1.5
#: and after which one without data exchange does
LONG_ALIVE_S: Final = 8.0

TABLES: Final[tuple[dict[str, object], ...]] = (
    {
        "name": "valves", "address": 4, "ident": 0x1234, "config": "21 11", "safe": "A5 5A", "watchdog_ms": 1000,
        "inputs": {"level": "i16@0"}, "outputs": {"target": "u16@0"},
    },
    {"name": "lamps", "address": 5, "ident": 0x1234, "config": "20 10", "watchdog_ms": 0},
)  # fmt: skip
BUS: Final[dict[str, Any]] = {"baud": 1_500_000, "gap": 0, "max_retry": 15}
#: the connectors; the broker is not there
CONNECTORS: Final = """
[metrics]
listen = "127.0.0.1:0"

[mqtt]
url = "mqtt://127.0.0.1:9"
group = "plant"
node = "line"

[opcua]
listen = "127.0.0.1:0"
cert = "FOLDER/own.der"
key = "FOLDER/own.pem"
anonymous = "read"

[epics]
prefix = "LINE:"
listen = "127.0.0.1:0"
"""


#: the remark that it is not there comes at some loads of the computer only
NO_BROKER: Final = "dpstack: mqtt: broker "
#: of ``probe_connector``, with the way in which it fails
PROBE: Final = """
[probe]
fails = "{}"
"""
#: one that has ordered the outputs of the valves, and fails in the way when FOLDER/go is there
ORDERING: Final = """
[probe]
allow_commands = ["valves.*"]
go = "FOLDER/go"
fails = "{}"
"""
#: four further slaves with 7168 named bits in all; their outputs, and the tables of their configuration
BIG_OUTPUTS: Final = "55" + "00" * 111
BIG_SLAVES: Final = tuple(f"{address}:1234:{'1f2f' * 7}:112:112={BIG_OUTPUTS}" for address in range(10, 14))
BIG: Final = "".join(
    f"""
[[slave]]
name = "big {address}"
address = {address}
ident = 0x1234
config = "{"1f2f" * 7}"
watchdog_ms = 1000
inputs = {{ {", ".join(f'i{bit} = "bool@{bit // 8}.{bit % 8}"' for bit in range(896))} }}
outputs = {{ {", ".join(f'o{bit} = "bool@{bit // 8}.{bit % 8}"' for bit in range(896))} }}
"""
    for address in range(10, 14)
)


class Recorder:
    """The process of ``ends.recording_slave``."""

    def __init__(self, folder: Path, more: tuple[str, ...] = ()) -> None:
        self.link = str(folder / "line")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "ends.recording_slave", self.link, *SLAVES, *more],
            cwd=KITS,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self.read() == "ready"

    def read(self, timeout: float = HANG_S) -> Any:
        """The next value; None after ``timeout``."""
        out = self.process.stdout
        assert out is not None
        if not select.select([out], [], [], timeout)[0]:
            return None
        line = out.readline()
        assert line, "the recorder has ended"
        return json.loads(line)

    def say(self, command: str) -> None:
        pipe = self.process.stdin
        assert pipe is not None
        pipe.write(command.encode() + b"\n")
        pipe.flush()

    def record(self, command: str) -> dict[str, Any]:
        self.say(command)
        while (found := self.read()) == "live":
            pass
        assert isinstance(found, dict), f"no answer to {command}"
        return found

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()


class Program:
    """A program with a bus, and what it writes."""

    def __init__(self, row: Row, link: str, folder: Path) -> None:
        self.row = row
        self.folder = folder
        self.written: dict[str, list[str]] = {"out": [], "err": []}
        self.terminal = -1
        self.unread = -1  # of standard output, which nobody reads
        path = os.pathsep.join([str(KITS), str(ROOT)])
        places = dict.fromkeys(("XDG_RUNTIME_DIR", "XDG_STATE_HOME"), str(folder))
        environment = os.environ | places | {"PYTHONPATH": path}
        environment |= row.environment
        if row.program == "run":
            plant = folder / "plant.toml"
            text = plant_text(*TABLES, port=link, driver=row.driver, on_connector_loss=row.on_loss, **BUS)
            text += row.tables.replace("FOLDER", str(folder))
            plant.write_text(text, encoding="utf-8")
            files = [argument.replace("FOLDER", str(folder)) for argument in row.arguments]
            main = "ends.run" if "[probe]" in row.tables else "dpstack.cli.main"
            command = [sys.executable, "-m", main, "run", str(plant)]
            big = [f"{slave.partition(':')[0]}={BIG_OUTPUTS}" for slave in row.slaves]
            command += ["--outputs", f"4={LIVE}", f"5={LIVE_LAMPS}", *big, "--plain", *files]
        else:
            main = "ends.blocking" if row.program == "blocking" else "ends.faults"
            command = [sys.executable, "-m", main, link, row.driver, row.way]
        stdin = stdout = subprocess.PIPE
        if row.reader_goes:
            self.unread, stdout = os.pipe()
        if row.terminal:
            self.terminal, theirs = os.openpty()
            stdin = stdout = theirs
        if row.stdout is not None:
            stdout = os.open(folder / row.stdout, os.O_CREAT | os.O_WRONLY)
        self.process = subprocess.Popen(
            command,
            stdin=stdin,
            stdout=stdout,
            stderr=subprocess.PIPE,
            env=environment,
            cwd=folder,
            start_new_session=True,  # nobody could continue it after SIGTSTP, wherever the test was started
            preexec_fn=functools.partial(prepare, row) if row.terminal or row.limits else None,
        )
        for fd in {stdin, stdout} - {subprocess.PIPE}:
            os.close(fd)
        self.readers = [self.follow("err", self.process.stderr)]
        if self.process.stdout is not None:
            self.readers.append(self.follow("out", self.process.stdout))

    @property
    def pid(self) -> int:
        return self.process.pid

    @property
    def bus_process(self) -> int:
        """Its only child. The list of children may miss one that is there (proc_pid_children(5))."""
        path = Path(f"/proc/{self.pid}/task/{self.pid}/children")
        eventually(lambda: bool(path.read_text().split()), "a bus process", 5)
        return int(path.read_text().split()[0])

    def follow(self, name: str, pipe: Any) -> threading.Thread:
        def read() -> None:
            with contextlib.suppress(ValueError, OSError):  # closed by the test
                for line in pipe:
                    self.written[name].append(line.decode(errors="replace").rstrip("\n"))

        thread = threading.Thread(target=read, daemon=True)
        thread.start()
        return thread

    def settle(self, acted: float, exchanges: Callable[[], bool]) -> str:
        """The outcome: "stopped", "goes on", or how the program ended. ``exchanges``: whether it exchanges data."""
        end = time.monotonic() + HANG_S
        while time.monotonic() < end:
            code = self.process.poll()
            if code is not None:
                return f"killed by {name_of(-code)}" if code < 0 else str(code)
            if state_of(self.pid) == "T" and self.row.group in ("signal", "stopped"):
                return "stopped"
            if "goes on" in self.written["out"]:
                return "goes on"
            late = time.monotonic() - acted
            if self.row.may_go_on and late > (ALIVE_S if exchanges() else LONG_ALIVE_S):
                return "goes on"
            time.sleep(0.05)
        return "HANGS"

    def close(self) -> None:
        """The program first: it has no time to say anything about the end of its bus process."""
        children = ""
        with contextlib.suppress(OSError):
            children = Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text()
        self.process.kill()
        for child in children.split():
            with contextlib.suppress(OSError):
                os.kill(int(child), signal.SIGKILL)
        self.process.wait()
        for thread in self.readers:
            thread.join(5)
        if self.process.stdin is not None:
            with contextlib.suppress(OSError):
                self.process.stdin.close()
        if not any(thread.is_alive() for thread in self.readers):  # a read that goes on holds the pipe
            for pipe in (self.process.stdout, self.process.stderr):
                if pipe is not None:
                    pipe.close()
        for fd in (self.terminal, self.unread):
            if fd >= 0:
                os.close(fd)
        self.terminal = self.unread = -1


Act = Callable[["Program", Recorder], None]


@dataclass
class Row:
    """One row. ``program``: application, blocking, run. ``way``: of ``ends.faults`` or ``ends.blocking``; ``act``: what
    happens to it once its outputs are live, where it does nothing itself. ``may_go_on``: it may outlive this.
    ``quick``: measured in ``make test``. ``reader_goes``: its standard output is a pipe that ``act`` closes.
    ``may_tell``: the beginning of a text that it tells at some loads of the computer only; it is left out."""

    group: str
    text: str
    driver: str
    program: str = "application"
    way: str = "waits"
    act: Act | None = None
    may_go_on: bool = False
    quick: bool = False
    terminal: bool = False
    reader_goes: bool = False
    stdout: str | None = None
    arguments: tuple[str, ...] = ()
    #: more of the configuration of ``dpstack run``, and the slaves in it
    tables: str = ""
    on_loss: str = "safe"
    slaves: tuple[str, ...] = ()
    #: ``act`` comes when the program has written this, and not when outputs are live
    writes: str = ""
    environment: dict[str, str] = field(default_factory=dict)
    limits: dict[int, int] = field(default_factory=dict)
    ignored: int = 0
    may_tell: str | None = None

    @property
    def key(self) -> str:
        return f"{self.group}: {self.text}; {self.program}, {self.driver}"


def prepare(row: Row) -> None:
    """In the new process."""
    if row.terminal:
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    if row.ignored:
        signal.signal(row.ignored, signal.SIG_IGN)
    for which, most in row.limits.items():
        resource.setrlimit(which, (most, resource.getrlimit(which)[1]))


def name_of(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"SIGRTMIN+{number - signal.SIGRTMIN}"


def state_of(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return ""


# --- what happens to a program ----------------------------------------------------------------------------------------


def send(number: int) -> Act:
    return lambda program, _: os.kill(program.pid, number)


def send_to_bus_process(number: int) -> Act:
    return lambda program, _: os.kill(program.bus_process, number)


def send_twice(number: int) -> Act:
    """Signals within a second are the same one to ``dpstack run``."""

    def act(program: Program, _: Recorder) -> None:
        os.kill(program.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            program.process.wait(1.1)
        with contextlib.suppress(ProcessLookupError):
            os.kill(program.pid, number)

    return act


def end_beside_a_connector(program: Program, recorder: Recorder) -> None:
    """The outputs are safe while the program still waits for its connector, or for what that has left behind."""
    os.kill(program.pid, signal.SIGTERM)
    eventually(lambda: "clear" in recorder.record("look")["4"]["words"], "Clear")
    assert program.process.poll() is None, "nobody has waited for the connector"


def go(program: Program, _: Recorder) -> None:
    """The connector, which has ordered the outputs, fails."""
    eventually(lambda: "ordered" in program.written["out"], "the order of the connector")
    (program.folder / "go").touch()


def go_and_settle(program: Program, recorder: Recorder) -> None:
    """The connector blocks the event loop until outputs are safe, or for the time in which they would be."""
    go(program, recorder)
    if program.row.driver == "asyncio":
        eventually(functools.partial(watchdog_acted, recorder), "the watchdog")
    elif program.row.on_loss == "safe":
        eventually(lambda: "clear" in recorder.record("look")["4"]["words"], "Clear")
    else:
        time.sleep(1.5 * CONNECTORS_HANG_S)


def order_and_kill(program: Program, _: Recorder) -> None:
    eventually(lambda: "ordered" in program.written["out"], "the order of the connector")
    os.kill(program.pid, signal.SIGKILL)


def hang_up(_: Program, recorder: Recorder) -> None:
    recorder.say("hang up")


def close_terminal(program: Program, _: Recorder) -> None:
    os.close(program.terminal)
    program.terminal = -1


def lose_reader(program: Program, _: Recorder) -> None:
    os.close(program.unread)
    program.unread = -1


def stop(program: Program, recorder: Recorder) -> None:
    """Stopped until outputs are safe; with a bus process and no watchdog for the time in which they would be."""
    os.kill(program.pid, signal.SIGSTOP)
    if program.row.way == "waits_alive":
        eventually(lambda: "clear" in recorder.record("look")["4"]["words"], "Clear")
    elif program.row.driver == "asyncio":
        eventually(functools.partial(watchdog_acted, recorder), "the watchdog")
    else:
        time.sleep(1.5 * WATCHDOG_MS / 1000)


def stop_and_go_on(program: Program, recorder: Recorder) -> None:
    stop(program, recorder)
    os.kill(program.pid, signal.SIGCONT)
    eventually(functools.partial(exchanges, recorder), "data exchange")


def stop_bus_process(program: Program, recorder: Recorder) -> None:
    """Stopped until the watchdog has acted, and the program knows of it."""
    os.kill(program.bus_process, signal.SIGSTOP)
    eventually(functools.partial(watchdog_acted, recorder), "the watchdog")
    eventually(lambda: any("no sign of life" in line for line in program.written["out"]), "the program's word")


def stop_bus_process_and_go_on(program: Program, recorder: Recorder) -> None:
    stop_bus_process(program, recorder)
    os.kill(program.bus_process, signal.SIGCONT)
    eventually(functools.partial(exchanges, recorder), "data exchange")


def stop_bus_process_and_end(program: Program, recorder: Recorder) -> None:
    stop_bus_process(program, recorder)
    os.kill(program.pid, signal.SIGINT)


def watchdog_acted(recorder: Recorder) -> bool:
    return recorder.record("look")["4"]["expired_ms"] is not None


def no_room(program: Program) -> None:
    """No file of the program may grow any more."""
    for pid in processes_of(program):
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (1, 1))


def full_store(program: Program, recorder: Recorder) -> None:
    """No file may grow, the store of MQTT meets this, and the bus goes on; then comes an ordered end."""
    no_room(program)
    text = "are not kept on the disk"
    eventually(lambda: any(text in line for line in program.written["out"]), "the remark of the store")
    assert exchanges(recorder), "the bus does not go on"
    os.kill(program.pid, signal.SIGTERM)


def full_disk(program: Program, _: Recorder) -> None:
    no_room(program)
    time.sleep(1.2)  # so long the log and the recording are kept back at most
    os.kill(program.pid, signal.SIGTERM)


def no_handles(program: Program, _: Recorder) -> None:
    """The limit is the lowest number that is free."""
    for pid in processes_of(program):
        used = {int(name) for name in os.listdir(f"/proc/{pid}/fd")}
        free = min(set(range(len(used) + 1)) - used)
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (free, free))
    os.kill(program.pid, signal.SIGTERM)


def no_memory(program: Program, _: Recorder) -> None:
    """No page more than each process has now. Later the master may have none, and send Clear without its machine:
    that is another row, and its moment would depend on the load of the computer."""
    for pid in processes_of(program):
        size = int(Path(f"/proc/{pid}/statm").read_text().split()[0]) * resource.getpagesize()
        resource.prlimit(pid, resource.RLIMIT_AS, (size, size))
    os.kill(program.pid, signal.SIGTERM)


def processes_of(program: Program) -> Iterator[int]:
    yield program.pid
    if program.row.driver == "process":
        yield program.bus_process


# --- the rows ---------------------------------------------------------------------------------------------------------

#: of the application itself: the method of ``ends.faults``, the text, whether it is measured in ``make test``
WAYS: Final = {
    "end": {
        "the_block_ends": "the `async with` block ends",
        "an_exception": "an exception leaves the block",
        "nobody_closes_it": "`open()` without `close()`, or a generator that is abandoned",
        "closed_in_another_loop": "it is closed in another event loop than its own, which does not run",
        "the_loop_is_closed": "the loop is closed before the bus",
        "the_interpreter_ends": "the interpreter ends, and the loop stands still",
        "in_a_daemon_thread": "the interpreter ends, and the loop runs in a daemon thread",
        "os_exit": "`os._exit()`",
        "os_execv": "`os.execv()`: another program takes its place",
        "a_forked_child_ends": "a forked child ends",
    },
    "exception": {
        "in_a_plugin": "in a drive plugin",
        "sys_exit_in_a_plugin": "`sys.exit()` in a drive plugin",
        "in_a_reader": "in a callback of `add_reader()`",
        "in_a_done_callback": "in a done-callback of a task",
        "in_a_task": "in a task that nobody awaits",
        "in_on_event": "in `on_event`",
        "in_a_thread": "in a thread",
        "in_a_signal_handler": "in a signal handler",
        "sys_exit_in_a_callback": "`sys.exit()` in a callback",
        "sys_exit_in_on_event": "`sys.exit()` in `on_event`",
        "a_defect": "in the protocol machine (a defect of dpstack)",
    },
    "connector": {
        "a_connector_raises": "it fails",
        "a_connector_never_ends": "it does not end, and the block ends",
        "a_connector_never_ends_and_an_exception": "it does not end, and an exception leaves the block",
    },
    "cancellation": {
        "cancelled_once": "once",
        "cancelled_many_times": "1000 times, one every 0.1 ms",
        "anyio_scope": "by a scope of anyio, a task group, a time limit",
        "ctrl_c_three_times": "by Ctrl-C, three times",
        "ctrl_c_without_asyncio_run": "by Ctrl-C, again and again, without `asyncio.run()`",
    },
    "no handles": {
        "no_handles": "as the block ends",
        "no_handles_in_the_loop": "while the bus runs",
        "no_handles_and_the_loop_is_closed": "as the loop is closed before the bus",
        "no_handles_and_the_interpreter_ends": "as the interpreter ends, and the loop stands still",
        "no_handles_and_a_forked_child_ends": "as a forked child ends",
        "no_handles_before_the_start": "before the bus is opened",
    },
    "no memory": {
        "memory_error_in_the_block": "`MemoryError` leaves the block",
        "no_memory_before_the_start": "before the bus is opened",
        "no_memory_in_the_block": "the block has used up all there is, and ends",
        "no_memory_in_the_machine": "`MemoryError` in the protocol machine",
    },
}
#: of a script with ``dpstack.blocking``: the method of ``ends.blocking``
BLOCKING_WAYS: Final = {
    "end": {
        "the_block_ends": "the `with` block ends",
        "an_exception": "an exception leaves the block",
        "sys_exit": "`sys.exit()` in the block",
        "the_interpreter_ends": "the interpreter ends, and nobody closed the bus (a REPL)",
        "the_main_thread_ends": "an exception ends the main thread, and another thread still waits",
        "os_exit": "`os._exit()`",
        "os_execv": "`os.execv()`: another program takes its place",
        "a_forked_child_ends": "a forked child ends",
    },
    "exception": {
        "in_a_signal_handler": "in a signal handler",
        "sys_exit_in_on_event": "`sys.exit()` in `on_event`",
    },
    "cancellation": {
        "ctrl_c_three_times": "by Ctrl-C, three times",
        "ctrl_c_is_caught": "by Ctrl-C in a waiting call, and the program catches it",
    },
}
#: ways that the bus process does not have: the machines are out of the test's reach there
ASYNCIO_ONLY: Final = {"a_defect", "no_memory_in_the_machine"}
QUICK: Final = {
    ("the_interpreter_ends", "asyncio"),
    ("no_handles_and_a_forked_child_ends", "asyncio"),
    ("os_exit", "process"),
}
#: a script in which nobody closes the bus
QUICK_BLOCKING: Final = {("the_interpreter_ends", "process")}
#: of the real-time signals, which are alike, the first and the last
SIGNALS: Final = sorted(n for n in signal.valid_signals() if not signal.SIGRTMIN < n < signal.SIGRTMAX)
#: of a terminal, and that end a program
TO_BUS_PROCESS: Final = (
    *(signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGTERM, signal.SIGUSR1),
    *(signal.SIGSEGV, signal.SIGKILL),
)
STOPS: Final = {
    "stopped (SIGSTOP)": stop_bus_process,
    "stopped (SIGSTOP), and goes on": stop_bus_process_and_go_on,
}
#: how a connector hangs at its end: the key ``fails`` of ``probe_connector``
CONNECTOR_ENDS: Final = {
    "end": "it does not end",
    "thread": "a thread of it goes on at its end",
    "loop": "it blocks its event loop at its end",
}
#: of a connector that has ordered outputs: the key ``fails`` of ``probe_connector``; text, act, ``on_connector_loss``
LOSSES: Final[dict[str, tuple[str, Act, tuple[str | None, ...]]]] = {
    "fault": ("it has ordered outputs, and ends by a fault", go, ("safe", "keep")),
    "blocks": ("it has ordered outputs, and blocks its loop", go_and_settle, ("safe", "keep")),
    "no": ("it has ordered outputs, and is killed with its program (SIGKILL)", order_and_kill, (None,)),
    "old": ("the program was started again, and an order of before comes", go, (None,)),
}
#: file descriptors with which ``dpstack run`` begins, but cannot open its bus
FEW_HANDLES: Final = {"asyncio": 6, "process": 10}
#: at the start of ``dpstack run`` and of applications: no room for the memory that bus process and application share
SMALL: Final = {resource.RLIMIT_FSIZE: 1 << 20}


def rows() -> list[Row]:
    found = [
        Row(group, text, driver, way=way, quick=(way, driver) in QUICK)
        for group, ways in WAYS.items()
        for way, text in ways.items()
        for driver in DRIVERS
        if not (driver == "process" and way in ASYNCIO_ONLY)
    ]
    for driver in DRIVERS:
        script = functools.partial(Row, driver=driver, program="blocking")
        found += [
            script(group, text, way=way, quick=(way, driver) in QUICK_BLOCKING)
            for group, ways in BLOCKING_WAYS.items()
            for way, text in ways.items()
        ]
        found += [
            script("cancellation", "by Ctrl-C in a waiting call", act=send(signal.SIGINT)),
            *(script("end", f"it gets {name_of(n)}", act=send(n)) for n in (signal.SIGTERM, signal.SIGKILL)),
        ]
        for program in ("application", "run"):
            make = functools.partial(Row, driver=driver, program=program)
            if driver == "asyncio" or program == "application":
                found.append(make("stopped", "by SIGSTOP, and goes on", act=stop_and_go_on, may_go_on=True))
            found += [
                *(make("signal", name_of(n), act=send(n), may_go_on=True) for n in SIGNALS),
                make("terminal", "closed", act=close_terminal, terminal=True),
                make("port", "lost", act=hang_up, may_go_on=True),
                make("full disk", "of Python's compiled files", act=send(signal.SIGINT), environment=NO_CACHE),
                make("full disk", "of shared memory, before the bus is opened", limits=SMALL, act=send(signal.SIGINT)),
            ]
        run = functools.partial(Row, driver=driver, program="run")
        few = {resource.RLIMIT_NOFILE: FEW_HANDLES[driver]}
        files = ("--record", "FOLDER/rows.csv", "--log", "FOLDER/events.log")
        end = send(signal.SIGTERM)
        found += [
            run("no handles", "too few of them to open the bus", limits=few),
            run("no handles", "while the bus runs, and SIGTERM", act=no_handles),
            run("no memory", "while the bus runs, and SIGTERM at once", act=no_memory),
        ]
        faced = functools.partial(run, "connector", tables=CONNECTORS, may_tell=NO_BROKER)
        found += [
            *(
                faced(f"metrics, MQTT, OPC UA and EPICS, and {name_of(n)}", act=send(n))
                for n in (signal.SIGTERM, signal.SIGKILL)
            ),
            faced("metrics, MQTT, OPC UA and EPICS, and SIGINT twice", act=send_twice(signal.SIGINT)),
            *(
                run("connector", f"{text}, and SIGTERM", tables=PROBE.format(fails), act=end_beside_a_connector)
                for fails, text in CONNECTOR_ENDS.items()
            ),
            *(
                run(
                    "connector",
                    text if rule is None else f'{text}, `on_connector_loss = "{rule}"`',
                    tables=ORDERING.format(fails),
                    on_loss=rule or "safe",
                    act=act,
                    may_go_on=fails != "no",
                )
                for fails, (text, act, rules) in LOSSES.items()
                for rule in rules
            ),
            run("connector", "it makes its nodes, and SIGTERM", tables=PROBE.format("build"), writes="builds", act=end),
            faced(
                "metrics, MQTT, OPC UA and EPICS of 7168 values at their start, and SIGTERM",
                tables=BIG + CONNECTORS,
                slaves=BIG_SLAVES,
                act=end,
                may_tell="dpstack: mqtt: ",  # of values that the disk has not taken by then
            ),
            run(
                "full disk",
                "of the store of MQTT, without a broker",
                tables=CONNECTORS,
                act=full_store,
                may_tell=NO_BROKER,
            ),
        ]
        for option in ("--plain", "--json"):
            text = f"its reader has gone (`{option}`)"
            found.append(run("standard output", text, reader_goes=True, arguments=(option,), act=lose_reader))
        nohup = functools.partial(run, ignored=signal.SIGHUP, terminal=True, may_go_on=True)
        found += [
            nohup("terminal", "closed, and SIGHUP is ignored (nohup)", act=close_terminal),
            run("full disk", "of standard output", stdout="out.jsonl", arguments=("--json",), act=full_disk),
            run("full disk", "of recording and log", arguments=files, act=full_disk),
        ]
    for program in ("application", "run"):
        make = functools.partial(Row, driver="process", program=program, may_go_on=True)
        found += [make("bus process", name_of(n), act=send_to_bus_process(n)) for n in TO_BUS_PROCESS]
        found += [make("bus process", text, act=act) for text, act in STOPS.items()]
        # noticed if a telegram is due before the bus process reads the order to end
        text = "stopped (SIGSTOP), and the program gets SIGINT"
        found.append(make("bus process", text, act=stop_bus_process_and_end, may_tell="Stalled"))
    beside = functools.partial(
        Row, "bus process", driver="process", program="run", tables=CONNECTORS, may_go_on=True, may_tell=NO_BROKER
    )
    found += [
        beside(f"{name_of(n)}, beside metrics, MQTT, OPC UA and EPICS", act=send_to_bus_process(n))
        for n in (signal.SIGTERM, signal.SIGKILL)
    ]
    watched = functools.partial(Row, "stopped", driver="process", way="waits_alive", may_go_on=True)
    found += [
        watched("by SIGSTOP, with `application_watchdog_ms`", act=stop),
        watched("by SIGSTOP, with `application_watchdog_ms`, and goes on", act=stop_and_go_on),
        Row("no handles", "too few of them to open the bus", "process", act=send(signal.SIGINT), limits=few),
    ]
    return found


NO_CACHE: Final = {"PYTHONPYCACHEPREFIX": "/dev/full/cache"}


# --- measuring --------------------------------------------------------------------------------------------------------


def measure(row: Row) -> dict[str, str]:
    """The last octets to the slaves, the cause of their safe state, the texts that were printed, and the exit code."""
    with tempfile.TemporaryDirectory() as name:
        recorder = Recorder(Path(name), row.slaves)
        program = Program(row, recorder.link, Path(name))
        try:
            if row.writes:
                eventually(lambda: row.writes in program.written["out"], "the program's own word")
            is_live = not row.writes and wait_until_live(program, recorder)
            if (is_live or row.writes) and row.act is not None:
                recorder.say("mark")
                row.act(program, recorder)
            outcome = program.settle(time.monotonic(), functools.partial(exchanges, recorder))
            lives_on = outcome == "goes on" or (outcome == "stopped" and exchanges(recorder))
            record = recorder.record("look" if lives_on else "end")
            program.close()
            return {**at_slaves(row, record, outcome, is_live=is_live), "told": told(program), "exit": outcome}
        finally:
            program.close()
            recorder.close()


def exchanges(recorder: Recorder) -> bool:
    """Whether slave 4 exchanges data now."""
    before = recorder.record("look")["4"]["exchanges"]
    time.sleep(0.1)  # ten rotations and more of the slowest plant
    return bool(recorder.record("look")["4"]["exchanges"] > before)


def wait_until_live(program: Program, recorder: Recorder) -> bool:
    """Whether the slaves have live outputs, and an application to which something will happen knows it."""
    if not slaves_are_live(program, recorder):
        return False
    if program.row.program != "run" and program.row.act is not None and program.process.stdout is not None:
        eventually(lambda: "live" in program.written["out"], "the application's own word")
    return True


def slaves_are_live(program: Program, recorder: Recorder) -> bool:
    end = time.monotonic() + HANG_S
    while time.monotonic() < end:
        if recorder.read(0.05) == "live":
            return True
        if program.process.poll() is not None:
            return bool(recorder.read(0.05) == "live")
    raise AssertionError(f"{program.row.key}: neither live nor ended: {program.written}")


def at_slaves(row: Row, record: dict[str, Any], outcome: str, *, is_live: bool) -> dict[str, str]:
    if not is_live:
        return {"last": "no outputs", "safe by": "", "without watchdog": ""}
    valves, lamps = record["4"], record["5"]
    words = [LIVE, *valves["words"]]
    before, rest = after_live(words, LIVE)
    outputs = [word for word in before if word != "clear"]
    last = "live outputs"
    if rest:
        last = "safe values, Clear" if outputs[:1] == [SAFE] else "Clear"
    elif outputs:
        last = "safe values" if outputs[0] == SAFE else "zeros"
    expired = valves["expired_ms"]
    if expired is not None:
        assert expired >= WATCHDOG_MS, f"{row.key}: after {expired} ms"
    if last != "live outputs":
        safe = "telegrams"
    elif outcome in ("goes on", "stopped") and (expired is None or row.group not in _PAUSES):
        safe = ""
    else:
        safe = f"its watchdog, {WATCHDOG_MS} ms after the last telegram" if expired is not None else "nothing"
    kept = "live outputs" if lamps["outputs"] == LIVE_LAMPS else "safe"
    return {"last": last, "safe by": safe, "without watchdog": kept if safe else ""}


#: what may keep a bus that goes on from asking its slaves
_PAUSES: Final = ("stopped", "port", "bus process", "signal", "connector")
#: parts of texts that differ from run to run
_VARIABLE: Final = (
    (re.compile(r"/tmp/\w+/line"), "PORT"),
    (re.compile(r"/tmp/\w+/"), ""),
    (re.compile(r"pid \d+"), "pid N"),
    (re.compile(r"vanished \([^)]*\)"), "vanished (WHY)"),
    (re.compile(r"\b\d+(\.\d+)? (ms|s|rows|rounds|telegrams|values)\b"), r"N \2"),
    (re.compile(r"\bline \d+\b"), "line N"),
)
#: what Python itself says; and events of a busy computer
_NO_STORY: Final = re.compile(
    r"^($|  |Traceback|Task |task:|future:|handle:|source_traceback|Exception |During|The above|sys:1|AttributeError)"
    r"|^SlaveFaulted: .*(taken up again|wants parameters again)|^Notice: .*telegrams dropped|^dpstack: probe: born "
)
#: notices about connectors that have given orders
_LOSS: Final = re.compile(r" *[\d.]+ s  connectors: (.*(?: fault of |safe values are|stay as|refused|sign of life).*)")
_MOST: Final = 150


def told(program: Program) -> str:
    """Events, log and standard error, the first sentence of each."""
    lines = [line.removeprefix("event: ") for line in program.written["out"] if line.startswith("event: ")]
    if "go =" in program.row.tables:
        lines += [found[1] for line in program.written["out"] if (found := _LOSS.match(line))]
    lines += [line.removeprefix("dpstack.errors.") for line in program.written["err"]]
    unsure = program.row.may_tell
    lines = [line for line in lines if not (_NO_STORY.search(line) or (unsure and line.startswith(unsure)))]
    return " / ".join(dict.fromkeys(map(plain, lines)))


def plain(line: str) -> str:
    for pattern, word in _VARIABLE:
        line = pattern.sub(word, line)
    line = line.rstrip(": ")  # an exception without a text
    return line if len(line) <= _MOST else line[:_MOST].rsplit(" ", 1)[0] + " ..."


def text_of(found: dict[str, dict[str, str]]) -> str:
    """One line a row."""
    lines = [f"  {json.dumps(key)}: {json.dumps(row, ensure_ascii=False)}" for key, row in found.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def kept() -> dict[str, dict[str, str]]:
    found: dict[str, dict[str, str]] = json.loads(DATA.read_text(encoding="utf-8"))
    return found


def main(wanted: list[str]) -> None:
    known = {row.key: row for row in rows()}
    names = wanted
    before = kept() if DATA.exists() else {}
    if names == ["--missing"]:
        names = [key for key in known if "last" not in before.get(key, {})]
    chosen = [row for key, row in known.items() if not wanted or any(name in key for name in names)]

    def one(row: Row) -> tuple[str, dict[str, str]]:
        try:
            return row.key, measure(row)
        except Exception as error:  # the other rows are measured all the same
            return row.key, {"exit": f"NOT MEASURED: {type(error).__name__}: {error}"}

    with ThreadPoolExecutor(int(os.environ.get("ENDS_AT_ONCE", "2"))) as pool:
        for done in as_completed([pool.submit(one, row) for row in chosen]):
            key, found = done.result()
            if before.get(key) != found:
                print(key, "\n   was", before.get(key), "\n   is ", found, flush=True)
            before[key] = found
            new = DATA.with_suffix(".new")
            new.write_text(text_of({name: before[name] for name in known if name in before}), encoding="utf-8")
            new.replace(DATA)
