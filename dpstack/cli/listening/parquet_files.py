"""``dpstack decode --parquet``: the telegrams of captures as Parquet files."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from dpstack.api.listen.telegram_table import TelegramTable, segment_folder, segment_of
from dpstack.capture.pcapng import Interface
from dpstack.capture.transmission import Transmission
from dpstack.cli import options
from dpstack.cli.listening.capture_set import NamedFile, files_in
from dpstack.cli.listening.source_file import STDIN, UnreadLines, transmissions_of
from dpstack.cli.terminal import output
from dpstack.decode.telegram import Explained
from dpstack.errors import CaptureFileError, UsageError


class Buses(Protocol):
    """The buses in one capture: explains their transmissions."""

    def choose(self, interface: Interface) -> None: ...
    def explain(self, sent: Transmission) -> Explained: ...


def execute(args: argparse.Namespace, buses: Callable[[], Buses]) -> int:
    """``buses`` explain the telegrams of one capture. Exit code 1 if a capture cannot be read to its end, or a file
    cannot be written."""
    if args.filter is not None:
        raise UsageError("--parquet keeps every telegram: give the filter in the query, not with --filter")
    if args.diagnosis or args.address is not None:
        raise UsageError("--parquet is of telegrams: it does not go with --diagnosis and --address")
    options.require("pyarrow", "--parquet", "parquet")
    captures = [(one.name, _segment(args, one)) for one in files_in(args.source, output.warn)]
    folder = _folder(args.parquet)
    return _Conversion(args, folder, buses).run(captures)


def _segment(args: argparse.Namespace, source: NamedFile) -> str:
    """The name of the segment of which the capture ``source`` is. Raises UsageError."""
    name: str | None = args.segment
    if name is None and args.config is not None:
        name = segment_of(Path(args.config))
    if name is None and source.name == STDIN:
        raise UsageError("standard input has no name: name the segment, for instance --segment press")
    if name is None:
        name = Path(source.folder).resolve().name if source.folder else segment_of(Path(source.name))
    segment_folder(name)
    return name


def _folder(name: str) -> Path:
    """The folder of ``--parquet``, which is made if it does not exist. Raises UsageError."""
    folder = Path(name)
    if not name:
        raise UsageError("--parquet needs the name of a folder; it is made if it is missing")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except ValueError as error:  # a name with a zero octet
        raise UsageError(f"{name}: {error}; name a folder") from None
    except (FileExistsError, NotADirectoryError):
        raise UsageError(f"{name}: is no folder; name one with --parquet, it is made if it is missing") from None
    except OSError as error:
        raise UsageError(f"{name}: cannot be made ({error.strerror}); name a folder of yours with --parquet") from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise UsageError(f"{name}: you may not write into this folder; name a folder of yours with --parquet")
    return folder


class _Conversion:
    """Writes one capture after another."""

    def __init__(self, args: argparse.Namespace, folder: Path, buses: Callable[[], Buses]) -> None:
        self._args = args
        self._buses = buses
        self._folder = folder
        self._json: bool = args.json
        self._telegrams = 0
        self._files = 0
        self._written_by: dict[tuple[str, str], str] = {}  # captures by segment and the name of their files

    def run(self, captures: list[tuple[str, str]]) -> int:
        """``captures``: each with the name of its segment."""
        unread = 0
        for source, segment in captures:
            unread += not self._read(source, segment)
            if output.lost.error is not None:
                return 1
        if self._json:
            summary = {"captures": len(captures), "unread": unread, "telegrams": self._telegrams, "files": self._files}
            output.json_line({"event": "summary", **summary})
        else:
            output.line(f"{self._telegrams} telegrams in {self._files} files below {self._folder}")
        return 1 if unread else 0

    def _read(self, source: str, segment: str) -> bool:
        """Write the capture ``source``; what cannot be read is reported. False if it could not be read to its end."""
        args, buses, unread = self._args, self._buses(), UnreadLines(shown=False)
        damage: list[str] = []

        def named(files: str) -> None:
            before = self._written_by.setdefault((segment, files), source)
            if before != source:
                raise UsageError(
                    f"{source}: left out: it has the name and the first telegram of {before}, as a copy of the same "
                    "capture has; give one of them"
                )

        capture = None if source == STDIN else Path(source)
        with TelegramTable(self._folder, segment, capture, self._written, named) as table:

            def choose(interface: Interface) -> None:
                table.port = interface.name
                buses.choose(interface)

            sent = transmissions_of(source, choose, on_unread=unread.add, baud=args.baud, channel=args.channel)
            try:
                for one in sent:
                    table.add(buses.explain(one))
                    if output.lost.error is not None:
                        return True
            except (CaptureFileError, UsageError) as error:  # a ring may remove a file while others are read
                damage.append(str(error))
            try:
                table.close()
            except UsageError as error:  # of named
                damage.append(str(error))
        for text in dict.fromkeys(damage):
            output.warn(text)
        return not unread.report() and not damage

    def _written(self, path: Path, telegrams: int) -> None:
        self._files += 1
        self._telegrams += telegrams
        if self._json:
            output.json_line({"event": "file", "file": str(path), "telegrams": telegrams})
        else:
            output.line(f"{path}: {telegrams} telegrams")
