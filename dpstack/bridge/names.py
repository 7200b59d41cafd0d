"""Names of slaves and values as Sparkplug B, OPC UA, Prometheus and EPICS permit them.

The rule is the same for all connectors: a character that the connector does not permit becomes ``_``, a name that is
too long is cut, an empty one becomes ``_``. If two names would then be the same, the one with the lower key keeps
it, the others get their key behind it. So the names depend only on the plant, and not on the order in which its slaves
come.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from string import ascii_letters, digits
from typing import Final

from dpstack.text import is_plain, printable


@dataclass(frozen=True, slots=True)
class NameRule:
    """The names of a connector. ``reserved``: characters that it does not permit, besides controls and surrogates;
    ``only``: if given, it permits no others than these. ``most``: octets of UTF-8 at most. ``fold``: names that differ
    in case only are the same. ``gap``: stands between a name and its key, if two would be the same."""

    connector: str
    reserved: str
    most: int
    fold: bool = False
    only: str = ""
    gap: str = " "

    def valid(self, text: str) -> str:
        """``text`` as a valid name."""
        # e and an accent as two characters are the same name as one character for a reader
        made = "".join(letter if self.permits(letter) else "_" for letter in unicodedata.normalize("NFC", text).strip())
        return _cut(made, self.most).rstrip() or "_"

    def permits(self, letter: str) -> bool:
        if self.only:
            return letter in self.only
        return is_plain(letter) and letter not in self.reserved and not _is_noncharacter(letter)

    def key(self, name: str) -> str:
        """The part of a name by which the connector distinguishes it from another."""
        return name.casefold() if self.fold else name


#: group, edge node and device: a level of a topic of MQTT (tck-id-topic-structure-namespace-valid-device-id)
SPARKPLUG_ID: Final = NameRule("Sparkplug", "+/#", 120, fold=True)
#: one level of the name of a metric; ``/`` separates levels. Names should not differ in case only (6.4.6)
SPARKPLUG_METRIC: Final = NameRule("Sparkplug", "/+#", 120, fold=True)
#: slaves and values of plain JSON: a level of a topic
MQTT_NAME: Final = NameRule("MQTT", "+/#", 120, fold=True)
#: a QualifiedName has 512 characters at most (Part 3, 8.3); the reserved ones have a meaning in a path (Part 4, A.2)
OPCUA_BROWSE: Final = NameRule("OPC UA", "/.<>:#!&", 200)
#: the value of a label: every text in UTF-8
PROMETHEUS_LABEL: Final = NameRule("Prometheus", "", 200)
#: a part of the name of a record (EPICS Application Developer's Guide, "Database Definition"), but for ``:``, which
#: separates the parts. A whole name that is too long is no name; it is not cut
EPICS_PART: Final = NameRule("EPICS", "", 200, only=f"{ascii_letters}{digits}_-+[]<>;", gap="_")


@dataclass(frozen=True, slots=True)
class Names:
    """Valid names by key. ``changed``: one line for each that is not the name given."""

    names: Mapping[str, str]
    changed: tuple[str, ...]


def unique_names(rule: NameRule, given: Iterable[tuple[str, str]]) -> Names:
    """A valid name for each pair of key and wanted name, different from all others. Keys are different and sort in the
    order of precedence; see :func:`sort_key`."""
    names: dict[str, str] = {}
    changed: list[str] = []
    taken: set[str] = set()
    for key, wanted in sorted(given, key=lambda pair: sort_key(pair[0])):
        name = found = rule.valid(wanted)
        number = 1
        while rule.key(found) in taken:
            own = f"{rule.gap}{rule.valid(key)}"
            tail = own if number == 1 else f"{own}{rule.gap}{number}"
            tail = tail if len(tail.encode()) < rule.most // 2 else f"{rule.gap}{number}"
            found = _cut(name, rule.most - len(tail.encode())) + tail
            number += 1
        taken.add(rule.key(found))
        names[key] = found
        if found != wanted:
            why = "another one has this name" if found != name else f"{rule.connector} does not permit this name"
            changed.append(f"{printable(wanted)!r} ({printable(key)}) is called {found!r}: {why}")
    return Names(names, tuple(changed))


def sort_key(key: str) -> tuple[tuple[int, int, str], ...]:
    """Sorts ``slave 9`` before ``slave 10``."""
    parts = re.split(r"([0-9]{1,9})", key)
    return tuple((0, int(part), "") if part.isascii() and part.isdigit() else (1, 0, part) for part in parts)


def _cut(text: str, most: int) -> str:
    octets = text.encode()
    return text if len(octets) <= most else octets[:most].decode(errors="ignore")


def _is_noncharacter(letter: str) -> bool:
    """U+FFFE and the like: MQTT 5.0, 1.5.4, advises against them."""
    code = ord(letter)
    return code & 0xFFFE == 0xFFFE or 0xFDD0 <= code <= 0xFDEF
