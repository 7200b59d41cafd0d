"""Commissioning sheets: what to set at each drive and device of a configuration, and why, with all that belongs to it.

A drive's facts come from its plugin (:meth:`~dpstack.profile.DriveProfile.describe`), those of another slave from its
GSD file. A CPU (S7-200) has a sheet with its settings and its named values. :func:`blocks_of` gives a sheet in the
order in which people read it; terminal, HTML file and page show that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import msgspec
from msgspec import Struct

from dpstack.api.bus.compose import plan_bus
from dpstack.api.config.config import Config
from dpstack.api.config.cpu import CpuConfig
from dpstack.api.config.drives_source import DriveConfig
from dpstack.api.config.slave import SlaveConfig
from dpstack.dp.slot_map import Direction
from dpstack.errors import DpError, GsdError, UsageError
from dpstack.gsd.model import Device, Module
from dpstack.gsd.prm import UserPrm
from dpstack.params import UNADDRESSED
from dpstack.profile.drive_profile import DeviceProfile
from dpstack.profile.model.description import (
    Check,
    DescribedMessage,
    DescribedPlace,
    DescribedStep,
    DescribedWord,
    DeviceDescription,
)
from dpstack.text import brief, did_you_mean, octets_text
from dpstack.units import baud_text

_GSD: Final = "its GSD file"
#: kind of the sheet of a CPU
_PPI: Final = "ppi"
_NO_FACTS: Final = "nobody described this part: see the manual of the device"
#: of a slave without drive plugin
_NOT_IN_GSD: Final = {
    "leds": "a GSD file has no LEDs: see the manual of the device",
    "acknowledge": "",
}


class SheetModule(Struct, frozen=True, kw_only=True):
    """A module in its slot, with its octets of the process data; ``""`` for none."""

    slot: int
    name: str
    #: identifier octets, hex
    config: str
    #: octets of the inputs, for instance ``0..1``
    inputs: str = ""
    outputs: str = ""


class SheetValue(Struct, frozen=True, kw_only=True):
    """A named value of the process data."""

    name: str
    #: ``inputs`` or ``outputs``; of a CPU ``read``, or ``read and write`` if ``allow_commands`` lists it
    way: str
    #: type and place, for instance ``i16@2``; of a CPU its address there, ``VW100:int``
    at: str
    unit: str = ""
    #: slot of the module that has the octet; None if it is not known
    slot: int | None = None


class Sheet(Struct, frozen=True, kw_only=True):
    """The commissioning sheet of one slave or CPU."""

    name: str
    address: int
    #: ``drive``: by a drive plugin; ``gsd``: by a GSD file; ``octets``: by identifier octets only; ``ppi``: a CPU
    kind: str
    device: DeviceDescription
    #: ident number as configured, hex; None: the master takes that of the diagnosis
    ident: str | None
    #: baud rate of the bus in bit/s; None: "auto"
    baud: int | None
    #: watchdog in ms, 0 is off; None: the plan chooses it when the rate is known
    watchdog_ms: int | None
    #: safe outputs, hex
    safe: str
    #: what the device does when the master stops
    on_loss: str
    #: what its outputs do after it was away; empty without outputs
    on_return: str
    #: user parameters of Set_Prm, hex
    user_prm: str
    groups: tuple[int, ...] = ()
    modules: tuple[SheetModule, ...] = ()
    #: user parameters by name: (name, value)
    parameters: tuple[tuple[str, str], ...] = ()
    values: tuple[SheetValue, ...] = ()
    remarks: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON data."""
        found: dict[str, Any] = msgspec.to_builtins(self)
        return found


class Block(Struct, frozen=True, kw_only=True):
    """A part of a sheet for people: lines, then a table if it has ``rows``."""

    title: str
    lines: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()


def make_sheets(config: Config, name: str | None = None) -> list[Sheet]:
    """The sheets of all slaves and CPUs, or of the one called ``name`` (or at that address). Raises UsageError."""
    chosen = config.slaves if name is None else [slave for slave in [config.find(name)] if slave is not None]
    cpus = [cpu for cpu in config.ppi if name in (None, cpu.name, str(cpu.address))]
    if not chosen and not cpus:
        if name is None:
            raise UsageError("the configuration has no slaves: add a [[slave]] table")
        names = [*(slave.name for slave in config.slaves), *(cpu.name for cpu in config.ppi)]
        known = f"known: {', '.join(names)}" if names else "the configuration has no slaves"
        raise UsageError(f"no slave is called {brief(name)}; {did_you_mean(name, names, known)}")
    losses = _losses(config)
    baud = config.bus.baud if isinstance(config.bus.baud, int) else None
    return [
        *(
            _sheet(slave, drive, baud, losses.get(slave.address))
            for slave in chosen
            for drive in slave.drives or [None]
        ),
        *(_sheet_of_cpu(cpu, baud) for cpu in cpus),
    ]


def _losses(config: Config) -> dict[int, tuple[int, str]]:
    """Watchdog in ms and what follows, by address; none if the bus has no plan yet ("auto")."""
    try:
        plan = plan_bus(config)
    except DpError:
        return {}
    return {slave.setup.address: (slave.watchdog_ms, slave.on_loss) for slave in plan.slaves}


def _sheet(slave: SlaveConfig, drive: DriveConfig | None, baud: int | None, loss: tuple[int, str] | None) -> Sheet:
    """``drive``: the one of several that the sheet is for."""
    params = slave.params
    if drive is not None:
        kind, device = "drive", drive.profile.describe(slave.address, drive.telegram, drive.options)
    elif slave.profile is not None:
        # not as simulated: a sheet is for the real drive, also if the plant is still on the port "virtual"
        kind, device = "drive", slave.profile.describe(slave.address, slave.telegram, slave.options)
    elif slave.device is not None:
        kind, device = "gsd", _describe_gsd(slave, slave.device, baud)
    else:
        kind, device = "octets", _describe_octets(slave)
    if slave.device_profile is not None:
        device = _with_device_file(slave, device, slave.device_profile)
    watchdog, on_loss = loss or (params.watchdog_ms, params.on_loss or "as its manual says (usually outputs off)")
    modules = tuple(_modules(slave))
    return Sheet(
        name=slave.name if drive is None else f"{slave.name}, {drive.name}",
        address=slave.address,
        kind=kind,
        device=device,
        ident=None if params.ident is None else f"0x{params.ident:04X}",
        baud=baud,
        watchdog_ms=watchdog,
        safe=params.safe.hex(" ").upper() or bytes(params.output_len).hex(" "),
        on_loss=on_loss,
        on_return=slave.on_return,
        user_prm=params.user_prm.hex(" ").upper(),
        groups=params.groups,
        modules=modules,
        parameters=_parameters(slave),
        values=tuple(_values(slave)),
        remarks=slave.notes if drive is None else (drive.place_text, *slave.notes),
    )


def _sheet_of_cpu(cpu: CpuConfig, baud: int | None) -> Sheet:
    rate = "that of the bus" if baud is None else baud_text(baud)
    steps = (
        msgspec.structs.replace(_address_step(cpu.address, "its manual says where to set it"), delivered="2"),
        DescribedStep(
            what=f"baud rate = {rate}",
            why="the port of the CPU has one rate: 9.6, 19.2 or 187.5 kbit/s",
            delivered="9.6 kbit/s",
            source="the configuration",
        ),
    )
    return Sheet(
        name=cpu.name,
        address=cpu.address,
        kind=_PPI,
        device=DeviceDescription(title="S7-200 (PPI)", manual="the configuration", steps=steps),
        ident=None,
        baud=baud,
        watchdog_ms=0,
        safe="",
        on_loss="what was written stays: no watchdog of the CPU watches this master, so its program has to",
        on_return="",
        user_prm="",
        values=tuple(
            SheetValue(name=name, way=way, at=one.written, unit=one.unit)
            for way, fields in zip(("read", "read and write"), cpu.fields, strict=True)
            for name, one in fields.fields.items()
        ),
        remarks=(f"its values are read every {cpu.poll_ms} ms",),
    )


#: the octet of a diagnosis behind the header of its first block, counted from 1
_FIRST_OCTET: Final = 8


def _with_device_file(slave: SlaveConfig, device: DeviceDescription, profile: DeviceProfile) -> DeviceDescription:
    """``device`` with the facts of its device file."""
    told = [
        DescribedMessage(code=f"{kind} {_FIRST_OCTET + bit // 8}.{bit % 8}", text=text, source="its device file")
        for kind, texts in (("alarm", profile.alarms), ("warning", profile.warnings))
        for bit, text in texts.items()
    ]
    known = {one.text.lower() for one in told}
    others = (one for one in device.faults if one.text.lower() not in known)
    missing = {what: why for what, why in device.missing.items() if what != "faults" or not told}
    of_gsd = f", {device.manual}" if slave.device is not None else ""
    return msgspec.structs.replace(
        device,
        title=profile.title,
        manual=f"device file {profile.name}.toml{of_gsd}",
        notes=(*device.notes, *profile.notes),
        faults=(*told, *others),
        missing=missing,
    )


# --- slaves without a drive plugin ------------------------------------------------------------------------------------


def _describe_gsd(slave: SlaveConfig, device: Device, baud: int | None) -> DeviceDescription:
    manual = f"GSD file {slave.gsd}" + (f", revision {device.revision}" if device.revision else "")
    return DeviceDescription(
        title=" ".join(filter(None, (device.vendor, device.model))) or "unknown device",
        manual=manual,
        ident=device.ident,
        rates=tuple(sorted(speed.baud for speed in device.speeds)),
        steps=tuple(_steps_of_gsd(slave, device, baud)),
        faults=tuple(_messages_of_gsd(device, slave.modules or ())),
        missing=_NOT_IN_GSD | {"faults": "its GSD file has no texts for diagnosis bits"},
    )


def _describe_octets(slave: SlaveConfig) -> DeviceDescription:
    return DeviceDescription(
        title="device by identifier octets",
        manual="the configuration: neither a drive plugin nor a GSD file describes the device",
        ident=slave.params.ident,
        steps=(_address_step(slave.address, "the manual of the device says where"),),
        missing=_NOT_IN_GSD | {"faults": "without a GSD file nothing is known about its diagnosis bits"},
    )


def _address_step(address: int, where: str) -> DescribedStep:
    return DescribedStep(
        what=f"station address = {address}",
        why=f"the master asks for the device at this address; {where}",
        source="the configuration",
    )


def _steps_of_gsd(slave: SlaveConfig, device: Device, baud: int | None) -> Iterator[DescribedStep]:
    where = "at the device, as its manual says"
    if device.set_slave_add:
        where = f"at the device, or over the bus while it has {UNADDRESSED} or another one: `dpstack address`"
    yield _address_step(slave.address, where)
    if not device.auto_baud:
        rate = "that of the bus" if baud is None else baud_text(baud)
        yield DescribedStep(
            what=f"baud rate = {rate}",
            why="its GSD file does not say that it detects the rate by itself (Auto_Baud_supp)",
            source=_GSD,
        )
    if device.modular and slave.modules:
        yield DescribedStep(
            what="modules plugged in the order of the table of modules",
            why="the master sends them in Chk_Cfg; a device with others refuses data exchange",
            check=Check.REFUSED,
            source=_GSD,
        )


def _messages_of_gsd(device: Device, modules: Sequence[Module | None]) -> Iterator[DescribedMessage]:
    """The texts of diagnosis bits and channel errors of the device and of its modules, each text once."""
    seen: set[tuple[str, str]] = set()
    sources = [("", device.diagnosis.texts), *((one.name, one.diagnosis.texts) for one in modules if one is not None)]
    sources += [(f"UnitDiagType {one.type}", one.texts) for one in device.diag_types]
    for where, texts in sources:
        for one in texts:
            bits = "" if one.first is None else f"{one.first}" if one.first == one.last else f"{one.first}..{one.last}"
            code = {
                "bit": f"bit {bits}",
                "not_bit": f"bit {bits} = 0",
                "area": f"bits {bits} = {one.value}",
                "channel": f"channel error {one.value}",
            }[one.kind]
            code = f"{code} ({where})" if where else code
            if (code, one.text) not in seen:
                seen.add((code, one.text))
                yield DescribedMessage(code=code, text=one.text, remedy=one.help, source=_GSD)


def _modules(slave: SlaveConfig) -> Iterator[SheetModule]:
    """The slots; of a drive only those of its GSD file, as its telegram says more."""
    if slave.profile is not None and slave.modules is None:
        return
    for slot in slave.params.slots.slots:
        yield SheetModule(
            slot=slot.number,
            name="(empty)" if slot.is_empty else slot.name,
            config="" if slot.is_empty else slot.config.hex(" ").upper(),
            inputs=_octets(slot.inputs.at, slot.inputs.octets),
            outputs=_octets(slot.outputs.at, slot.outputs.octets),
        )


def _octets(at: int, length: int) -> str:
    return "" if not length else str(at) if length == 1 else f"{at}..{at + length - 1}"


def _parameters(slave: SlaveConfig) -> tuple[tuple[str, str], ...]:
    """The user parameters by name as the master sends them; none if ``user_prm`` has other octets than its file."""
    if slave.device is None or slave.modules is None:
        return ()
    try:
        prm = UserPrm(slave.device, slave.modules)
        fields = prm.read(slave.params.user_prm)
    except GsdError:
        return ()
    return tuple((prm.shortest_key(one), one.text) for one in fields if one.parameter.visible)


def _values(slave: SlaveConfig) -> Iterator[SheetValue]:
    for direction, named in ((Direction.INPUT, slave.input_fields), (Direction.OUTPUT, slave.output_fields)):
        for name, one in named.fields.items():
            slot = slave.params.slots.at(direction, one.octet)
            number = None if slot is None else slot.number
            yield SheetValue(name=name, way=f"{direction}s", at=one.spec, unit=one.unit, slot=number)


# --- for people -------------------------------------------------------------------------------------------------------


def title_of(sheet: Sheet) -> str:
    """The title of a sheet: ``hoist, address 3: Demag Dedrive Compact``."""
    return f"{sheet.name}, address {sheet.address}: {sheet.device.title}"


def blocks_of(sheet: Sheet) -> Iterator[Block]:
    """The parts of ``sheet`` in the order in which a commissioner needs them; a part without facts says so."""
    device = sheet.device
    yield Block(title="Device", columns=("", ""), rows=tuple(_facts(sheet)))
    notes = (*device.notes, *sheet.remarks)
    if notes:
        yield Block(title="To know", lines=notes)
    yield _table(
        device,
        "steps",
        "To set at the device",
        ("set", "why", "as delivered", "if it differs", "source"),
        ((one.what, one.why, one.delivered, str(one.check), one.source) for one in device.steps),
    )
    yield Block(title="When the master stops", lines=(sheet.on_loss, *_safe_lines(sheet)))
    if sheet.on_return:
        yield Block(title="After it was away", lines=(sheet.on_return,))
    if sheet.modules:
        yield Block(
            title="Modules",
            columns=("slot", "module", "identifier", "octets in", "octets out"),
            rows=tuple((str(one.slot), one.name, one.config, one.inputs, one.outputs) for one in sheet.modules),
        )
    if sheet.parameters:
        lines = ("the master sends them in Set_Prm: nothing of it is set at the device",)
        yield Block(title="User parameters", lines=lines, columns=("parameter", "value"), rows=sheet.parameters)
    if sheet.values:
        yield Block(
            title="Names of values",
            columns=("name", "way", "address" if sheet.kind == _PPI else "type and octet", "unit", "slot"),
            rows=tuple((v.name, v.way, v.at, v.unit, "" if v.slot is None else str(v.slot)) for v in sheet.values),
        )
    if sheet.kind == _PPI:
        return
    if sheet.kind == "drive":
        yield from _process_data(device)
        yield _table(
            device,
            "ranges",
            "Ranges",
            ("value", "range", "on the wire", "source"),
            ((one.name, one.range, one.wire, one.source) for one in device.ranges),
        )
    messages = ("code", "meaning", "remedy", "source")
    yield _table(device, "faults", "Faults", messages, _rows(device.faults), _acknowledge(device))
    if sheet.kind == "drive":
        yield _table(device, "warnings", "Warnings", messages, _rows(device.warnings))
    leds = ("LED", "shows", "meaning", "remedy", "source")
    yield _table(
        device,
        "leds",
        "LEDs",
        leds,
        ((one.name, one.shows, one.meaning, one.remedy, one.source) for one in device.leds),
    )
    if device.errors:
        yield _table(device, "errors", "Errors of parameter access", messages, _rows(device.errors))
    if device.parameters:
        yield Block(
            title="Parameters that the plugin knows",
            lines=("without a range: no manual here gives it",),
            columns=("parameter", "title", "range", "as delivered", "access"),
            rows=tuple(
                (one.name, one.title, one.range, one.delivered, "read only" if one.read_only else "")
                for one in device.parameters
            ),
        )


def _facts(sheet: Sheet) -> Iterator[tuple[str, str]]:
    device = sheet.device
    yield "device", device.title
    if device.manual:
        yield "facts from", device.manual
    yield "station address", str(sheet.address)
    baud = "found by listening (auto)" if sheet.baud is None else baud_text(sheet.baud)
    if sheet.kind == _PPI:
        yield "baud rate of the bus", baud
        return
    known = "" if device.ident is not None or sheet.kind != "drive" else " (no manual gives it: made up or configured)"
    yield "ident number", "as the device shows it" if sheet.ident is None else f"{sheet.ident}{known}"
    yield "baud rate of the bus", baud
    if device.rates:
        yield "baud rates of the device", ", ".join(map(baud_text, device.rates))
    if device.telegram:
        yield "telegram", device.telegram
    watchdog = {None: "chosen when the rate of the bus is known", 0: "off"}.get(sheet.watchdog_ms)
    yield "watchdog", watchdog or f"{sheet.watchdog_ms} ms"
    yield "safe outputs", _safe_text(sheet) or "none: it has no outputs"
    if sheet.user_prm:
        yield "user parameters", sheet.user_prm
    if sheet.groups:
        yield "groups", ", ".join(map(str, sheet.groups))


def _safe_text(sheet: Sheet) -> str:
    octets = bytes.fromhex(sheet.safe)
    return sheet.safe if any(octets) else octets_text(len(octets)) + " of zeros" if octets else ""


def _safe_lines(sheet: Sheet) -> Iterator[str]:
    if not sheet.safe:
        return
    yield f"an ordered end of the master writes the safe outputs ({_safe_text(sheet)}) first, then Clear"
    if sheet.watchdog_ms == 0:
        yield "its watchdog is off (watchdog_ms = 0): without a master it never stops by itself"


def _process_data(device: DeviceDescription) -> Iterator[Block]:
    yield Block(
        title="Telegrams",
        lines=(f"in use: {device.telegram}",),
        columns=("telegram", "identifier octets", "octets out", "octets in", "parameter channel", "source"),
        rows=tuple(
            (
                one.name,
                one.config,
                str(one.outputs),
                str(one.inputs),
                "yes" if one.channel else "no",
                "made up: no manual here gives the octets" if one.made_up else "the manual",
            )
            for one in device.telegrams
        ),
    )
    for way, found in (("Outputs", device.outputs), ("Inputs", device.inputs)):
        if found:
            rows = tuple((_place(one), one.name) for one in found)
            yield Block(title=f"{way} of {device.telegram}", columns=("octet", "value"), rows=rows)
    for word in device.words:
        yield Block(title=word.name, columns=("bits", "name"), rows=tuple(_word_rows(word)))


def _place(one: DescribedPlace) -> str:
    return _octets(one.octet, one.length)


def _word_rows(word: DescribedWord) -> Iterator[tuple[str, str]]:
    yield from ((f"bit {one.bit}", one.name) for one in word.bits)
    yield from ((one.code, one.name) for one in word.codes)


def _rows(messages: Sequence[DescribedMessage]) -> Iterator[tuple[str, str, str, str]]:
    return ((one.code, one.text, one.remedy, one.source) for one in messages)


def _acknowledge(device: DeviceDescription) -> tuple[str, ...]:
    return (f"to acknowledge: {device.acknowledge}",) if device.acknowledge else ()


def _table(
    device: DeviceDescription,
    part: str,
    title: str,
    columns: tuple[str, ...],
    rows: Iterator[tuple[str, ...]],
    lines: tuple[str, ...] = (),
) -> Block:
    """A table, or the sentence that says why it is empty."""
    found = tuple(rows)
    if not found:
        return Block(title=title, lines=(device.missing.get(part, _NO_FACTS), *lines))
    if "remedy" in columns and not all(row[columns.index("remedy")] for row in found):
        lines = (*lines, "without a remedy: this source has none")
    return Block(title=title, lines=lines, columns=columns, rows=found)
