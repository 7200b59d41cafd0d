"""A whole master (link layer, DP, DP-V1, a drive's plugin) with a slave that answers anything, beside a correct one.

The input chooses setup, orders of the application, and an answer to each request to slave 3: a right one, a bent one,
octets of its own, another time, nothing. Slave 4 does what it should. Judged: no exception, no fault of the plugin,
one end of every order, the outputs of slave 4, limits of remarks and queues, printable texts; and when slave 3 has
become correct (one input in four), both are in data exchange and a Read of it works.
"""

from __future__ import annotations

from collections import Counter

from dpstack.devices.finding import find
from dpstack.dp.acyclic.class2 import ReadService, Service
from dpstack.dp.acyclic.job import CancelService
from dpstack.dp.master.commands import DriveCommand, Mode, SetMode
from dpstack.dp.master.events import DriveEvent, FaultKind, SlaveRemark, SlaveState, SlaveStateChanged
from dpstack.dp.master.settings import MasterSettings, StackSpec
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.alarm_orders import AcknowledgeAlarm, CloseConnection, CloseConnections, HoldAlarms
from dpstack.dpv1.master.orders import OpenConnection, RecordDone, RecordOrder
from dpstack.dpv1.master.plugin_queue import RecordQueue
from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.pdu.read_write import Function
from dpstack.drivers.stack import Stack
from dpstack.errors import UsageError
from dpstack.fdl.commands import GoOnline
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT
from dpstack.trace import Event
from tests.fuzz.frame import Cutter, Target, assert_plain, one_in
from tests.fuzz.octet_line import DH, DL, SC, Asked, CorrectSlave, Line, sd1, sd2

MS = 1_000_000
BAUD = 19_200
PARAMS = BusParams.preset(BAUD, address=2, gap=0, extra_idle=1500)
BIT_NS = 1_000_000_000 // BAUD
LIAR, GOOD = 3, 4
GOOD_OUTPUTS = b"\x5a\xa5"
ALL = ("pull_plug", "process", "diagnostic", "manufacturer", "status", "update")
#: drives by the input's first octet; None: a slave without plugin
DRIVES = (None, None, None, "demag-dedrive", "fuji-frenic", "keb-f5", "ls-s100", "imo-hd2")
#: answers to other requests, or to none
STRANGE = tuple(
    bytes.fromhex(text)
    for text in [
        "\n    5E 01 02 02 01 02",
        " 5F 01 02 02",
        " 51 01 02 00",
        " DE 80 B5 00",
        " 5C 01 02 01",
        " DC 80 B0 00",
        " 56 30 00 0A",
        "\n    57 F0 01 00 00 00 00 00 00 02 00 02 00 00 00 00",
        " 58 00 13",
        " 48 01",
        " D7 80 C3 00",
        " 58",
        " 00",
        "\n    08 0C 00 02 06 96 06 02 01 09 01 02",
        " 08 0C 00 02 06 96 04 81 01 00",
        " 0A 0E 00 02 06 96",
        " 02 05 00 FF 06 96",
        "\n    5E 00 2F 04 01 01 01 00",
        " 5E 00 2F 0A 01 81 01 01 10 00",
        " DE 81 B7 00\n    ",
    ]
)
#: requests whose answers are counted after the garbage
LIMIT_STEPS = 4_000
#: behind the garbage of one input in so many slave 3 becomes correct, which takes a third of the time of an input
_RECOVERS = 4


def good_setup() -> SlaveParams:
    return SlaveParams(address=GOOD, name="good", ident=0x1234, config=b"\x10\x21", watchdog_ms=0, every=2)


def liar_setup(drive: str | None) -> SlaveParams:
    if drive is None:
        return SlaveParams(
            address=LIAR, name="liar", ident=0x0696, config=b"\x11\x21", user_prm=bytes(3), watchdog_ms=0,
            dpv1=Dpv1(alarms=ALL, alarm_mode=3, c1_response_timeout_ns=1_000 * MS),
        )  # fmt: skip
    profile = find(drive)
    config = profile.telegram(None).config
    return SlaveParams(address=LIAR, name="liar", ident=profile.ident, config=config, watchdog_ms=0)


class Run:
    """One execution."""

    def __init__(self, octets: bytes) -> None:
        self.script = Cutter(octets)
        kind = self.script.octet()
        self.drive = DRIVES[kind & 7]
        setup = liar_setup(self.drive)
        spec = StackSpec(
            params=PARAMS, patience=EXACT, slaves=(setup, good_setup()), watched=False,
            master=MasterSettings(auto_clear=bool(kind & 8), cycle_ns=700 * MS if kind & 16 else 0),
        )  # fmt: skip
        self.stack = stack = Stack(spec)
        if self.drive is not None:
            records = RecordQueue() if kind & 32 else None
            stack.master.handlers[LIAR].image.plugin = find(self.drive).core("liar", None, {}, records=records)
        self.liar = CorrectSlave(LIAR, setup.ident or 0, setup.config, bytes(setup.input_len))
        self.good = CorrectSlave(GOOD, 0x1234, b"\x10\x21", b"\x77")
        self.line = Line(stack.station, BAUD, self.heard)
        self.events: list[Event] = []
        self.tokens = 0
        self.ordered: Counter[int] = Counter()
        self.connections: list[int] = []
        self.lying = False
        self.disturbed = False
        self.sent_before = b""

    # --- the line ---

    def heard(self, octets: bytes, end: int) -> None:
        """The master has sent a telegram."""
        if octets[0] == 0xDC:
            return
        da = octets[4 if octets[0] == 0x68 else 1] & 0x7F
        if da == GOOD:
            answer = self.good.answer(octets)
            if self.good.outputs is not None:
                assert self.good.outputs in (bytes(2), GOOD_OUTPUTS, b""), self.good.outputs
            if answer is not None:
                self.line.say(answer, end, 11)
        elif da == LIAR:
            if self.lying and self.script.at < len(self.script.octets):
                self.lie(octets, end)
            elif (right := self.liar.answer(octets)) is not None:
                self.line.say(right, end, 11)

    def lie(self, octets: bytes, end: int) -> None:
        """An answer as the input has it."""
        script, line, asked = self.script, self.line, Asked(octets)
        right = self.liar.answer(octets)
        head = script.octet()
        right = SC if right is None else right
        data = right[9:-2] if asked.dsap is not None and right[0] == 0x68 else right[7:-2] if right[0] == 0x68 else b""
        answer, bits = right, 11
        match head >> 4:
            case 0:
                return
            case 1:
                answer = SC
            case 2:
                answer = asked.refusal(script.octet())
            case 3:
                answer = asked.answer(script.take(script.octet() & 0x3F), script.octet() if head & 1 else DL)
            case 4:
                bent = bytearray(data)
                for _ in range((head & 3) + 1):
                    at = script.octet()
                    if at < len(bent):
                        bent[at] = script.octet()
                answer = asked.answer(bytes(bent), DH if head & 4 else DL)
            case 5:
                answer = asked.answer(
                    data[: script.octet() & 0x1F] if head & 1 else data + script.take(script.octet() & 15)
                )
            case 6:
                saps = (script.octet(), script.octet()) if head & 1 else None
                da, sa = (script.octet(), script.octet()) if head & 2 else (asked.sa, asked.da)
                answer = sd2(da & 0x7F, sa & 0x7F, DL, data, saps)
            case 7:
                answer = script.take(head & 15 or script.octet())
            case 8:
                bits = (head & 15) * 25
            case 9:
                answer = right + script.take((head & 15) + 1)
            case 10:
                self.disturbed = True
                line.say(script.take((head & 7) + 1), end, script.word())
            case 11:
                answer = (
                    bytes((0xDC, script.octet() & 0x7F, script.octet() & 0x7F))
                    if head & 1
                    else sd1(2, 3, script.octet())
                )
            case 12:
                line.say(right, end, 11)
                bits = 20
            case 13:
                answer = asked.answer(data, DH) if data else right
            case 14:
                answer = asked.answer(STRANGE[script.octet() % len(STRANGE)], DH if head & 1 else DL)
            case _:
                self.order(head & 15)
        if len(answer) > 1 and asked.dsap is not None and head >> 4 in (9, 12):
            self.disturbed = True
        if bits > 100 or head >> 4 in (6, 7, 9, 11, 12):
            self.disturbed = True
        line.say(answer, end, bits)

    # --- the application ---

    def send(self, order: object) -> bool:
        try:
            self.stack.station.command(order, self.line.now)
        except UsageError:
            return False
        return True

    def order(self, kind: int) -> None:
        """An order of the application; it is given within a step, as a callback of an event would give it."""
        script = self.script
        self.tokens += 1
        token, argument = self.tokens, script.octet()
        timeout = (1 + argument % 4) * 500 * MS
        order: object
        match kind:
            case 0:
                order = RecordOrder(token, Function.READ, 1, argument, 8, address=LIAR, timeout_ns=timeout)
            case 1:
                order = RecordOrder(
                    token, Function.WRITE, 1, 2, data=bytes(argument % 9), address=LIAR, timeout_ns=timeout
                )
            case 2:
                order = OpenConnection(token, LIAR, InitiateReq(200 * MS), 60 * MS, timeout_ns=timeout)
            case 3 if self.connections:
                function = Function.DATA_TRANSPORT if argument & 1 else Function.READ
                order = RecordOrder(
                    token, function, 1, 2, data=b"\1", connection=self.connections[-1], timeout_ns=timeout
                )
            case 4 if self.connections:
                self.send(CloseConnection(self.connections[argument % len(self.connections)]))
                return
            case 5:
                service = (Service.INPUTS, Service.OUTPUTS, Service.CONFIG, Service.DIAGNOSIS)[argument & 3]
                order = ReadService(token, LIAR, service)
            case 6:
                self.send(CancelService(max(1, token - argument % 4)))
                return
            case 7:
                self.send(HoldAlarms(LIAR, bool(argument & 1)))
                return
            case 8:
                self.send(AcknowledgeAlarm(LIAR, argument))
                return
            case 9 if self.drive is not None:
                ops: tuple[tuple[str, dict[str, object]], ...] = (
                    ("read", {"number": argument}),
                    ("write", {"number": argument, "value": 1}),
                    ("start", {}),
                    ("stop", {}),
                    ("setpoint", {"value": 0.5}),
                    ("reset", {}),
                    ("speed", {"value": 0.2}),
                )
                op, args = ops[argument % len(ops)]
                self.send(DriveCommand(LIAR, op, args, token))
                return
            case 10:
                self.send(SetMode((Mode.CLEAR, Mode.OPERATE, Mode.OPERATE, Mode.STOP)[argument & 3]))
                return
            case 11:
                self.liar.restart()
                return
            case _:
                return
        if self.send(order):
            self.ordered[token] += 1
            if kind == 2:
                self.connections.append(token)

    # --- the course ---

    def drain(self) -> None:
        self.events += self.stack.station.take_events()

    def step_until(self, steps: int, done: object = None) -> None:
        line = self.line
        for _ in range(steps):
            line.step(line.now + 20_000 * MS)
            self.drain()
            if callable(done) and done():
                return

    def exchanging(self) -> bool:
        return all(h.state is SlaveState.DATA_EXCHANGE for h in self.stack.master.handlers.values())

    def run(self) -> None:
        stack, script = self.stack, self.script
        self.send(GoOnline())
        self.send(SetMode(Mode.OPERATE))
        stack.master.handlers[GOOD].image.outputs = GOOD_OUTPUTS
        self.line.pump()
        if not script.octets[:1] or not script.octets[0] & 0x80:  # else it lies from the beginning
            self.step_until(400, self.exchanging)
        self.lying = True
        self.step_until(LIMIT_STEPS, lambda: script.at >= len(script.octets) or stack.master.mode is Mode.STOP)
        self.judge_garbage()
        if one_in(_RECOVERS, script.octets):
            self.recover()

    def judge_garbage(self) -> None:
        for event in self.events:
            assert_plain(event.text)
            if isinstance(event, DriveEvent):
                assert event.payload.get("type") != "failed", event.payload
        handler = self.stack.master.handlers[LIAR]
        assert handler.fault is None or handler.fault.kind is not FaultKind.PLUGIN, handler.fault
        assert sum(isinstance(event, SlaveRemark) for event in self.events) <= 20
        if not self.disturbed:
            left = [e.state for e in self.events if isinstance(e, SlaveStateChanged) and e.address == GOOD]
            assert left.count(SlaveState.DATA_EXCHANGE) <= 1, left

    def recover(self) -> None:
        stack, line = self.stack, self.line
        self.lying = False
        line.forget()
        self.liar.restart()
        self.send(CloseConnections())
        self.send(HoldAlarms(LIAR, False))
        self.send(SetMode(Mode.OPERATE))
        line.pump()
        before = self.good.exchanges, self.liar.exchanges
        self.step_until(
            LIMIT_STEPS,
            lambda: self.exchanging() and self.good.exchanges > before[0] + 1 and self.liar.exchanges > before[1] + 1,
        )
        assert self.exchanging(), [(h.state, h.fault) for h in stack.master.handlers.values()]
        if self.drive is None:
            self.tokens += 1
            token = self.tokens
            self.ordered[token] += 1
            self.send(RecordOrder(token, Function.READ, 1, 2, 8, address=LIAR, timeout_ns=5_000 * MS))
            self.step_until(LIMIT_STEPS, lambda: self.ended(token) is not None)
            end = self.ended(token)
            assert end is not None
            assert end.outcome.data == b"\1\2", end.text
        acyclic = stack.station
        self.step_until(LIMIT_STEPS, self.all_ended)
        assert self.all_ended(), (self.ordered, acyclic)

    def ended(self, token: int) -> RecordDone | None:
        return next((e for e in self.events if isinstance(e, RecordDone) and e.token == token), None)

    def all_ended(self) -> bool:
        done = Counter(e.token for e in self.events if hasattr(e, "outcome") and hasattr(e, "token"))
        assert not done - self.ordered, done - self.ordered
        return done == self.ordered


def run(octets: bytes) -> None:
    Run(octets).run()


TARGET = Target(
    run=run,
    covers=(
        "dpstack.dp.master",
        "dpstack.dp.acyclic",
        "dpstack.dpv1.master",
        "dpstack.profile",
    ),
    executions=100_000,
    compares=False,
    max_len=300,
)
