"""The key ``subscribes`` of [[slave]]: values that a slave takes from other slaves by data exchange broadcast (DXB).

A subscription names another slave, so it is resolved when all slaves are known (:mod:`dpstack.api.config.broadcast`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Final, NamedTuple, TypedDict

from dpstack.fdl.telegram import MAX_DATA
from dpstack.params import MAX_STATION
from dpstack.text import brief
from dpstack.toml.table import Key, Table, keys_of

if TYPE_CHECKING:
    pass

_OCTETS: Final = re.compile(r"(\d{1,3}):(\d{1,3})")
_EXAMPLE: Final = 'subscribes = [{ from = "encoder", octets = "0:4", to = 8 }]'


class Subscription(NamedTuple):
    """Octets ``first`` up to, not including, ``end`` of the inputs of ``publisher``, a name or an address.

    ``to``: the first octet of the subscriber's outputs that they act as; None: a link table has no place for them.
    """

    publisher: str | int
    first: int
    end: int
    to: int | None = None


def _from(table: Table, name: str, _: Key) -> str | int:
    given = table.raw(name)
    return table.text(name) if isinstance(given, str) else table.integer(name, 0, MAX_STATION)


def _octets(table: Table, name: str, _: Key) -> tuple[int, int]:
    given = table.text(name)
    found = _OCTETS.fullmatch(given)
    if found is None or not int(found[1]) < int(found[2]) <= MAX_DATA:
        todo = (
            f'write the first octet and the one behind the last, for instance "0:4" for octets 0..3, up to {MAX_DATA}'
        )
        table.fail(name, f"{name} = {brief(given)}", todo)
    return int(found[1]), int(found[2])


SubscribeKeys = TypedDict(
    "SubscribeKeys",
    {
        "from": Annotated[str, Key(read=_from)],
        "octets": Annotated[str, Key(read=_octets)],
        "to": Annotated[int, Key(0, MAX_DATA - 1, hint="the first octet of its own outputs, from 0")],
    },
    total=False,
)
SubscribeKeys.__doc__ = """The keys of one entry of ``subscribes``, as docs/reference/configuration.md has them.

    from: the publisher, by name or address. Left out: required
    octets: octets of the inputs of the publisher: the first one, from 0, and the one behind the last. Left out:
        required
    to: the first octet of the outputs of this slave that they act as, in all entries or in none. Left out: the slave
        gets a link table, which has no places: its manual says what it does with the octets
    """


def read_subscribes(table: Table, key: str, _: Key) -> tuple[Subscription, ...]:
    """Reader of ``subscribes``: a list of tables. Raises ConfigError."""
    given = table.raw(key)
    if not isinstance(given, (list, tuple)) or not all(isinstance(one, Mapping) and one for one in given):
        table.fail(key, f"{key} = {brief(given)} is no list of tables", f"write {_EXAMPLE}")
    return tuple(_entry(table.inner(key, number, one)) for number, one in enumerate(given, 1))


def _entry(entry: Table) -> Subscription:
    values = entry.read(keys_of(SubscribeKeys))
    for name in ("from", "octets"):
        if name not in values:
            entry.fail(None, f"no {name}", f"write {_EXAMPLE}")
    first, end = values["octets"]
    return Subscription(values["from"], first, end, values.get("to"))
