"""The bus process from the inside: its host on a pty, told by octets on its socket."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
import types
from collections.abc import Callable, Iterator
from itertools import pairwise
from time import monotonic_ns
from typing import ClassVar

import pytest
from support_responder import Responder

from dpstack.dp.master.commands import AddSlave, Mode, RemoveSlave, SetMode, Shutdown
from dpstack.dp.master.events import DriveEvent
from dpstack.dp.master.settings import MasterSettings, StackSpec
from dpstack.dp.pdu import layouts
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.line.select_loop import SelectLoop
from dpstack.drivers.process import early_start
from dpstack.drivers.process import messages as m
from dpstack.drivers.process.bus_process import Host
from dpstack.drivers.process.plugins import AttachPlugin
from dpstack.drivers.process.shared_image import Area, Outputs, Picture, SharedImage, Word, make_memory
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.params import BusParams
from dpstack.phy.patience import HOST
from dpstack.trace import Notice
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S


def is_full(outbox: m.Outbox) -> bool:
    return outbox.full


def test_an_application_that_does_not_read_bounds_the_outbox() -> None:
    """Bounded: beyond the limit it says so, and what somebody waits for is still taken."""
    loop = SelectLoop()
    ours, theirs = socket.socketpair()
    with theirs:
        ours.setblocking(False)
        outbox = m.Outbox(loop, ours)
        event = m.named(Notice(t_ns=1, source="x" * 1000, message="y"))
        sent = 0
        while not is_full(outbox):
            outbox.send(m.News(events=[event]))
            sent += 1
            assert sent < 10 * m.FULL
        outbox.send(m.News(answer=m.Answer(7)))
        frames = m.Frames(m.News)
        got: list[m.News] = []

        def read() -> None:
            got.extend(frames.feed(theirs.recv(65_536)))
            if any(news.answer for news in got):
                loop.stop()

        loop.add_reader(theirs.fileno(), read)
        loop.run()
        assert len(got) == sent + 1
        assert [news.answer for news in got if news.answer is not None] == [m.Answer(7)]
        assert not is_full(outbox)
        outbox.close()
    loop.close()


class Rig:
    """A bus process's inside in this process: its host on a pty, and the application's end of its socket."""

    def __init__(self, slaves: tuple[SlaveParams, ...] = ()) -> None:
        params = BusParams.preset(1_500_000, address=2, gap=0)
        spec = StackSpec(
            params=params,
            patience=HOST,
            slaves=slaves,
            master=MasterSettings(watchdog_ms=1000),
            watched=True,
        )
        self.loop = SelectLoop()
        ours, self.sock = socket.socketpair()
        memory = make_memory()
        self.image = SharedImage(memory)
        os.close(memory)
        setup = m.SetUp(port="pty", event_char=False, rs485=True, echo=Echo.OFF, tune=False, stack=spec)
        self.host = Host(self.loop, ours, self.image, setup)
        self.host.open(["no real-time priority"])
        self.got: list[m.News] = []
        self.closed = False  # by order
        self.frames = m.Frames(m.News)

    def read(self) -> None:
        self.got += self.frames.feed(self.sock.recv(65_536))

    def close(self) -> None:
        self.sock.close()
        if not (self.over or self.closed):
            self.loop.run()  # the ordered end of a bus without an application
        self.loop.close()
        self.image.close()

    @property
    def over(self) -> bool:
        return any(news.over is not None for news in self.got)

    @property
    def told(self) -> list[str]:
        return [m.event_of(event).text for news in self.got for event in news.events]


def test_the_inputs_of_a_round_are_published_behind_the_next_telegram(monkeypatch: pytest.MonkeyPatch) -> None:
    """Encoding them takes longer than an idle time at the high rates: no telegram waits for it."""
    rig = Rig((SlaveParams(address=3, name="s", ident=0x0696, config=b"\xf3\xf1"),))
    host = rig.host
    log: list[str] = []
    put, write = host.runtime._put, Area.write

    def written(octets: bytes) -> bool:
        log.append("telegram")
        return put(octets)

    def ended(now: int) -> None:
        log.append("end of the round")
        host._on_round(now)

    def published(area: Area[object], picture: object) -> None:
        if isinstance(picture, Picture):
            log.append("picture")
        write(area, picture)

    monkeypatch.setattr(host.runtime, "_put", written)
    monkeypatch.setattr(host._master, "on_round", ended)
    monkeypatch.setattr(Area, "write", published)
    with Responder(host.runtime.port_name, ["3:0696:f3f1:12:12"]):
        host.runtime.command(GoOnline())
        host.runtime.command(SetMode(Mode.OPERATE))
        limit = monotonic_ns() + 10 * NS_PER_S

        def look() -> None:
            if log.count("end of the round") > 40 or monotonic_ns() > limit:
                rig.loop.stop()
            else:
                rig.loop.call_at(monotonic_ns() + NS_PER_MS, look)

        rig.loop.call_soon(look)
        rig.loop.run()
        rig.close()
    behind = [after for before, after in pairwise(log) if before == "end of the round"]
    assert behind.count("telegram") >= 40
    assert behind.count("picture") <= 4  # with the first states of the slave


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    yield made
    made.close()


def test_sigterm_to_both_leaves_the_end_to_the_application(rig: Rig) -> None:
    """As a service manager sends it: the end that the application has begun goes on, and is no failure."""
    rig.host.end_soon("it was ordered to end (SIGTERM)")
    for number, order in enumerate((Shutdown(), m.TakeOutputs()), 1):
        rig.sock.send(m.framed(m.Question(number, m.named(order))))
    rig.loop.call_at(time.monotonic_ns() + 400_000_000, rig.loop.stop)
    rig.loop.run()
    rig.sock.send(m.framed(m.Question(3, m.named(m.CloseBus()))))
    rig.loop.run()
    rig.sock.setblocking(True)
    rig.read()
    assert not rig.over
    assert [news.answer.number for news in rig.got if news.answer is not None] == [0, 1, 2, 3]
    rig.closed = True


def test_events_beyond_the_bound_are_dropped_counted_and_reported(rig: Rig) -> None:
    event = Notice(t_ns=1, source="x" * 1000, message="y")
    for _ in range(2_000):
        rig.host.on_events([event])
    answer = DriveEvent(t_ns=2, address=3, name="d", payload={"type": "result", "token": 9})
    rig.host.on_events([event, answer])  # somebody waits for this one
    rig.loop.add_reader(rig.sock.fileno(), rig.read)
    dropped = "the application did not read for a while: "

    def look() -> None:
        if any(dropped in text for text in rig.told):
            rig.loop.stop()
        else:
            rig.loop.call_at(time.monotonic_ns() + 10**6, look)

    look()
    rig.loop.run()
    rig.loop.remove_reader(rig.sock.fileno())
    assert rig.told[0] == "bus process: no real-time priority"
    events = rig.told.count(event.text)
    assert 100 < events < 1_000
    assert f"bus process: {dropped}{2_001 - events} events were dropped" in rig.told
    owed = [event for news in rig.got for event in news.events if event[0] == "DriveEvent"]
    assert [m.event_of(event) for event in owed] == [answer]


def test_the_reason_of_the_end_is_never_dropped(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """An application that begins to read when the bus process hangs up is told why it did."""
    hangs_up = threading.Event()

    def close(outbox: m.Outbox, real: Callable[[m.Outbox], None] = m.Outbox.close) -> None:
        hangs_up.set()
        real(outbox)

    def read() -> None:
        hangs_up.wait()
        rig.sock.setblocking(True)
        while octets := rig.sock.recv(65_536):
            rig.got += rig.frames.feed(octets)

    monkeypatch.setattr(m.Outbox, "close", close)
    reader = threading.Thread(target=read)
    reader.start()
    for _ in range(2_000):
        rig.host.on_events([Notice(t_ns=1, source="x" * 1000, message="y")])
    rig.host.end("somebody wants it")
    rig.loop.run()
    reader.join()
    rig.closed = True
    assert rig.got[-1].over == "somebody wants it"


def test_a_flood_of_orders_is_answered_in_order_and_never_piles_up(rig: Rig) -> None:
    count = 500
    rig.sock.setblocking(False)
    left = b"".join(m.framed(m.Question(n, m.named(RemoveSlave(77)))) for n in range(1, count + 1))

    def write() -> None:
        nonlocal left
        with contextlib.suppress(BlockingIOError):
            left = left[rig.sock.send(left) :]
        if not left:
            rig.loop.remove_writer(rig.sock.fileno())

    def read() -> None:
        rig.read()
        if rig.got[-1].answer is not None and rig.got[-1].answer.number == count:
            rig.loop.stop()

    rig.loop.add_writer(rig.sock.fileno(), write)
    rig.loop.add_reader(rig.sock.fileno(), read)
    rig.loop.run()
    rig.loop.remove_reader(rig.sock.fileno())
    answers = [news.answer for news in rig.got if news.answer is not None and news.answer.number]
    assert [answer.number for answer in answers] == list(range(1, count + 1))
    assert {answer.error for answer in answers} == {
        ("UsageError", "no slave with address 77 is configured (configured: none)")
    }


def test_garbage_from_the_application_ends_the_bus_in_order(rig: Rig) -> None:
    rig.sock.send(b"\xff" * 8)
    rig.loop.run()
    rig.read()
    assert "a message of 4294967295 octets" in str(rig.got[-1].over)


def asked(rig: Rig, number: int, order: object, until_ns: int = NEVER) -> m.Answer:
    """The answer to ``order``; what was told before it is in ``rig.got``."""
    rig.sock.send(m.framed(m.Question(number, m.named(order), until_ns)))

    def read() -> None:
        rig.read()
        if any(news.answer is not None and news.answer.number == number for news in rig.got):
            rig.loop.stop()

    rig.loop.add_reader(rig.sock.fileno(), read)
    rig.loop.run()
    rig.loop.remove_reader(rig.sock.fileno())
    return next(news.answer for news in rig.got if news.answer is not None and news.answer.number == number)


def run_until(rig: Rig, condition: Callable[[], bool]) -> None:
    def look() -> None:
        if condition():
            rig.loop.stop()
        else:
            rig.loop.call_at(time.monotonic_ns() + 10**6, look)

    look()
    rig.loop.run()


def test_an_order_after_its_time_limit_is_dropped_and_its_number_shows_that_it_was_looked_at(rig: Rig) -> None:
    assert asked(rig, 1, m.TakeOutputs()) == m.Answer(1)
    assert rig.image.words[Word.ORDER_TAKEN] == 1
    answer = asked(rig, 2, SetMode(Mode.OPERATE), until_ns=time.monotonic_ns())
    assert answer.error is not None
    kind, text = answer.error
    assert kind == "OrderDropped"
    assert "too late and dropped it" in text
    assert rig.image.words[Word.ORDER_TAKEN] == 2
    asked(rig, 3, m.TakeOutputs())
    modes = [news.bus.mode for news in rig.got if news.bus]
    assert modes == [Mode.CLEAR]


def test_outputs_after_their_time_limit_are_dropped_and_reported(rig: Rig) -> None:
    asked(rig, 1, AddSlave(SlaveParams(address=4, name="v", ident=1, config=b"\x20\x10")))
    late = time.monotonic_ns()
    rig.image.outputs.write({4: Outputs(late, b"\x11")})
    asked(rig, 2, m.TakeOutputs())
    assert [news.dropped for news in rig.got if news.dropped] == [{4: late}]
    assert outputs_of(rig) == b"\0"
    # the same again beside those of others is not told again; what has time is taken, without any round
    rig.image.outputs.write({4: Outputs(late, b"\x11")})
    asked(rig, 3, m.TakeOutputs())
    rig.image.outputs.write({4: Outputs(NEVER, b"\x22")})
    run_until(rig, lambda: rig.image.words[Word.OUTPUTS_TAKEN] == 3)
    assert len([news for news in rig.got if news.dropped]) == 1
    assert outputs_of(rig) == b"\x22"


def outputs_of(rig: Rig) -> bytes:
    return rig.host._master.handlers[4].image.outputs


def test_the_heartbeat_goes_on_whatever_the_application_does(rig: Rig) -> None:
    before = rig.image.words[Word.HEARTBEAT]
    run_until(rig, lambda: rig.image.words[Word.HEARTBEAT] > before + 100_000_000)
    counters = rig.image.counters.read_new()
    assert counters is not None
    assert counters.t_ns > before


def test_an_application_that_found_the_bus_process_silent_gets_the_whole_state_anew(rig: Rig) -> None:
    asked(rig, 1, AddSlave(SlaveParams(address=4, name="v", ident=1, config=b"\x20\x10")))
    told = len(rig.got)
    rig.image.words[Word.SILENCES] = 7
    run_until(rig, lambda: rig.host._silences == 7)
    rig.sock.setblocking(True)
    while not any(news.silence for news in rig.got[told:]):
        rig.read()
    (news,) = [news for news in rig.got[told:] if news.silence]
    assert news.silence == 7
    assert news.bus is not None
    assert set(news.slaves) == {4}


def asked_beside(rig: Rig, order: object) -> tuple[list[int], m.Answer]:
    """The numbers of the answers to an order whose work takes long (1) and to one that came after it (2), and the
    answer to the first one."""
    for number, one in enumerate((order, m.TakeOutputs()), 1):
        rig.sock.send(m.framed(m.Question(number, m.named(one))))
    asked(rig, 3, m.TakeOutputs())
    released.set()

    def answers() -> list[m.Answer]:
        return [news.answer for news in rig.got if news.answer is not None and 0 < news.answer.number < 3]

    rig.loop.add_reader(rig.sock.fileno(), rig.read)
    run_until(rig, lambda: len(answers()) == 2)
    rig.loop.remove_reader(rig.sock.fileno())
    return [answer.number for answer in answers()], answers()[-1]


#: what a plugin of these tests waits for while it is made
released = threading.Event()


class SlowProfile:
    """A drive whose module takes long to import; ``threads``: in which it was."""

    threads: ClassVar[list[str]] = []

    def __init__(self, argument: str) -> None:
        self.threads.append(threading.current_thread().name)
        assert released.wait(10)
        if argument == "exit":
            sys.exit(3)

    def core(self, *_: object, **__: object) -> object:
        return self


@pytest.fixture
def slow() -> str:
    """Where a bus process finds it."""
    released.clear()
    SlowProfile.threads.clear()
    return f"{__name__}:{SlowProfile.__name__}"


def test_a_drive_is_imported_beside_the_running_bus(rig: Rig, slow: str) -> None:
    asked(rig, 1, AddSlave(SlaveParams(address=4, name="v", ident=1, config=b"\x20\x10")))
    rig.got.clear()
    order, answer = asked_beside(rig, AttachPlugin(address=4, place=slow, argument="x", name="v"))
    assert order == [2, 1]  # the bus has carried out the later order meanwhile
    assert answer.error is None
    assert SlowProfile.threads == ["beside the bus"]
    assert isinstance(rig.host._master.handlers[4].image.plugin, SlowProfile)


@pytest.mark.parametrize(
    ("address", "argument", "text"),
    [
        (4, "exit", "a plugin ended its import with SystemExit"),
        (5, "x", "no slave with address 5 in the bus process"),
        (4, "", "makes no cyclic unit"),
    ],
)
def test_an_import_beside_the_bus_that_fails_is_the_answer(
    rig: Rig, slow: str, address: int, argument: str, text: str
) -> None:
    asked(rig, 1, AddSlave(SlaveParams(address=4, name="v", ident=1, config=b"\x20\x10")))
    rig.got.clear()
    released.set()
    place = slow if argument else "os:path"
    answer = asked(rig, 2, AttachPlugin(address=address, place=place, argument=argument, name="v"))
    assert answer.error is not None
    assert text in answer.error[1]
    assert rig.host._master.handlers[4].image.plugin is None


_LIKE_A_BUS_PROCESS = """
import builtins, sys
from dpstack.drivers.process.plugins import core_at
from dpstack.errors import ConfigError
print("site" in sys.modules, hasattr(builtins, "exit"))
try:
    core_at("no_such_package:drive")
except ConfigError as error:
    print("No module named 'no_such_package'" in str(error), hasattr(builtins, "exit"))
"""


def test_plugins_are_imported_in_a_process_that_is_prepared_as_any_other() -> None:
    """Packages add to the import of modules by the module site, without which a bus process begins."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}
    command = [sys.executable, "-P", "-S", "-c", _LIKE_A_BUS_PROCESS]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False", "True", "True"]


@pytest.mark.parametrize("name", ["sitecustomize", "usercustomize", ""])
def test_an_installation_that_changes_each_program_changes_the_bus_process_too(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands: list[list[str]] = []
    monkeypatch.setattr(subprocess, "Popen", lambda command, **_: commands.append(command))
    for module in ("sitecustomize", "usercustomize"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    if name:
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    early_start.started(3, 4)
    ((program, *options, package, _sock, _memory, _pid),) = commands
    assert (program, package) == (sys.executable, "dpstack.drivers.process")
    assert options == (["-P", "-m"] if name else ["-P", "-S", "-m"])


def test_a_slave_that_was_removed_meanwhile_gets_no_drive(rig: Rig, slow: str) -> None:
    asked(rig, 1, AddSlave(SlaveParams(address=4, name="v", ident=1, config=b"\x20\x10")))
    rig.sock.send(m.framed(m.Question(2, m.named(AttachPlugin(address=4, place=slow, argument="x", name="v")))))
    asked(rig, 3, RemoveSlave(4))
    released.set()
    run_until(rig, lambda: 4 not in rig.host._master.handlers)
    answer = asked(rig, 4, m.LoadServices())
    assert answer.error is None
    (late,) = [n.answer for n in rig.got if n.answer is not None and n.answer.number == 2]
    assert late.error == ("UsageError", "no slave with address 4 in the bus process")


def test_construct_is_loaded_with_the_bus_for_slaves_with_dpv1_and_otherwise_beside_it(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: list[str] = []
    monkeypatch.setattr(layouts, "load", lambda: threads.append(threading.current_thread().name))
    asked(rig, 1, GoOnline())
    assert threads == []
    asked(rig, 2, m.LoadServices())
    assert threads == ["beside the bus"]
    threads.clear()
    dpv1 = Rig((SlaveParams(address=4, name="v", ident=1, config=b"\x20\x10", user_prm=b"\x80\0\0", dpv1=Dpv1()),))
    asked(dpv1, 1, m.TakeOutputs())
    assert threads == []  # the application has not gone online
    for number in (2, 3):
        asked(dpv1, number, GoOnline())
    assert threads == ["MainThread"]
    dpv1.close()


@pytest.mark.parametrize("orders", [(Shutdown(), m.CloseBus()), (GoOffline(), m.CloseBus())], ids=["port", "ring"])
def test_orders_of_the_end_that_come_all_at_once_do_not_cut_it_short(rig: Rig, orders: tuple[object, ...]) -> None:
    """The application ended the bus while this process was stopped, and waited for no answer."""
    rig.closed = True
    asked(rig, 1, GoOnline())
    asked(rig, 2, SetMode(Mode.CLEAR))
    begun = time.monotonic_ns()
    while not any("claimed the token" in text for text in rig.told):
        assert time.monotonic_ns() - begun < 10 * NS_PER_S
        asked(rig, 3, m.TakeOutputs())
        rig.got = [news for news in rig.got if news.answer is None]
    for number, order in enumerate(orders, 4):
        rig.sock.send(m.framed(m.Question(number, m.named(order))))
    rig.loop.run()
    rig.read()
    # nobody reads the other end of this line: a slow computer may hear of dropped telegrams after it
    assert rig.told.index("station 2 left the token ring: ordered") > rig.told.index(
        "master: stopped: safe values and Clear were sent"
    )
    assert rig.over
