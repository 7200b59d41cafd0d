"""The master's end of an IMO HD2."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from msgspec import structs

from dpstack.devices.drive_core import DeclaredMapCore
from dpstack.devices.model import DeviceFile
from dpstack.profile import (
    FAULTED,
    MAP_OPS,
    NS_PER_S,
    OTHER_MANUAL,
    Args,
    CommandError,
    ConfigError,
    ControlTable,
    DriveProfile,
    Goal,
    ListedParam,
    Options,
    ParamKey,
    Setting,
    Steps,
    TelegramSpec,
    equal,
    listing,
    process_data_map,
    same,
    settled,
)
from dpstack_drives.imo import table as t
from dpstack_drives.imo.channel import ImoAccess, address_of

FieldMap = process_data_map.FieldMap
#: two rotations for each of 22 parameters, at 9.6 kbit/s with other slaves
_LEARN_NS: Final = 60 * NS_PER_S
_TIMEOUT_S: Final = 10.0
_INCHES: Final = {"forward": t.Command.INCH_FORWARD, "reverse": t.Command.INCH_REVERSE, "stop": t.Command.INCH_STOP}
_SOURCES: Final = {
    t.Source.KEYPAD: "its keypad",
    t.Source.TERMINALS: "its terminals",
    t.Source.RESERVED: "a source that is reserved",
}


class ImoCore(DeclaredMapCore[FieldMap]):
    """Speed by the frequency in whichever PZD carries it; the drive is asked for its maps when data exchange begins.

    Options: ``reference_hz`` (what 100 % is), ``max_hz`` (the inverter's maximum frequency; 0: ``reference_hz``),
    ``reference_rpm`` and ``rated_current`` (0: not known), ``motor`` 1 or 2, ``heartbeat`` (CW bit 15 set, its echo
    watched), ``map_inputs`` and ``map_outputs``: the maps that ``write_map`` writes if none is given, and
    ``start()`` with ``set_map``; ``fault_names`` (``4=OC1 ...``), ``baud_index``;
    ``frequency_source`` and ``maximum_parameter``: parameters of the inverter whose settings the plugin relies on
    (readings: they are not in the card's manual).

    Jobs of its own: those of a :class:`MappedCore`, ``inch`` (``direction`` forward, reverse or stop),
    ``pre_excite``, ``control`` (``number`` a name of CW bits 11 to 14, ``value`` 0 or 1).
    """

    inputs_at = outputs_at = 1  # behind SW and CW
    own_ops = (*MAP_OPS, "inch", "pre_excite", "control")

    def __init__(
        self, file: DeviceFile, profile: DriveProfile, name: str, telegram: TelegramSpec, options: Options
    ) -> None:
        super().__init__(file, profile, name, telegram, options)
        self._words = self.table
        self._max_given = bool(options["max_hz"])
        self._max_hz = float(options["max_hz"] or options["reference_hz"])
        inputs, outputs = self.map_fields
        limited = {
            code: structs.replace(one, high=self._max_hz) if one.limit else one for code, one in outputs.fields.items()
        }
        self.map_fields = (inputs, structs.replace(outputs, fields=limited))
        self._set_frequency = limited[t.SET_FREQUENCY]
        try:
            t.check_rate(float(options["baud_index"]))
            self._fault_names = t.faults(str(options["fault_names"]))
            self._frequency_source = t.source(str(options["frequency_source"]))
            self._maximum = t.parameter(str(options["maximum_parameter"]), "maximum_parameter")
        except ValueError as error:
            raise ConfigError(f"{self.title}: {error}") from None
        self._wanted_maps = self.maps_of_options(options)
        self._reference_rpm = float(options["reference_rpm"])
        self._rated_current = float(options["rated_current"])
        self._set_map = bool(options["set_map"])
        self._heartbeat = bool(options["heartbeat"])
        self._fixed = self.table.control.mask(
            *(["heartbeat"] if self._heartbeat else []), *(["motor_2"] if options["motor"] == "2" else [])
        )
        self._chosen = 0
        self._learning = False
        self._online_at = 0
        self._source_seen: t.Source | None = None
        self._maps_now: tuple[FieldMap, FieldMap] | None = None
        #: as the drive has them; None until they were read
        self.inputs_map: FieldMap | None = None
        self.outputs_map: FieldMap | None = None

    def words_and_states(self) -> ControlTable:
        return t.control_table(self.file.table)

    def open_channel(self) -> ImoAccess:
        self._channel = ImoAccess(self.file.channel.of_pkw, self.file.parameters, self, self.notice)
        return self._channel

    # -- process data ---------------------------------------------------------------------------------------------

    def received(self) -> None:
        """At the beginning the drive is asked what stands in its process data.

        A command to inch ends if it cannot be obeyed: it must not come true later by surprise.
        """
        if self.raw_state in FAULTED or self.obstacle() is not None:
            self.table = self._words
        if self._source_seen not in (None, source := self._source()):
            self.settings_check.changed()
        self._source_seen = source
        if self.inputs_map is None and not self._learning and not self._online_at:
            self._online_at = self.now
            self._learning = True
            self.spawn("map", self._first_learn())

    def lost(self, now: int) -> None:
        """The maps may be others when it returns; bits and values of the user's do not come back by themselves."""
        self._chosen = 0
        super().lost(now)
        self.inputs_map = self.outputs_map = None
        self.dirty = True
        self._learning = False
        self._online_at = 0
        self._source_seen = None

    def set_goal(self, goal: Goal) -> None:
        """Any order that moves the drive ends inching and pre-excitation."""
        self.table = self._words
        super().set_goal(goal)

    def encode(self, control: int, setpoint: int) -> bytes:
        """CW with the direction, and with bit 8 while a parameter is written; then PZD2 to PZD12."""
        if control & t.CODE == t.Command.FORWARD and self.setpoint < 0:
            control += t.Command.REVERSE - t.Command.FORWARD
        if self._channel.writing:
            control |= self.table.control.mask("enable_writing")
        outputs = self.outputs_map
        words = (
            (*self.rest, 0)
            if outputs is None
            else process_data_map.pack(outputs.fields, {**self.values, t.SET_FREQUENCY: setpoint}, len(self.rest) + 1)
        )
        return self.pack(control, *words)

    def decode(self, process: bytes) -> tuple[int | None, float | None]:
        """CW, and the set frequency if the map of the options has it; the direction is in CW."""
        control, _ = super().decode(process)
        at = None if self.outputs_map is None else self.outputs_map.place(t.SET_FREQUENCY)
        if control is None or at is None or len(process) < 2 * at + 4:
            return control, None
        raw = int.from_bytes(process[2 * at + 2 : 2 * at + 4], "big")
        setpoint = self._set_frequency.decode(raw) / self.reference_hz
        return control, -setpoint if control & t.CODE == t.Command.REVERSE else setpoint

    def setpoint_word(self, fraction: float) -> int:
        """The set frequency in 0.01 Hz; the direction is in CW."""
        try:
            return self._set_frequency.encode(abs(fraction) * self.reference_hz)
        except ValueError as error:
            raise ValueError(f"speed {fraction:g}: {error}") from None

    def control_bits(self) -> int:
        """Motor and heartbeat of the options, what the order ``control`` has set."""
        return self._fixed | self._chosen

    def measured(self) -> tuple[float | None, float | None, float | None]:
        """Frequency (or rpm), current and torque if they are in the map; the sign is that of SW."""
        fields = () if self.inputs_map is None else self.inputs_map.fields
        values = process_data_map.decoded(fields, self.words[1:])
        speed: float | None = None
        if (hertz := values.get("frequency")) is not None:
            speed = hertz / self.reference_hz
        elif self._reference_rpm and (rpm := values.get("rpm")) is not None:
            speed = rpm / self._reference_rpm
        if speed and self.status_word & t.CODE == t.Running.REVERSE:
            speed = -speed
        current, torque = values.get("current"), values.get("torque")
        return (
            speed,
            current / self._rated_current if current is not None and self._rated_current else None,
            None if torque is None else torque / 100,
        )

    def fault_texts(self) -> tuple[str, ...] | None:
        """By the fault code if it is in the map; its names are in the inverter's manual."""
        at = None if self.inputs_map is None else self.inputs_map.place(t.FAULT_CODE)
        if at is not None:
            code = self.words[1 + at]
            name = self._fault_names.get(code)
            return (f"{name} (code {code})" if name else f"code {code}",)
        if self._learning:
            return None
        return ("without a name: no transmitted PZD (P15.13 to P15.23) is 11, fault_code; the keypad shows it",)

    def warnings(self) -> tuple[str, ...]:
        """SW bit 12, and a heartbeat that is not echoed (an echo is a reading)."""
        found = ["overload pre-alarm"] if self.table.status.is_set(self.status_word, "overload") else []
        late = self.now >= self._online_at + self.settle_ns
        if self._heartbeat and late and not self.table.status.is_set(self.status_word, "heartbeat"):
            found.append("heartbeat not echoed (SW bit 15)")
        return tuple(found)

    # -- what keeps it from running -------------------------------------------------------------------------------

    def place_of(self, key: ParamKey) -> tuple[int, int]:
        return address_of(key), 0

    def may_turn(self) -> str | None:
        """Inching and pre-excitation are no run."""
        if self.table is not self._words or self.status_word & t.CODE == t.Running.PRE_EXCITED:
            return "it inches, or is pre-excited"
        return super().may_turn()

    def cannot(self, op: str) -> str | None:
        """Quick stop: the drive has no ramp of its own for an emergency."""
        if op == "quick_stop":
            return "imo-hd2 has no quick stop ramp: its emergency stop (6) coasts; use stop() or coast()"
        return None

    def parameters(self) -> tuple[ListedParam, ...]:
        """The parameters in the manual of the card."""
        return listing(self.file.parameters, known=lambda spec: not spec.made_up)

    def obstacle(self) -> str | None:
        """SW bits 13-14, then the voltage."""
        if (why := self._other_source()) is not None:
            return why
        if self.status_word & t.CODE == t.Running.POFF:
            return "the drive reports POFF: its mains are off"
        if not self.table.status.is_set(self.status_word, "bus_voltage"):
            return "SW bit 8 is 0: the bus voltage is not established, not ready to run; see to the mains"
        return None

    def refused_in_clear(self) -> str | None:
        return self.obstacle()

    def _other_source(self) -> str | None:
        source = self._source()
        if source is t.Source.COMMUNICATION:
            return None
        return (
            f"SW bits 13-14 are {int(source)}: {_SOURCES[source]} commands the drive, not the bus; set the run "
            "command channel to communication (2), a parameter of the inverter's manual"
        )

    def _source(self) -> t.Source:
        return t.Source(self.status_word >> t.SOURCE_SHIFT & 3)

    def _other_map(self) -> str | None:
        now = self._maps_now
        if now is None or self.are_maps(now, self.inputs_map, self.outputs_map):
            return None
        return (
            f"the map was changed at the drive: it has inputs '{now[0]}' and outputs '{now[1]}' now, not "
            f"'{self.inputs_map}' and '{self.outputs_map}': order read_map to use it, or write_map"
        )

    def _no_frequency(self) -> str | None:
        if self._frequency_at() is not None:
            return None
        return (
            "no received PZD carries the set frequency: of P15.02 to P15.12 none is 1; set P15.02 to 1, by "
            "write_map(outputs='set_frequency') or the option set_map = true"
        )

    def prepare(self, deadline: int) -> Steps[None]:
        """A start needs commands from the bus, the bus voltage, and a PZD with the set frequency."""
        yield from settled(self, lambda: self.obstacle() is None, deadline)
        if (why := self.obstacle()) is not None:
            raise CommandError("fault", why)
        yield from self.known(deadline)
        if self._frequency_at() is None and self._set_map:
            yield from self.change_maps(*self._wanted_maps, dict(self.plant.values), deadline)
        if (why := self._no_frequency()) is not None:
            raise CommandError("fault", why)
        yield from super().prepare(deadline)

    def _frequency_at(self) -> int | None:
        return None if self.outputs_map is None else self.outputs_map.place(t.SET_FREQUENCY)

    # -- the settings that the plugin relies on -----------------------------------------------------------------------

    def before_settings(self, deadline: int) -> Steps[None]:
        """Wait for the maps of the drive, or read them again: a keypad may have changed them."""
        self._maps_now = None
        learns = self._learning
        while self._learning:
            yield
        if not learns and self.inputs_map is not None:
            self._maps_now = yield from self.read_maps(self.now + _LEARN_NS)

    def settings(self) -> Sequence[Setting]:
        """Source of the commands, which stands in SW; set frequency in the maps, which are learned; source and limit
        of the set frequency."""
        found = [
            Setting(
                wanted="SW bits 13-14 = 2",
                keys=(),
                differs=lambda _: self._other_source(),
                why="the drive obeys CW only while communication is the source of the run command; the parameter is in "
                "the inverter's manual",
                source="table 2-7",
            ),
            Setting(
                wanted="P15.02 to P15.23 as they were learned",
                keys=(),
                differs=lambda _: self._other_map(),
                why="the plugin reads the map when data exchange begins; a change at the keypad afterwards would give "
                "the words another meaning",
                source="tables 2-6, 2-8",
            ),
        ]
        if not self._set_map:
            found.append(
                Setting(
                    wanted="a set frequency in P15.02 to P15.12",
                    keys=(),
                    differs=lambda _: self._no_frequency(),
                    why="one of them must be 1 (set frequency), otherwise no speed reaches the drive; all are 0 as "
                    "delivered. `write_map` or the option set_map = true writes them",
                    source="table 2-6",
                )
            )
        if self._frequency_source is not None:
            number, value = self._frequency_source
            name = t.name_of(number)
            remedy = (
                f"the set frequency does not come from PROFIBUS; set {name} = {value}, or the option frequency_source "
                "to what the inverter's manual has"
            )
            why = "the set frequency has to come from PROFIBUS"
            found.append(equal(name, value, remedy, why=why, source=OTHER_MANUAL))
        if self._maximum is not None:
            found.append(
                Setting(
                    wanted=f"{t.name_of(self._maximum)} = {self._max_hz:g} Hz",
                    keys=(ParamKey(self._maximum),),
                    differs=self._other_maximum,
                    refuse=False,
                    why="the inverter limits set points to its maximum frequency",
                    source=OTHER_MANUAL,
                )
            )
        return found

    def _other_maximum(self, values: Sequence[float]) -> str | None:
        hertz = values[0] / t.PER_HZ
        if same(hertz, self._max_hz) or (not self._max_given and hertz > self._max_hz):
            return None
        name = t.name_of(self._maximum or 0)
        return (
            f"{name} (maximum frequency) is {hertz:g} Hz, not {self._max_hz:g} Hz: set points are limited there; set "
            f"{name} = {self._max_hz:g} or the option max_hz = {hertz:g}"
        )

    # -- maps -----------------------------------------------------------------------------------------------------

    def _first_learn(self) -> Steps[dict[str, object]]:
        try:
            yield from self._learn_maps(self.now + _LEARN_NS)
        finally:
            self._learning = False
        return {}

    def known(self, deadline: int) -> Steps[None]:
        """Wait for the maps, ask again if that failed."""
        while self._learning:
            if self.now >= deadline:
                raise CommandError("timeout", "the drive's process data map (P15.02 to P15.23) has not been read yet")
            yield
        if self.inputs_map is None or self.outputs_map is None:
            yield from self._learn_maps(deadline)

    def _learn_maps(self, deadline: int) -> Steps[None]:
        self.inputs_map, self.outputs_map = yield from self.read_maps(deadline)
        self._maps_now = None
        self.dirty = True
        self.update()

    def maps_unknown(self) -> None:
        """They are asked for before the next start."""
        self.inputs_map = None

    def read_map(self, deadline: int) -> Steps[dict[str, object]]:
        """P15.02 to P15.23."""
        if self._learning:
            yield from self.known(deadline)
        else:
            yield from self._learn_maps(deadline)
            self.settings_check.changed()
        return {"value": {"inputs": str(self.inputs_map), "outputs": str(self.outputs_map)}}

    def present_maps(self) -> tuple[FieldMap, FieldMap]:
        """Those of the options."""
        return self._wanted_maps

    def written_by(self, key: int) -> str | None:
        return "speed and frequency" if key == t.SET_FREQUENCY else None

    # -- orders of its own ----------------------------------------------------------------------------------------

    def order(self, op: str, args: Args) -> Steps[dict[str, object]] | None:
        if op in MAP_OPS:
            return super().order(op, args)
        deadline = self.now + args.timeout_ns(_TIMEOUT_S)
        match op:
            case "inch":
                wanted = args.text("direction") or ""
                if wanted not in _INCHES:
                    raise CommandError("usage", f"inch: direction must be {', '.join(_INCHES)}, not {wanted!r}")
                return self._special(_INCHES[wanted], deadline)
            case "pre_excite":
                return self._special(t.Command.PRE_EXCITE, deadline)
            case "control":
                return self._set_bit(str(args.name_or_number("number")), args.number("value"))
            case _:
                return None

    def _special(self, command: t.Command, deadline: int) -> Steps[dict[str, object]]:
        """A command that lasts until another one: not a run, so it ends with the goal it began in."""
        yield from settled(self, lambda: self.obstacle() is None, deadline)
        if (why := self.obstacle()) is not None:
            raise CommandError("fault", why)
        if (why := self.refuses_setpoint()) is not None:
            raise CommandError("fault", why)
        if self.goal is Goal.RUN:
            raise CommandError("usage", f"{command.name.lower()}: the drive is running; stop() it first")
        self.set_goal(Goal.IDLE)
        self.table = t.control_table(self.file.table, command)
        self.update()
        return {"value": command.name.lower()}

    def _set_bit(self, name: str, value: float) -> Steps[dict[str, object]]:
        yield from ()
        if name not in t.SETTABLE or value not in (0, 1):
            raise CommandError("usage", f"control: number must be {', '.join(t.SETTABLE)} and value 0 or 1")
        mask = self.table.control.mask(name)
        self._chosen = self._chosen | mask if value else self._chosen & ~mask
        self.update()
        return {"value": int(value)}
