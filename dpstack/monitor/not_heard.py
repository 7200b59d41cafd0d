"""Things of a bus that nobody can know who only listens, as no telegram of the time of listening carried them.

A slave in data exchange sends its diagnosis only when its master asks for it: in a bring-up, and after an answer that
announces a new one. A diagnosis that stood before is on no wire while the plant runs in order. A verdict that is good
is good as far as heard as long as one of these things is missing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from dpstack.monitor.counters import Station, Unheard
from dpstack.monitor.verdict import GOOD
from dpstack.monitor.verdicts import Heard
from dpstack.text import some_of

DIAGNOSIS, PARAMETERS, MODE = "diagnosis", "parameters", "mode"
#: stations named in one line
_NAMED: Final = 8
_DIAGNOSES: Final = {
    Unheard.NEVER: "standing diagnoses of {}: no Slave_Diag was on the wire",
    Unheard.GAP: "diagnoses of {} since octets were missed: a Slave_Diag may be among them",
    Unheard.UNREADABLE: "the last diagnosis of {}: nobody could read the answer to Slave_Diag",
    Unheard.UNREAD: "the announced diagnosis of {}: its master has not asked for it",
}
_OTHERS: Final = {
    PARAMETERS: "parameters of {} (watchdog, groups, user parameters): no Set_Prm was on the wire",
    MODE: "the mode of master {}: no Global_Control was on the wire",
}
_AS_FAR: Final = "as far as heard"


def of_station(station: Station, heard: Heard) -> list[str]:
    """The things not heard of a station, by name; none of an address where nobody answers."""
    master = heard.counters.masters.get(station.address)
    if master is not None:
        return [MODE] if master.mode == "unknown" and master.slaves and not master.is_silent else []
    if station.is_cpu:  # it has neither
        return []
    missing = [DIAGNOSIS] if station.unheard else []
    if station.set_prm is None:
        missing.append(PARAMETERS)
    return missing if station.is_present else []


def lines_of(heard: Heard) -> list[str]:
    """One line for people for each thing, with the stations that it is about; none if this is no PROFIBUS."""
    return list(_lines(heard)) if heard.is_profibus else []


def _lines(heard: Heard) -> Iterator[str]:
    by_thing: dict[str, list[Station]] = {}
    for _, station in sorted(heard.counters.stations.items()):
        for thing in of_station(station, heard):
            by_thing.setdefault(thing, []).append(station)
    for why, text in _DIAGNOSES.items():
        found = [station for station in by_thing.get(DIAGNOSIS, ()) if station.unheard is why]
        if found:
            yield text.format(_names(found, heard))
    for thing, text in _OTHERS.items():
        if thing in by_thing:
            yield text.format(_names(by_thing[thing], heard))


def _names(stations: Sequence[Station], heard: Heard) -> str:
    names = {one.address: heard.devices.find(one.address, one.ident).name for one in stations}
    return some_of([f"{address} ({name})" if name else str(address) for address, name in names.items()], _NAMED)


def verdict_text(found: Mapping[str, Any]) -> str:
    """The verdict of a summary, of a station or a master in it for people: its word, and "as far as heard" behind a
    good one with things that were not heard."""
    verdict = str(found.get("verdict", ""))
    return f"{verdict}, {_AS_FAR}" if verdict == GOOD and found.get("not_heard") else verdict
