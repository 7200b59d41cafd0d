"""The GSD files of a folder by file name, ident number and order number, as an importer asks for them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import PurePath
from typing import Final

from dpstack.api.files import read_file
from dpstack.api.gsd_folder import GsdEntry, GsdFolder, by_language
from dpstack.errors import ConfigError
from dpstack.gsd.search import order_number_fits
from dpstack.gsd.text import MAX_OCTETS, decode
from dpstack.importers.step7_slaves import Found, bare_order

#: 6ES7 153-2BA00-0XB0, also with placeholders for some characters: 6ES7 314-6C***-0AB0, 6ES7 132-0BL0.-0XB0
_ORDER: Final = re.compile(r"\b\d[A-Z]{2}\d ?[\w*?.]{3}-[\w*?.]{5}(?:-[\w*?.]{4})?")
_MODULES: Final = re.compile(r"^[ \t]*Module[ \t]*=", re.IGNORECASE | re.MULTILINE)
#: the part of an order number that names the device; the rest is the version
_DEVICE: Final = len("6ES71532BA00") + 1


class FolderFinder:
    """The files of ``folder`` for an importer. A damaged file is skipped.

    A project names a device by its whole order number. A GSD file often has another version of it, or placeholders, and
    lists further numbers in comments: all numbers in front of its modules count, first the whole number, then the part
    that names the device.
    """

    def __init__(self, folder: GsdFolder) -> None:
        self._folder = folder
        self._orders: dict[str, frozenset[str]] | None = None

    def named(self, name: str, ident: int | None) -> list[Found]:
        """The files with that name, then those in another language (``.gse``, ``.gsg``), then those with ``ident``."""
        wanted = PurePath(name.lower())
        own = [entry for entry in self._folder.entries if entry.path is not None]
        exact = [entry for entry in own if entry.path and entry.path.name.lower() == wanted.name]
        alike = [entry for entry in own if entry.path and entry.path.stem.lower() == wanted.stem]
        return self._read((*exact, *alike, *([] if ident is None else self._folder.with_ident(ident))))

    def with_order(self, number: str) -> list[Found]:
        """The files that name ``number``, the best one first.

        Fewer placeholders are a better fit; of files in several languages the one without a language and the English
        one come first.
        """
        wanted = bare_order(number)
        known = self._all_orders()
        for length in (len(wanted), _DEVICE):
            fits = {
                key: max((order_number_fits(order[:length], wanted[:length]) for order in orders), default=0)
                for key, orders in known.items()
            }
            found = [entry for entry in self._folder.entries if fits.get(entry.key)]
            if found:
                return self._read(sorted(found, key=lambda entry: (-fits[entry.key], by_language(entry))))
        return []

    def _all_orders(self) -> dict[str, frozenset[str]]:
        if self._orders is None:
            self._orders = {}
            for entry in self._folder.entries:
                if entry.path is not None:
                    try:
                        text, _ = decode(read_file(entry.path, MAX_OCTETS))
                    except (OSError, ValueError):
                        continue
                    head = _MODULES.split(text, maxsplit=1)[0]
                    self._orders[entry.key] = frozenset("".join(order.split()) for order in _ORDER.findall(head))
        return self._orders

    def _read(self, entries: Iterable[GsdEntry]) -> list[Found]:
        found: dict[str, Found] = {}
        for entry in entries:
            if entry.key not in found:
                try:
                    found[entry.key] = Found(entry.key, self._folder.device(entry.key))
                except ConfigError:
                    continue
        return list(found.values())
