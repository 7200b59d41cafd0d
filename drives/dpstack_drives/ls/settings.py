"""The communication parameters of the simulated drive: presets, and the values that act
(docs/reference/drives/ls-s100.md#parameters-and-maps)."""

from __future__ import annotations

from collections.abc import Mapping

from dpstack.profile import ConfigError, Options, ParamSpec, ParamStore, TelegramSpec, process_data_map
from dpstack_drives.ls import paramap
from dpstack_drives.ls import table as t


class Settings:
    """The communication parameters as they act since power-on or the last COM-94 = 1."""

    __slots__ = ("control_map", "profile", "rpm", "status_map", "swap")

    def __init__(self, store: ParamStore) -> None:
        value = store.value
        self.profile = int(value("COM-11"))
        self.rpm = bool(value("COM-14"))
        self.swap = bool(value("COM-68"))
        self.status_map = tuple(int(value(f"COM-{31 + n}")) for n in range(int(value("COM-30"))))
        self.control_map = tuple(int(value(f"COM-{51 + n}")) for n in range(int(value("COM-50"))))


def spec(code: str) -> ParamSpec:
    """The parameter with this code."""
    found = t.PARAMETERS.named(code)
    if found is None:
        raise KeyError(code)
    return found


def store_counts(store: ParamStore, telegram: TelegramSpec) -> None:
    """The word counts of a vendor telegram become COM-50 and COM-30 (4.2.10)."""
    store.write(spec("COM-50"), telegram.outputs // 2, ram_only=True)
    store.write(spec("COM-30"), telegram.inputs // 2, ram_only=True)


def presets(options: Options, given: Mapping[str, object], where: str) -> dict[str, object]:
    """Values of parameters by code, from the declared options and from parameters given (``DRV-20`` is dr-20).

    Raises ConfigError.
    """
    found: dict[str, object] = {
        "COM-06": 0x0201 if options["version"] == "2.01" else 0x0300,
        "COM-11": t.LS_DRIVE if options["profile"] == "ls" else t.PROFIDRIVE,
        "COM-14": int(options["speed_unit"] == "rpm"),
        "COM-68": int(bool(options["swap"])),
        "dr-20": float(options["reference_hz"]),
    }
    for option, count, fields in (("para_status", 30, paramap.STATUS), ("para_control", 50, paramap.CONTROL)):
        try:
            entries = fields.parse(process_data_map.split(str(options[option]))[0]).codes
        except ValueError as error:
            raise ConfigError(f"{where}: {option}: {error}") from None
        if entries:
            found[f"COM-{count}"] = len(entries)
            found |= {f"COM-{count + 1 + place}": entry for place, entry in enumerate(entries)}
    for name, value in given.items():
        at = t.address(name)
        found[name if at is None else t.code_of(at)] = value
    return found
