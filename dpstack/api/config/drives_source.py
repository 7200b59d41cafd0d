"""A [[slave]] table with several drives: `drives = [...]`, an axis each. Loaded if a slave has the key ``drives``."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, NoReturn, TypedDict

from msgspec import structs

from dpstack.api.config.drive_source import params_by_profile
from dpstack.api.config.slave_source import DRIVE_KEYS, PERCENT, REFERENCES, Basis, Who, leave_out, need_gsd
from dpstack.devices import finding
from dpstack.dp.slave_params import SlaveParams
from dpstack.dp.slot_map import Slot, slot_map
from dpstack.errors import GsdError
from dpstack.gsd.configuration import configure, fixed_modules, is_fixed
from dpstack.gsd.identifiers import io_lengths
from dpstack.gsd.model import Device
from dpstack.profile import DriveProfile, TelegramSpec
from dpstack.profile.master.several_drives import MOST_DRIVES
from dpstack.text import brief
from dpstack.toml.table import Key, Table, keys_of

#: a name stands in front of those of process data and in command lines
_NAME: Final = re.compile(r"[^\W\d][\w-]*")
#: the identifier octet of an empty slot
_EMPTY: Final = b"\0"
_LAST_SLOT: Final = 254
_PLACE: Final = re.compile(r"(?P<type>\w+)@(?P<octet>\d+)(?P<bit>.*)")


class DriveKeys(TypedDict, total=False):
    """The keys of one of `drives`, as docs/reference/configuration.md has them.

    name: the name of the drive in programs and messages, unique on the bus: a letter, then letters, digits, `_` and
        `-`. Left out: required
    file: the name of a known drive, or a device file relative to the configuration, as the key `drive` has them. Left
        out: required
    slot: its first slot. Left out: the one behind the drive before
    telegram: one of the telegrams of that drive
    object: its number in record 47, the drive object (DO-ID of SINAMICS). Left out: that of its device file
    reference_hz: as that key of the slave
    reference_rpm: as that key of the slave
    options: as that key of the slave
    simulated: as that key of the slave
    """

    name: str
    file: str
    slot: Annotated[int, Key(0, _LAST_SLOT)]
    telegram: str
    object: Annotated[int, Key(0, 255, hint="a drive object is one octet")]
    reference_hz: Annotated[float, PERCENT]
    reference_rpm: Annotated[float, PERCENT]
    options: Mapping[str, object]
    simulated: Mapping[str, object]


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveConfig:
    """One of the drives of a slave, as configured and checked."""

    name: str
    profile: DriveProfile
    telegram: str
    options: Mapping[str, object] = field(default_factory=dict)
    simulated: Mapping[str, object] = field(default_factory=dict)
    #: number in record 47; None: that of the profile
    record_object: int | None = None
    #: the identifier octets of its slots
    config: bytes
    #: octets of the process image, the first one and the one behind the last
    inputs: tuple[int, int]
    outputs: tuple[int, int]
    slots: tuple[int, ...]
    safe: bytes

    @property
    def place_text(self) -> str:
        """Its place in the slave for people: slots, octets, object."""
        slots = ", ".join(map(str, self.slots))
        octets = (f"{what} {first} to {end - 1}" for what, (first, end) in (("in", self.inputs), ("out", self.outputs)))
        number = "that of its device file" if self.record_object is None else self.record_object
        return f"slot {slots}, octets {', '.join(octets)}; object in record 47: {number}"


@dataclass(slots=True)
class _Given:
    """A drive while its table is read."""

    table: Table
    given: dict[str, Any]
    profile: DriveProfile
    telegram: TelegramSpec

    @property
    def name(self) -> str:
        name: str = self.given["name"]
        return name

    @property
    def options(self) -> dict[str, object]:
        own: dict[str, object] = self.given.get("options", {})
        return own | {key: self.given[key] for key in REFERENCES if key in self.given}

    @property
    def lengths(self) -> tuple[int, int]:
        return self.telegram.input_octets, self.telegram.output_octets

    def fail(self, key: str | None, what: str, todo: str) -> NoReturn:
        self.table.fail(key, what, todo)


def basis_of_drives(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
    """The basis of a slave with several drives. Raises ConfigError, one line."""
    leave_out(table, "config", "beside drives", "leave config out: it follows from the telegrams of the drives")
    for key in ("drive", "device", *DRIVE_KEYS):
        own = "file" if key in ("drive", "device") else key
        leave_out(table, key, "beside drives", f"give {own} to each drive of the list")
    drives = _read_drives(table, given)
    files = {one.profile.gsd_file for one in drives}
    if "gsd" not in given and len(files) == 1 and None not in files:
        given = {**given, "gsd": files.pop()}
    rest: dict[str, Any]
    if "gsd" in given:
        from dpstack.api.config.gsd_source import read_gsd_slave  # here, as most drives need no GSD file

        _, (known, rest) = read_gsd_slave(
            table, given, who, lambda device, own_prm: configure(device, _modules(device, drives), own_prm=own_prm)
        )
    else:
        need_gsd(table)
        known, rest = _without_gsd(table, drives, who), {"baud_rates": _common_rates(drives)}
    placed = tuple(_placed(drives, known, rest))
    safe = bytearray(known.output_len)
    for one in placed:
        safe[slice(*one.outputs)] = one.safe
    on_loss = "; ".join(dict.fromkeys(f"{one.name}: {one.profile.on_loss}" for one in drives))
    notes = (*rest.get("notes", ()), *_notes(known, placed, given))
    # after_return: also if the application makes the outputs octet by octet
    known = structs.replace(known, safe=bytes(safe), on_loss=on_loss, after_return="safe")
    return known, rest | {"drives": placed, "notes": notes}


def with_words(table: Table, drives: Sequence[DriveConfig]) -> Table:
    """``table`` with the inputs that the device files name, each with the name of its drive in front."""
    if "outputs" in table:
        table.fail("outputs", "outputs beside drives: their plugins make the outputs", "leave outputs out")
    found: dict[str, object] = {}
    for one in drives:
        if one.profile.fields is not None:
            inputs, _ = one.profile.fields(one.profile.telegram(one.telegram).name)
            own = {f"{one.name}_{name}": _moved(spec, one.inputs[0]) for name, spec in inputs.items()}
            if both := sorted(own.keys() & found.keys()):
                what = f"the input {both[0]!r} would be one of {one.name} and one of another drive"
                table.fail("drives", what, "give the drives names of which none begins with another one and _")
            found |= own
    given = table.raw("inputs")
    return table.extended({"inputs": found | (given if isinstance(given, dict) else {})})


def check_objects(table: Table, drives: Sequence[DriveConfig]) -> None:
    """Raises ConfigError if two drives have the same object in record 47: one would get the parameters of the other."""
    taken: dict[int, str] = {}
    for one in drives:
        core = one.profile.core(one.name, one.telegram, one.options)
        if core.record_slot is None:
            continue
        number = core.record_object if one.record_object is None else one.record_object
        before = taken.setdefault(number, one.name)
        if before != one.name:
            table.fail(
                "drives",
                f"{before} and {one.name} both have object {number} in record 47",
                "give each drive its own: object = 2 (DO-ID of SINAMICS), or switch dpv1 off",
            )


# --- reading --------------------------------------------------------------------------------------------------------


def _read_drives(table: Table, given: Mapping[str, Any]) -> list[_Given]:
    entries: list[object] = given["drives"]
    if not 1 <= len(entries) <= MOST_DRIVES:
        table.fail("drives", f"{len(entries)} drives", f"give 1 to {MOST_DRIVES} in one slave")
    drives: list[_Given] = []
    for number, entry in enumerate(entries, 1):
        own = table.inner("drives", number, entry)
        one = own.read(keys_of(DriveKeys))
        for key in ("name", "file"):
            if key not in one:
                own.fail(None, f"no {key}", f"add {key} = ...")
        if not _NAME.fullmatch(one["name"]):
            own.fail("name", f"name = {brief(one['name'])}", "begin with a letter; letters, digits, _ and - may follow")
        if one["name"] in [other.name for other in drives]:
            own.fail("name", f"two drives are called {one['name']!r}", "give each a name of its own")
        with own.blaming("file"):
            profile = finding.find(one["file"], table.folder)
        if profile.rate_setting is not None:
            own.fail("file", f"{profile.name} is set to a baud rate of its own", "give it a slave of its own")
        with own.blaming("telegram"):
            telegram = profile.telegram(one.get("telegram"))
        drives.append(_Given(own, one, profile, telegram))
    return drives


def _without_gsd(table: Table, drives: Sequence[_Given], who: Who) -> SlaveParams:
    """The parameters of a slave whose profiles describe it: they must agree on it."""
    first = drives[0].profile
    for one in drives[1:]:
        profile = one.profile
        for what in ("ident", "user_prm", "fail_safe"):
            if getattr(profile, what) != getattr(first, what) and what not in table:
                one.fail("file", f"{profile.name} and {first.name} differ in {what}, and are one slave", _BY_GSD)
    config = b""
    for one in drives:
        slot = one.given.get("slot")
        free = len(slot_map(config).slots) + 1 if config else 1
        if slot is not None:
            if slot < free:
                one.fail("slot", f"slot {slot} is taken, the next free one is {free}", "correct slot or leave it out")
            config += _EMPTY * (slot - free)
        config += one.telegram.config
    with table.blaming():
        known = params_by_profile(first, who, config)
    longest = max(one.profile.min_slave_interval_ns for one in drives)
    return structs.replace(known, min_slave_interval_ns=longest)


_BY_GSD: Final = "name the GSD file of the slave: gsd = ..."


def _common_rates(drives: Sequence[_Given]) -> frozenset[int]:
    known = [set(one.profile.baud_rates) for one in drives if one.profile.baud_rates]
    return frozenset(set.intersection(*known)) if known else frozenset()


def _modules(device: Device, drives: Sequence[_Given]) -> list[int | str]:
    """The modules of the telegrams in slot order, "" for an empty slot. Raises GsdError."""
    row: list[int | str] = []
    first = device.first_slot + len(fixed_modules(device))
    for one in drives:
        slot, free = one.given.get("slot"), first + len(row)
        if slot is not None:
            if slot < free:
                one.fail("slot", f"slot {slot} is taken, the next free one is {free}", "correct slot or leave it out")
            row += [""] * (slot - free)
        row += one.profile.modules.get(one.telegram.name) or [_module(device, one)]
    return row


def _module(device: Device, one: _Given) -> int | str:
    """The only module with the identifier octets of the drive's telegram, or with its lengths. Raises GsdError."""
    usable = [module for module in device.modules if module.complete and not is_fixed(device, module)]
    fitting = [module for module in usable if module.config == one.telegram.config] or [
        module for module in usable if io_lengths(module.config) == one.lengths
    ]
    if len(fitting) == 1:
        return fitting[0].name if fitting[0].reference is None else fitting[0].reference
    there = " or ".join(module.title for module in fitting[:8]) or "no single module of the GSD file"
    raise GsdError(f"telegram {one.telegram.name} of {one.name} may be {there}; name all modules: modules = [...]")


def _placed(drives: Sequence[_Given], known: SlaveParams, rest: Mapping[str, Any]) -> Iterator[DriveConfig]:
    """The drives in the slots of the slave."""
    slots = known.slots.slots
    at = 0
    for one in drives:
        first = one.given.get("slot")
        if first is not None:
            found = next((place for place, slot in enumerate(slots) if slot.number == first), None)
            if found is None:
                one.fail("slot", f"slot = {first}, the slave has {known.slots.range_text}", "correct it")
            if found < at:
                one.fail("slot", f"slot {first} belongs to the drive before", "correct it or leave it out")
            at = found
        own, at = _own_slots(one, slots, at)
        yield _drive(one, own, known, rest)


def _own_slots(one: _Given, slots: Sequence[Slot], at: int) -> tuple[Sequence[Slot], int]:
    """The slots from ``at`` on that have the octets of the drive's telegram, and the place behind them."""
    while at < len(slots) and slots[at].inputs.octets == slots[at].outputs.octets == 0:
        at += 1
    first, found = at, (0, 0)
    while found != one.lengths:
        if at == len(slots) or found[0] > one.lengths[0] or found[1] > one.lengths[1]:
            what = f"the slots from {slots[first].number} on" if first < len(slots) else "the slots that are left"
            one.fail(
                "slot" if "slot" in one.given else "telegram",
                f"{what} do not have {one.lengths[0]} octets of inputs and {one.lengths[1]} of outputs, "
                f"as {one.telegram.name} of {one.name} has",
                "correct telegram, slot or the modules of the slave",
            )
        found = found[0] + slots[at].inputs.octets, found[1] + slots[at].outputs.octets
        at += 1
    return slots[first:at], at


def _drive(one: _Given, own: Sequence[Slot], known: SlaveParams, rest: Mapping[str, Any]) -> DriveConfig:
    profile, telegram = one.profile, one.telegram
    config = b"".join(slot.config for slot in own)
    if "gsd" in rest:  # the GSD file has priority over the plugin
        rates = tuple(sorted(rest["baud_rates"]))
        profile = profile.described(telegram, structs.replace(known, config=config, safe=b""), rates)
        telegram = profile.telegram(telegram.name)
    with one.table.blaming(next((key for key in REFERENCES if key in one.given), "options")):
        core = profile.core(one.name, telegram.name, one.options)
    simulated = one.given.get("simulated", {})
    if profile.device_factory is not None or simulated:
        with one.table.blaming("simulated"):
            profile.simulated(telegram.name, one.options, simulated)
    inputs, outputs = own[0].inputs.at, own[0].outputs.at
    return DriveConfig(
        name=one.name,
        profile=profile,
        telegram=telegram.name,
        options=one.options,
        simulated=simulated,
        record_object=one.given.get("object"),
        config=config,
        inputs=(inputs, inputs + one.lengths[0]),
        outputs=(outputs, outputs + one.lengths[1]),
        slots=tuple(slot.number for slot in own),
        safe=core.safe_outputs,
    )


def _notes(known: SlaveParams, drives: Sequence[DriveConfig], given: Mapping[str, Any]) -> Iterator[str]:
    """Remarks: outputs of no drive, facts that are made up."""
    of_drives = {octet for one in drives for octet in range(*one.outputs)}
    free = [octet for octet in range(known.output_len) if octet not in of_drives]
    if free:
        places = ", ".join(map(str, free[:8])) + (" ..." if len(free) > 8 else "")
        yield f"octets {places} of its outputs belong to no drive: they are 0"
    first = drives[0].profile
    if first.ident_made_up and "ident" not in given:
        yield f"the ident number 0x{first.ident:04X} of {first.name} is in no manual (made up); give ident = 0x..."
    for one in drives:
        if one.profile.telegram(one.telegram).made_up:
            yield (
                f"the identifier octets {one.config.hex(' ').upper()} of {one.name} are in no manual (made up): "
                f"compare them with the GSD file of the slave"
            )


def _moved(spec: object, by: int) -> object:
    """The place of a named value, ``by`` octets behind."""
    if isinstance(spec, Mapping):
        return {**spec, "at": _moved(spec["at"], by)}
    found = _PLACE.fullmatch(str(spec))
    assert found is not None
    return f"{found['type']}@{int(found['octet']) + by}{found['bit']}"
