"""A telegram explained to the bit: link layer, service, fields, and what it is in the course of the bus."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from dpstack.capture.transmission import Transmission
from dpstack.decode.course import Course, Place, Step
from dpstack.decode.fields import Fields, fields_of
from dpstack.decode.words import describe, flaw_text
from dpstack.errors import ConfigError, PduError
from dpstack.fdl.codec import decode
from dpstack.fdl.service_names import service
from dpstack.fdl.telegram import FC_FCB, FC_FCV, Kind, Req, Resp, Telegram
from dpstack.units import NS_PER_S, chars_to_ns

#: the names of functions as the standard has them, of requests and of responses
_REQUEST: Final = {number.value: number.name for number in Req if number is not Req.CLOCK_VALUE}
_RESPONSE: Final = {number.value: number.name for number in Resp}


@dataclass(frozen=True, slots=True)
class Explained:
    """One transmission. ``telegram`` is None where the octets are none, ``error`` says why, and also what is wrong in
    the data unit of a whole telegram."""

    number: int
    transmission: Transmission
    telegram: Telegram | None
    service: str
    fields: Fields
    error: str | None
    step: Step

    @property
    def text(self) -> str:
        """One line for people, without its time and octets."""
        telegram = self.telegram
        parts = [describe(telegram)] if telegram is not None else []
        if self.error is not None:
            parts.append(self.error if telegram is None else f"cannot be read: {self.error}")
        step = self.step
        if step.retry_of is not None:
            parts.append(f"retry of {step.retry_of}")
        elif step.unanswered is not None:
            parts.append(f"{step.unanswered} was not answered")
        parts += step.remarks
        if self.transmission.note:
            parts.append(self.transmission.note)
        return "; ".join(parts)

    def as_dict(self) -> dict[str, object]:
        """The object of ``decode --json``."""
        telegram = self.telegram
        octets = self.transmission.octets
        step = self.step
        t_ns = self.transmission.t_ns
        found: dict[str, object] = {
            "number": self.number,
            "t": None if t_ns is None else t_ns / NS_PER_S,
            "octets": octets.hex(),
            "kind": None if telegram is None else telegram.kind.name,
            "da": None,
            "sa": None,
            "fc": None,
            "function": None,
            "fcb": None,
            "fcv": None,
            "service": self.service or None,
            "dsap": None,
            "ssap": None,
            "data": None,
            "fields": self.fields,
            "course": {
                "retry_of": step.retry_of,
                "answer_to": step.answer_to,
                "response_us": step.response_us,
                "unanswered": step.unanswered,
                "late": step.late,
                "remarks": list(step.remarks),
            },
            "error": self.error,
            "text": self.text,
        }
        if telegram is None:
            return found
        if telegram.kind is Kind.SC:
            found["from"] = None if step.request is None else step.request.da
            return found
        found |= {"da": telegram.da, "sa": telegram.sa}
        if telegram.kind is Kind.SD4:
            return found
        request = telegram.is_request
        names = _REQUEST if request else _RESPONSE
        found |= {
            "fc": telegram.fc,
            "function": names.get(telegram.function, f"reserved {telegram.function}"),
            "dsap": telegram.dsap,
            "ssap": telegram.ssap,
            "data": telegram.data.hex(),
        }
        if request:
            found |= {"fcb": bool(telegram.fc & FC_FCB), "fcv": bool(telegram.fc & FC_FCV)}
        return found


def explain(transmissions: Iterable[Transmission]) -> Iterator[Explained]:
    """Explain a log, one :class:`Explained` for each transmission, numbered from 1. Never raises for octets."""
    return map(Explainer().add, transmissions)


class Explainer:
    """Explains the transmissions of one bus as they come, numbered from 1."""

    def __init__(self) -> None:
        self._course = Course()
        self._number = 0

    def add(self, sent: Transmission) -> Explained:
        """Never raises for octets."""
        self._number += 1
        return _explain(self._number, sent, self._course)


def _explain(number: int, sent: Transmission, course: Course) -> Explained:
    octets = sent.octets
    telegram = decode(octets)
    if telegram is None:
        course.damaged()
        return Explained(number, sent, None, "", {}, flaw_text(octets), Step())
    end = None if sent.t_ns is None or not sent.baud else sent.t_ns + chars_to_ns(len(octets), sent.baud)
    step = course.follow(telegram, Place(number, end), sent.t_ns)
    error = None
    fields: Fields = {}
    try:
        fields = fields_of(telegram)
    except (PduError, ConfigError) as refused:
        error = str(refused)
    return Explained(number, sent, telegram, _service(telegram, step), fields, error, step)


def _service(telegram: Telegram, step: Step) -> str:
    """An acknowledgement, or a response without SAPs, is of the service that it answers."""
    if step.request is not None and (telegram.kind is Kind.SC or telegram.dsap is telegram.ssap is None):
        return service(step.request)
    return service(telegram)
