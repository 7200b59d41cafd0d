"""Identity, variables and status of a transmitter: several commands, as rows and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, TypeVar

from msgspec import Struct, field

from dpstack.errors import PduError
from dpstack.hart.client import HartClient, HartClientError, Transport
from dpstack.hart.commands import (
    READ_LONG_TAG,
    READ_RANGE,
    READ_STATUS,
    READ_TAG,
    READ_VARIABLES,
    Identity,
    Range,
    Rows,
    Tag,
    Variables,
)
from dpstack.hart.status import additional_status_texts, device_status_texts
from dpstack.hart.tables import latin_text

T = TypeVar("T")
#: the HART revision from which on there is a long tag
_LONG_TAG_SINCE: Final = 6
_LONG_TAG_LEN: Final = 32


class HartReading(Struct, frozen=True):
    """Identity, variables, tag, range and status of a transmitter. A command that it refuses is in ``refused``, with
    its number and the reason, and its part is None."""

    #: maker, device type, revisions, address (command 0)
    identity: Identity
    #: loop current and up to four variables (command 3)
    variables: Variables | None = None
    #: tag, descriptor, date (command 13)
    tag: Tag | None = None
    #: command 20, HART 6 and later
    long_tag: str | None = None
    #: range of the primary variable (command 15)
    range: Range | None = None
    #: the device status octet in words, of all answers
    device_status: tuple[str, ...] = ()
    #: command 48 in words, as far as it is standardized
    additional_status: tuple[str, ...] | None = None
    #: command number -> why there is no answer
    refused: Mapping[int, str] = field(default_factory=dict)

    @property
    def rows(self) -> Rows:
        """Labels and texts in the order in which a technician asks."""
        rows = [*(() if self.tag is None else self.tag.rows)]
        if self.long_tag is not None:
            rows.insert(1 if rows else 0, ("long tag", self.long_tag))
        for part in (self.variables, self.range):
            rows += () if part is None else part.rows
        rows.append(("device status", "; ".join(self.device_status) or "good"))
        if self.additional_status is not None:
            rows.append(("additional status", "; ".join(self.additional_status) or "none"))
        rows += self.identity.rows
        return rows + [(f"command {number}", text) for number, text in self.refused.items()]

    def as_dict(self) -> dict[str, object]:
        """For JSON: values as numbers, with their units in words."""
        identity, variables, found = self.identity, self.variables, self.range
        shown: dict[str, object] = {
            "identity": {
                "manufacturer": identity.manufacturer,
                "maker": identity.maker,
                "device_type": identity.device_type,
                "device_id": identity.device_id,
                "revision": identity.revision,
                "device_revision": identity.device_revision,
                "software_revision": identity.software_revision,
                "hardware_revision": identity.hardware_revision,
                "address": identity.address.hex(),
            }
        }
        if variables is not None:
            shown["current_ma"] = variables.current
            shown["variables"] = [
                {"name": one.name, "value": one.value, "unit": one.unit, "unit_code": one.unit_code}
                for one in variables.variables
            ]
        if self.tag is not None:
            shown |= {"tag": self.tag.tag, "descriptor": self.tag.descriptor, "date": self.tag.date}
        if self.long_tag is not None:
            shown["long_tag"] = self.long_tag
        if found is not None:
            shown["range"] = {
                "lower": found.lower,
                "upper": found.upper,
                "unit": found.unit,
                "unit_code": found.unit_code,
                "damping_s": found.damping,
            }
        shown["device_status"] = list(self.device_status)
        if self.additional_status is not None:
            shown["additional_status"] = list(self.additional_status)
        return shown | (
            {"refused": {str(number): text for number, text in self.refused.items()}} if self.refused else {}
        )


def read_out(client: HartClient, deadline: Callable[[], int]) -> Transport[HartReading]:
    """Commands 0, 3, 13, 15, 20 and 48. ``deadline`` makes that of each command. Raises HartClientError, except for a
    command that the device refuses."""
    client.identity, client.seen = None, 0  # the transmitter may be another one than before
    identity = yield from client.read_identity(deadline=deadline())
    revision = identity.revision
    refused: dict[int, str] = {}

    def ask(number: int, parse: Callable[[bytes], T]) -> Transport[T | None]:
        try:
            answer = yield from client.command(number, deadline=deadline())
            return parse(answer.data)
        except PduError as error:
            refused[number] = str(error)
        except HartClientError as failure:
            if failure.reason != "refused":
                raise
            refused[number] = failure.text
        return None

    variables = yield from ask(READ_VARIABLES, Variables.parse)
    tag = yield from ask(READ_TAG, Tag.parse)
    long_tag = None
    if revision >= _LONG_TAG_SINCE:
        long_tag = yield from ask(READ_LONG_TAG, lambda data: latin_text(data[:_LONG_TAG_LEN]))
    limits = yield from ask(READ_RANGE, Range.parse)
    additional = yield from ask(READ_STATUS, lambda data: additional_status_texts(data, revision))
    return HartReading(
        identity, variables, tag, long_tag, limits, device_status_texts(client.seen), additional, refused
    )
