"""One [[slave]] table: a known drive by name, a GSD file, or a raw slave by ident and identifier octets.

Its keys ``inputs`` and ``outputs`` name its process data.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from dpstack.api.config.dpv1 import Ms2Limits, read_dpv1
from dpstack.api.config.gsd_slave import remarks
from dpstack.api.config.slave_source import Basis, basis_of
from dpstack.api.config.table import Table
from dpstack.dp.pdu.diag_texts import DiagTexts
from dpstack.dp.pdu.diagnosis import FIXED_LEN, MAX_LEN
from dpstack.dp.pdu.dpv1_status import DPV1_STATUS_LEN, Dpv1
from dpstack.dp.process_data import Field, FieldMap, field_of, overlap
from dpstack.dp.slave_params import INTERVAL_UNIT, MAX_WATCHDOG_MS, SlaveParams
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.errors import ConfigError
from dpstack.gsd.identifiers import io_lengths
from dpstack.gsd.model import Device
from dpstack.params import MAX_STATION, UNADDRESSED
from dpstack.profile import DriveProfile
from dpstack.units import ms_text


def read_fields(table: Table, input_len: int, output_len: int) -> tuple[FieldMap, FieldMap]:
    """The fields of a slave with so many octets of inputs and outputs. Raises ConfigError.

    Inputs may be read in several ways, so their fields may overlap; outputs may not: who writes one field must not
    change another. A name stands for one field of a slave.
    """
    inputs = _fields(table, "inputs", input_len)
    outputs = _fields(table, "outputs", output_len)
    both = next((name for name in outputs if name in inputs), None)
    if both is not None:
        table.fail("outputs", f"{both!r} is an input and an output", "give one of them another name")
    shared = overlap(outputs)
    if shared is not None:
        later, first = shared
        table.fail(
            "outputs",
            f"{later.name} ({later.spec}) and {first.name} ({first.spec}) share bits",
            "move one of them, or name the bits that are left",
        )
    return FieldMap(inputs, input_len), FieldMap(outputs, output_len)


def _fields(table: Table, key: str, length: int) -> dict[str, Field]:
    inside = table.table(key)
    return {} if inside is None else {name: _field(inside, name, length, key) for name in inside}


def _field(inside: Table, name: str, length: int, key: str) -> Field:
    text = inside.text(name) or ""
    try:
        return field_of(name, text, length, key)
    except ConfigError as error:
        what, _, todo = str(error).rpartition("; ")
        raise inside.error(name, what, todo) from None


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
    "simulated",
    "inputs",
    "outputs",
)


#: commands take a name or an address: a name that is a number could mean another slave
_NUMERIC: Final = re.compile(r"[+-]?(\d+|0[xX][0-9a-fA-F]+)")


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
    #: what only its simulated drive has: options and parameters by name
    simulated: Mapping[str, object] = field(default_factory=dict)
    watchdog_ms: int | None = None
    groups: tuple[int, ...] = ()
    every: int = 1
    safe: bytes = b""
    initial: bytes | None = None
    min_slave_interval_ns: int = 0
    fail_safe: bool = False
    #: a DP-V1 slave is told so in DPV1_Status_1
    fail_safe_told: bool = False
    sync: bool = False
    freeze: bool = False
    wd_base_1ms: bool = False
    ignore_auto_clear: bool = False
    #: DPV1_Enable and what goes with it; None: nothing of DP-V1 is used
    dpv1: Dpv1 | None = None
    #: what its GSD file says about class 2 connections
    ms2: Ms2Limits = field(default_factory=Ms2Limits)
    #: what the device's GSD file says to a diagnosis
    texts: DiagTexts | None = field(default=None, compare=False, repr=False)
    #: as a slave, where its GSD file describes it
    description: SlaveDescription | None = field(default=None, compare=False, repr=False)
    #: what its GSD file says
    device: Device | None = field(default=None, compare=False, repr=False)
    #: names for what is in the process data
    input_fields: FieldMap = field(default_factory=FieldMap)
    output_fields: FieldMap = field(default_factory=FieldMap)
    #: the application makes the outputs octet by octet, also where there is a drive plugin
    raw: bool = False
    #: MaxTsdr in bit times by rate, and the rates it knows, where manual or GSD file say so
    max_tsdr: Mapping[int, int] = field(default_factory=dict)
    baud_rates: frozenset[int] = frozenset()
    #: Max_Diag_Data_Len of its GSD file
    max_diag_len: int | None = None
    notes: tuple[str, ...] = ()
    #: see :attr:`~dpstack.dp.slave_params.SlaveParams.prm_note`
    prm_note: str = ""

    @property
    def input_len(self) -> int:
        """Octets of inputs."""
        return io_lengths(self.config)[0]

    @property
    def output_len(self) -> int:
        """Octets of outputs."""
        return io_lengths(self.config)[1]

    def setup(self, baud: int) -> SlaveParams:
        """What the master must know of it at ``baud`` bit/s."""
        profile = self.profile
        return SlaveParams(
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
            fail_safe_told=self.fail_safe_told,
            every=self.every,
            min_slave_interval_ns=self.min_slave_interval_ns,
            max_tsdr=self.max_tsdr.get(baud),
            max_diag_len=self.max_diag_len,
            on_loss=profile.on_loss if profile else "",
            sync=self.sync,
            freeze=self.freeze,
            wd_base_1ms=self.wd_base_1ms,
            ignore_auto_clear=self.ignore_auto_clear,
            dpv1=self.dpv1,
            texts=self.texts,
            prm_note=self.prm_note,
        )


def read_slave(table: Table, *, unaddressed: bool = False) -> SlaveConfig:
    """Check one table. ``unaddressed``: 126, a slave as delivered, is an address too. Raises ConfigError, one line."""
    named = table.raw("name")
    if isinstance(named, str) and named.strip() and named.isprintable():
        table.title = f"[[slave]] {named}" if table.title.startswith("[[") else f"slave {named}"
    table.check_keys(_KEYS)
    highest = UNADDRESSED if unaddressed else MAX_STATION
    address = table.integer("address", 0, highest, "stations have 0..125; 126 is a slave without an address yet")
    if address is None:
        table.fail(None, "no address", "add its station address, 0..125")
    slave = _build(table, address, basis_of(table))
    try:
        slave.setup(500_000)
    except ConfigError as error:
        raise table.error(None, str(error), "correct it") from None
    return slave


def _build(table: Table, address: int, basis: Basis) -> SlaveConfig:
    watchdog = table.integer("watchdog_ms", 0, MAX_WATCHDOG_MS, "0 is off; leave it out for the plan's recommendation")
    interval = table.integer("min_slave_interval", 0, 0xFFFF)
    every = table.integer("every", 1, 10_000)
    safe = table.octets("safe")
    outputs = io_lengths(basis.config)[1]
    if safe is not None and len(safe) != outputs:
        table.fail("safe", f"safe has {len(safe)} octets", f"the configuration has {outputs} octets of outputs")
    device = basis.device
    octets = table.octets("user_prm") if device is None else None  # with a GSD file it was looked at there
    user_prm = basis.user_prm if octets is None else octets
    told = device is not None and device.dpv1.slave and len(user_prm) >= DPV1_STATUS_LEN
    ident, ident_note = _ident(table, basis)
    input_fields, output_fields = read_fields(table, *io_lengths(basis.config))
    name = table.text("name") or f"slave{address}"
    if _NUMERIC.fullmatch(name.strip()):
        table.fail("name", f"name = {name!r} looks like an address", f'write a word: name = "slave{address}"')
    profile = basis.profile
    interval_ns = basis.interval_ns if interval is None else interval * INTERVAL_UNIT
    dpv1 = read_dpv1(table, device, user_prm)
    told_of_it = (ident_note, _hurried(basis, interval_ns), *basis.notes, *remarks(device, dpv1))
    notes = [f"slave {address} ({name}): {note}" for note in told_of_it if note]
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
        user_prm=user_prm,
        profile=profile,
        telegram=basis.telegram,
        options=basis.options,
        simulated=basis.simulated,
        max_tsdr=basis.max_tsdr,
        baud_rates=basis.baud_rates,
        texts=basis.texts,
        description=basis.description,
        device=device,
        watchdog_ms=watchdog,
        groups=table.integers("groups", 1, 8),
        every=1 if every is None else every,
        safe=basis.safe if safe is None else safe,
        min_slave_interval_ns=interval_ns,
        max_diag_len=_max_diag_len(device),
        fail_safe=_fail_safe(table, basis),
        fail_safe_told=told and basis.fail_safe,
        sync=_mode(table, "sync", None if device is None else device.sync, "Sync_Mode_supp"),
        freeze=_mode(table, "freeze", None if device is None else device.freeze, "Freeze_Mode_supp"),
        wd_base_1ms=_wd_base_1ms(table, device, told),
        ignore_auto_clear=table.flag("ignore_auto_clear", False),
        dpv1=dpv1,
        ms2=Ms2Limits.of(device),
        input_fields=input_fields,
        output_fields=output_fields,
        notes=tuple(notes),
        prm_note=basis.prm_note,
    )


def _hurried(basis: Basis, interval_ns: int) -> str:
    """A remark on a Min_Slave_Interval below what the slave is known to need."""
    if interval_ns >= basis.interval_ns:
        return ""
    known = "its GSD file" if basis.device is not None or basis.profile is None else basis.profile.name
    return (
        f"min_slave_interval = {interval_ns // INTERVAL_UNIT} ({ms_text(interval_ns)}) is shorter than the "
        f"{ms_text(basis.interval_ns)} of {known} (Min_Slave_Intervall): it may not follow; leave it out"
    )


def _max_diag_len(device: Device | None) -> int | None:
    if device is None or device.max_diag_data_len is None:
        return None
    return min(max(FIXED_LEN, device.max_diag_data_len), MAX_LEN)


def _mode(table: Table, key: str, supported: bool | None, keyword: str) -> bool:
    """A flag that a GSD file may not allow; ``supported`` None: there is no such file."""
    wanted = table.flag(key, False)
    if wanted and supported is False:
        table.fail(key, f"{key} = true, but its GSD file says {keyword} = 0", f"leave {key} out")
    return wanted


def _wd_base_1ms(table: Table, device: Device | None, told: bool) -> bool:
    supported = device is not None and device.dpv1.wd_base_1ms
    wanted = table.flag("wd_base_1ms", supported and told)
    if wanted and device is not None and not supported:
        table.fail("wd_base_1ms", "wd_base_1ms = true, but its GSD file says WD_Base_1ms_supp = 0", "leave it out")
    return wanted


def _fail_safe(table: Table, basis: Basis) -> bool:
    wanted = table.flag("fail_safe", basis.fail_safe)
    if basis.device is not None and basis.device.dpv1.fail_safe_required and not wanted:
        table.fail("fail_safe", "fail_safe = false, but its GSD file says Fail_Safe_required = 1", "leave it out")
    return wanted


def _ident(table: Table, basis: Basis) -> tuple[int | None, str]:
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
