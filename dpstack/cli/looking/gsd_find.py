"""``dpstack gsd find``: GSD files by words: vendor, model, order number, ident number, module."""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

from dpstack.api.gsd_folder import GsdEntry, GsdFolder
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.gsd.search import Field, Found, Match
from dpstack.text import some_of

#: texts of one field that a line shows
_SHOWN: Final = 3


def add_to(parser: Parser) -> None:
    what = "words that all must be found, in any case, then a folder (default: this one, with the folders in it)"
    parser.value("words", "WORDS [DIR]", what, nargs="+")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if nothing was found. Files that cannot be used are reported, and change no exit code."""
    words, place = args.words, "."
    if len(words) > 1 and os.path.isdir(words[-1]):
        *words, place = words
    folder = GsdFolder(place, beside=".")
    hits = without_languages(folder.search(words))
    if os.path.isabs(place):
        hits = [hit.with_whole_paths() for hit in hits]
    for hit in hits:
        if args.json:
            output.json_line(hit.as_dict())
        else:
            output.line(hit.text)
    for path, reason in folder.bad:
        if args.json:
            output.json_line({"file": path, "error": reason})
        else:
            output.warn(f"left out: {path}: {reason}")
    if not hits:
        output.warn(f"nothing found: {len(folder.entries)} devices in {place} and among those of dpstack")
    return 0 if hits else 1


class Hit(NamedTuple):
    """A device, and its files in other languages."""

    entry: GsdEntry
    found: Found
    also: list[str]

    def with_whole_paths(self) -> Hit:
        """The hit with its paths as seen from everywhere."""
        key, also = ((os.path.abspath(name) for name in names) for names in ([self.entry.key], self.also))
        return self if self.entry.path is None else Hit(replace(self.entry, key=next(key)), self.found, list(also))

    @property
    def text(self) -> str:
        entry = self.entry
        ident = "without an ident number" if entry.ident is None else f"ident 0x{entry.ident:04X}"
        order = f", order number {' '.join(entry.order_number.split())}" if entry.order_number else ""
        also = f" (also {', '.join(Path(name).suffix for name in self.also)})" if self.also else ""
        name = " ".join(f"{entry.vendor} {entry.model}".split())
        where = "; ".join(_places(self.found.matches))
        return f"{entry.key}{also}: {name}, {ident}{order}; found in {where}"

    def as_dict(self) -> dict[str, object]:
        entry = self.entry
        return {
            "file": entry.key,
            "bundled": entry.path is None,
            "also": self.also,
            "ident": None if entry.ident is None else f"0x{entry.ident:04X}",
            "vendor": entry.vendor,
            "model": entry.model,
            "order_number": entry.order_number,
            "matches": [
                {"field": match.field.name.lower(), "text": match.text, "reference": match.reference}
                for match in self.found.matches
            ],
        }


def _places(matches: tuple[Match, ...]) -> list[str]:
    """The fields with the texts that have the words; those that the line shows already by name only."""
    modules = [f'"{" ".join(match.text.split())}"' for match in matches if match.field is Field.MODULE]
    fields = [match.field.title for match in matches if match.field is not Field.MODULE]
    return [*fields, *([f"module {some_of(modules, _SHOWN)}"] if modules else [])]


def without_languages(found: list[tuple[GsdEntry, Found]]) -> list[Hit]:
    """Files of one folder that differ in the language of their name only are one hit."""
    hits: dict[tuple[str, int | None], Hit] = {}
    for entry, one in found:
        known = hits.setdefault(
            (entry.key.rpartition(".")[0].casefold() or entry.key, entry.ident), Hit(entry, one, [])
        )
        if known.entry is not entry:
            known.also.append(entry.key)
    return list(hits.values())
