"""Profiles of drives and of other devices: data for bus, configuration and simulation, and their options."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Final, Generic, NamedTuple, Self, TypeVar

from msgspec import Struct, structs

from dpstack.errors import ConfigError
from dpstack.profile.model.drive_type import CHECK_SETTINGS, DriveType, Options, TelegramSpec, config_number

if TYPE_CHECKING:
    from dpstack.dp.counter import Counter
    from dpstack.dp.slave_params import SlaveParams
    from dpstack.dpv1.master.plugin_queue import RecordQueue
    from dpstack.dpv1.slave.device import Device
    from dpstack.profile.master.core import DriveCore
    from dpstack.profile.master.device_core import DeviceCore
    from dpstack.profile.model.description import DeviceDescription
    from dpstack.profile.simulator.device import DriveDevice


class OptionSpec(Struct, frozen=True, kw_only=True):
    """An option: ``default`` fixes the type (bool, float, str); ``low``/``high`` or ``choices`` limit it."""

    #: default, which fixes the type (bool, float, str)
    default: bool | float | str
    #: meaning for people
    text: str
    #: lowest value; None without a limit
    low: float | None = None
    #: highest value; None without a limit
    high: float | None = None
    #: values that are allowed; empty: all
    choices: tuple[str, ...] = ()


#: the option of every simulated drive that sets it up for the bus
READY: Final = "ready"
#: options of every drive's plugin beside its own
_OPTIONS: Final = {
    CHECK_SETTINGS: OptionSpec(
        default=True, text="read the settings that the plugin relies on and compare them with its options"
    )
}
#: and of every simulated drive
_DEVICE_OPTIONS: Final = {
    READY: OptionSpec(default=False, text="set up for the bus and wired to run; false: as delivered, nothing wired")
}


class RateSetting(NamedTuple):
    """Baud rate of a drive that cannot detect it: the ``option`` with its setting, ``rates`` in bit/s by value."""

    #: name of the option that holds the setting
    option: str
    #: baud rate in bit/s by value of the setting
    rates: Mapping[int, int]


class TelegramSetting(NamedTuple):
    """The setting of a drive that chooses its telegram, where it does not follow its master."""

    #: number or name of the parameter
    parameter: str
    #: value of the parameter by name of the telegram
    values: Mapping[str, int]
    #: how a changed value gets into force
    acts: str = "power off and on"


class UnitPlace(NamedTuple):
    """The record that holds the unit of the named values ``names``: ``slot``, its index ``record``, its ``octets``, and
    the first octet ``at`` of the code of the unit (Unsigned16). ``revision``: index of the counter of changes,
    Unsigned16."""

    names: tuple[str, ...]
    slot: int
    record: int
    octets: int
    at: int
    revision: int
    #: index of the text of a unit that has no code; None without one
    text: int | None = None


CoreFactory = Callable[["DriveProfile", str, TelegramSpec, Options], "DriveCore"]
DeviceFactory = Callable[["DriveProfile", TelegramSpec, Options, Mapping[str, object]], "DriveDevice"]
#: see :attr:`Profile.settle`
Settle = Callable[
    ["DeviceProfile", str, Mapping[str, object], bytes, Mapping[str, int]],
    tuple["DeviceProfile", dict[str, object], tuple[str, ...]],
]
#: the master's end, and the simulated device
CoreT = TypeVar("CoreT", bound="DriveCore | DeviceCore")
DeviceT = TypeVar("DeviceT", bound="Device")


@dataclass(frozen=True, slots=True, kw_only=True, init=False, repr=False, eq=False)  # those of its two subclasses count
class Profile(DriveType, Generic[CoreT, DeviceT]):
    """The common part of a drive's profile (:class:`DriveProfile`) and that of another device.

    ``on_loss``: what the drive does when its master stops. ``notes``: what a user should know. ``simulated_options``:
    options of the core that no manual gives, as the simulated drive has them. ``ready``: parameters of the simulated
    drive that differ from delivery if it is set up for the bus (option :data:`READY`); ``gsd``: a GSD file of ours made
    from the manual's facts (not the vendor's), as ``package:file name`` or as an absolute path.
    """

    #: maker and type for people
    title: str
    on_loss: str
    #: makes the end of a master: of the profile, the name in the configuration, telegram, checked options
    core_factory: Callable[[Any, str, TelegramSpec, Options], CoreT]
    #: makes the simulated device: of the profile, telegram, checked options, and further presets; None: it has none
    device_factory: Callable[[Any, TelegramSpec, Options, Mapping[str, object]], DeviceT] | None = None
    #: options beside those of the profile: of the core, and of the simulated device
    _common_options: ClassVar[Mapping[str, OptionSpec]] = {}
    _common_device_options: ClassVar[Mapping[str, OptionSpec]] = {}
    #: no manual gives the ident number
    ident_made_up: bool = False
    #: baud rates in bit/s; empty if the manual gives none
    baud_rates: tuple[int, ...] = ()
    #: max T_SDR in bit times by baud rate; empty if the manual gives none
    max_tsdr: Mapping[int, int] = field(default_factory=dict)
    #: shortest time between two polls, in ns
    min_slave_interval_ns: int = 0
    #: options of ``[slave.options]`` by name
    core_options: Mapping[str, OptionSpec] = field(default_factory=dict)
    #: options of the simulated drive by name
    device_options: Mapping[str, OptionSpec] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    simulated_options: Mapping[str, object] = field(default_factory=dict)
    ready: Mapping[str, object] = field(default_factory=dict)
    #: parameters of ``ready`` that a plant without that option leaves as delivered
    left_open: Mapping[str, object] = field(default_factory=dict)
    gsd: str | None = None
    #: the setting of the rate, for a drive that works only at the rate it is set to; None: it detects the rate
    rate_setting: RateSetting | None = None
    #: the setting of the telegram, for a drive that does not follow its master; None: it does
    telegram_setting: TelegramSetting | None = None
    #: a function, or ``module:function`` that is loaded for a sheet only: gets core, description, station address and
    #: options of the core; returns the description with the facts of the manual. None: it is what core and profile have
    details: Callable[..., DeviceDescription] | str | None = None
    #: path of its device file; "" for a plugin
    file: str = ""
    #: SHA-256 of that file, hex
    digest: str = ""
    #: the maker's GSD file that comes with the device file
    gsd_file: str | None = None
    #: the modules of a telegram in the GSD file, by its name
    modules: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    #: the named values of inputs and outputs in a telegram, as a plant file writes them; None: it has none
    fields: Callable[[str], tuple[dict[str, object], dict[str, object]]] | None = None
    #: raises ValueError for a value that a free word of the outputs cannot have; None: it has no such words
    check_word: Callable[[str, object], None] | None = None

    def rates(self, options: Mapping[str, object]) -> tuple[int, ...]:
        """The baud rates of the drive with these checked options in bit/s; empty: the manual gives none."""
        setting = self.rate_setting
        if setting is None:
            return self.baud_rates
        value = options.get(setting.option, self.core_options[setting.option].default)
        assert isinstance(value, (int, float))
        return (setting.rates[int(value)],)

    def described(self, telegram: TelegramSpec, params: SlaveParams, baud_rates: tuple[int, ...]) -> Self:
        """The drive with ``telegram`` by default, as a GSD file describes it; what that says is not made up.

        ``params.ident`` None: the file has none.
        """
        others = {name: spec for name, spec in self.telegrams.items() if name != telegram.name}
        return replace(
            self,
            ident=self.ident if params.ident is None else params.ident,
            ident_made_up=self.ident_made_up and params.ident is None,
            telegrams={telegram.name: structs.replace(telegram, config=params.config, made_up=False)} | others,
            default_telegram=telegram.name,
            user_prm=params.user_prm,
            baud_rates=baud_rates,
            max_tsdr=params.max_tsdr,
            min_slave_interval_ns=params.min_slave_interval_ns,
            fail_safe=params.fail_safe,
        )

    def core(
        self,
        name: str,
        telegram: str | None = None,
        options: Mapping[str, object] | None = None,
        *,
        simulated: bool = False,
        records: RecordQueue | None = None,
        record_object: int | None = None,
    ) -> CoreT:
        """The master's end for the device called ``name`` in the configuration. Raises ConfigError.

        ``simulated``: the other end is the simulated drive, so what is made up for it counts if nothing is given.
        ``records``: the master carries out Read and Write of this slave, so parameters go over record 47 if the
        drive has it, and over the parameter channel of its telegram if not. ``record_object``: the drive object there,
        None: that of the profile.
        """
        where = f"drive {name} ({self.name})"
        checked = self.checked_options({**(self.simulated_options if simulated else {}), **(options or {})}, where)
        core = self.core_factory(self, name, self.telegram(telegram), checked)
        if records is not None:
            self._give_records(core, records, record_object)
        return core

    def _give_records(self, core: CoreT, records: RecordQueue, record_object: int | None) -> None:
        """The master carries out Read and Write for ``core``."""

    def checked_options(self, options: Mapping[str, object], where: str = "") -> Options:
        """The options of the core with their values or defaults. ``where``: its name in messages. Raises
        ConfigError."""
        where = where or self.name
        specs = {**self.core_options, **self._common_options}
        checked, extra = _checked(specs, options, where)
        for unknown in extra:
            import difflib  # here, as most names are right

            near = difflib.get_close_matches(unknown, specs, n=1)
            hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(specs) or 'none'}"
            raise ConfigError(f"{where}: there is no option {unknown!r}; {hint}")
        return checked

    def device(self, telegram: str | None = None, options: Mapping[str, object] | None = None) -> DeviceT:
        """A simulated drive, as delivered. Options: those declared, :data:`READY`, and parameters by number or name
        with their value.

        Raises ConfigError, also if the plugin has no simulated drive.
        """
        if self.device_factory is None:
            raise ConfigError(f"{self.name} has no simulated drive: use the drive itself, on a port of this computer")
        specs = {**self.device_options, **self._common_device_options}
        checked, extra = _checked(specs, options or {}, f"simulated {self.name}")
        if checked.get(READY):
            extra = {**self.ready, **extra}
        return self.device_factory(self, self.telegram(telegram), checked, extra)

    def simulated(
        self, telegram: str | None, options: Mapping[str, object], simulated: Mapping[str, object]
    ) -> DeviceT:
        """The simulated drive of a plant: ready but for ``left_open``, unless ``simulated`` has :data:`READY`.

        ``options``: those of the core. Raises ConfigError.
        """
        own = {READY: True, **self.left_open} if READY in self._common_device_options and READY not in simulated else {}
        return self.device(telegram, {**own, **self.shared(options), **simulated})

    def shared(self, options: Mapping[str, object]) -> dict[str, object]:
        """The options of the core that the simulated drive has too."""
        return {name: value for name, value in options.items() if name in self.device_options}


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveProfile(Profile["DriveCore", "DriveDevice"]):
    """A drive: found by the entry point group ``dpstack.drives`` under ``name``, or made of a device file."""

    #: makes the :class:`DriveCore` of a master
    core_factory: CoreFactory
    #: makes the :class:`DriveDevice` of a simulation; None: the plugin has no simulated drive
    device_factory: DeviceFactory | None = None
    _common_options: ClassVar[Mapping[str, OptionSpec]] = _OPTIONS
    _common_device_options: ClassVar[Mapping[str, OptionSpec]] = _DEVICE_OPTIONS

    def describe(
        self, address: int, telegram: str | None = None, options: Mapping[str, object] | None = None
    ) -> DeviceDescription:
        """The drive at the station ``address`` with telegram and options, for the commissioning sheet.

        Raises ConfigError.
        """
        from pkgutil import resolve_name  # these here, as only a sheet needs them

        from dpstack.profile.core_description import describe_core

        checked = self.checked_options(options or {})
        core = self.core_factory(self, self.name, self.telegram(telegram), checked)
        basic = structs.replace(
            describe_core(core, address, self.title, self.telegrams),
            ident=None if self.ident_made_up else self.ident,
            rates=self.baud_rates,
            notes=self.notes,
            on_loss=self.on_loss,
        )
        if self.details is None:
            return basic
        try:
            details = resolve_name(self.details) if isinstance(self.details, str) else self.details
            described: DeviceDescription = details(core, basic, address, checked)
        except Exception as error:
            why = f"{type(error).__name__}: {error}"
            remedy = self.details if isinstance(self.details, str) else self.file
            raise ConfigError(f"drive {self.name} cannot be described: {why}; repair {remedy}") from error
        return described

    def _give_records(self, core: DriveCore, records: RecordQueue, record_object: int | None) -> None:
        """Parameters go over record 47 if the drive has it."""
        if record_object is not None:
            core.record_object = record_object
        acyclic = core.over_records(records)
        if acyclic is not None:
            core.records, acyclic.notice = records, core.notice
            acyclic.cyclic, core.access = core.access, acyclic


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceProfile(Profile["DeviceCore", "Device"]):
    """A device that is no drive, with values and orders."""

    #: named values of counters, with the counts of a turn if they are an angle
    counters: Mapping[str, tuple[Counter, float]] = field(default_factory=dict)
    #: completes a device whose values depend on its user parameters: called with the profile, the name of the telegram,
    #: the given options, the octets and the values by name; returns the profile, its options and remarks
    settle: Settle | None = None
    #: texts by bit of a device related diagnosis, from 0 behind its header: alarms, which make all values bad, and
    #: warnings, which make them uncertain
    alarms: Mapping[int, str] = field(default_factory=dict)
    warnings: Mapping[int, str] = field(default_factory=dict)
    #: of a PROFIBUS PA device: the maker's parameters, see :class:`dpstack.pa.parameters.MakersParameter`
    pa_parameters: Sequence[Any] = ()
    #: makes the telegram of modules by name, one for each slot, for a device without GSD file; raises ConfigError.
    #: None: modules are those of its GSD file
    plug: Callable[[Sequence[int | str]], TelegramSpec] | None = None
    #: names and identifier octets of the modules of a telegram in the slots; None: those of its GSD file. A device with
    #: them sends status messages in its diagnosis
    slots: Callable[[str], tuple[tuple[str, bytes], ...]] | None = None
    #: of a PROFIBUS PA device: texts of the bits of DIAGNOSIS_EXTENSION by their numbers from 1
    pa_extension: Mapping[int, str] = field(default_factory=dict)
    #: names of telegrams by the ident number that means them, if the plant file has this number and no modules
    by_ident: Mapping[int, str] = field(default_factory=dict)
    #: why the plant file gives no safe outputs; empty: it may
    fixed_safe: str = ""
    #: the records with the units of its named values, by the name of its telegram and its options; None: it has none
    units: Callable[[str, Mapping[str, object]], tuple[UnitPlace, ...]] | None = None


def _checked(
    specs: Mapping[str, OptionSpec], given: Mapping[str, object], where: str
) -> tuple[dict[str, bool | float | str], dict[str, object]]:
    """The declared options with their values or defaults, and all others. Raises ConfigError."""
    known = {
        name: _check(spec, name, given[name], where) if name in given else spec.default for name, spec in specs.items()
    }
    return known, {name: value for name, value in given.items() if name not in specs}


def _check(spec: OptionSpec, name: str, value: object, where: str) -> bool | float | str:
    """``value`` in the type of the option's default. Raises ConfigError."""
    default = spec.default
    if isinstance(default, bool):
        if isinstance(value, bool):
            return value
        raise ConfigError(f"{where}: {name} must be true or false, not {value!r}")
    if isinstance(default, str):
        if isinstance(value, str) and (not spec.choices or value in spec.choices):
            return value
        raise ConfigError(f"{where}: {name} must be {' or '.join(map(repr, spec.choices)) or 'text'}, not {value!r}")
    number = config_number(f"{where}: {name}", value)
    if (spec.low is not None and not number >= spec.low) or (spec.high is not None and not number <= spec.high):
        low, high = ("" if limit is None else f"{limit:g}" for limit in (spec.low, spec.high))
        raise ConfigError(f"{where}: {name} = {number:g} is outside {low}..{high}")
    return float(number)
