"""The tools for assistants: names, descriptions, types of arguments and answers. All of them only read.

Nothing here knows the protocol: ``server`` does.
"""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Awaitable, Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec
from msgspec import Struct

from dpstack.cli.assistants import answers, bus_tools, docs_search, file_tools, recordings
from dpstack.cli.assistants.folders import Folders
from dpstack.cli.assistants.foreign import NOTE
from dpstack.errors import DpError, UsageError
from dpstack.text import did_you_mean

_G = TypeVar("_G", bound=Struct)
#: octets of an answer in JSON, at most
MOST_OCTETS: Final = 400_000
#: tools that work at a time
_AT_ONCE: Final = 2
#: time limit of a tool, in s: listening, waiting for another one, a run that does not answer
LIMIT_S: Final = 120.0


class MonitorBus(Struct, kw_only=True, forbid_unknown_fields=True):
    """Without a file: of the bus of CONFIG."""

    file: file_tools.FileName | None = None
    baud: file_tools.Baud | None = None
    channel: file_tools.Channel = ""
    seconds: bus_tools.Seconds = bus_tools.USUAL_S


class Tool(Struct, frozen=True):
    """A tool. ``takes`` and ``gives``: the types of its arguments and of its answer."""

    name: str
    text: str
    takes: type[Struct]
    gives: type[answers.Answer]
    carry_out: Callable[[Any], Awaitable[answers.Answer]]

    @property
    def description(self) -> str:
        return f"{self.text} {NOTE}"

    @property
    def input_schema(self) -> dict[str, Any]:
        return schema_of(self.takes)

    @property
    def output_schema(self) -> dict[str, Any]:
        return schema_of(self.gives)


def schema_of(kind: type) -> dict[str, Any]:
    """The JSON schema of ``kind``, with an object at its root as the protocol wants it."""
    schema = msgspec.json.schema(kind)
    definitions = schema["$defs"]
    root = definitions.pop(schema["$ref"].rpartition("/")[2])
    return {**root, "$defs": definitions} if definitions else dict(root)


class Toolbox:
    """The tools of one server: on the bus of the configuration ``path`` (None: none), and on ``folders``."""

    def __init__(self, path: Path | None, folders: Folders) -> None:
        self._bus = bus_tools.BusTools(path)
        self._files = file_tools.FileTools(folders, path)
        self._folders = folders
        self._free = asyncio.Semaphore(_AT_ONCE)
        self.tools: Mapping[str, Tool] = {tool.name: tool for tool in self._all()}

    def _all(self) -> Iterable[Tool]:
        bus, files = self._bus, self._files
        passive = (
            "No telegram is sent: a run that holds the port tells what it knows, otherwise the port is listened to."
        )
        yield Tool(
            "scan",
            f"The stations on the bus of CONFIG: masters, slaves, ident numbers, states. {passive}",
            bus_tools.Scan,
            answers.ScanAnswer,
            bus.scan,
        )
        yield Tool(
            "why",
            f"Why a slave of CONFIG is not in data exchange: last bring-up, likely causes, what to try next. {passive}",
            bus_tools.Why,
            answers.WhyAnswer,
            bus.why,
        )
        yield Tool(
            "diag",
            f"Diagnosis, configuration, inputs and outputs of one station of the bus of CONFIG. {passive}",
            bus_tools.Diag,
            answers.DiagAnswer,
            bus.diag,
        )
        yield Tool(
            "monitor",
            "Judges a bus by listening: verdicts with reasons on the bus and each station, counters, events. Of the "
            f"bus of CONFIG, or of a capture file. {passive}",
            MonitorBus,
            answers.MonitorAnswer,
            self._monitor,
        )
        yield Tool(
            "decode",
            "Explains PROFIBUS telegrams to the bit: octets in hex, or a capture file, page by page, with a filter.",
            file_tools.Decode,
            answers.DecodeAnswer,
            _in_thread(files.decode),
        )
        yield Tool(
            "plan",
            "The plan of a configuration: bus parameters, rotation times, watchdogs, octets of Set_Prm and Chk_Cfg, "
            "what is out of bounds.",
            file_tools.PlanFile,
            answers.PlanAnswer,
            _in_thread(files.plan),
        )
        yield Tool(
            "gsd_show",
            "A GSD file: ident number, limits, modules with identifier octets, parameters, texts of diagnoses.",
            file_tools.GsdShow,
            answers.GsdAnswer,
            _in_thread(files.gsd_show),
        )
        yield Tool(
            "gsd_find",
            "GSD files of the folders, and those of dpstack, by words: vendor, model, order or ident number, module.",
            file_tools.GsdFind,
            answers.GsdFindAnswer,
            _in_thread(files.gsd_find),
        )
        yield Tool(
            "files",
            "The files in the folders of this server that the other tools read: configurations, GSD files, captures, "
            "recordings.",
            file_tools.Files,
            answers.FilesAnswer,
            _in_thread(files.files),
        )
        yield Tool(
            "recording",
            "Values of a recording of `dpstack run --record`, by names and period: figures of each column, and rows.",
            recordings.ReadRecording,
            answers.RecordingAnswer,
            _in_thread(functools.partial(recordings.read_recording, self._folders)),
        )
        yield Tool(
            "search_docs",
            "Searches the documentation of dpstack: commands, configuration, PROFIBUS, symptoms and their causes.",
            docs_search.SearchDocs,
            answers.SearchAnswer,
            _in_thread(docs_search.search_docs),
        )
        yield Tool(
            "read_docs",
            "A page of the documentation of dpstack, in parts of 8000 characters.",
            docs_search.ReadDocs,
            answers.PageAnswer,
            _in_thread(docs_search.read_docs),
        )

    async def call(self, name: str, arguments: Mapping[str, Any]) -> tuple[bytes, dict[str, Any]]:
        """The answer of the tool ``name`` as JSON and as plain data. Raises DpError with one line."""
        tool = self.tools.get(name)
        if tool is None:
            raise UsageError(
                f"no tool {name!r}; " + did_you_mean(name, self.tools, f"there are {', '.join(self.tools)}")
            )
        try:
            given = msgspec.convert(arguments, tool.takes)
        except msgspec.ValidationError as error:
            raise UsageError(f"{name}: {error}") from None
        try:
            async with asyncio.timeout(LIMIT_S), self._free:
                answer = await tool.carry_out(given)
        except TimeoutError:
            raise DpError(f"{name}: no answer within {LIMIT_S:g} s; ask for less") from None
        octets = msgspec.json.encode(answer)
        if len(octets) > MOST_OCTETS:
            raise UsageError(f"{name}: the answer has {len(octets)} octets, more than {MOST_OCTETS}: ask for less")
        msgspec.json.decode(octets, type=tool.gives)  # a defect ends here, and not at the other end
        return octets, msgspec.json.decode(octets)

    async def _monitor(self, given: MonitorBus) -> answers.MonitorAnswer:
        if given.file is None:
            return await self._bus.monitor(given.seconds)
        return await asyncio.to_thread(self._files.monitor, given.file, given.baud, given.channel)


def _in_thread(work: Callable[[_G], answers.Answer]) -> Callable[[_G], Awaitable[answers.Answer]]:
    async def carry_out(given: _G) -> answers.Answer:
        return await asyncio.to_thread(work, given)

    return carry_out
