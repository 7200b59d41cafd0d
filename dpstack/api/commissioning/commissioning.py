"""``Commissioning``: match, modules, table, check, toml and sheet, with plain data in and out.

Everything that goes in and comes out is plain data (texts, numbers, lists, dicts, None), as it goes through JSON.
Nothing is written to a file, and the only GSD files that are read are those of one folder and those named in the
configuration that it belongs to.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from dpstack.api.bus.compose import plan_bus
from dpstack.api.bus.plan_checks import refuse_misfit
from dpstack.api.commissioning.candidates import candidates, module_choice
from dpstack.api.commissioning.sheet import Sheet, make_sheets
from dpstack.api.config.channel_names import name_lines, slot_remarks
from dpstack.api.config.config import Config, check_config, load_config, slave_config
from dpstack.api.config.gsd_choice import base_name, octet_remarks
from dpstack.api.files import read_file
from dpstack.api.gsd_folder import GsdFolder
from dpstack.api.gsd_info import bundled
from dpstack.errors import ConfigError, DpError, UsageError
from dpstack.params import MAX_STATION
from dpstack.text import printable, shortened
from dpstack.toml.reading import TomlError, read_toml, table_lines
from dpstack.toml.table import parse_hex

#: errors of one text, stations of one question
_MOST_ERRORS: Final = 50
_MOST_STATIONS: Final = 127
#: octets of the present configuration
_MOST_OCTETS: Final = 4_000_000
#: the name of a configuration that has no file yet
_NEW: Final = "plant.toml"
_HEAD: Final = (
    "# Made by dpstack from the slaves that were found on the bus. Nothing reads the user parameters of a slave:",
    "# compare them with the project of its maker's tool, or with its manual.",
)
_IDENT: Final = re.compile(r"0[xX][0-9a-fA-F]{1,4}|[0-9]{1,5}")


class Commissioning:
    """``config``: path of the present configuration, which need not exist; paths of GSD files are written as seen from
    its folder. ``gsd``: the folder of the GSD files; None: the folder of the configuration, without the folders in it,
    and the GSD files that the configuration names.

    The methods read files and may take some seconds: call them in a thread of their own, one at a time. Wrong arguments
    raise UsageError with one line that says what to do. Raises ConfigError if ``gsd`` is no folder.
    """

    def __init__(self, config: str | Path | None = None, gsd: str | Path | None = None) -> None:
        self._file = Path(_NEW if config is None else config)
        beside = self._file.parent
        named = [] if config is None else _gsd_of(self._file)
        #: the GSD files among which descriptions are looked for
        self.folder = GsdFolder(
            beside if gsd is None else gsd,
            beside=beside,
            deep=gsd is not None,
            also=[path for name in named if (path := beside / name).is_file()],
        )

    def __repr__(self) -> str:
        return f"<Commissioning {self._file}>"

    @property
    def name(self) -> str:
        """Name of the configuration file, without its folder."""
        return self._file.name

    def files(self) -> dict[str, Any]:
        """The GSD files: ``{"folder": PATH, "files": [{"gsd", "ident", "vendor", "model"}], "bad": [{"gsd",
        "reason"}]}``.

        ``gsd`` is the name of the file in a configuration, and in the other methods. ``bad``: files that cannot be
        used, at most 200.
        """
        self.folder.refresh()
        return {**self._head(), "files": [entry.as_dict() for entry in self.folder.entries]}

    def _head(self) -> dict[str, Any]:
        bad = [{"gsd": path, "reason": reason} for path, reason in self.folder.bad]
        return {"folder": self._folder_text(), "bad": bad}

    def _folder_text(self) -> str:
        """The folder of the GSD files as seen from the configuration: paths of this computer are not for all who look
        at a page."""
        folder = os.path.relpath(self.folder.folder.resolve(), self._file.parent.resolve())
        return f"the folder of {self._file.name}" if folder == os.curdir else folder

    def match(self, stations: object) -> dict[str, Any]:
        """The candidates of each slave in ``stations``, which are those of a scan: a list of ``{"address": 8, "ident":
        "0x0FFE" or null, "config": "20 10" or null}`` (further keys do not matter; masters are left out).

        ``{"folder", "bad", "stations": [{"address", "ident", "config", "name", "candidates"}]}``. ``name``: a proposal.
        ``candidates``, the best one first: ``{"kind": "drive", "gsd" or "octets", "fit": "exact", "unknown" (the slave
        did not give its configuration), "partly" or "none", "text": one sentence about the fit, "gsd": its name in a
        configuration or null, "drive": name or null, "telegrams": those that fit, "vendor", "model", "revision",
        "unknown_octets": identifier octets of no module, "readings": ways to make them from modules, "ambiguous": true
        if a person has to choose among modules with equal octets, "keys": the keys for :meth:`table` without name
        and address, or null if it leads to none}``. The best candidate is a proposal: a person chooses.
        """
        given = [_station(one) for one in _list(stations, "stations", _MOST_STATIONS)]
        self.folder.refresh()
        found = []
        for address, ident, config, kind in given:
            if kind not in (None, "slave"):
                continue
            ranked = candidates(self.folder, ident, config)
            model = next((one.drive or one.model for one in ranked if one.keys is not None), "") or "slave"
            found.append(
                {
                    "address": address,
                    "ident": None if ident is None else f"0x{ident:04X}",
                    "config": None if config is None else config.hex(" ").upper(),
                    "name": f"{base_name(model)}-{address}",
                    "candidates": [one.as_dict() for one in ranked],
                }
            )
        return {**self._head(), "stations": found}

    def modules(self, gsd: object, config: object = None) -> dict[str, Any]:
        """The modules of the file ``gsd``, and the readings of the identifier octets ``config`` (hex; None: not known).

        ``{"gsd", "ident", "vendor", "model", "revision", "modular", "max_module" (null: no limit), "first_slot",
        "modules": [{"key": its entry in the key `modules` or null, "name", "reference", "config", "inputs", "outputs",
        "fixed", "info", "reason": why it has no key}], "slots": [{"slot", "name", "modules": [numbers]}] (slots that
        take some modules only), "default": [numbers] or null, "readings": [{"unknown_octets", "places": [{"slot",
        "config", "unknown", "modules": [numbers]}]}], "more_readings": bool}``. A number counts ``modules`` from 0. A
        place with several modules is a choice; one without is an empty slot (entry ``""``), or ``unknown``.
        """
        name = _text(gsd, "gsd")
        octets = None if config is None else _octets(config)
        self.folder.refresh()
        device = self.folder.device(name)
        entry = next(entry for entry in self.folder.entries if entry.key == name)
        return module_choice(entry, device, octets)

    def table(self, slave: object) -> dict[str, Any]:
        """The [[slave]] table with the keys ``slave``: ``{"text", "errors", "inputs", "outputs", "config", "user_prm",
        "notes"}``.

        The keys are those of docs/reference/configuration.md; ``ident`` may be a text like "0x0FFE". ``errors`` as
        those of :meth:`check`; with errors the other values but ``text`` are null. ``inputs``, ``outputs``: octets.
        """
        self.folder.refresh()
        return self._table(_keys(slave))

    def _table(self, keys: Mapping[str, Any]) -> dict[str, Any]:
        lines = table_lines("[[slave]]", keys)
        nothing: dict[str, Any] = dict.fromkeys(("inputs", "outputs", "config", "user_prm"))
        refused = self._foreign_gsd(keys.get("gsd"))
        try:
            if refused is not None:
                raise refused
            found = slave_config(keys, where=str(self._file))
        except ConfigError as error:
            return {"text": _joined(lines), "errors": [_error(error)], **nothing, "notes": []}
        params = found.params
        lines += [*octet_remarks(params.config, params.user_prm), *slot_remarks(params.slots)]
        if not found.has_drive and not (found.input_fields or found.output_fields):
            lines += name_lines(params.slots)
        return {
            "text": _joined(lines),
            "errors": [],
            "inputs": params.input_len,
            "outputs": params.output_len,
            "config": params.config.hex(" ").upper(),
            "user_prm": params.user_prm.hex(" ").upper(),
            "notes": list(found.notes),
        }

    def check(self, text: object) -> dict[str, Any]:
        """Check ``text``, a configuration: ``{"errors": [{"line" (from 1) or null, "text", "suggestion"}], "plan",
        "text": one sentence}``.

        ``plan`` as ``dpstack plan --json`` prints it (``rotation_us``, ``findings``, ``notes`` ...), null with errors
        and if none exists (no baud rate, "auto"). One error of each table is found, at most 50.
        """
        written = _text(text, "text", blank=True)
        self.folder.refresh()
        errors = self._foreign_files(written)
        config: Config | None = None
        if not errors:
            config, errors = check_config(written, str(self._file), most=_MOST_ERRORS)
        plan: dict[str, object] | None = None
        reason = ""
        if config is not None and not errors:
            try:
                rate = config.baud
            except ConfigError as error:
                reason = f"there is no plan without a baud rate: {error.todo or error}"
            else:
                try:
                    made = plan_bus(config, rate)
                    refuse_misfit(config, made, config.slave_params)
                    plan = made.as_dict()
                except ConfigError as error:
                    errors = [error]
                except DpError as error:  # the port, for instance
                    reason = f"there is no plan: {error}"
        return {"errors": [_error(error) for error in errors], "plan": plan, "text": _verdict(errors, plan, reason)}

    def toml(self, plant: object) -> dict[str, Any]:
        """The text of a whole configuration, and its check: ``{"toml": TEXT, "errors", "plan", "text"}``.

        ``plant``: ``{"bus": {keys of [bus]}, "slaves": [{keys of [[slave]]}, ...]}``. The text loads again if there
        are no errors; it is not written to any file.
        """
        given = _mapping(plant, "plant")
        unknown = sorted(set(given) - {"bus", "slaves"})
        if unknown:
            raise UsageError(f"plant has {shortened(unknown[0])!r}; it has bus and slaves only")
        slaves = [_keys(slave) for slave in _list(given.get("slaves", []), "slaves", MAX_STATION + 1)]
        self.folder.refresh()
        parts = ["\n".join([*_HEAD, *table_lines("[bus]", _mapping(given.get("bus", {}), "bus"))]) + "\n"]
        parts += [self._table(keys)["text"] for keys in sorted(slaves, key=_address)]
        written = "\n".join(parts)
        return {"toml": written, **self.check(written)}

    def sheet(self, slave: object) -> dict[str, Any]:
        """The commissioning sheet of ``slave`` (name or address) in the present configuration, as ``dpstack sheet
        --json`` has it.

        Raises ConfigError if the configuration cannot be read, UsageError for a slave that it does not have.
        """
        return self.typed_sheet(slave).as_dict()

    def typed_sheet(self, slave: object) -> Sheet:
        """As :meth:`sheet`, typed; for the texts that people read and print."""
        name = str(slave) if type(slave) is int else _text(slave, "slave")
        (found,) = make_sheets(load_config(self._file), name)
        return found

    def _foreign_files(self, text: str) -> list[ConfigError]:
        """An error for each GSD file of the configuration ``text`` that must not be read."""
        try:
            data, lines = read_toml(text)
        except TomlError:
            return []  # the reader of configurations reports the same
        slaves = data.get("slave")
        errors = []
        for number, slave in enumerate(slaves if isinstance(slaves, list) else []):
            error = self._foreign_gsd(slave.get("gsd") if isinstance(slave, Mapping) else None)
            if error is not None:
                error.line = lines.get(("slave", number, "gsd"))
                errors.append(error)
        return errors[:_MOST_ERRORS]

    def _foreign_gsd(self, name: object) -> ConfigError | None:
        """The error for a GSD file that is none of the folder's; its existence makes no difference."""
        if not isinstance(name, str) or not name.strip() or self.folder.has(name):
            return None
        folder = printable(self._folder_text())
        what = f"gsd = {shortened(name)!r} is none of the GSD files in {folder}"
        todo = f"take one of its files, or one of {', '.join(bundled())}"
        return ConfigError.at(self._file.name, None, what, todo)


def _verdict(errors: Sequence[ConfigError], plan: Mapping[str, object] | None, reason: str) -> str:
    if errors:
        return "1 error" if len(errors) == 1 else f"{len(errors)} errors"
    if plan is None:
        return f"the configuration can be read; {reason}"
    findings = plan["findings"]
    count = len(findings) if isinstance(findings, list) else 0
    if count:
        return f"the configuration can be read; the plan has {count} finding{'s' * (count > 1)}"
    return "nothing is out of bounds"


def _error(error: ConfigError) -> dict[str, Any]:
    what, _, todo = str(error).partition("; ")
    return {
        "line": error.line,
        "text": printable(error.what or what),
        "suggestion": printable(error.todo or todo),
    }


def _joined(lines: Sequence[str]) -> str:
    return "\n".join(lines) + "\n"


def _gsd_of(path: Path) -> list[str]:
    """The names of GSD files in the configuration at ``path``; none if it cannot be read."""
    try:
        data, _ = read_toml(read_file(path, _MOST_OCTETS).decode("utf-8-sig"))
    except (OSError, ValueError):
        return []
    slaves = data.get("slave")
    found = [slave.get("gsd") for slave in slaves if isinstance(slave, Mapping)] if isinstance(slaves, list) else []
    return [name for name in found if isinstance(name, str) and "\0" not in name]


# --- plain data from outside ------------------------------------------------------------------------------------------


def _text(value: object, what: str, *, blank: bool = False) -> str:
    if not isinstance(value, str) or not (blank or value):
        raise UsageError(f"{what} must be a text")
    return value


def _list(value: object, what: str, most: int) -> Sequence[object]:
    if not isinstance(value, list) or len(value) > most:
        raise UsageError(f"{what} must be a list of at most {most} entries")
    return value


def _mapping(value: object, what: str) -> dict[str, Any]:
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise UsageError(f"{what} must be an object with its keys")
    return dict(value)


def _octets(value: object) -> bytes:
    try:
        return parse_hex(_text(value, "config", blank=True))
    except ValueError as error:
        raise UsageError(f"config = {shortened(str(value))!r} is no hex ({error}); write octets like 20 10") from None


def _ident(value: object) -> int | None:
    """An ident number as a number, or as a text like "0x0FFE"."""
    if value is None:
        return None
    number: object = value
    if isinstance(value, str) and _IDENT.fullmatch(value):
        number = int(value, 16 if value[:2].lower() == "0x" else 10)
    if type(number) is not int or not 0 <= number <= 0xFFFF:
        raise UsageError(f"ident = {shortened(repr(value))} is no ident number; write it as 0x0FFE")
    return number


def _station(value: object) -> tuple[int, int | None, bytes | None, object]:
    """(address, ident, identifier octets, type) of a station."""
    given = _mapping(value, "a station")
    address, config = given.get("address"), given.get("config")
    if type(address) is not int or not 0 <= address <= MAX_STATION + 1:
        raise UsageError(f"address = {shortened(repr(address))} is no station address; they are 0..126")
    return address, _ident(given.get("ident")), None if config is None else _octets(config), given.get("type")


def _keys(slave: object) -> dict[str, Any]:
    """The keys of a [[slave]] table, name and address first; the ident number as a number."""
    given = _mapping(slave, "a slave")
    keys = {key: given.pop(key) for key in ("name", "address") if key in given} | given
    ident = keys.get("ident")
    if isinstance(ident, str) and _IDENT.fullmatch(ident):
        keys["ident"] = _ident(ident)
    return keys


def _address(keys: Mapping[str, Any]) -> int:
    address = keys.get("address")
    return address if type(address) is int else MAX_STATION + 1
