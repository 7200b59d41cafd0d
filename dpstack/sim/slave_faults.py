"""Faults of one simulated slave: late answers, refusals, wrong lengths, noise on its stub, repeated answers, diagnosis.

They act between the station and its line and between the station and its application, so they are the same on a
simulated bus and behind a real port. A station without faults has neither in its way.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from random import Random
from typing import Final

from msgspec import Struct

from dpstack.dp.pdu.alarm_blocks import Alarm, ModuleState
from dpstack.dp.pdu.diag_blocks import UserDiag
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.device import Ms1Server
from dpstack.errors import AlarmError, UsageError
from dpstack.fdl.interface import Reply, StationControl
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import MAX_DATA, Resp, Telegram
from dpstack.phy.noise import BitNoise
from dpstack.phy.uart import flipped
from dpstack.sim.reported_diagnosis import Reported, ReportedOctets, SlotDiagnosis, TextDiagnosis, combined
from dpstack.trace import Event
from dpstack.units import chars_to_ns, ms_text

#: sends octets at a time (ns), whatever is on the line then
SendAt = Callable[[bytes, int], None]
#: the states of the modules of a slave, the first one first; modules behind them are well
ModuleStates = Callable[[], Sequence[ModuleState]]
#: bit times between an answer and its repetition
_GAP_BITS: Final = 11
#: octets of an SD1 telegram, and of an SD2 telegram without its data unit
_SD1_LEN: Final = 6
_SD2_LEN: Final = 9
_POSITIVE: Final = (Resp.OK, Resp.DL, Resp.DH)


class LateAnswers(Struct, frozen=True):
    """Every answer begins ``by_ns`` later. Until then the slave hears nothing, as one that is busy."""

    by_ns: int


class Refusals(Struct, frozen=True):
    """Data_Exchange is answered with ``status`` and does not reach the device."""

    status: Resp = Resp.RS


class WrongLength(Struct, frozen=True):
    """The inputs in the answer have ``by_octets`` more octets, or fewer with a minus; at least none, at most 244."""

    by_octets: int = -1


class StubNoise(Struct, frozen=True):
    """Each bit that the slave hears or sends is inverted with the probability ``rate``."""

    rate: float
    seed: int = 0


class RepeatedAnswers(Struct, frozen=True):
    """Every answer is sent twice, the second time directly behind the first."""


def fault_text(fault: Fault) -> str:
    """The fault for people."""
    match fault:
        case LateAnswers(by_ns):
            return f"late answers by {ms_text(by_ns)}"
        case Refusals(status):
            return f"Data_Exchange refused with {status.name}"
        case WrongLength(by_octets):
            return f"inputs of the wrong length, {by_octets:+} octet{'s' * (abs(by_octets) > 1)}"
        case StubNoise(rate):
            return f"noise on its stub, {rate:g} a bit"
        case RepeatedAnswers():
            return "every answer twice"
        case ReportedOctets() | SlotDiagnosis() | TextDiagnosis():
            return fault.text


Fault = LateAnswers | Refusals | WrongLength | StubNoise | RepeatedAnswers | Reported


class SlaveFaults:
    """The faults of one simulated slave: any number of diagnoses, of the other kinds at most one each. They stay when
    the slave is switched off and on.

    :meth:`attach` gives it the station and its application, ``send_at`` the line.
    """

    def __init__(self) -> None:
        #: by kind; a diagnosis by itself
        self._active: dict[type[Fault] | int, Fault] = {}
        self._reports: list[Reported] = []
        self._noise: BitNoise | None = None
        self._send_at: SendAt = _no_line
        self._busy_until = 0

    def attach(self, station: PassiveStation, app: SlaveApp, states: ModuleStates) -> None:
        """Act on this station from now on. ``states`` returns those of the modules, as far as its device knows them."""
        self._station = station
        self._app = app
        self._states = states
        self._ms1 = next((service for service in app.services if isinstance(service, Ms1Server)), None)
        self._install()
        if self._reports:
            self._diagnose()

    def connect(self, send_at: SendAt) -> None:
        """Send late and repeated answers by ``send_at``."""
        self._send_at = send_at

    @property
    def active(self) -> tuple[Fault, ...]:
        return tuple(self._active.values())

    def begin(self, fault: Fault) -> None:
        """Begin ``fault``; unless it is a diagnosis, it replaces one of its kind. Raises UsageError, AlarmError if the
        alarm of a diagnosis cannot be raised; then nothing has begun."""
        if isinstance(fault, SlotDiagnosis) and fault.alarm:
            self._alarm(fault.appears())
        self._active[_key(fault)] = fault
        if isinstance(fault, StubNoise):
            self._noise = BitNoise(fault.rate, Random(fault.seed))
        elif isinstance(fault, Reported):
            self._diagnose()
        self._install()

    def end(self, fault: Fault) -> bool:
        """End ``fault``. False: another one of its kind has replaced it, or it has ended before."""
        if self._active.get(_key(fault)) is not fault:
            return False
        del self._active[_key(fault)]
        if isinstance(fault, StubNoise):
            self._noise = None
        elif isinstance(fault, Reported):
            self._diagnose()
        elif isinstance(fault, LateAnswers):
            self._busy_until = 0
        self._install()
        if isinstance(fault, SlotDiagnosis) and fault.alarm:
            with contextlib.suppress(AlarmError):  # the diagnosis ends in any case
                self._alarm(fault.disappears(self._is_faulty(fault.module)))
        return True

    def end_alike(self, wanted: Reported) -> bool:
        """End the diagnoses that report the same as ``wanted``. False: none of those that act does."""
        alike = [report for report in self._reports if report.content == wanted.content]
        for report in alike:
            self.end(report)
        return bool(alike)

    # --- diagnosis ---
    def _diagnose(self) -> None:
        """Report the diagnoses that act now, beside that of the device."""
        reports = self._reports = [fault for fault in self._active.values() if isinstance(fault, Reported)]
        last: tuple[object, UserDiag] | None = None

        def report(own: UserDiag) -> UserDiag:
            nonlocal last  # it is asked in each exchange
            now = own, self._states(), self._ms1 is not None and self._ms1.enabled
            if last is None or last[0] != now:
                last = now, combined(own, reports, now[1], dpv1=now[2])
            return last[1]

        self._app.diag.extend(report)

    def _is_faulty(self, module: int) -> bool:
        states = self._states()
        injected = any(isinstance(report, SlotDiagnosis) and report.module == module for report in self._reports)
        return injected or (module < len(states) and states[module] is not ModuleState.OK)

    def _alarm(self, alarm: Alarm) -> None:
        server = None if self._ms1 is None else self._ms1.messages
        if server is None:
            raise UsageError(f"{self._app.device.name} raises no alarms: its device has no DP-V1; leave alarm out")
        server.alarm(alarm)

    def _install(self) -> None:
        kinds = self._active.keys()
        self._station.stub = self if kinds & {LateAnswers, StubNoise, RepeatedAnswers} else None
        self._station.responder = self if kinds & {Refusals, WrongLength} else self._app

    # --- Stub ---
    def hears(self, telegram: Telegram, now: int) -> bool:
        if now < self._busy_until:
            return False
        size = _SD1_LEN
        if telegram.data or telegram.dsap is not None:
            size = _SD2_LEN + len(telegram.data) + (telegram.dsap is not None) + (telegram.ssap is not None)
        return self._noise is None or not self._noise.flips(size)

    def answer(self, octets: bytes, now: int) -> bytes | None:
        station, late = self._station, self._active.get(LateAnswers)
        if self._noise is not None:
            flips = self._noise.flips(len(octets))
            # octets with a parity or framing error are lost at every receiver
            read = (flipped(octet, flips.get(number, 0)) for number, octet in enumerate(octets))
            octets = bytes(octet for octet in read if octet is not None)
            if not octets:
                return None
        begin = now + station.t_sdr_ns
        if isinstance(late, LateAnswers):
            begin += late.by_ns
            self._busy_until = begin
            self._send_at(octets, begin)
        if RepeatedAnswers in self._active:
            self._send_at(octets, begin + chars_to_ns(len(octets), station.baud) + station.params.ns(_GAP_BITS))
        return None if late else octets

    # --- Responder ---
    def serve(self, request: Telegram, now: int) -> Reply | None:
        """Refuse Data_Exchange, or change the length of its inputs; everything else is up to the application."""
        if request.dsap is not None:
            return self._app.serve(request, now)
        refusal = self._active.get(Refusals)
        if isinstance(refusal, Refusals):
            return Reply(refusal.status)
        reply = self._app.serve(request, now)
        wrong = self._active.get(WrongLength)
        if reply is None or not isinstance(wrong, WrongLength) or reply.status not in _POSITIVE:
            return reply
        length = min(max(0, len(reply.data) + wrong.by_octets), MAX_DATA)
        status = Resp.DL if reply.short else reply.status
        return Reply(status, reply.data[:length].ljust(length, b"\0")) if length else Reply(Resp.OK, short=True)

    def attached(self, station: StationControl) -> None:
        self._app.attached(station)

    def take_events(self) -> list[Event]:
        return self._app.take_events()

    def indicate(self, telegram: Telegram, now: int) -> None:
        self._app.indicate(telegram, now)

    def wake_at(self) -> int:
        return self._app.wake_at()

    def tick(self, now: int) -> None:
        self._app.tick(now)


def _key(fault: Fault) -> type[Fault] | int:
    return id(fault) if isinstance(fault, Reported) else type(fault)


def _no_line(_octets: bytes, _at: int) -> None:
    raise RuntimeError("a slave that is on no line wanted to send")
