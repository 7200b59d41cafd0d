"""``dpstack device list`` and ``show``: device files as tables and JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from dpstack.cli.devices.check import place_of
from dpstack.cli.devices.drives import warn_broken
from dpstack.cli.terminal import output
from dpstack.devices import finding
from dpstack.devices.model import TYPES, DeviceFile, FileFacts, Messages, WordSpec
from dpstack.devices.pa.model import PaFile
from dpstack.errors import ConfigError
from dpstack.profile import registry
from dpstack.profile.drive_profile import DeviceProfile, DriveProfile, OptionSpec

#: the base of a drive that is a plugin
_PLUGIN: Final = "python"


# --- list -------------------------------------------------------------------------------------------------------------
def list_devices(*, json: bool) -> int:
    """Exit code 1 if one cannot be loaded."""
    found = sorted(all_devices(), key=lambda one: (one["base"], one["name"]))
    broken = finding.broken()
    if json:
        unusable = [{"name": name, "reason": why} for name, why in broken.items()]
        output.json_line({"devices": found, "broken": unusable})
        return int(bool(broken))
    rows = [(one["name"], one["title"], one["base"], one["source"], one["tried"], one["origin"]) for one in found]
    title = 'Drives and devices, for drive = "NAME" or device = "NAME"'
    output.table(title, ("name", "title", "base", "source", "tried", "from"), rows)
    warn_broken(broken)
    return int(bool(broken))


def all_devices() -> list[dict[str, Any]]:
    """All device files and plugins that are known, as JSON has them."""
    origins = finding.origins()
    found = []
    known: dict[str, DriveProfile | DeviceProfile] = {**finding.known(), **finding.known_devices()}
    for name, profile in known.items():
        file = finding.file_at(Path(profile.file)) if profile.file else None
        found.append(
            {
                "name": name,
                "kind": "drive" if isinstance(profile, DriveProfile) else "device",
                "title": profile.title,
                "base": _PLUGIN if file is None else file.base,
                "source": "" if file is None else file.source,
                "tried": "" if file is None else file.tried,
                "telegrams": list(profile.telegrams),
                "ident": None if profile.ident_made_up else f"0x{profile.ident:04X}",
                "origin": origins.get(name, ""),
                "file": profile.file,
            }
        )
    return found


# --- show -------------------------------------------------------------------------------------------------------------
def show_device(name: str, *, json: bool) -> int:
    """Raises ConfigError for a name that is not known, or a file with mistakes."""
    if not finding.is_path(name) and (name in registry.places() or finding.path_of(name) is None):
        finding.find(name)  # says which names are near
        raise ConfigError(
            f"{name} is a plugin of a Python package, not a device file; "
            "`dpstack sheet` of a configuration with this drive has its words and parameters"
        )
    shown = _as_dict(finding.file_at(place_of(name)))
    if json:
        output.json_line(shown)
    else:
        _show(shown)
    return 0


def _as_dict(file: FileFacts) -> dict[str, Any]:
    profile = finding.made(file)
    shown = _facts(file, profile)
    if isinstance(file, DeviceFile):
        shown |= _drive(file)
    elif isinstance(file, PaFile):
        shown |= _process_device(file)
    return shown | {
        "options": [_option(name, one) for name, one in profile.core_options.items()],
        "simulated_options": [_option(name, one) for name, one in profile.device_options.items()],
    }


def _facts(file: FileFacts, profile: DriveProfile | DeviceProfile) -> dict[str, Any]:
    """The part that all device files have."""
    return {
        "name": file.name,
        "title": file.title,
        "base": file.base,
        "file": str(file.path),
        "source": file.source,
        "tried": file.tried,
        "on_loss": file.on_loss,
        "notes": list(file.notes),
        "ident": None if profile.ident_made_up else f"0x{profile.ident:04X}",
        "gsd": None if file.gsd is None else str(file.gsd),
        "telegram": file.default_telegram,
        "telegrams": [
            {
                "name": name,
                "config": one.spec.config.hex(" ").upper(),
                "made_up": one.spec.made_up,
                "channel": one.spec.channel,
                "outputs": list(one.outputs),
                "inputs": list(one.inputs),
                "modules": list(one.modules),
            }
            for name, one in file.telegrams.items()
        ],
        "words": [_word(word) for word in file.words.values()],
    }


def _drive(file: DeviceFile) -> dict[str, Any]:
    table = file.table
    return {
        "python": file.python,
        "derived": [
            {"name": name, "of": one.of, "shift": one.shift, "mask": one.mask, "when": one.when}
            for name, one in file.derived.items()
        ],
        "control_bits": dict(table.control.bits),
        "control_words": {
            **{f"to running from {state}": f"{word:04X}" for state, word in file.run.items()},
            **{goal.value: f"{word:04X}" for goal, word in file.steady.items()},
            "safe outputs": f"{file.safe_control:04X}",
        },
        "status_bits": dict(table.status.bits),
        "states": [
            {"state": str(row.state), "mask": f"{row.mask:04X}", "value": f"{row.value:04X}"}
            for row in table.states.rows
        ],
        "orders": {
            name: {"set": list(table.control.names(one.set)), "clear": list(table.control.names(one.clear))}
            for name, one in file.orders.items()
        },
        "obstacles": [
            {"bits": list(table.status.names(one.mask)), "when": int(bool(one.value)), "text": one.text}
            for one in file.obstacles
        ],
        "fault": _messages(file.fault),
        "warning": _messages(file.warning),
        "parameters": [
            {
                "number": spec.number,
                "index": spec.index,
                "name": spec.name,
                "title": spec.title,
                "type": str(spec.type),
                "unit": spec.unit,
                "low": spec.low,
                "high": spec.high,
                "factory": spec.factory,
                "read_only": spec.read_only,
                "use": str(spec.use),
            }
            for spec in file.parameters
        ],
        "settings": [
            {
                "parameter": one.parameter,
                "equals": f"{{{one.equals}}}" if isinstance(one.equals, str) else one.equals,
                "notice": one.notice,
                "remedy": one.remedy,
                "why": one.why,
            }
            for one in file.settings
        ],
    }


def _process_device(file: PaFile) -> dict[str, Any]:
    """A PROFIBUS PA device: its slots and modules, and the maker's words."""
    return {
        "coding": file.coding,
        "slots": [
            {
                "slot": slot.number,
                "block": slot.block,
                "name": slot.name,
                "title": slot.title,
                "unit": slot.unit,
                "module": slot.module,
                "modules": list(slot.modules),
            }
            for slot in file.slots
        ],
        "modules": [
            {
                "name": one.name,
                "block": one.block,
                "config": one.config.hex(" ").upper(),
                "inputs": list(one.inputs),
                "outputs": list(one.outputs),
            }
            for one in file.modules.values()
        ],
        "extension": {f"{bit // 8}.{bit % 8}": text for bit, text in sorted(file.extension.items())},
        "parameters": [
            {
                "name": one.name,
                "block": one.block,
                "relative": one.relative,
                "slot": one.slot,
                "index": one.index,
                "type": one.type,
                "unit": one.unit,
                "access": one.access,
                "title": one.title,
            }
            for one in file.parameters.values()
        ],
    }


def _word(word: WordSpec) -> dict[str, Any]:
    return {
        "name": word.name,
        "type": word.type,
        "octets": TYPES[word.type][0] // 8,
        "part": word.part,
        "full": word.full,
        "of": word.of if word.full else None,
        "unit": word.shown_unit,
        "low": word.low,
        "high": word.high,
        "neutral": word.neutral,
        "bits": dict(word.bits),
    }


def _messages(messages: Messages) -> dict[str, Any]:
    return {
        "word": messages.word,
        "kind": messages.kind,
        "parameter": None if messages.parameter is None else messages.parameter.number,
        "texts": {str(number): text for number, text in messages.texts.items()},
    }


def _option(name: str, option: OptionSpec) -> dict[str, Any]:
    return {
        "name": name,
        "default": option.default,
        "text": option.text,
        "low": option.low,
        "high": option.high,
        "choices": list(option.choices),
    }


def _show(shown: Mapping[str, Any]) -> None:
    output.line(f"{shown['name']}: {shown['title']}", "bold")
    for key in ("base", "file", "gsd", "ident", "python", "source", "tried", "on_loss"):
        if shown.get(key):
            output.line(f"{key.replace('_', ' ')}: {shown[key]}")
    for note in shown["notes"]:
        output.line(f"- {note}")
    used = {one for telegram in shown["telegrams"] for way in ("outputs", "inputs") for one in telegram[way]}
    _table(
        f"Telegrams; without a choice {shown['telegram']}",
        ("telegram", "identifiers", "to the drive", "from the drive"),
        (
            (
                one["name"],
                f"{one['config']}{' (made up)' if one['made_up'] else ''}",
                _words(one["outputs"], one["channel"]),
                _words(one["inputs"], one["channel"]),
            )
            for one in shown["telegrams"]
        ),
    )
    _table(
        "Words",
        ("word", "type", "part", "scale", "limits", "bits"),
        (
            (one["name"], one["type"], one["part"], _scale(one), _limits(one), _bits(one["bits"]))
            for one in shown["words"]
            if one["name"] in used
        ),
    )
    if "states" in shown:
        _show_drive(shown)
    if "slots" in shown:
        _show_process_device(shown)
    for key, title in (("options", "Options"), ("simulated_options", "Options of the simulated device")):
        _table(
            title,
            ("option", "default", "limits", "meaning"),
            (
                (one["name"], str(one["default"]), _limits(one) or " ".join(one["choices"]), one["text"])
                for one in shown[key]
            ),
        )


def _show_process_device(shown: Mapping[str, Any]) -> None:
    _table(
        "Slots",
        ("slot", "block", "value", "unit", "module without a choice", "it may have", "what it is"),
        (
            (
                one["slot"],
                one["block"],
                one["name"],
                one["unit"],
                one["module"],
                ", ".join(one["modules"]),
                one["title"],
            )
            for one in shown["slots"]
        ),
    )
    _table(
        "Modules",
        ("module", "block", "identifiers", "from the device", "to the device"),
        (
            (one["name"], one["block"], one["config"], " ".join(one["inputs"]), " ".join(one["outputs"]))
            for one in shown["modules"]
        ),
    )
    _table("DIAGNOSIS_EXTENSION", ("octet and bit", "text"), shown["extension"].items())
    _table(
        "Parameters of the maker",
        ("name", "place", "type", "unit", "access", "title"),
        (
            (
                one["name"],
                f"{one['block']} + {one['relative']}" if one["block"] else f"slot {one['slot']} index {one['index']}",
                one["type"],
                one["unit"],
                one["access"],
                one["title"],
            )
            for one in shown["parameters"]
        ),
    )


def _show_drive(shown: Mapping[str, Any]) -> None:
    _table(
        "Derived values",
        ("name", "of", "shift", "mask", "when"),
        (
            (one["name"], one["of"], one["shift"], f"{one['mask']:X}h", f"{one['when']:04X}h")
            for one in shown["derived"]
        ),
    )
    output.line("")
    for name in ("control", "status"):
        output.line(f"{name} word: {_bits(shown[f'{name}_bits']) or 'no bit has a name'}")
    _table("Control words", ("goal", "word"), shown["control_words"].items())
    _table("States", ("state", "mask", "value"), ((one["state"], one["mask"], one["value"]) for one in shown["states"]))
    _table(
        "Orders of its own",
        ("order", "sets", "clears"),
        ((name, " ".join(one["set"]), " ".join(one["clear"])) for name, one in shown["orders"].items()),
    )
    _table(
        "It does not run while",
        ("bit of the status word", "is", "because"),
        ((" ".join(one["bits"]), one["when"], one["text"]) for one in shown["obstacles"]),
    )
    for part in ("fault", "warning"):
        one = shown[part]
        where = f"word {one['word']}" if one["word"] else ""
        if one["parameter"]:
            where = f"{where}{', else ' if where else ''}parameter {one['parameter']}"
        if where:
            output.line(f"{part}: {one['kind']} in {where}")
        _table(f"Texts of the {part}", (one["kind"].removesuffix("s"), "text"), one["texts"].items())
    _table(
        "Parameters",
        ("number", "name", "title", "type", "limits", "at delivery", "use"),
        (
            (
                f"{one['number']}{'.' + str(one['index']) if one['index'] else ''}",
                one["name"],
                one["title"],
                one["type"],
                _limits(one),
                "" if one["read_only"] else f"{one['factory']:g} {one['unit']}".strip(),
                "read only" if one["read_only"] else one["use"],
            )
            for one in shown["parameters"]
        ),
    )
    _table(
        "Settings",
        ("parameter", "must be", "otherwise", "remedy"),
        (
            (
                one["parameter"],
                one["equals"] if isinstance(one["equals"], str) else f"{one['equals']:g}",
                "notice" if one["notice"] else "no start",
                one["remedy"] or one["why"],
            )
            for one in shown["settings"]
        ),
    )


def _table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """A table that is left out without rows; and so are its empty columns."""
    cells = [[str(cell) for cell in row] for row in rows]
    if cells:
        used = [n for n in range(len(columns)) if n == 0 or any(row[n] for row in cells)]
        output.line("")
        output.table(title, [columns[n] for n in used], [[row[n] for n in used] for row in cells])


def _words(words: Iterable[str | int], channel: bool) -> str:
    names = [one if isinstance(one, str) else f"{one:04X}h" for one in words]
    return " ".join(["PKW"] * channel + names)


def _bits(bits: Mapping[str, int]) -> str:
    return ", ".join(f"{number} {name}" for name, number in sorted(bits.items(), key=lambda item: item[1]))


def _scale(word: Mapping[str, Any]) -> str:
    if not word["full"]:
        return str(word["unit"])
    of = word["of"] if isinstance(word["of"], str) else f"{word['of']:g} {word['unit']}"
    return f"{word['full']:X}h = {of}"


def _limits(one: Mapping[str, Any]) -> str:
    low, high = one["low"], one["high"]
    if low is None and high is None:
        return ""
    shown = ("" if limit is None else f"{limit:.10g}" for limit in (low, high))
    return f"{'..'.join(shown)} {one.get('unit', '')}".strip()
