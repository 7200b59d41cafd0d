"""What a [[slave]] table stands on: a known drive, a GSD file, a drive as its maker's GSD file has it, or octets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from dpstack.api.config.gsd_slave import GSD_KEYS, GsdSlave, read_gsd_slave
from dpstack.api.config.table import Table
from dpstack.dp.pdu.diag_texts import DiagTexts
from dpstack.dp.slave_params import INTERVAL_UNIT
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.description_from_gsd import slave_description
from dpstack.errors import ConfigError
from dpstack.fdl.telegram import MAX_DATA
from dpstack.gsd.configuration import configuration_like
from dpstack.gsd.identifiers import io_lengths
from dpstack.gsd.model import Device
from dpstack.profile import DriveProfile, TelegramSpec, registry


@dataclass(frozen=True, slots=True)
class Basis:
    """What the kinds of slave take from elsewhere. ``device``: what its GSD file says; ``description``: as a slave."""

    ident: int | None
    config: bytes
    user_prm: bytes = b""
    safe: bytes = b""
    interval_ns: int = 0
    fail_safe: bool = False
    profile: DriveProfile | None = None
    telegram: str | None = None
    options: Mapping[str, object] = field(default_factory=dict)
    simulated: Mapping[str, object] = field(default_factory=dict)
    max_tsdr: Mapping[int, int] = field(default_factory=dict)
    baud_rates: frozenset[int] = frozenset()
    device: Device | None = None
    description: SlaveDescription | None = None
    texts: DiagTexts | None = None
    notes: tuple[str, ...] = ()
    #: see :attr:`~dpstack.dp.slave_params.SlaveParams.prm_note`
    prm_note: str = ""


def basis_of(table: Table) -> Basis:
    """Read it. Raises ConfigError, one line."""
    drive, gsd = table.text("drive"), table.text("gsd")
    if gsd is None:
        for key in GSD_KEYS:
            if key in table:
                table.fail(key, f"{key} without gsd", f"name the GSD file, or leave {key} out")
    else:
        _leave_out(table, "config", "beside gsd", "leave config out, or gsd")
    if drive is not None:
        return _drive(table, drive, gsd)
    for key in ("telegram", "reference_hz", "reference_rpm", "options", "simulated"):
        _leave_out(table, key, "without drive", f"add drive, or leave {key} out")
    return _raw(table) if gsd is None else _gsd(table, gsd)


def _gsd(table: Table, path: str) -> Basis:
    found = read_gsd_slave(table, path)
    _check_ident(table, path, found)
    return Basis(
        ident=found.device.ident,
        config=found.configuration.config,
        user_prm=found.user_prm,
        interval_ns=_interval_ns(found.device),
        fail_safe=_fail_safe(found.device),
        max_tsdr=found.max_tsdr,
        baud_rates=found.baud_rates,
        device=found.device,
        description=slave_description(found.device, found.configuration, ident=found.device.ident or 0),
        texts=found.configuration.texts(),
        notes=found.notes,
        prm_note=found.prm_note,
    )


def _drive(table: Table, name: str, gsd: str | None) -> Basis:
    _leave_out(table, "config", "beside drive", "leave config out: it follows from drive and telegram")
    try:
        profile = registry.find(name)
    except ConfigError as error:
        raise _split(table, "drive", error) from None
    found: GsdSlave | None = None
    wanted = table.text("telegram")
    try:
        telegram = profile.telegram(wanted)
    except ConfigError as error:
        raise _split(table, "telegram", error) from None
    if gsd is not None:
        like = telegram.config, _lengths(telegram)
        found = read_gsd_slave(table, gsd, lambda device: configuration_like(device, *like))
        _check_ident(table, gsd, found)
        telegram = _telegram_for(table, profile, telegram, found)
        profile = _as_its_gsd_says(profile, telegram, found)
        telegram = profile.telegram(telegram.name)
    options, simulated = _inside(table, "options"), _inside(table, "simulated")
    references: dict[str, object] = {}
    for key in ("reference_hz", "reference_rpm"):
        value = table.number(key, 0.001, 1_000_000)
        if value is not None:
            references[key] = value
    options |= references
    try:
        core = profile.core(table.text("name") or name, telegram.name, options)
    except ConfigError as error:
        raise _split(table, next(iter(references), "options"), error) from None
    try:
        profile.device(telegram.name, {**profile.shared(options), **simulated})
    except ConfigError as error:
        raise _split(table, "simulated", error) from None
    return Basis(
        ident=profile.ident if found is None else found.device.ident,
        config=telegram.config,
        user_prm=profile.user_prm,
        safe=core.safe_outputs,
        interval_ns=profile.min_slave_interval_ns,
        fail_safe=profile.fail_safe,
        max_tsdr=profile.max_tsdr,
        baud_rates=frozenset(profile.rates(options)),
        profile=profile,
        telegram=telegram.name,
        options=options,
        simulated=simulated,
        device=None if found is None else found.device,
        texts=None if found is None else found.configuration.texts(),
        notes=() if found is None else found.notes,
    )


def _inside(table: Table, key: str) -> dict[str, object]:
    """A table within the table, empty where it is left out."""
    inside = table.table(key)
    return {} if inside is None else {name: inside.raw(name) for name in inside}


def _telegram_for(table: Table, profile: DriveProfile, default: TelegramSpec, found: GsdSlave) -> TelegramSpec:
    """The telegram that the modules are: the one that is named, else known by the identifier octets or the lengths."""
    chosen = found.configuration
    lengths, octets = (chosen.inputs, chosen.outputs), chosen.config.hex(" ").upper()
    if "telegram" in table or "modules" not in table:
        if _lengths(default) != lengths:
            table.fail(
                "telegram" if "telegram" in table else "gsd",
                f"the modules {octets} have {lengths[0]} octets of inputs and {lengths[1]} of outputs, "
                f"{default.name} has {default.input_octets} and {default.output_octets}",
                "name the modules that it is made of",
            )
        return default
    fitting = profile.telegrams_of(chosen.config) or tuple(
        spec for spec in profile.telegrams.values() if _lengths(spec) == lengths
    )
    if len(fitting) == 1:
        return fitting[0]
    names = " or ".join(spec.name for spec in fitting)
    raise table.error(
        "modules",
        f"the modules {octets} have {lengths[0]} octets of inputs and {lengths[1]} of outputs: "
        + (f"that may be {names}" if names else f"no telegram of {profile.name}"),
        f'add telegram = "{fitting[0].name}"' if fitting else "name the modules of a telegram, or leave drive out",
    )


def _as_its_gsd_says(profile: DriveProfile, telegram: TelegramSpec, found: GsdSlave) -> DriveProfile:
    """What a GSD file says goes before what the plugin knows of ident number, identifier octets and parameters."""
    device = found.device
    return profile.described(
        telegram,
        config=found.configuration.config,
        ident=device.ident,
        user_prm=found.user_prm,
        baud_rates=tuple(sorted(found.baud_rates)),
        max_tsdr=found.max_tsdr,
        min_slave_interval_ns=_interval_ns(device),
        fail_safe=_fail_safe(device),
    )


def _raw(table: Table) -> Basis:
    config = table.octets("config")
    if config is None:
        table.fail(
            None,
            "neither drive nor config",
            'name a drive or a GSD file, or give ident and config (identifier octets, "20 10")',
        )
    try:
        io_lengths(config)
    except ConfigError as error:
        raise table.error("config", f"config: {error}", "take the octets from its GSD file") from None
    if not 1 <= len(config) <= MAX_DATA:
        table.fail("config", f"config has {len(config)} octets", f"1..{MAX_DATA} are possible")
    if "ident" not in table:
        table.fail(None, "no ident", 'add ident = 0x1234 (from its GSD file), or ident = "ask"')
    return Basis(ident=None, config=config)


def _leave_out(table: Table, key: str, why: str, todo: str) -> None:
    if key in table:
        table.fail(key, f"{key} {why}", todo)


def _check_ident(table: Table, path: str, found: GsdSlave) -> None:
    if found.device.ident is None and "ident" not in table:
        table.fail("gsd", f"{path} has no Ident_Number", 'add ident = 0x1234, or ident = "ask"')


def _lengths(telegram: TelegramSpec) -> tuple[int, int]:
    return telegram.input_octets, telegram.output_octets


def _interval_ns(device: Device) -> int:
    return (device.min_slave_interval or 0) * INTERVAL_UNIT


def _fail_safe(device: Device) -> bool:
    """A slave that needs empty frames in Clear can take them."""
    return device.fail_safe or device.dpv1.fail_safe_required


def _split(table: Table, key: str | None, error: ConfigError) -> ConfigError:
    """A refusal of the drive registry (``what; what to do``) with the place in front."""
    what, _, todo = str(error).partition("; ")
    return table.error(key, what, todo or "correct it")
