"""The [[slave]] table: keys, checks, changes while the bus runs.

Its keys ``inputs`` and ``outputs`` name its process data.
"""

import contextlib
import re
from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypedDict

from msgspec import Struct, structs

from dpstack.api.config.slave_source import (
    DRIVE_KEYS,
    PERCENT,
    Basis,
    Who,
    basis_of_octets,
    block_remarks,
    demand_of,
    drives_of,
    leave_out,
    modules_of,
    need_gsd,
    remarks,
)
from dpstack.dp.field_map import FieldMap
from dpstack.dp.pdu.dpv1_status import DPV1_ENABLE, Dpv1
from dpstack.dp.slave_params import INTERVAL_UNIT, SLAVE_LIMITS, SlaveParams
from dpstack.dp.slot_map import Direction
from dpstack.errors import ConfigError, GsdError, UsageError
from dpstack.gsd.dpv1_keywords import NO_GSD, DpV1
from dpstack.gsd.identifiers import io_lengths
from dpstack.params import DPV1_STATUS_LEN, MAX_STATION, UNADDRESSED
from dpstack.text import brief
from dpstack.toml.table import Gsd, Key, Octets, Source, Table, as_given, keys_of
from dpstack.units import ms_text

if TYPE_CHECKING:
    from dpstack.api.config.drives_source import DriveConfig
    from dpstack.api.config.simulate import SimulateConfig
    from dpstack.api.config.subscribes import Subscription
    from dpstack.dpv1.slave.description import SlaveDescription
    from dpstack.gsd.model import Device, Module
    from dpstack.profile import DriveProfile
    from dpstack.profile.drive_profile import DeviceProfile

#: commands take a name or an address: a name that is a number could mean another slave
_NUMERIC: Final = re.compile(r"[+-]?(\d+|0[xX][0-9a-fA-F]+)")


class IdentKeys(TypedDict, total=False):
    """The keys of a table ``ident``, as docs/reference/configuration.md has them.

    configured: the ident number in Set_Prm. Left out: the drive's, or that of its GSD file
    adapts: the device shows another ident number until Set_Prm, and takes over the configured one. Left out: false
    """

    configured: Annotated[int, Key(*SLAVE_LIMITS["ident"], hint="an ident number has two octets")]
    adapts: bool


def _ident(table: Table, name: str, key: Key) -> object:
    """Reader of ``ident``; "ask" becomes None, a table stays one."""
    value = table.raw(name)
    if isinstance(value, Mapping):
        return table.table(name).read(keys_of(IdentKeys))
    if isinstance(value, str):
        if value.strip().lower() != "ask":
            table.fail(name, f"{name} = {brief(value)}", 'give a number like 0x0696, or "ask"')
        return None
    return table.integer(name, key.low, key.high, key.hint)


def _ident_changes(given: int | Mapping[str, Any] | None, known: SlaveParams) -> dict[str, Any]:
    if isinstance(given, Mapping):
        return {"ident": given.get("configured", known.ident), "ident_adapts": given.get("adapts", False)}
    return {"ident": given, "ident_adapts": False}


def _interval(table: Table, name: str, key: Key) -> object:
    """Reader of ``min_slave_interval``: from units of 100 us to ns."""
    return table.integer(name, key.low, key.high) * INTERVAL_UNIT


def _subscribes(table: Table, name: str, key: Key) -> object:
    from dpstack.api.config.subscribes import read_subscribes  # here, as few slaves subscribe

    return read_subscribes(table, name, key)


class SlaveKeys(TypedDict, total=False):
    """The keys of [[slave]] that describe the slave, as docs/reference/configuration.md has them.

    name: the name in programs and messages, unique. Left out: `slaveN`
    address: the station address, unique. Left out: required
    drive: the name of a known drive, see [drives.md](drives.md), or the path of a device file
    drives: the drives of a slave with several, instead of `drive`, [see below](#several-drives-in-one-slave)
    device: the same as `drive` for a device that is no drive, such as an encoder, see
        [encoder.md](../how-to/encoder.md)
    telegram: one of the telegrams of that drive or device
    gsd: a [GSD file](gsd.md), relative to the configuration; or the name of a drive for which dpstack has one; or
        `"io-station"` ([io-station.md](io-station.md)). Beside `drive`, the file has priority over the data of the
        plugin
    modules: the modules by name or reference number, in slot order, `""` for an empty slot. Left out: the presets of
        the file
    parameters: the user parameters by name, as number or text. Left out: the defaults of the file
    defaults: which defaults of the file count: `"refs"` or `"const"`, see
        [gsd.md](gsd.md#two-readings-of-the-defaults). Left out: `"refs"`
    inputs: names for the inputs, [see below](#names-for-process-data)
    outputs: names for the outputs
    reference_hz: the frequency at 100 % speed, if the drive has that option. Left out: the drive's
    reference_rpm: the speed in rpm at 100 %, if the drive has that option. Left out: the drive's
    options: options of the drive plugin, see [drives.md](drives.md), or of the device
    simulate: the inputs of the simulated slave, [see below](#inputs-of-a-simulated-slave)
    simulated: for the simulated drive or device only: its options, and a drive's parameters by name or number
        (`{ load = 0.8, 412 = 1 }`), see [drives.md](drives.md)
    subscribes: values that the slave takes from other slaves by data exchange broadcast, `[{ from = "encoder", octets =
        "0:4", to = 8 }]`, see [dxb.md](dxb.md). Left out: none
    filter_block: `"sinamics"`: SINAMICS's own block in Set_Prm for these values; `"standard"`: the subscriber table of
        DP-V2. Left out: `"standard"`
    refuse_master: the reason why dpstack must not be the master of this slave. Everything that would bring it up
        refuses the configuration with this text; listening, `read_only` and simulation take it,
        [see below](#slaves-that-dpstack-must-not-bring-up). Left out: none
    """

    name: str
    address: Annotated[int, Key(0, MAX_STATION, hint="stations have 0..125; 126 is a slave without an address yet")]
    drive: str
    drives: Annotated[Sequence[Mapping[str, object]], Key(read=drives_of)]
    device: str
    telegram: str
    gsd: str
    modules: Annotated[Sequence[int | str], Key(read=modules_of)]
    parameters: Mapping[str, object]
    defaults: Literal["refs", "const"]
    inputs: Mapping[str, object]
    outputs: Mapping[str, object]
    reference_hz: Annotated[float, PERCENT]
    reference_rpm: Annotated[float, PERCENT]
    options: Mapping[str, object]
    simulate: Mapping[str, object]
    simulated: Mapping[str, object]
    subscribes: Annotated[Sequence[Mapping[str, object]], Key(read=_subscribes)]
    filter_block: Literal["standard", "sinamics"]
    refuse_master: str


class Changes(TypedDict, total=False):
    """The keys of [[slave]] that are parameters for its master:
    :meth:`~dpstack.api.slave.slave.Slave.reparameterise` changes them while the bus runs. None means left out.

    ident: the ident number, or `"ask"`: the master reads it from the diagnosis; or `{ configured = 0x9700, adapts =
        true }`, [see below](#a-device-that-adapts-its-ident-number). Left out: the drive's, or that of its GSD file
    config: identifier octets in hex (instead of `drive`). Left out: those of the telegram or of the modules
    user_prm: user parameters of Set_Prm in hex. Left out: those of the drive or of the GSD file
    watchdog_ms: the watchdog time; 0 = off, with a warning at every start. It is rounded up to the next value of the
        two watchdog factors; `dpstack plan`, `run --json` and `slave.watchdog_ms` show the effective time. Left out:
        the plan's recommendation
    wd_base_1ms: a DP-V1 slave uses the watchdog base of 1 ms (WD_Base_1ms); its `user_prm` begin with the three
        DPV1_Status octets. Left out: as its GSD file says, else false
    groups: group numbers for Global_Control
    sync: request SYNC in Set_Prm; `bus.sync` and `bus.group` refuse slaves without it
    freeze: request FREEZE in Set_Prm; `bus.freeze` and `bus.group` refuse slaves without it
    every: exchange data in every n-th round or cycle; the turns of such slaves are [spread](cycle.md#rate-groups)
    safe: output octets for every way out, in hex. Left out: the drive's, else zeros
    after_return: the outputs after the slave was away: `"resume"`: those that were set before go out again at once;
        `"safe"`: they stay at their safe values until they are set anew, [see below](#outputs-after-a-slave-was-away).
        Not beside `drive`: a drive never starts by itself. Left out: `"resume"`; a drive by octets (`--outputs`) has
        `"safe"`
    min_slave_interval: the shortest time between two exchanges with the slave. A time shorter than in the GSD file gets
        a remark. Left out: the drive's, or that of its GSD file
    dpv1: DP-V1 on or off, or a table of the other settings in DPV1_Status ([dp-v1.md](dp-v1.md)); `user_prm` begin with
        its three octets. Left out: on if the GSD file says DPV1_Slave and C1_Read_Write_supp, or if DPV1_Enable is set
        in `user_prm`
    ignore_auto_clear: `auto_clear` ignores this slave
    fail_safe: in Clear the slave gets an empty output frame. Left out: the drive's, or as its GSD file says
    """

    ident: Annotated[
        int | str | Mapping[str, object] | None,
        Key(*SLAVE_LIMITS["ident"], hint="an ident number has two octets", read=_ident),
    ]
    config: Octets | None
    user_prm: Octets | None
    watchdog_ms: Annotated[
        int | None, Key(*SLAVE_LIMITS["watchdog_ms"], hint="0 is off; leave it out for the plan's recommendation")
    ]
    wd_base_1ms: Annotated[bool | None, Key(gsd=Gsd("WD_Base_1ms_supp", attrgetter("dpv1.wd_base_1ms")))]
    groups: Annotated[Sequence[int] | None, Key(*SLAVE_LIMITS["groups"])]
    sync: Annotated[bool | None, Key(gsd=Gsd("Sync_Mode_supp", attrgetter("sync")))]
    freeze: Annotated[bool | None, Key(gsd=Gsd("Freeze_Mode_supp", attrgetter("freeze")))]
    every: Annotated[int | None, Key(*SLAVE_LIMITS["every"])]
    safe: Octets | None
    after_return: Literal["resume", "safe"] | None
    min_slave_interval: Annotated[int | None, Key(0, 0xFFFF, "x 100 us", read=_interval)]
    dpv1: Annotated[bool | Mapping[str, object] | None, Key(read=as_given)]
    ignore_auto_clear: bool | None
    fail_safe: Annotated[
        bool | None, Key(gsd=Gsd("Fail_Safe_required", attrgetter("dpv1.fail_safe_required"), required=True))
    ]


_DRIVE_RETURNS: Final = "the drive does not start by itself: start() starts it again"
_DEVICE_RETURNS: Final = "its outputs stay at their safe values until it gets an order"
_RETURNS: Final = {
    "resume": (
        'its outputs are at once those from before (after_return = "resume"), and a drive that starts by level turns; '
        'after_return = "safe" keeps them safe until they are set anew'
    ),
    "safe": 'its outputs stay at their safe values until they are set anew (after_return = "safe")',
}


class SlaveConfig(Struct, frozen=True, kw_only=True, repr_omit_defaults=True):
    """One slave as configured and checked."""

    params: SlaveParams
    #: the parameters by drive, GSD file or identifier octets, without the table's own keys
    known: SlaveParams
    profile: "DriveProfile | None" = None
    #: the drives of a slave with several; empty for all others, ``profile`` is None then
    drives: "tuple[DriveConfig, ...]" = ()
    #: of a device that is no drive
    device_profile: "DeviceProfile | None" = None
    telegram: str | None = None
    options: Mapping[str, object] = {}
    #: where the inputs of the simulated slave come from; None: they are its outputs
    simulate: "SimulateConfig | None" = None
    #: options and parameters by name that only its simulated drive has
    simulated: Mapping[str, object] = {}
    #: the simulated slave by its GSD file, None without one
    description: "SlaveDescription | None" = None
    #: the device of its GSD file
    device: "Device | None" = None
    #: the key ``gsd``, and the modules of that file in slot order (None: an empty slot); None without a GSD file
    gsd: str | None = None
    modules: "tuple[Module | None, ...] | None" = None
    #: names for the process data
    input_fields: FieldMap = FieldMap()
    output_fields: FieldMap = FieldMap()
    #: the application makes the outputs octet by octet, also if there is a drive plugin
    raw: bool = False
    #: values that it takes from other slaves
    subscribes: "tuple[Subscription, ...]" = ()
    #: the block in Set_Prm for them
    filter_block: str = "standard"
    #: why dpstack must not be its master; empty: it may
    refuse_master: str = ""
    #: its baud rates by manual or GSD file; empty: not known
    baud_rates: frozenset[int] = frozenset()
    notes: tuple[str, ...] = ()

    @property
    def address(self) -> int:
        return self.params.address

    @property
    def name(self) -> str:
        return self.params.name

    @property
    def any_profile(self) -> "DriveProfile | DeviceProfile | None":
        """The profile of its drive or device; None without one."""
        return self.profile or self.device_profile

    @property
    def has_drive(self) -> bool:
        """Whether plugins of one or several drives make its outputs."""
        return self.profile is not None or bool(self.drives)

    @property
    def has_plugin(self) -> bool:
        """Whether plugins of its drives or of its device make its outputs."""
        return self.has_drive or self.device_profile is not None

    @property
    def expected_user_prm(self) -> bytes | None:
        """The user parameters that its GSD file gives for its modules, or its plugin; None without either."""
        if self.device is not None:
            from dpstack.gsd.prm import UserPrm  # here, as only diagnoses compare with it

            texts = self.params.texts
            with contextlib.suppress(GsdError):
                return UserPrm(self.device, () if texts is None else texts.modules).octets()
        return self.known.user_prm if self.has_plugin else None

    @property
    def fields(self) -> tuple[tuple[Direction, FieldMap], ...]:
        """The named inputs, then the named outputs."""
        return (Direction.INPUT, self.input_fields), (Direction.OUTPUT, self.output_fields)

    @property
    def on_return(self) -> str:
        """What its outputs do after it was away, for people; empty without outputs."""
        if not self.params.output_len:
            return ""
        if not self.has_plugin or self.raw:
            return _RETURNS[self.params.after_return]
        return _DRIVE_RETURNS if self.has_drive else _DEVICE_RETURNS

    @property
    def gsd_dpv1(self) -> DpV1:
        """The DP-V1 keywords of its GSD file."""
        return NO_GSD if self.device is None else self.device.dpv1


def read_slave(table: Table, *, unaddressed: bool = False) -> SlaveConfig:
    """Check one table. ``unaddressed``: 126, a slave as delivered, is an address too. Raises ConfigError, one line."""
    named = table.raw("name")
    if isinstance(named, str) and named.strip() and named.isprintable():
        table.title = f"[[slave]] {named}" if table.title.startswith("[[") else f"slave {named}"
    keys = keys_of(SlaveKeys) | keys_of(Changes)
    if unaddressed:
        keys["address"] = structs.replace(keys["address"], high=UNADDRESSED)
    given = table.read(keys)
    if "address" not in given:
        table.fail(None, "no address", "add its station address, 0..125")
    address = given["address"]
    name = given.get("name") or f"slave{address}"
    if _NUMERIC.fullmatch(name.strip()):
        table.fail("name", f"name = {name!r} looks like an address", f'write a word: name = "slave{address}"')
    known, rest = _basis_of(table, given, Who(address=address, name=name))
    slave = SlaveConfig(params=known, known=known, **rest)
    changes = _changes(slave, table, given)
    with table.blaming():
        params = structs.replace(known, **changes)
        params = structs.replace(params, isochronous=demand_of(slave.device, params))
    inputs, outputs = _fields(_with_words(table, slave), params)
    if slave.drives and params.dpv1 is not None:
        from dpstack.api.config.drives_source import check_objects

        check_objects(table, slave.drives)
    if slave.device_profile is not None:
        inputs = _with_counters(inputs, table, slave.device_profile)
    simulate = None
    if table.raw("simulate") is not None:
        from dpstack.api.config.simulate import read_simulate  # here, as a real bus has no simulated slaves

        simulate = read_simulate(table, drive=slave.has_plugin)
    slave = structs.replace(
        slave,
        params=params,
        input_fields=inputs,
        output_fields=outputs,
        simulate=simulate,
        subscribes=given.get("subscribes", ()),
        filter_block=given.get("filter_block", "standard"),
        refuse_master=given.get("refuse_master", ""),
    )
    notes = (f"slave {address} ({name}): {note}" for note in _notes(slave, given) if note)
    return structs.replace(slave, notes=tuple(notes))


def _fields(table: Table, params: SlaveParams) -> tuple[FieldMap, FieldMap]:
    """The named inputs and outputs. Raises ConfigError."""
    if table.raw("inputs") is None and table.raw("outputs") is None:
        return FieldMap({}, params.input_len), FieldMap({}, params.output_len)
    from dpstack.api.config.field_names import read_fields  # here, as many slaves have no names for their data

    return read_fields(table, params)


def _with_words(table: Table, slave: SlaveConfig) -> Table:
    """``table`` with the words that a device file names; the names that a user gives go before them."""
    profile = slave.any_profile
    if slave.drives:
        from dpstack.api.config.drives_source import with_words

        return with_words(table, slave.drives)
    if profile is None:
        return table
    if "outputs" in table and not slave.raw:
        key = "device" if slave.profile is None else "drive"
        table.fail("outputs", f"outputs beside {key}: its plugin makes the outputs", "leave outputs out")
    if profile.fields is None:
        return table
    inputs, outputs = profile.fields(profile.telegram(slave.telegram).name)
    given = table.raw("inputs")
    return table.extended({"inputs": inputs | (given if isinstance(given, dict) else {}), "outputs": outputs})


def _with_counters(fields: FieldMap, table: Table, profile: "DeviceProfile") -> FieldMap:
    """``fields`` with the counters of the device; a name that the user gives is the user's."""
    from dpstack.dp.counter import counted  # here, as most buses have no device with counters

    given = table.raw("inputs")
    own = given if isinstance(given, dict) else {}
    counters = {
        name: counted(fields.fields[name], *counter) for name, counter in profile.counters.items() if name not in own
    }
    return FieldMap({**fields.fields, **counters}, fields.length)


def _basis_of(table: Table, given: Mapping[str, Any], who: Who) -> Basis:
    """Parameters from the drive, the GSD file, both, or octets, by the keys ``given``. Raises ConfigError, one line."""
    if "gsd" in given:
        leave_out(table, "config", "beside gsd", "leave config out, or gsd")
    if "drives" in given:
        from dpstack.api.config.drives_source import basis_of_drives  # here, as few slaves have several

        return basis_of_drives(table, given, who)
    if "drive" in given or "device" in given:
        from dpstack.api.config.drive_source import basis_of_profile  # here, as a bus without drives needs no plugins

        return basis_of_profile(table, given, who)
    if "gsd" not in given:
        need_gsd(table)
    for key in DRIVE_KEYS:
        leave_out(table, key, "without drive", f"add drive, or leave {key} out")
    if "gsd" in given:
        from dpstack.api.config.gsd_source import (
            basis_of_gsd,  # here, as a bus without GSD files needs no reader of them
        )

        return basis_of_gsd(table, given, who)
    return basis_of_octets(table, given, who)


def _changes(slave: SlaveConfig, table: Table, given: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of ``slave.params`` that the keys ``given`` in ``table`` change, checked against its GSD file.

    Raises ConfigError.
    """
    changes: dict[str, Any] = {}
    keys = keys_of(Changes)
    for name in keys:
        to = "min_slave_interval_ns" if name == "min_slave_interval" else name
        if name in given:
            changes[to] = given[name]
        elif name in table:
            changes[to] = getattr(slave.known, to)
    if "ident" in changes:
        changes |= _ident_changes(changes["ident"], slave.known)
    if slave.has_plugin and not slave.raw:
        todo = "leave it out: a drive never starts by itself after it was away, start() starts it again"
        kind = "drives" if slave.drives else "drive"
        if slave.device_profile is not None:
            kind, todo = "device", f"leave it out: {_DEVICE_RETURNS}"
        leave_out(table, "after_return", f"beside {kind}", todo)
    table.check_against_gsd(keys, given, slave.device)
    safe, outputs = changes.get("safe"), io_lengths(changes.get("config", slave.params.config))[1]
    if safe and len(safe) != outputs:
        table.fail("safe", f"safe has {len(safe)} octets", f"the configuration has {outputs} octets of outputs")
    fixed = "" if slave.device_profile is None or slave.raw else slave.device_profile.fixed_safe
    if safe is not None and fixed:
        table.fail("safe", f"safe beside device: {fixed}", "leave safe out")
    if "user_prm" in changes:
        changes["prm_note"] = "" if "user_prm" in given else slave.known.prm_note
    if "dpv1" in table or slave.params is slave.known:
        changes["dpv1"] = _dpv1(table, slave.device, changes.get("user_prm", slave.params.user_prm))
    return changes


def _dpv1(table: Table, device: "Device | None", user_prm: bytes) -> Dpv1 | None:
    is_enabled = len(user_prm) >= DPV1_STATUS_LEN and bool(user_prm[0] & DPV1_ENABLE)
    if table.raw("dpv1") is None and device is None and not is_enabled:
        return None
    from dpstack.api.config.dpv1 import read_dpv1  # here, as many slaves have nothing of DP-V1

    return read_dpv1(table, device, user_prm)


def changed(slave: SlaveConfig, changes: Changes) -> SlaveConfig:
    """``slave`` after ``changes``, checked against its names for process data and its GSD file.

    Raises UsageError for an unknown key, ConfigError.
    """
    keys = keys_of(Changes)
    unknown = sorted(set(changes) - set(keys))
    if unknown:
        raise UsageError(f"{unknown[0]!r} cannot be changed; these can: {', '.join(sorted(keys))}")
    where = f"slave {slave.address} ({slave.name})"
    table = Table(Source(where), (), changes, "reparameterise")
    params = structs.replace(slave.params, **_changes(slave, table, table.read(keys)))
    params = structs.replace(params, isochronous=demand_of(slave.device, params))
    profile = slave.device_profile
    if profile is not None and profile.plug is None and params.user_prm != slave.params.user_prm:
        raise UsageError(
            f"{where}: its user parameters decide how its plugin reads the position: remove the slave and add it with "
            "others"
        )
    if slave.has_drive and not slave.raw and (slave.params.dpv1 is None) is not (params.dpv1 is None):
        raise UsageError(
            f"{where}: DP-V1 on or off decides how its drive plugin asks for parameters: remove the slave and add it "
            f"with another dpv1"
        )
    if params.publishes and params.input_len != slave.params.input_len:
        raise UsageError(f"{where}: its subscribers have a filter for {slave.params.input_len} octets of inputs")
    if params.links and params.config != slave.params.config:
        raise UsageError(f"{where}: its links give octets of this configuration: remove the slave and add it anew")
    described = slave.description
    reason = None
    if described is not None and params.config in described.configs:
        reason = described.check_prm(params.user_octets(None))
    if reason is not None:
        raise ConfigError(f"{where}: {reason}")
    try:
        inputs = slave.input_fields.fitted(params.input_len, "inputs", params.slots)
        outputs = slave.output_fields.fitted(params.output_len, "outputs", params.slots)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}; a named field would be lost") from None
    return structs.replace(slave, params=params, input_fields=inputs, output_fields=outputs)


def _notes(slave: SlaveConfig, given: Mapping[str, Any]) -> Iterator[str]:
    profile, params = slave.any_profile, slave.params
    if profile is not None and profile.ident_made_up and "ident" not in given:
        yield (
            f"the ident number 0x{profile.ident:04X} of {profile.name} is in no manual (made up); "
            f'for a real one give ident = 0x... or ident = "ask"'
        )
    interval, needed = params.min_slave_interval_ns, slave.known.min_slave_interval_ns
    if interval < needed:
        known = "its GSD file" if slave.device is not None or profile is None else profile.name
        yield (
            f"min_slave_interval = {interval // INTERVAL_UNIT} ({ms_text(interval)}) is shorter than the "
            f"{ms_text(needed)} of {known} (Min_Slave_Intervall): it may not follow; leave it out"
        )
    yield from slave.notes
    yield from remarks(slave.device, params, dpv1_given="dpv1" in given)
    yield from block_remarks(params)
    if profile is not None and profile.telegram(slave.telegram).made_up:
        yield (
            f"the identifier octets {params.config.hex(' ').upper()} of {profile.name} are in no manual (made up): "
            f"compare them with its GSD file"
        )
