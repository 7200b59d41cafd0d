"""A telegram explained to the bit: link layer, service, fields, and what it is in the course of the bus."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from msgspec import Struct

from dpstack.capture.transmission import DAMAGE_TEXTS, Damage, Transmission, damage_text
from dpstack.decode.course import Course, Step
from dpstack.decode.fields import Fields
from dpstack.decode.names import NO_NAMES, Names
from dpstack.decode.stations import Stations
from dpstack.decode.words import PPI, acknowledged, describe_with, flaw_text
from dpstack.errors import ConfigError, PduError
from dpstack.fdl.codec import decode
from dpstack.fdl.service_names import service
from dpstack.fdl.telegram import FC_FCB, FC_FCV, FC_FUNCTION, FC_REQUEST, Kind, Req, Resp, Telegram
from dpstack.units import NS_PER_S, chars_to_ns

#: the names of functions as the standard has them, of requests and of responses
_REQUEST: Final = {number.value: number.name for number in Req if number is not Req.CLOCK_VALUE}
_RESPONSE: Final = {number.value: number.name for number in Resp}


#: functions whose answers have data, and no SAPs that name their service
_NAMES_ANSWER: Final = (Req.IDENT, Req.LSAP_STATUS)
_KINDS: Final = {kind: kind.name for kind in Kind}
_KIND_SC: Final = Kind.SC
_KIND_SD4: Final = Kind.SD4
_DAMAGED: Final = int(sum(Damage))
#: damage that the octets themselves do not show
_UNSEEN: Final = int(Damage.PARITY_OR_FRAMING | Damage.TOO_LONG)
_NO_FIELDS: Final[Fields] = {}
#: telegrams that are kept with what their octets say, and the octets of the longest one
_KEPT_TELEGRAMS: Final = 4096
_LONGEST: Final = 255


class Explained(Struct, eq=False):
    """One transmission. ``telegram`` is None if the octets make none, ``error`` says why, and also what is wrong in the
    data unit of a whole telegram. ``fields`` may be shared with other telegrams of the same content: do not change
    them.
    """

    #: number of the transmission, from 1
    number: int
    #: octets with their times
    transmission: Transmission
    #: the telegram; None if the octets make no telegram
    telegram: Telegram | None
    #: name of the service; empty if it is not known
    service: str
    #: decoded fields by name; shared with other telegrams of the same content, so do not change them
    fields: Fields
    #: what is wrong with the octets or the data unit; None without a finding
    error: str | None
    #: its place among the other telegrams: answer to, retry of, remarks
    step: Step
    #: name of the sending station; empty without one
    sender: str = ""
    #: name of the receiving station; empty without one
    receiver: str = ""
    #: a request that nobody answered; known when the next telegram is explained
    unanswered: bool = False

    @property
    def text(self) -> str:
        """One line for people, without its time and octets."""
        telegram, step = self.telegram, self.step
        if telegram is None:
            text = self.error or ""
        elif telegram.kind is _KIND_SC and step.request is not None:
            request = step.request
            text = acknowledged(self.service, request.da, request.sa, self.sender, self.receiver)
        else:
            text = describe_with(
                telegram, self.fields, self.error, self.sender, self.receiver, self._service_of_request
            )
        if step.retry_of is not None:
            text = f"{text}; retry of {step.retry_of}"
        elif step.repeated_poll_of is not None:
            text = f"{text}; the same poll as {step.repeated_poll_of}"
        elif step.unanswered is not None:
            text = f"{text}; {step.unanswered} was not answered"
        if step.remarks:
            text = "; ".join((text, *step.remarks))
        sent = self.transmission
        if sent.damage and (marked := damage_text(sent.damage & (_DAMAGED if telegram else _UNSEEN))):
            text = f"{text}; marked by the port: {marked}"
        return f"{text}; {sent.note}" if sent.note else text

    @property
    def _service_of_request(self) -> str:
        """The service of PPI, and of an answer to Request Ident or LSAP Status: they look like Data_Exchange."""
        asked, telegram = self.step.request, self.telegram
        if self.service == PPI and telegram is not None and (telegram.data or telegram.is_request):
            return PPI
        if asked is None or telegram is None or asked.function not in _NAMES_ANSWER or not telegram.data:
            return ""
        return self.service if telegram.dsap is telegram.ssap is None else ""

    @property
    def function(self) -> str | None:
        """The standard's name of the function code."""
        telegram = self.telegram
        if telegram is None or telegram.fc < 0:
            return None
        if telegram.is_clock_value:
            return Req.CLOCK_VALUE.name
        number = telegram.fc & FC_FUNCTION
        names = _REQUEST if telegram.fc & FC_REQUEST else _RESPONSE
        return names.get(number) or f"reserved {number}"

    def as_dict(self) -> dict[str, object]:
        """The object of ``decode --json``."""
        telegram, step, sent = self.telegram, self.step, self.transmission
        t_ns = sent.t_ns
        kind = da = sa = fc = fcb = fcv = dsap = ssap = data = None
        if telegram is not None:
            kind = _KINDS[telegram.kind]
            if telegram.kind is not _KIND_SC:
                da, sa = telegram.da, telegram.sa
                if telegram.kind is not _KIND_SD4:
                    fc, dsap, ssap, data = telegram.fc, telegram.dsap, telegram.ssap, telegram.data.hex()
                    if fc & FC_REQUEST:
                        fcb, fcv = bool(fc & FC_FCB), bool(fc & FC_FCV)
        found: dict[str, object] = {
            "number": self.number,
            "t": None if t_ns is None else t_ns / NS_PER_S,
            "octets": sent.octets.hex(),
            "kind": kind,
            "da": da,
            "sa": sa,
            "fc": fc,
            "function": self.function,
            "fcb": fcb,
            "fcv": fcv,
            "service": self.service or None,
            "dsap": dsap,
            "ssap": ssap,
            "data": data,
            "fields": self.fields,
            "course": _course(step),
            "error": self.error,
            "text": self.text,
        }
        if kind == "SC":
            found["from"] = None if step.request is None else step.request.da
        if self.sender or self.receiver:
            found["names"] = {"sender": self.sender or None, "receiver": self.receiver or None}
        if sent.damage:
            found["damage"] = [text for bit, text in DAMAGE_TEXTS.items() if sent.damage & bit]
        return found


def _course(step: Step) -> dict[str, object]:
    return {
        "retry_of": step.retry_of,
        "answer_to": step.answer_to,
        "response_us": step.response_us,
        "unanswered": step.unanswered,
        "late": step.late,
        "repeated_poll_of": step.repeated_poll_of,
        "fcb_turned": step.fcb_turned,
        "probably_answers": step.probably_answers,
        "remarks": list(step.remarks),
    }


class Explainer:
    """Explains the transmissions of one bus in the order of their times, numbered from 1, with ``names``."""

    def __init__(self, names: Names = NO_NAMES) -> None:
        self._course = Course()
        self._stations = Stations(names)
        self._name_of = self._stations.name_of
        self._named = bool(names.slaves or names.cpus)
        self._number = 0
        self._asked: Explained | None = None  # the last request
        self._known: dict[bytes, tuple[Telegram | None, str, bool]] = {}
        self._baud = 0
        self._durations: Sequence[int] = ()  # of telegrams by their size, at the present rate

    def add(self, sent: Transmission, number: int | None = None) -> Explained:
        """The next transmission; ``number``: if it is not that of the one before and 1. Never raises for octets."""
        self._number = number = self._number + 1 if number is None else number
        octets, t_ns, baud, _, _ = sent
        telegram, name, is_request = self._known.get(octets) or self._know(octets)
        if telegram is None:
            return Explained(number, sent, None, "", _NO_FIELDS, flaw_text(octets), self._course.damaged(octets))
        if t_ns is None or not baud:
            end_ns = None
        else:
            if baud != self._baud:
                self._baud, self._durations = baud, [chars_to_ns(size, baud) for size in range(_LONGEST + 1)]
            end_ns = t_ns + self._durations[len(octets)]
        step = self._course.follow(telegram, number, t_ns, end_ns)
        error = None
        fields = _NO_FIELDS
        request = step.request
        if telegram.data:
            try:
                fields = self._stations.fields(telegram, request)
            except (PduError, ConfigError) as refused:
                error = str(refused)
        asked = self._asked
        # an acknowledgement, or a response without SAPs, is of the service that it answers
        if request is not None and (telegram.kind is _KIND_SC or telegram.dsap is telegram.ssap is None):
            name = service(request) if asked is None or asked.telegram is not request else asked.service
        if "PPI_PDU" in fields or (is_request and self._stations.polls_cpu(telegram)):
            name = PPI
        found = Explained(number, sent, telegram, name, fields, error, step)
        if step.unanswered is not None and asked is not None:
            asked.unanswered = asked.number == step.unanswered
        if is_request:
            self._asked = found
        if self._named:
            self._name(found, telegram if telegram.sa >= 0 else request)
        return found

    def _know(self, octets: bytes) -> tuple[Telegram | None, str, bool]:
        """The telegram in octets that are not kept, the name of its service, and whether it is a request."""
        telegram = decode(octets)
        if telegram is None:
            return None, "", False
        if len(self._known) >= _KEPT_TELEGRAMS:
            self._known.clear()
        self._known[octets] = found = telegram, service(telegram), telegram.is_request
        return found

    def _name(self, found: Explained, telegram: Telegram | None) -> None:
        """The names of both stations; of an SC by its request."""
        if telegram is None:
            return
        found.sender, found.receiver = self._name_of(telegram.sa), self._name_of(telegram.da)
        if found.telegram is not telegram:
            found.sender, found.receiver = found.receiver, found.sender


def explain(transmissions: Iterable[Transmission], names: Names = NO_NAMES) -> Iterator[Explained]:
    """Explain a log, one :class:`Explained` for each transmission, numbered from 1. Never raises for octets."""
    return map(Explainer(names).add, transmissions)
