"""The tools that read files of the named folders: ``files``, ``decode``, ``monitor`` of a file, ``plan``, ``gsd_show``.

Each reads what the command of its name reads, up to :data:`MOST_OCTETS` and for :data:`LONGEST_S` at most.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from time import monotonic
from typing import Annotated, Any, Final

from msgspec import Meta, Struct

from dpstack.api.bus.compose import plan_bus
from dpstack.api.config.config import Config, load_config
from dpstack.api.gsd_folder import GsdFolder
from dpstack.api.gsd_info import ENDINGS, bundled, gsd_dict, read_gsd
from dpstack.api.listen.names import decode_names
from dpstack.api.listen.plant_files import load_devices
from dpstack.capture.timing import FILE, LineTiming
from dpstack.capture.transmission import Transmission
from dpstack.cli.assistants import answers
from dpstack.cli.assistants.bus_tools import monitor_answer, numbers, value_of
from dpstack.cli.assistants.folders import Folders
from dpstack.cli.assistants.foreign import quote, quote_all, quote_or_none
from dpstack.cli.listening.decode import Buses
from dpstack.cli.listening.judged_file import JudgedFiles
from dpstack.cli.listening.source_file import transmissions_of
from dpstack.cli.looking.gsd_find import without_languages
from dpstack.decode.filter import one_later, parse_filter
from dpstack.decode.log_text import Unread
from dpstack.decode.source import read_transmissions
from dpstack.decode.telegram import Explained
from dpstack.errors import CaptureFileError, UsageError
from dpstack.monitor.exchanges import Batch
from dpstack.monitor.monitor import Monitor
from dpstack.record.reader import SUFFIXES
from dpstack.text import iso_time
from dpstack.units import AUTO, BAUD_RATES

#: octets of a capture file or recording
MOST_OCTETS: Final = 64_000_000
#: time that a tool may work on a file, in s
LONGEST_S: Final = 20.0
#: files that `decode` and `monitor` read: pcapng, text with hex digits, files of logic analysers
_CAPTURES: Final = frozenset((".pcapng", ".txt", ".hex", ".log", ".sr", ".vcd"))
CAPTURES: Final = _CAPTURES | {".csv"}
PLANTS: Final = frozenset((".toml",))
RECORDINGS: Final = frozenset(SUFFIXES)
_KINDS: Final[dict[str, frozenset[str]]] = {
    "configuration": PLANTS,
    "gsd": ENDINGS,
    "capture": _CAPTURES,  # a CSV file may also be one: it is listed as a recording
    "recording": RECORDINGS,
}
_FIELDS: Final = 60
_REMARKS: Final = 100
_HEX: Final = 1000

FileName = Annotated[str, Meta(max_length=1000, description="a file of the list that `files` gives")]
Baud = Annotated[int, Meta(ge=BAUD_RATES[0], le=BAUD_RATES[-1], description="in bit/s")]
Channel = Annotated[str, Meta(max_length=100, description="of a logic analyser's file; empty: it is found")]
_From = Annotated[int, Meta(ge=0, description="leave out so many")]


class Files(Struct, kw_only=True, forbid_unknown_fields=True):
    words: Annotated[str, Meta(max_length=200, description="parts of names, all of which a file has; empty: all")] = ""
    kind: Annotated[str, Meta(pattern="^(configuration|gsd|capture|recording|)$")] = ""


class Decode(Struct, kw_only=True, forbid_unknown_fields=True):
    octets: (
        Annotated[str, Meta(max_length=20_000, description="telegrams in hex digits, in place of a file")] | None
    ) = None
    file: FileName | None = None
    filter: Annotated[
        str, Meta(max_length=500, description="as `dpstack decode --filter`, e.g. station 5 and error")
    ] = ""
    baud: Baud | None = None
    channel: Channel = ""
    begin: Annotated[int, Meta(ge=1, description="number of the first transmission")] = 1
    limit: answers.Page = 30


class PlanFile(Struct, kw_only=True, forbid_unknown_fields=True):
    file: Annotated[str, Meta(max_length=1000, description="left out: CONFIG")] | None = None
    baud: Baud | None = None


class GsdShow(Struct, kw_only=True, forbid_unknown_fields=True):
    file: Annotated[
        str, Meta(max_length=1000, description="a GSD file of the list, or the name of a device of dpstack")
    ]
    offset: _From = 0
    limit: answers.Page = 40


class GsdFind(Struct, kw_only=True, forbid_unknown_fields=True):
    words: Annotated[
        str,
        Meta(min_length=1, max_length=200, description="all must fit: vendor, model, order or ident number, module"),
    ]
    limit: answers.Page = 20


class FileTools:
    """The tools on ``folders``; names in telegrams are those of the configuration ``path``, None without one."""

    def __init__(self, folders: Folders, path: Path | None) -> None:
        self._folders = folders
        self._path = path

    def _config(self) -> Config | None:
        return None if self._path is None else load_config(self._path)

    def _capture(self, name: str) -> Path:
        path = self._folders.file(name, CAPTURES)
        check_size(path, name)
        return path

    # --- the tools ---
    def files(self, given: Files) -> answers.FilesAnswer:
        wanted = {given.kind: _KINDS[given.kind]} if given.kind else _KINDS
        words = given.words.lower().split()
        found: list[answers.File] = []
        left_out = 0
        for one in self._folders.files(frozenset().union(*wanted.values())):
            if not all(word in one.name.lower() for word in words):
                continue
            if len(found) == answers.MOST:
                left_out += 1
                continue
            kind: Any = next(kind for kind, endings in wanted.items() if one.path.suffix.lower() in endings)
            found.append(answers.File(name=quote(one.name), kind=kind, size=one.size, changed=iso_time(one.changed)))
        return answers.FilesAnswer(folders=quote_all(self._folders.roots), files=found, left_out=left_out)

    def decode(self, given: Decode) -> answers.DecodeAnswer:
        if (given.octets is None) == (given.file is None):
            raise UsageError("decode: give either octets or a file")
        buses = Buses(decode_names(self._config()))
        remarks: list[str] = []
        if given.file is not None:
            source: Iterator[Transmission] = transmissions_of(
                str(self._capture(given.file)),
                buses.choose,
                baud=given.baud or AUTO,
                channel=given.channel,
                on_remark=remarks.append,
                on_unread=_remark_into(remarks),
            )
        else:
            source = read_transmissions(
                io.BytesIO((given.octets or "").encode()), "octets", on_unread=_remark_into(remarks)
            )
        match = parse_filter(given.filter) if given.filter else None
        explained: Iterator[Explained] = map(buses.explain, source)
        found: list[answers.Telegram] = []
        read, following, stopped = 0, None, None
        until = monotonic() + LONGEST_S
        try:
            for one in explained if match is None else one_later(explained):
                read = one.number
                if one.number >= given.begin and (match is None or match(one)):
                    if len(found) == given.limit:
                        following = one.number
                        break
                    found.append(_telegram(one))
                if monotonic() > until:
                    following, stopped = one.number + 1, f"after {LONGEST_S:g} s"
                    break
        except CaptureFileError as error:
            if not read:
                raise
            stopped = str(error)
        return answers.DecodeAnswer(
            source="octets" if given.file is None else "file",
            read=read,
            telegrams=found,
            next=following,
            stopped=quote_or_none(stopped),
            remarks=quote_all(remarks),
        )

    def monitor(self, name: str, baud: int | None, channel: str) -> answers.MonitorAnswer:
        path = self._capture(name)
        config = self._config()
        monitor = Monitor(LineTiming(FILE, None), devices=load_devices(config, None))
        remarks: list[str] = []
        until = monotonic() + LONGEST_S

        def add_all(transmissions: Batch) -> None:
            monitor.add_all(transmissions)
            if monotonic() > until:
                raise _TimeIsUpError

        judged = JudgedFiles(
            [str(path)],
            monitor,
            on_unread=_remark_into(remarks),
            baud=baud or AUTO,
            channel=channel,
            add_all=add_all,
            on_remark=remarks.append,
        )
        try:
            judged.read()
        except _TimeIsUpError:
            remarks.append(f"judged up to here: the file takes longer than {LONGEST_S:g} s")
        except CaptureFileError as error:
            if not monitor.counters.telegrams:
                raise
            remarks.append(str(error))
        return monitor_answer(monitor, "file", quote_all(remarks))

    def plan(self, given: PlanFile) -> answers.PlanAnswer:
        path = self._path if given.file is None else self._folders.file(given.file, PLANTS)
        if path is None:
            raise UsageError("plan: name a configuration file; this server was started without CONFIG")
        config = load_config(path)
        plan: Mapping[str, Any] = plan_bus(config, given.baud or config.baud).as_dict()
        return answers.PlanAnswer(
            file=quote(path.name),
            port=quote(config.port),
            baud=plan["baud"],
            address=plan["address"],
            rotation_us=numbers(plan["rotation_us"]),
            parameters=numbers(plan["parameters"]),
            slaves=[
                answers.PlannedSlave(
                    address=one["address"],
                    name=quote(one["name"]),
                    inputs=one["inputs"],
                    outputs=one["outputs"],
                    watchdog_ms=one["watchdog_ms"],
                    on_loss=quote(one["on_loss"]),
                    set_prm=one["set_prm"].lower(),
                    chk_cfg=one["chk_cfg"].lower(),
                )
                for one in plan["slaves"]
            ],
            findings=quote_all(plan["findings"]),
            remarks=quote_all(plan["notes"]),
        )

    def gsd_show(self, given: GsdShow) -> answers.GsdAnswer:
        name = given.file
        file = read_gsd(name if name in bundled() else self._folders.file(name, ENDINGS))
        data: Mapping[str, Any] = gsd_dict(file)
        texts = [("device", data["diagnosis"])]
        texts += [(f"type {one['type']}", one["diagnosis"]) for one in data["diagnosis_types"]]
        texts += [(one["name"], one["diagnosis"]) for one in data["modules"]]
        flat = [(of, one) for of, every in texts for one in every]
        page = slice(given.offset, given.offset + given.limit)
        limits = "max_module max_input_len max_output_len max_data_len max_diag_data_len min_slave_interval"
        counts = {"modules": len(data["modules"]), "parameters": len(data["parameters"]), "texts": len(flat)}
        return answers.GsdAnswer(
            file=quote(name),
            ident=data["ident"],
            vendor=quote(data["vendor"]),
            model=quote(data["model"]),
            revision=quote(data["revision"]),
            gsd_revision=data["gsd_revision"],
            modular=bool(data["modular"]),
            numbers=numbers({key: data[key] for key in limits.split() if data[key] is not None}),
            supports=quote_all(data["supports"]),
            requires=quote_all(data["requires"]),
            bauds=numbers({key: -1 if bits is None else bits for key, bits in data["max_tsdr"].items()}),
            user_prm=data["user_prm"],
            counts=numbers(counts),
            modules=[
                answers.GsdModule(
                    name=quote(one["name"]),
                    reference=one["reference"],
                    config=one["config"],
                    inputs=one["inputs"],
                    outputs=one["outputs"],
                    user_prm=one["user_prm"][:_HEX],
                )
                for one in data["modules"][page]
            ],
            parameters=[_parameter(one) for one in data["parameters"][page]],
            texts=[
                answers.GsdText(place=quote(f"{of}: {_place(one)}"), text=quote(one["text"])) for of, one in flat[page]
            ],
            diagnostics=[
                answers.GsdRemark(line=one["line"], severity=one["severity"], message=quote(one["message"]))
                for one in data["diagnostics"][:50]
            ],
        )

    def gsd_find(self, given: GsdFind) -> answers.GsdFindAnswer:
        found: list[answers.FoundDevice] = []
        remarks: list[str] = []
        for number, root in enumerate(self._folders.roots):
            folder = GsdFolder(root)
            for hit in without_languages(folder.search(given.words.split())):
                path = hit.entry.path
                if not number if path is None else self._folders.contains(path.resolve()):
                    found.append(_found_device(hit.as_dict()))
            remarks += [f"left out: {path}: {reason}" for path, reason in folder.bad]
        return answers.GsdFindAnswer(
            devices=found[: given.limit], left_out=max(0, len(found) - given.limit), remarks=quote_all(remarks, 20)
        )


class _TimeIsUpError(Exception):
    """The file takes longer than :data:`LONGEST_S`."""


def _remark_into(remarks: list[str]) -> Callable[[Unread], None]:
    """Lines of a log without octets as remarks: those that seem to have some."""

    def note(line: Unread) -> None:
        if line.reason and len(remarks) < _REMARKS:
            remarks.append(f"line {line.number}: {line.reason}")

    return note


def check_size(path: Path, name: str) -> None:
    """Raises UsageError for a file of more than :data:`MOST_OCTETS`."""
    size = path.stat().st_size
    if size > MOST_OCTETS:
        raise UsageError(f"{name} has {size} octets, more than {MOST_OCTETS}: take a part of it, or the command itself")


def _telegram(one: Explained) -> answers.Telegram:
    data: Mapping[str, Any] = one.as_dict()
    function, service = data["function"], data["service"]
    return answers.Telegram(
        number=one.number,
        t=data["t"],
        octets=data["octets"][:_HEX],
        kind=data["kind"],
        da=data["da"],
        sa=data["sa"],
        function=None if function is None else _word(function),
        service=None if service is None else _word(service),
        text=quote(data["text"]),
        fields=[
            answers.ExplainedField(place=quote(place), value=value_of(value))
            for place, value in islice(_flat(data["fields"]), _FIELDS)
        ],
        error=quote_or_none(data["error"]),
    )


def _word(text: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in text)[:40]


def _flat(value: object, place: str = "") -> Iterator[tuple[str, object]]:
    """The plain values in fields, each with its place."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flat(inner, f"{place}.{key}" if place else str(key))
    elif isinstance(value, (list, tuple)):
        for number, inner in enumerate(value):
            yield from _flat(inner, f"{place}[{number}]")
    else:
        yield place, value


def _found_device(one: Mapping[str, Any]) -> answers.FoundDevice:
    return answers.FoundDevice(
        file=quote(one["file"]),
        also=quote_all(one["also"], 10),
        ident=one["ident"],
        vendor=quote(one["vendor"]),
        model=quote(one["model"]),
        order_number=quote_or_none(one["order_number"]),
        found_in=[
            answers.FoundText(field=match["field"], text=quote(match["text"]), reference=match["reference"])
            for match in one["matches"][:10]
        ],
    )


def _parameter(one: Mapping[str, Any]) -> answers.GsdParameter:
    allowed = [f"{value} = {text}" for value, text in one["texts"].items()]
    allowed = allowed or [f"{low}..{high}" if low != high else str(low) for low, high in one["allowed"]]
    return answers.GsdParameter(
        number=one["number"],
        name=quote(one["name"]),
        type=quote(one["type"]),
        default=one["default"],
        allowed=quote_all(allowed, 20),
    )


def _place(one: Mapping[str, Any]) -> str:
    match one["kind"]:
        case "bit":
            return f"bit {one['first']}"
        case "not_bit":
            return f"bit {one['first']} is 0"
        case "area":
            return f"bits {one['first']} to {one['last']} = {one['value']}"
        case _:
            return f"channel error {one['value']}"
