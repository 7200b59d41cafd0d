"""One [[slave]] table: a known drive by name, a GSD file, or a raw slave by ident and identifier octets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from dpstack.api.field_config import read_fields
from dpstack.api.gsd_slave import GSD_KEYS, read_gsd_slave
from dpstack.api.tables import Table
from dpstack.dp.diag_texts import DiagTexts
from dpstack.dp.fields import FieldMap
from dpstack.dp.setup import SlaveSetup
from dpstack.errors import ConfigError
from dpstack.fdl.telegram import MAX_DATA
from dpstack.gsd.identifiers import io_lengths
from dpstack.params import MAX_STATION
from dpstack.profile import DriveProfile, registry
from dpstack.units import NS_PER_US

_KEYS: Final = (
    "name",
    "address",
    "drive",
    "telegram",
    "ident",
    "config",
    "user_prm",
    "gsd",
    "modules",
    "parameters",
    "defaults",
    "watchdog_ms",
    "groups",
    "every",
    "safe",
    "min_slave_interval",
    "fail_safe",
    "sync",
    "freeze",
    "wd_base_1ms",
    "ignore_auto_clear",
    "dpv1",
    "reference_hz",
    "reference_rpm",
    "options",
    "inputs",
    "outputs",
)
#: keys whose function comes later, with the values that ask for nothing
_LATER: Final[dict[str, tuple[object, ...]]] = {
    "dpv1": (False,),
}
#: Min_Slave_Interval counts in 100 us, as GSD files do
_INTERVAL_UNIT: Final = 100 * NS_PER_US
MAX_WATCHDOG_MS: Final = 650_250


@dataclass(frozen=True, slots=True, kw_only=True)
class SlaveConfig:
    """One slave as configured and checked. ``ident`` None: taken from the slave's diagnosis (``ident = "ask"``)."""

    name: str
    address: int
    ident: int | None
    config: bytes
    user_prm: bytes = b""
    profile: DriveProfile | None = None
    telegram: str | None = None
    options: Mapping[str, object] = field(default_factory=dict)
    watchdog_ms: int | None = None
    groups: tuple[int, ...] = ()
    every: int = 1
    safe: bytes = b""
    initial: bytes | None = None
    min_slave_interval_ns: int = 0
    fail_safe: bool = False
    sync: bool = False
    freeze: bool = False
    wd_base_1ms: bool = False
    ignore_auto_clear: bool = False
    #: what the device's GSD file says to a diagnosis
    texts: DiagTexts | None = field(default=None, compare=False, repr=False)
    #: names for what is in the process data
    input_fields: FieldMap = field(default_factory=FieldMap)
    output_fields: FieldMap = field(default_factory=FieldMap)
    #: the application makes the outputs octet by octet, also where there is a drive plugin
    raw: bool = False
    #: MaxTsdr in bit times by rate, and the rates it knows, where manual or GSD file say so
    max_tsdr: Mapping[int, int] = field(default_factory=dict)
    baud_rates: frozenset[int] = frozenset()
    notes: tuple[str, ...] = ()

    @property
    def input_len(self) -> int:
        """Octets of inputs."""
        return io_lengths(self.config)[0]

    @property
    def output_len(self) -> int:
        """Octets of outputs."""
        return io_lengths(self.config)[1]

    def setup(self, baud: int) -> SlaveSetup:
        """What the master must know of it at ``baud`` bit/s."""
        profile = self.profile
        return SlaveSetup(
            address=self.address,
            name=self.name,
            ident=self.ident,
            config=self.config,
            user_prm=self.user_prm,
            watchdog_ms=self.watchdog_ms,
            groups=self.groups,
            safe=self.safe,
            initial=self.initial,
            fail_safe=self.fail_safe,
            every=self.every,
            min_slave_interval_ns=self.min_slave_interval_ns,
            max_tsdr=self.max_tsdr.get(baud),
            on_loss=profile.on_loss if profile else "",
            sync=self.sync,
            freeze=self.freeze,
            wd_base_1ms=self.wd_base_1ms,
            ignore_auto_clear=self.ignore_auto_clear,
            texts=self.texts,
        )


def read_slave(table: Table) -> SlaveConfig:
    """Check one table. Raises ConfigError, one line."""
    named = table.raw("name")
    if isinstance(named, str) and named.strip() and named.isprintable():
        table.title = f"[[slave]] {named}" if table.title.startswith("[[") else f"slave {named}"
    table.check_keys(_KEYS)
    table.refuse_later(_LATER)
    address = table.integer("address", 0, MAX_STATION, "stations have 0..125; 126 is a slave without an address yet")
    if address is None:
        table.fail(None, "no address", "add its station address, 0..125")
    slave = _build(table, address, _basis(table))
    try:
        slave.setup(500_000)
    except ConfigError as error:
        raise table.error(None, str(error), "correct it") from None
    return slave


@dataclass(frozen=True, slots=True)
class _Basis:
    """What the kinds of slave take from elsewhere: the drive's manual, a GSD file, or nothing."""

    ident: int | None
    config: bytes
    user_prm: bytes = b""
    safe: bytes = b""
    interval_ns: int = 0
    fail_safe: bool = False
    profile: DriveProfile | None = None
    telegram: str | None = None
    options: Mapping[str, object] = field(default_factory=dict)
    max_tsdr: Mapping[int, int] = field(default_factory=dict)
    baud_rates: frozenset[int] = frozenset()
    texts: DiagTexts | None = None
    notes: tuple[str, ...] = ()


def _basis(table: Table) -> _Basis:
    """What the table stands on: a GSD file, a known drive, or octets."""
    drive, gsd = table.text("drive"), table.text("gsd")
    if gsd is not None:
        return _gsd(table, gsd)
    for key in GSD_KEYS:
        if key in table:
            table.fail(key, f"{key} without gsd", f"name the GSD file, or leave {key} out")
    return _raw(table) if drive is None else _drive(table, drive)


def _gsd(table: Table, path: str) -> _Basis:
    found = read_gsd_slave(table, path)
    device = found.device
    if device.ident is None and "ident" not in table:
        table.fail("gsd", f"{path} has no Ident_Number", 'add ident = 0x1234, or ident = "ask"')
    return _Basis(
        ident=device.ident,
        config=found.configuration.config,
        user_prm=found.user_prm,
        interval_ns=(device.min_slave_interval or 0) * _INTERVAL_UNIT,
        fail_safe=device.fail_safe,
        max_tsdr=found.max_tsdr,
        baud_rates=found.baud_rates,
        texts=found.configuration.texts(),
        notes=found.notes,
    )


def _drive(table: Table, name: str) -> _Basis:
    for key in ("config",):
        if key in table:
            table.fail(key, f"{key} beside drive", f"leave {key} out: it follows from drive and telegram")
    try:
        profile = registry.find(name)
    except ConfigError as error:
        raise _split(table, "drive", error) from None
    wanted = table.text("telegram")
    try:
        telegram = profile.telegram(wanted)
    except ConfigError as error:
        raise _split(table, "telegram", error) from None
    inside = table.table("options")
    options = {} if inside is None else {key: inside.raw(key) for key in inside}
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
    return _Basis(
        ident=profile.ident,
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
    )


def _raw(table: Table) -> _Basis:
    for key in ("telegram", "reference_hz", "reference_rpm", "options"):
        if key in table:
            table.fail(key, f"{key} without drive", f"add drive, or leave {key} out")
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
    return _Basis(ident=None, config=config)


def _split(table: Table, key: str | None, error: ConfigError) -> ConfigError:
    """A refusal of the drive registry (``what; what to do``) with the place in front."""
    what, _, todo = str(error).partition("; ")
    return table.error(key, what, todo or "correct it")


def _build(table: Table, address: int, basis: _Basis) -> SlaveConfig:
    watchdog = table.integer("watchdog_ms", 0, MAX_WATCHDOG_MS, "0 is off; leave it out for the plan's recommendation")
    interval = table.integer("min_slave_interval", 0, 0xFFFF)
    every = table.integer("every", 1, 10_000)
    safe = table.octets("safe")
    outputs = io_lengths(basis.config)[1]
    if safe is not None and len(safe) != outputs:
        table.fail("safe", f"safe has {len(safe)} octets", f"the configuration has {outputs} octets of outputs")
    user_prm = None if basis.texts is not None else table.octets("user_prm")
    ident, ident_note = _ident(table, basis)
    input_fields, output_fields = read_fields(table, *io_lengths(basis.config))
    name = table.text("name") or f"slave{address}"
    profile = basis.profile
    notes = [f"slave {address} ({name}): {note}" for note in (ident_note, *basis.notes) if note]
    if profile is not None and profile.telegram(basis.telegram).made_up:
        notes.append(
            f"slave {address} ({name}): the identifier octets {basis.config.hex(' ').upper()} of {profile.name} are in "
            f"no manual (made up): compare them with its GSD file"
        )
    return SlaveConfig(
        name=name,
        address=address,
        ident=ident,
        config=basis.config,
        user_prm=basis.user_prm if user_prm is None else user_prm,
        profile=profile,
        telegram=basis.telegram,
        options=basis.options,
        max_tsdr=basis.max_tsdr,
        baud_rates=basis.baud_rates,
        texts=basis.texts,
        watchdog_ms=watchdog,
        groups=table.integers("groups", 1, 8),
        every=1 if every is None else every,
        safe=basis.safe if safe is None else safe,
        min_slave_interval_ns=basis.interval_ns if interval is None else interval * _INTERVAL_UNIT,
        fail_safe=table.flag("fail_safe", basis.fail_safe),
        sync=table.flag("sync", False),
        freeze=table.flag("freeze", False),
        wd_base_1ms=table.flag("wd_base_1ms", False),
        ignore_auto_clear=table.flag("ignore_auto_clear", False),
        input_fields=input_fields,
        output_fields=output_fields,
        notes=tuple(notes),
    )


def _ident(table: Table, basis: _Basis) -> tuple[int | None, str]:
    """The ident number and a remark on it. "ask" is None."""
    profile = basis.profile
    value = table.raw("ident")
    if value is None:
        if profile is not None and profile.ident_made_up:
            return basis.ident, (
                f"the ident number 0x{profile.ident:04X} of {profile.name} is in no manual (made up); "
                f'for a real one give ident = 0x... or ident = "ask"'
            )
        return basis.ident, ""
    if isinstance(value, str):
        if value.strip().lower() != "ask":
            table.fail("ident", f"ident = {value!r}", 'give a number like 0x0696, or "ask"')
        return None, ""
    return table.integer("ident", 0, 0xFFFF, "an ident number has two octets"), ""
