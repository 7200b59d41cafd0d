"""Faults of one simulated slave: late answers, refusals, wrong lengths, noise on its stub, repeated answers, diagnosis.

They act between the station and its line and between the station and its application, so they are the same on a
simulated bus and behind a real port. A station without faults has neither in its way.
"""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Final

from msgspec import Struct

from dpstack.dp.pdu.diag_blocks import NO_DIAG, UserDiag
from dpstack.dp.slave.application import SlaveApp
from dpstack.fdl.interface import Reply, StationControl
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import MAX_DATA, Resp, Telegram
from dpstack.phy.noise import BitNoise
from dpstack.phy.uart import flipped
from dpstack.trace import Event
from dpstack.units import chars_to_ns, ms_text

#: sends octets at a time (ns), whatever is on the line then
SendAt = Callable[[bytes, int], None]
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


class ReportedDiagnosis(Struct, frozen=True):
    """The slave reports ``diag`` beside what its device reports."""

    diag: UserDiag


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
        case ReportedDiagnosis(diag):
            return f"diagnosis {diag.ext.hex(' ').upper() or 'no octets'}"


Fault = LateAnswers | Refusals | WrongLength | StubNoise | RepeatedAnswers | ReportedDiagnosis


class SlaveFaults:
    """The faults of one simulated slave, at most one of each kind. They stay when the slave is switched off and on.

    :meth:`attach` gives it the station and its application, ``send_at`` the line.
    """

    def __init__(self) -> None:
        self._active: dict[type[Fault], Fault] = {}
        self._noise: BitNoise | None = None
        self._send_at: SendAt = _no_line
        self._busy_until = 0

    def attach(self, station: PassiveStation, app: SlaveApp) -> None:
        """Act on this station from now on."""
        self._station = station
        self._app = app
        self._install()
        found = self._active.get(ReportedDiagnosis)
        if isinstance(found, ReportedDiagnosis):
            app.diag.add(found.diag)

    def connect(self, send_at: SendAt) -> None:
        """Send late and repeated answers by ``send_at``."""
        self._send_at = send_at

    @property
    def active(self) -> tuple[Fault, ...]:
        return tuple(self._active.values())

    def begin(self, fault: Fault) -> None:
        """Begin ``fault``; it replaces one of its kind."""
        self._active[type(fault)] = fault
        if isinstance(fault, StubNoise):
            self._noise = BitNoise(fault.rate, Random(fault.seed))
        elif isinstance(fault, ReportedDiagnosis):
            self._app.diag.add(fault.diag)
        self._install()

    def end(self, fault: Fault) -> bool:
        """End ``fault``. False: another one of its kind has replaced it, or it has ended before."""
        if self._active.get(type(fault)) is not fault:
            return False
        del self._active[type(fault)]
        if isinstance(fault, StubNoise):
            self._noise = None
        elif isinstance(fault, ReportedDiagnosis):
            self._app.diag.add(NO_DIAG)
        elif isinstance(fault, LateAnswers):
            self._busy_until = 0
        self._install()
        return True

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


def _no_line(_octets: bytes, _at: int) -> None:
    raise RuntimeError("a slave that is on no line wanted to send")
