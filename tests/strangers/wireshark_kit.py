"""What Wireshark's dissector finds in a capture, beside what dpstack's own decoder finds: field by field, under the
names of the JSON objects of ``dpstack decode``.
"""

from __future__ import annotations

import atexit
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Final

import dpstack
from dpstack.capture.pcapng import USER0, Writer
from dpstack.capture.transmission import Transmission
from dpstack.decode.source import read_transmissions
from dpstack.decode.telegram import Explained, explain
from dpstack.units import baud_text
from tests.strangers.stranger_kit import HANGS_S, program

LUA: Final = Path(dpstack.__file__).parent / "wireshark" / "profibus.lua"
_STUB: Final = Path(__file__).parent / "wireshark_stub.lua"
#: fields of the dissector beside those of the decoder
_MORE: Final = frozenset(
    "profibus." + name
    for name in (
        "le",
        "fcs",
        "dseg",
        "sseg",
        "station_type",
        "pair",
        "response_in",
        "given_up_in",
        "octets",
    )
)
#: keys of the decoder's objects that have another name, or none because Wireshark has them
_NAMES: Final = {
    "number": None,
    "t": None,
    "octets": None,
    "course.retry_of": "retry_of",
    "course.answer_to": "response_to",
    "course.response_us": "response_time",
    "course.unanswered": "unanswered",
    "course.late": "late",
    "course.remarks": "remark",
    "course.repeated_poll_of": "repeated_poll_of",
    "course.fcb_turned": "fcb_turned",
    "course.probably_answers": "probably_answers",
}
_AGGREGATOR: Final = "\x1f"

Found = dict[str, list[str]]


@cache
def _home() -> Path:
    """A home folder with the dissector of this source tree as a plugin; it is removed at the end."""
    home = Path(tempfile.mkdtemp(prefix="dpstack-wireshark-"))
    atexit.register(shutil.rmtree, home, ignore_errors=True)
    plugins = home / ".local/lib/wireshark/plugins"
    plugins.mkdir(parents=True)
    shutil.copy(LUA, plugins)
    return home


def environment(home: Path) -> dict[str, str]:
    """The environment of a user with that home folder."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("WIRESHARK_", "XDG_CONFIG"))}
    return {**kept, "HOME": str(home)}


def tshark(*arguments: str | Path, home: Path | None = None) -> str:
    """The output of tshark; ``home``: with what is installed there, else with the dissector of this source tree."""
    command = [program("tshark"), *map(str, arguments)]
    env = environment(home or _home())
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANGS_S, check=False, env=env)
    assert done.returncode == 0, f"tshark ended with {done.returncode}: {done.stderr[-2000:]}"
    assert "Lua" not in done.stderr, done.stderr[-2000:]
    return done.stdout


def write_capture(path: Path, sent: Iterable[Transmission], linktype: int = USER0) -> Path:
    """A pcapng file of ``sent``, with an interface for each rate."""
    with path.open("wb") as file:
        writer = Writer(file, "dpstack tests")
        ports: dict[int, int] = {}
        for one in sent:
            if one.baud not in ports:
                about = f"PROFIBUS bus, {baud_text(one.baud)}, even parity" if one.baud else "PROFIBUS bus"
                ports[one.baud] = writer.interface("bus", one.baud, about, linktype=linktype)
            writer.packet(ports[one.baud], one.t_ns or 0, one.octets, one.damage, one.note)
    return path


def explained(path: Path) -> list[Explained]:
    """The packets of a capture by our own decoder."""
    with path.open("rb") as file:
        return list(explain(read_transmissions(file, str(path))))


@cache
def field_names() -> tuple[str, ...]:
    """The names of all fields of the dissector."""
    rows = [line.split("\t") for line in tshark("-G", "fields").splitlines()]
    return tuple(row[2] for row in rows if row[0] == "F" and row[2].startswith("profibus."))


def dissected(path: Path) -> list[Found]:
    """The fields of each packet of a capture as tshark prints them, in the order of the packets."""
    names = [name for name in field_names() if not name.startswith("profibus.expert.")]
    wanted = [part for name in names for part in ("-e", name)]
    options = ("-E", f"aggregator={_AGGREGATOR}", "-E", "occurrence=a", "-E", "separator=/t")
    lines = tshark("-2", "-r", path, "-T", "fields", *options, *wanted).split("\n")
    return [
        {name: text.split(_AGGREGATOR) for name, text in zip(names, line.split("\t"), strict=True) if text}
        for line in lines[:-1]
    ]


def dissected_by_lua(sent: Sequence[Transmission]) -> list[Found]:
    """The fields of each transmission, by a plain Lua 5.4 that has what the dissector uses of Wireshark."""
    begun = sent[0].t_ns or 0
    lines = "".join(f"{(one.t_ns or 0) - begun} {one.octets.hex()}\n" for one in sent)
    command = [program("lua5.4"), str(_STUB), str(LUA), f"bus, {baud_text(sent[0].baud)}, 8 data bits, even parity"]
    done = subprocess.run(command, input=lines, capture_output=True, text=True, timeout=HANGS_S, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    found: list[Found] = [{} for _ in sent]
    for line in done.stdout.splitlines():
        number, name, value = line.split("\t")
        found[int(number) - 1].setdefault(name, []).append(value)
    return found


def differences(found: Sequence[Found], ours: Sequence[Explained]) -> list[str]:
    """A line for each field in which the two differ."""
    assert len(found) == len(ours)
    wrong = []
    for theirs, one in zip(found, ours, strict=True):
        expected = _flat(one.as_dict())
        for name in sorted(expected.keys() | theirs.keys() - _MORE):
            want, have = expected.get(name, []), theirs.get(name, [])
            if len(want) != len(have) or not all(map(_same, want, have)):
                wrong.append(f"{one.number} {one.transmission.octets.hex(' ')}: {name}: {have} instead of {want}")
    return wrong


def _flat(found: Mapping[str, object], prefix: str = "") -> dict[str, list[object]]:
    """The values below each key, in their order; without those that say nothing: None, empty ones, ``late`` False."""
    flat: dict[str, list[object]] = {}
    for key, value in found.items():
        name: str | None = prefix + key.lower()
        if not prefix and key == "fields":
            name = "dp"
        if isinstance(value, Mapping):
            inner = _flat(value, f"{name}.")
            for below, values in inner.items():
                flat.setdefault(below, []).extend(values)
            continue
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, Mapping):
                for below, values in _flat(item, f"{name}.").items():
                    flat.setdefault(below, []).extend(values)
            elif item is not None and item != "" and (name != "course.late" or item):
                flat.setdefault(str(name), []).append(item)
    if prefix:
        return flat
    return {f"profibus.{_NAMES.get(name, name)}": values for name, values in flat.items() if _NAMES.get(name, name)}


def _same(ours: object, theirs: str) -> bool:
    """Whether a value of the decoder is that text of tshark: octets have blanks there, times are in seconds."""
    match ours:
        case bool():
            return theirs.lower() in (("1", "true") if ours else ("0", "false"))
        case int():
            return int(theirs, 0) == ours
        case float():
            return Decimal(theirs) in (Decimal(str(ours)), Decimal(str(ours)) / 1_000_000)
    return str(ours) in (theirs, theirs.replace(" ", ""))
