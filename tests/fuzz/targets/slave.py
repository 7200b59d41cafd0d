"""A whole slave (link layer, DP, DP-V1 with both classes, its device) that masters ask anything.

The input chooses the device and what masters 2, 9 and 1 send: a right bring-up, bent PDUs at every SAP, repetitions,
raw octets, telegrams in pieces, other stations' telegrams, times; and what the device's own program does meanwhile.
Judged: one answer at most, from its own address, with SAPs crosswise and T_SDR kept; outputs of the owner only, and
safe as soon as nobody owns it; no exception in the device; printable texts; a limit of reports; and (one input in
four) after silence no connection is left, and after a restart a right master gets it into data exchange.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

from dpstack.devices.finding import find
from dpstack.dp.pdu.alarm_blocks import Alarm, Status
from dpstack.dp.pdu.diag_blocks import UserDiag
from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave.events import DeviceFailed, RequestRefused
from dpstack.dpv1.pdu.im import Im0
from dpstack.dpv1.slave.alarms import AlarmServer
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.resource_manager import ConnectionClosed, ConnectionOpened, ms2_of
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.errors import DpError
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.gsd.identifiers import io_lengths
from dpstack.params import BusParams
from dpstack.sim.io_station.station import IoStation
from tests.fuzz.frame import Cutter, Target, assert_plain, one_in
from tests.fuzz.octet_line import Asked, Line, sd1, sd2

MS = 1_000_000
BAUD = 500_000
PARAMS = BusParams.preset(BAUD)
BIT_NS = 2_000
ADDRESS = 8
#: behind one input in so many come a silence, a restart and a right master, which takes a third of the time of an input
_RECOVERS = 4
INITIATE = bytes.fromhex("57 00 00 00 00 64 01 00 00 00 00 00 00 02 00 02 00 00 00 00")
#: right requests, which the input bends
PDUS = tuple(
    bytes.fromhex(text)
    for text in [
        "\n    ",
        " 5E 00 FF F0",
        " 5E 00 2F F0",
        " 5F 00 2F 0A 01 01 01 01 10 01 03 A2 00 00",
        "\n    5F 00 2F 0A 02 01 00 01 30 01 00 05 00 00",
        " 5F 00 2F 10 01 02 01 01 10 01 03 A2 00 00 42 01 00 05",
        "\n    5F 00 FF 04 08 00 FD E8",
        " 5F 00 FF 04 08 00 FD E9",
        " 5E 01 01 10",
        " 5F 01 01 01 55",
        " 51 00 02 01 55",
        " 48 01",
        "\n    58 00 25",
        " 5C 01 02 00",
        " 5C 04 01 09",
        " 5F 00 2F 40 01 02 01 01 10 01 00 01 00 00 42 01 00 05\n    ",
    ]
)


@functools.cache
def description() -> SlaveDescription:
    return SlaveDescription(
        ident=0x0A35, name="own", configs=(b"\x10\x21",), user_prm_len=(0, 12), set_slave_add=True, dpv1=True,
        alarms=("process", "diagnostic", "pull_plug", "status", "update", "manufacturer"), ms2=3,
    )  # fmt: skip


class OwnSlave(DpSlave):
    """A slave of one octet in and two out that keeps what it was given."""

    def __init__(self) -> None:
        self.seen: list[bytes] = []
        super().__init__(description(), self.cycle, im=[Im0(order_id="V-8")])

    def cycle(self, outputs: bytes, _elapsed: int) -> bytes:
        self.seen.append(outputs)
        return bytes((outputs[0] ^ 0xFF,))


def drive(kind: str) -> Device:
    return find(kind).simulated(None, {}, {})


DEVICES: tuple[Callable[[], Device], ...] = (
    OwnSlave,
    OwnSlave,
    lambda: IoStation.of(["8 DI", "8 DO", "2 AI"], name="io"),
    lambda: drive("demag-dedrive"),
    lambda: drive("fuji-frenic"),
    lambda: drive("keb-f5"),
    lambda: drive("imo-hd2"),
    lambda: drive("ls-s100"),
)


@functools.cache
def user_prm(kind: int) -> bytes:
    """User parameters that a device takes, with as much of DP-V1 enabled as it has."""
    for status in (b"\x80\xfc\0", b"\x80\0\0", b"\0\0\0", b""):
        for length in range(17):
            device = DEVICES[kind]()
            app = SlaveApp(device, address=ADDRESS)
            octets = b"\x88\x01\x0a\x0b" + device.ident.to_bytes(2, "big") + b"\0" + status + bytes(length)
            app.serve(Telegram(Kind.SD2, ADDRESS, 2, 0x5D, 61, 62, octets), 0)
            if app.master is not None:
                return octets[7:]
    raise AssertionError(f"device {kind} takes no parameters")


class Run:
    """One execution."""

    def __init__(self, octets: bytes) -> None:
        self.script = Cutter(octets)
        self.kind = self.script.octet() & 7
        self.device = device = DEVICES[self.kind]()
        self.app = SlaveApp(device, address=ADDRESS)
        self.station = PassiveStation(ADDRESS, self.app, PARAMS)
        self.line = Line(self.station, BAUD, self.heard)
        self.answers: list[tuple[int, bytes]] = []
        self.config = device.configs[0]
        self.prm = b"\x88\x01\x0a\x0b" + device.ident.to_bytes(2, "big") + b"\0" + user_prm(self.kind)
        self.lengths = io_lengths(self.config)
        #: FC of the next request by master
        self.counts: dict[int, int] = {}
        self.asked: bytes = b""
        #: the last answer to a request, which the slave keeps for repetitions
        self.kept = b""
        self.server_sap = 48
        #: raw octets came: they may be telegrams of any master
        self.dirty = False
        self.opened = self.closed = self.refusals = 0

    def heard(self, octets: bytes, end: int) -> None:
        self.answers.append((end - 11 * BIT_NS * len(octets), octets))

    # --- masters ---

    def put(self, *pieces: bytes) -> bytes:
        """Send a telegram, and wait for its answer as a master does. Returns it."""
        line = self.line
        self.answers.clear()
        line.run(40 * BIT_NS)
        at = line.now
        for piece in pieces:
            at = line.say(piece, at)
        line.run(at - line.now + 400 * BIT_NS)
        request = pieces[-1] if len(pieces) == 1 else b""
        answer = self.answers[-1][1] if self.answers else b""
        self.judge(request, at)
        self.kept = answer or self.kept
        return answer

    def ask(self, sa: int, dsap: int | None, data: bytes, ssap: int | None = 62, fc: int | None = None) -> bytes:
        """A request with the next frame count bit."""
        counted = fc is None
        if fc is None:
            fc = self.counts.get(sa, 0x6D)
        saps = None if dsap is None or ssap is None else (dsap & 0x7F, ssap & 0x7F)
        address = self.app.address
        assert address is not None
        self.asked = sd2(address, sa, fc, data[: 244 if saps else 246], saps)
        answer = self.put(self.asked)
        if counted and answer:
            self.counts[sa] = 0x7D if fc == 0x5D else 0x5D
        else:  # nobody knows the slave's frame count bit: begin anew
            self.counts.clear()
        return answer

    def bring_up(self, sa: int) -> bool:
        """Set_Prm, Chk_Cfg, and Slave_Diag. Whether the slave has taken master ``sa``."""
        self.ask(sa, 61, self.prm)
        self.ask(sa, 62, self.config)
        self.ask(sa, 60, b"")
        return self.app.master == sa

    def judge(self, request: bytes, end: int) -> None:
        """Check the rules that hold after each telegram."""
        app = self.app
        assert len(self.answers) <= 1, self.answers
        assert app.failure is None, app.failure
        if self.answers and request:
            begin, answer = self.answers[0]
            assert begin - end >= 11 * BIT_NS, (begin, end)
            if answer != b"\xe5":
                asked, said = Asked(request), Asked(answer)
                assert (said.da, said.sa) == (asked.sa, asked.da), (request, answer)
                # FCV, and the frame count bit as before: a repetition, whatever it asks. Octets that were no request
                # of this master may have moved the bit, so that only the answer says it
                if not (asked.fc & 0x10 and answer == self.kept):
                    assert answer[0] == 0x10 or (said.dsap, said.ssap) == (asked.ssap, asked.dsap), (
                        request.hex(),
                        answer.hex(),
                    )
                if asked.dsap == 49 and said.data[:1] == b"\x56":
                    self.server_sap = said.data[1]
        assert (app.master is None) is (app.state is SlaveAppState.WAIT_PRM)
        if app.state is not SlaveAppState.DATA_EXCH:
            assert app.outputs == b""
        elif not self.dirty:
            assert set(app.outputs) <= {0, app.master}, (app.outputs, app.master)
        if isinstance(self.device, OwnSlave) and self.device.seen:
            assert self.device.seen[-1] == (app.outputs or bytes(2))
            self.device.seen.clear()

    def forget(self) -> None:
        """Octets are about to come that may be a telegram of any master."""
        self.dirty = True
        self.counts.clear()

    def bent(self, octets: bytes) -> bytes:
        """Octets as the input changes them."""
        script, data = self.script, bytearray(octets)
        how = script.octet()
        for _ in range(how & 3):
            at = script.octet() % (len(data) + 1)
            match how >> 2 & 3:
                case 0 if at < len(data):
                    data[at] = script.octet()
                case 1:
                    del data[at:]
                case 2:
                    data += script.take(script.octet())
                case _:
                    data[at:at] = script.take(1)
        return bytes(data[:240])

    def step(self) -> None:
        script = self.script
        head = script.octet()
        sa = (2, 2, 9, 1)[head & 3]
        more = head & 4
        match head >> 3 & 0x1F:
            case 0:
                self.forget()
                self.put(script.take(script.octet() or 1), b"")
            case 1 | 2:
                self.bring_up(sa)
            case 3 | 4 | 5:
                self.ask(sa, None, bytes((sa,)) * self.lengths[1], None)
            case 6:
                self.ask(sa, None, bytes((sa,)) * script.octet(), None)
            case 7:
                self.ask(sa, (60, 59, 56, 57)[head >> 1 & 3], script.take(script.octet() & 7 if more else 0))
            case 8:
                self.ask(sa, 61, self.bent(self.prm))
            case 9:
                self.ask(sa, 62, self.bent(self.config))
            case 10:
                self.ask(
                    sa,
                    script.octet(),
                    script.take(script.octet()),
                    script.octet(),
                    script.octet() | 0x40 if more else None,
                )
            case 11:
                self.put(sd2(127 if more else ADDRESS, sa, 0x46, script.take(script.octet() & 3), (58, 62)))
            case 12:
                self.line.run(script.octet() * (MS if more else 10_000))
            case 13:
                bad = bytearray(self.asked or b"\x10")
                at = script.octet() % len(bad)
                bad[at] ^= script.octet()
                self.forget()
                self.put(bytes(bad), b"")
            case 14:
                if self.asked:
                    self.put(self.asked)
                    self.counts.clear()
            case 15 | 16 | 17 | 18:
                self.ask(sa, 51, self.bent(PDUS[script.octet() & 15]), 51)
            case 19 | 20:
                self.ask(sa, 49, self.bent(INITIATE) if more else INITIATE, 50)
                self.ask(sa, 49, b"", 50)
                self.ask(sa, self.server_sap, b"", 50)
            case 21 | 22 | 23:
                self.ask(
                    sa, self.server_sap - (script.octet() & 1 if more else 0), self.bent(PDUS[script.octet() & 15]), 50
                )
            case 24:
                whole = sd2(ADDRESS, sa, 0x5D, script.take(script.octet() & 15), (60, 62))
                at = script.octet() % len(whole)
                self.line.say(whole[:at], self.line.now)
                self.line.run(script.word() * BIT_NS)
                self.forget()
                self.put(whole[at:], b"")
            case 25 | 26:
                self.own_program()
            case 27:
                self.put(sd1(ADDRESS, sa, 0x49))
            case 28:
                self.put(bytes((0xDC, script.octet() & 0x7F, sa)))
            case 29:
                self.put(sd2(script.octet() & 0x7F, script.octet() & 0x7F, script.octet() & 0xBF, script.take(4)))
            case 30:
                ident = self.device.ident.to_bytes(2, "big")
                self.ask(sa, 55, self.bent(bytes((script.octet() & 0x7F,)) + ident + b"\0"))
            case _:
                self.ask(sa, 50, self.bent(PDUS[script.octet() & 15]), 51)

    def own_program(self) -> None:
        """The device's own program does something."""
        script, device = self.script, self.device
        what, value = script.octet(), script.octet()
        server = getattr(device, "alarm_server", None)
        match what & 7:
            case 0 if isinstance(device, OwnSlave):
                device.diag = UserDiag(stat=bool(value & 1))
            case 1 | 2 | 3 if isinstance(server, AlarmServer):
                try:
                    server.alarm(Alarm(type=value % 7, slot=value >> 4, specifier=value & 3, data=bytes(value & 7)))
                except DpError:
                    return
            case 4 if isinstance(server, AlarmServer):
                try:
                    server.status(Status(type=value & 3, slot=value >> 4, specifier=0, data=bytes(value & 7)))
                except DpError:
                    return
            case 5:
                self.app.restart(self.line.now)
                self.dirty = False
            case _:
                return
        self.line.pump()

    # --- the course ---

    def drain(self) -> None:
        for event in self.station.take_events():
            assert not isinstance(event, DeviceFailed), event.text
            self.opened += isinstance(event, ConnectionOpened)
            self.closed += isinstance(event, ConnectionClosed)
            self.refusals += isinstance(event, RequestRefused)
            assert_plain(event.text)

    def run(self) -> None:
        script = self.script
        self.line.pump()
        while script.at < len(script.octets):
            self.step()
            self.drain()
        assert self.refusals <= 153
        if one_in(_RECOVERS, script.octets):
            self.recover()

    def recover(self) -> None:
        """Silence, a restart, and a right master."""
        app = self.app
        self.line.run(100 * MS)
        self.put(sd1(127, 2, 0x49))
        if ms2_of(app).connections:
            self.line.run(3_600_000 * MS)
        self.drain()
        assert ms2_of(app).connections == ()
        assert ms2_of(app).free == self.device.ms2
        assert self.opened == self.closed
        app.restart(self.line.now)
        self.dirty = False
        self.counts.clear()
        assert app.outputs == b""
        assert self.bring_up(2)
        answer = self.ask(2, None, b"\2" * self.lengths[1], None)
        self.drain()
        assert app.state is SlaveAppState.DATA_EXCH
        assert len(answer) == (9 + self.lengths[0] if self.lengths[0] else 1), answer
        assert app.outputs == b"\2" * self.lengths[1]


def run(octets: bytes) -> None:
    Run(octets).run()


TARGET = Target(
    run=run,
    covers=(
        "dpstack.fdl.passive",
        "dpstack.dp.slave",
        "dpstack.dpv1.slave",
        "dpstack.profile",
    ),
    executions=100_000,
    compares=False,
    max_len=300,
)
