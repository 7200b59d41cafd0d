"""The application's view of a bus process after each of its events, beside the machines' own at that moment.

The bus process sends only the slaves that have changed. The line has slaves of octets that fall silent, refuse, change
their diagnosis and raise alarms; slaves come, go and change their parameters.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, Final
from unittest import mock

from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from property_kit import examples

from dpstack.dp.master.commands import (
    ActivateSlave,
    AddSlave,
    DeactivateSlave,
    Mode,
    RemoveSlave,
    ReparameteriseSlave,
    SetMode,
)
from dpstack.dp.master.events import OutputsWithheld, SlaveEvent, SlaveState
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.alarm_orders import AcknowledgeAlarm, HoldAlarms
from dpstack.drivers.process import messages
from dpstack.drivers.process.bus_process import Host
from dpstack.drivers.process.client import ProcessRuntime
from dpstack.drivers.process.shared_image import Outputs
from dpstack.drivers.snapshots import SlaveSnapshot
from dpstack.drivers.stack import Stack
from dpstack.fdl.commands import GoOnline
from dpstack.machine import LineDown, LineUp, Order
from dpstack.trace import Event
from dpstack.units import NEVER
from tests.fuzz.octet_line import DH, RS, Asked, CorrectSlave
from tests.fuzz.targets import process_server
from tests.fuzz.targets.process_server import GIVEN, MS, SAFE, FakeRuntime, Run, patched

_ADDRESSES: Final = (3, 4, 5)
_CONFIG: Final = b"\x10\x21"
_ALARMS: Final = ("process", "diagnostic", "update")
_EXTENDED: Final = {
    "extended": bytes.fromhex("02 80 03"),
    "alarm": bytes.fromhex("05 02 01 01 77"),
    "status": bytes.fromhex("05 81 01 00 55"),
    "malformed": bytes.fromhex("03 02 01"),
}
#: what a slave does from some moment on
_MOODS: Final = (
    "good",
    "silent",
    "refuses data",
    "refuses services",
    "wants parameters",
    "static",
    "other ident",
    "foreign",
    "not ready",
    "configuration fault",
    "wrong length",
    *_EXTENDED,
)
_MODES: Final = (Mode.OPERATE, Mode.CLEAR, Mode.STOP)


def params(address: int, *, dpv1: bool = True, watchdog_ms: int = 500, **more: Any) -> SlaveParams:
    return SlaveParams(
        address=address,
        name=f"s{address}",
        ident=1,
        config=_CONFIG,
        user_prm=bytes(3) if dpv1 else b"",
        dpv1=Dpv1(alarms=_ALARMS, alarm_mode=0) if dpv1 else None,
        watchdog_ms=watchdog_ms,
        **more,
    )


class MoodySlave(CorrectSlave):
    """Does what its ``mood`` says; asks for its diagnosis (DH) once after each change of mood."""

    mood = "good"
    calls = False

    def change(self, mood: str) -> None:
        self.mood, self.calls = mood, True
        if mood == "wants parameters":
            self.restart()

    def _served(self, asked: Asked) -> bytes | None:
        mood = self.mood
        if mood == "silent":
            return None
        if mood == "refuses services" and asked.dsap is not None:
            return asked.refusal(RS)
        if asked.dsap == 60 and not asked.status:
            return self._diagnosis(asked)
        if asked.dsap is None and not asked.status:
            if mood == "refuses data" or (mood == "not ready" and not self.exchanges):
                return asked.refusal(RS)
            served = super()._served(asked)
            if self.ready and mood == "wrong length":
                return asked.answer(self.inputs + b"\0")
            if self.ready and self.calls:
                self.calls = False
                return asked.answer(self.inputs, DH)
            return served
        return super()._served(asked)

    def _diagnosis(self, asked: Asked) -> bytes:
        mood = self.mood
        status = [0 if self.ready else 2, 0x0C if self.master != 255 else 5, 0]
        ident, master, more = self.ident, self.master, _EXTENDED.get(mood, b"")
        match mood:
            case "static":
                status[1] |= 0x02
            case "other ident":
                ident = b"\xde\xad"
            case "foreign":
                status[0], status[1], master = 0, 0x0C, 9
            case "not ready":
                status[0] |= 0x02
            case "configuration fault":
                status[0] |= 0x04
        if more:
            status[0] |= 0x08
        return asked.answer(bytes((*status, master)) + ident + more)


def _failed(error: Exception) -> None:
    raise error


class View:
    """A bus process in virtual time, and its application's view of it."""

    def __init__(self) -> None:
        self.run = Run(b"")
        self.host: Host
        self.app = ProcessRuntime(process_server.SETUP, lambda _events: None, _failed, lambda _order, _error: None)
        self.app._image = self.run.image
        self.orders: dict[int, Order] = {}
        self.compared = 0

    def begin(self) -> None:
        self.host = self.run.begin()
        runtime: Any = self.host.runtime
        runtime.slaves = {a: MoodySlave(a, 1, _CONFIG, b"\x07") for a in (*_ADDRESSES, 6)}
        send = self.host._send_news

        def send_news(events: list[Event], **more: Any) -> None:
            send(events, **more)
            self.compare(events)

        self.host._send_news = send_news  # type: ignore[method-assign]
        self.read()

    def slave(self, address: int) -> MoodySlave:
        runtime: Any = self.host.runtime
        slave = runtime.slaves[address]
        assert isinstance(slave, MoodySlave)
        return slave

    def read(self) -> None:
        """The application reads all news that have come, as its channel does."""
        with contextlib.suppress(BlockingIOError):
            for news in self.run.news.feed(self.run.theirs.recv(1 << 20)):
                self.app._on_news(news)
                answer = news.answer
                assert answer is None or answer.error is None or "defect" not in answer.error[1], answer
                if answer is not None and answer.error is None and answer.number in self.orders:
                    self.app._on_carried_out(self.orders[answer.number])

    def order(self, order: Order) -> None:
        self.run.number += 1
        self.orders[self.run.number] = order
        self.run.put(messages.framed(messages.Question(self.run.number, messages.named(order))))

    def wait(self, ms: int) -> None:
        with mock.patch.object(self.run, "read", self.read):
            self.run.run(ms * MS)

    def compare(self, events: list[Event]) -> None:
        """After ``events``, an answer or news without an event: all slaves, the bus, and the image of the slaves that
        the events name."""
        self.read()
        self.compared += 1
        stack, app = self.host._stack, self.app
        known = stack.setups
        assert {address: app.slave(address) for address in known} == {
            address: stack.slave(address) for address in known
        }
        assert app.bus() == stack.bus()
        for address, setup in known.items():
            image = app.image(setup)
            assert not image.valid or app.slave(address).state is SlaveState.DATA_EXCHANGE
            if not events or any(not isinstance(one, SlaveEvent) or one.address == address for one in events):
                assert image == stack.image(setup)

    def close(self) -> None:
        self.run.close()


@contextlib.contextmanager
def viewed(*slaves: SlaveParams) -> Iterator[View]:
    spec = structs.replace(process_server.SETUP.stack, slaves=slaves or tuple(map(params, _ADDRESSES)))
    setup = structs.replace(process_server.SETUP, stack=spec)
    with mock.patch.object(process_server, "SETUP", setup):
        view = View()
        with patched(view.run):
            view.begin()
            view.order(GoOnline())
            view.order(SetMode(Mode.OPERATE))
            view.wait(60)
            yield view
        view.close()


def do(view: View, action: str, address: int, choice: int) -> None:
    handlers = view.host._master.handlers
    match action:
        case "mood":
            view.slave(address).change(_MOODS[choice % len(_MOODS)])
        case "mode":
            view.order(SetMode(_MODES[choice % len(_MODES)]))
        case "deactivate":
            view.order(DeactivateSlave(address))
        case "activate":
            view.order(ActivateSlave(address))
        case "remove":
            view.order(RemoveSlave(address))
        case "add":
            view.order(AddSlave(params(address, dpv1=bool(choice & 1), watchdog_ms=300)))
        case "change" if address in handlers:
            view.order(ReparameteriseSlave(params(address, dpv1=bool(choice & 1), watchdog_ms=200 + choice)))
        case "hold":
            view.order(HoldAlarms(address, bool(choice & 1)))
        case "acknowledge":
            view.order(AcknowledgeAlarm(address, choice % 3))
        case "line":
            runtime: FakeRuntime = view.host.runtime  # type: ignore[assignment]
            runtime.command(LineDown("pulled out"))
            runtime.command(LineUp())


_ACTIONS: Final = (
    *["mood"] * 9,
    "mode",
    "deactivate",
    "activate",
    "remove",
    "add",
    "change",
    "hold",
    "acknowledge",
    "line",
)


@given(
    st.lists(
        st.tuples(
            st.sampled_from(_ACTIONS),
            st.sampled_from((*_ADDRESSES, 6)),
            st.integers(0, 99),
            st.sampled_from((1, 9, 60)),
        ),
        min_size=10,
        max_size=25,
    )
)
@examples(10)
def test_the_application_sees_after_each_event_what_the_machines_see(
    steps: list[tuple[str, int, int, int]],
) -> None:
    with viewed() as view:
        assert view.compared > 10  # the bring-up of three slaves
        for action, address, choice, ms in steps:
            do(view, action, address, choice)
            view.wait(ms)
        for address in (*_ADDRESSES, 6):
            if view.slave(address).mood != "good":
                view.slave(address).change("good")
        view.wait(200)


def test_an_event_of_one_slave_makes_a_snapshot_of_that_slave_only() -> None:
    made: list[int] = []
    real = Stack.slave

    def slave(stack: Stack, address: int) -> SlaveSnapshot:
        made.append(address)
        return real(stack, address)

    with (
        mock.patch.object(Stack, "slave", slave),
        mock.patch.object(View, "compare", lambda view, _events: view.read()),
        viewed() as view,
    ):
        assert set(made) == set(_ADDRESSES)
        assert all(view.slave(address).ready for address in _ADDRESSES)
        made.clear()
        for mood, ms in (("silent", 30), ("good", 300)) * 3:
            view.slave(4).change(mood)
            view.wait(ms)
        assert view.app.slave(4).state is SlaveState.DATA_EXCHANGE
        assert set(made) == {4}
        assert len(made) <= 3 * 6  # three losses: a state for each step down and up


# --- after_return = "safe": the application and the bus process agree on what is withheld ---------------------------


def set_outputs(view: View, octets: bytes) -> None:
    view.app.set_outputs(4, octets)
    view.app._publish()
    view.wait(20)


def restart(view: View) -> None:
    """Slave 4 is switched off and on, while the application reads nothing."""
    with mock.patch.object(View, "read"):
        view.slave(4).restart()
        view.wait(1_500)
    assert view.slave(4).ready


@contextlib.contextmanager
def waiting() -> Iterator[tuple[View, list[Event]]]:
    """Slave 4 was away, and its outputs GIVEN are withheld; the application has not read that yet."""
    told: list[Event] = []
    with (
        mock.patch.object(View, "compare", lambda view, _events: view.read()),
        viewed(params(4, safe=SAFE, after_return="safe")) as view,
    ):
        view.app._on_events = told.extend
        set_outputs(view, GIVEN)
        assert view.slave(4).outputs == GIVEN
        restart(view)
        assert view.slave(4).outputs == SAFE
        yield view, told


def test_the_application_sees_outputs_that_became_safe_before_it_reads_the_news() -> None:
    """So it puts a single value into the safe outputs, and none of the old ones goes out with it."""
    with waiting() as (view, told):
        setup = view.host._stack.setups[4]
        assert view.app.image(setup).outputs == SAFE
        view.read()
        assert view.app.slave(4).withheld == GIVEN
        assert [event.outputs for event in told if isinstance(event, OutputsWithheld)] == [GIVEN]
        set_outputs(view, GIVEN)
        assert view.app.slave(4).withheld is None
        assert view.app.image(setup).outputs == view.slave(4).outputs == GIVEN
        view.wait(200)
        assert view.app.slave(4) == view.host._stack.slave(4)
        assert view.app.slave(4).withheld is None


def test_outputs_from_before_the_application_could_know_do_not_go_out() -> None:
    with waiting() as (view, told):
        returns = view.app.image(view.host._stack.setups[4]).returns
        view.run.image.outputs.write({4: Outputs(NEVER, bytes(2), returns - 1)})
        view.wait(200)
        assert view.slave(4).outputs == SAFE
        assert view.app.slave(4).withheld == bytes(2)
        assert [event.outputs for event in told if isinstance(event, OutputsWithheld)] == [GIVEN, bytes(2)]
        set_outputs(view, GIVEN)
        assert view.slave(4).outputs == GIVEN


def test_outputs_that_are_set_while_it_is_away_are_withheld_by_the_bus_process() -> None:
    with waiting() as (view, _):
        set_outputs(view, GIVEN)
        view.slave(4).change("silent")
        view.wait(100)
        assert view.app.slave(4).state is SlaveState.OFFLINE
        set_outputs(view, bytes(2))
        view.slave(4).change("good")
        view.slave(4).restart()
        view.wait(1_500)
        assert view.slave(4).outputs == SAFE
        assert view.app.slave(4).withheld == bytes(2)
