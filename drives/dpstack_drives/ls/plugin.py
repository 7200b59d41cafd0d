"""The master's end of an LS LSLV-S100."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final

from dpstack.devices.drive_core import DeclaredMapCore
from dpstack.devices.model import DeviceFile
from dpstack.profile import (
    FAULTED,
    NS_PER_S,
    OTHER_MANUAL,
    CommandError,
    ConfigError,
    ControlTable,
    DriveProfile,
    Goal,
    ListedParam,
    Lookup,
    Options,
    ParamKey,
    ParamRef,
    Scale,
    Setting,
    State,
    Steps,
    TelegramSpec,
    equal,
    process_data_map,
    record47,
    settled,
)
from dpstack_drives.ls import paramap, records, references, telegrams
from dpstack_drives.ls import table as t

#: OFF1 (ramp down) with bit 10 set: zeros would be ignored and leave the drive running
_SAFE: Final = 0x047E
#: of the reference: below it the output frequency counts as 0
_STILL: Final = 0.005
#: for one element of a lookup: record 47 takes four rotations, 1.4 s at 9.6 kbit/s beside four drives
_ANSWER_NS: Final = 5 * NS_PER_S
FieldMap = process_data_map.FieldMap
_SOURCE: Final = "set dr-06 (command source) to 4, field bus, and see that the keypad is not in local mode"


def profile_of(telegram: TelegramSpec, wanted: str) -> int:
    """COM-11 of a telegram: 0 with 100, 1 with 1, the user's with 101 to 106
    (docs/reference/drives/ls-s100.md#profiles). Raises ConfigError."""
    number = telegrams.number_of(telegram)
    if number == telegrams.VENDOR:
        return t.IO
    if wanted == "ls" and telegram.name == "ST1":
        raise ConfigError("ST1 is a telegram of PROFIdrive: the LS Drive profile needs PPO1 to PPO6")
    return t.LS_DRIVE if wanted == "ls" else t.PROFIDRIVE


class LsCore(DeclaredMapCore[FieldMap]):
    """PROFIdrive or LS Drive profile in PPO1 to PPO6, PROFIdrive in ST1, the drive's own words in VENDOR n/m.

    Options: ``profile`` (COM-11: ``profidrive`` or ``ls``); ``speed_unit`` (COM-14: ``percent`` of dr-20 or ``rpm``);
    ``reference_hz`` (dr-20) and ``reference_rpm``: what 100 % is; ``para_status``, ``para_control``: the addresses that
    COM-31.. and COM-51.. have; ``swap`` (COM-68); ``trip_word``: 000F holds the ``number`` of the trip, as in the
    simulated drive, or bits of the inverter's manual (``raw``).

    Jobs of its own: those of a :class:`MappedCore`.

    Readings: in VENDOR, 0006h and 000Eh have the bits of the LS Drive profile (they are in the inverter's manual); the
    frequencies of the LS Drive profile have no sign, the direction is in control and status word.
    """

    address_trigger = "COM-94"
    inputs_map: FieldMap
    outputs_map: FieldMap
    map_options = ("para_status", "para_control")
    outputs_name = "para_control"

    def __init__(
        self, file: DeviceFile, profile: DriveProfile, name: str, telegram: TelegramSpec, options: Options
    ) -> None:
        try:
            self._profile = profile_of(telegram, str(options["profile"]))
        except ConfigError as error:
            raise ConfigError(f"drive {name} ({profile.name}): {error}") from None
        self._io = self._profile == t.IO
        super().__init__(file, profile, name, telegram, options)
        self.map_fields = paramap.MAPS
        self._trip_number = options["trip_word"] == "number"
        self._rpm = options["speed_unit"] == "rpm"
        self.inputs_at = self.outputs_at = 0 if self._io else t.PARA_AT
        order = "<" if options["swap"] else ">"
        self.octet_order = "little" if options["swap"] else "big"
        self.unpack = struct.Struct(f"{order}{telegram.inputs // 2}H").unpack_from
        self._words_out = struct.Struct(f"{order}{telegram.outputs // 2}H")
        self.holds_outputs = self._io
        self.inputs_map, self.outputs_map = self.maps_of_options(options)
        self.refuse_zeros()
        self._trips = Lookup(lambda: self.raw_state in FAULTED, self._ask_trips)
        self._warning = Lookup(self._warned, self._ask_warning)
        if self._profile != t.PROFIDRIVE:
            self.scale = Scale("speed", full=1, span=0.01 / self.reference_hz)
        elif self._rpm:
            self.scale = Scale("speed", full=1, span=1 / float(options["reference_rpm"]))
        else:  # no parameter tells what 100 % is in rpm
            self.reference_rpm = 0.0
        safe = _SAFE if self._profile == t.PROFIDRIVE else self.table.word(Goal.IDLE, State.OFFLINE)
        self.safe_outputs = bytes(self.offset) + self.encode(safe, 0)
        if telegram.channel:
            self.lookups = (self._trips, self._warning)
        self._advise_maps()

    def words_and_states(self) -> ControlTable:
        """By the profile."""
        return t.PROFIDRIVE_TABLE if self._profile == t.PROFIDRIVE else t.ls_table(0 if self._io else t.AUTHORITY)

    def room(self, *, outputs: bool) -> int:
        """Words of the telegram that a map fills."""
        octets = self.telegram.outputs if outputs else self.telegram.inputs
        return min(max(octets // 2 - self.inputs_at, 0), telegrams.MOST)

    def option_map(self, text: str, *, outputs: bool) -> FieldMap:
        """As much of the drive's default map as the telegram takes if the option is empty."""
        if text.strip():
            return self.parse_map(text, outputs=outputs)
        return self.map_of(paramap.WAYS[outputs].default[: self.room(outputs=outputs)], outputs=outputs)

    def _advise_maps(self) -> None:
        for where in sorted({*self.inputs_map.codes, *self.outputs_map.codes} & t.ADVISED_AGAINST):
            self._advise(where)

    def _advise(self, where: int) -> None:
        if self._io:
            return
        self.notice(
            f"address {where:04X} is not to be used beside a drive profile (manual 5.1, 5.3): take it out of "
            "COM-31.. and COM-51.. (write_map) or leave it alone"
        )

    def over_records(self, queue: record47.RecordQueue) -> record47.AcyclicAccess:
        """Parameters over record 47 (docs/reference/drives/ls-s100.md#record-47); trips and warnings have names in
        every telegram then."""
        self.lookups = (self._trips, self._warning)
        client = record47.ParameterClient(records.SLOT, limits=records.LIMITS, references=record47.PLUGIN)
        return record47.AcyclicAccess(client, queue, self._placed, self)

    # -- process data ---------------------------------------------------------------------------------------------

    def status_of(self, process: bytes) -> int:
        """ZSW1 or the LS status word, or 000Eh if Para Status has it; with bit 16 while ACT is not 0."""
        if self._io:
            return self._mapped(t.RUN_STATUS) or 0
        word = self.words[0]
        if self._profile == t.PROFIDRIVE and abs(self.scale.decode(self.words[1])) > _STILL:
            word |= t.TURNING
        return word

    def _mapped(self, where: int) -> int | None:
        return process_data_map.raws(self.inputs_map.fields, self.words[self.inputs_at :]).get(where)

    def encode(self, control: int, setpoint: int) -> bytes:
        """The profile's two words and what the user gave for the mapped ones; VENDOR has only mapped ones."""
        control &= 0xFFFF  # bit 16 is our own
        mapped = self._words_out.size // 2 - self.outputs_at
        if self._io:
            front: tuple[int, ...] = ()
            values = {**self.values, t.OPERATION: control, t.FREQUENCY: setpoint}
        else:
            front = (control, setpoint)
            values = self.values
        return self._words_out.pack(*front, *process_data_map.pack(self.outputs_map.fields, values, mapped))

    def decode(self, process: bytes) -> tuple[int | None, float | None]:
        """The profile's two words, in VENDOR the mapped ones; the direction of the LS Drive profile is in its word."""
        if len(process) != self._words_out.size:
            return None, None
        words = self._words_out.unpack(process)
        if self._io:
            mapped = process_data_map.raws(self.outputs_map.fields, words)
            control, raw = mapped.get(t.OPERATION), mapped.get(t.FREQUENCY)
        else:
            control, raw = words[0], words[1]
        if self._profile == t.PROFIDRIVE:
            return control, None if raw is None else self.scale.decode(raw)
        setpoint = None if raw is None else raw * self.scale.span
        reverse = setpoint and control is not None and self.table.control.is_set(control, "reverse")
        return control, -setpoint if setpoint and reverse else setpoint

    def control_bits(self) -> int:
        """The direction of the LS Drive profile's run command."""
        if self._profile == t.PROFIDRIVE or self.goal is not Goal.RUN:
            return 0
        return t.LS_CONTROL.mask("reverse" if self.setpoint < 0 else "forward")

    def setpoint_word(self, fraction: float) -> int:
        """C000..4000 of dr-20, rpm, or 0.01 Hz without a sign."""
        if not abs(fraction) <= 1:
            raise ValueError(f"speed {fraction:g} is outside -1..1: 100 % is dr-20 (maximum frequency), 0.5 is 50 %")
        if self._io and t.FREQUENCY not in self.outputs_map.codes:
            raise ValueError("0005 (frequency command) is not in para_control (COM-51..)")
        if self._profile == t.PROFIDRIVE:
            return self.scale.encode(fraction)
        return round(abs(fraction) / self.scale.span)

    def measured(self) -> tuple[float | None, float | None, float | None]:
        """ACT, or 000Ah in VENDOR."""
        if self._profile == t.PROFIDRIVE:
            return self.scale.decode(self.words[1]), None, None
        raw = self._mapped(t.OUTPUT_FREQUENCY) if self._io else self.words[1]
        if raw is None:
            return None, None, None
        speed = raw * self.scale.span
        return -speed if self.table.status.is_set(self.status_word, "reverse") else speed, None, None

    def cannot(self, op: str) -> str | None:
        """Orders that the profile or the map has no bits for."""
        if op == "quick_stop" and self._profile != t.PROFIDRIVE:
            return "the LS control word has no quick stop: stop() ramps down, coast() takes the power off"
        if self._io and t.OPERATION not in self.outputs_map.codes:
            return f"{op}: 0006 (operation command) is not in para_control (COM-51..)"
        if self._io and t.RUN_STATUS not in self.inputs_map.codes:
            return f"{op}: 000E (operating status) is not in para_status (COM-31..)"
        return None

    # -- faults and what keeps it from running --------------------------------------------------------------------

    def _warned(self) -> bool:
        return self.online and self.table.status.is_set(self.status_word, "warning")

    def fault_texts(self) -> tuple[str, ...] | None:
        """The messages of the present situation by name."""
        if (trips := self._trips.value) is not None:
            return tuple(map(t.trip_text, trips)) or ("without a name: PNU 947 holds none",)
        if self.access is not None:
            return None
        word = self._mapped(t.TRIP)
        if word and self._trip_number:
            return (t.trip_text(word),)
        shown = f" (000F is {word:04X})" if word is not None else ""
        return (f"without a name{shown}: {self.telegram.name} has no parameter channel, the keypad shows it",)

    def warnings(self) -> tuple[str, ...]:
        """ZSW1 bit 7; its bits are in the inverter's manual."""
        if not self._warned():
            return ()
        word = self._warning.value
        return ("warning" if word is None else f"warning word {word:04X}",)

    def parameters(self) -> tuple[ListedParam, ...]:
        return references.LISTED

    def place_of(self, key: ParamKey) -> tuple[int, int]:
        ref, where = references.resolve(key, self.drive)
        return (ref.pnu, 0) if where is None else (where >> 8, where & 0xFF)

    def remote(self, word: int) -> bool | None:
        """ZSW1 bit 9 repeats one's own bit 10; the LS status word has who controls the drive."""
        return None if self._profile == t.PROFIDRIVE else not self.table.status.is_set(word, "keypad")

    def obstacle(self) -> str | None:
        """The source of commands that is not the bus."""
        if self._profile == t.PROFIDRIVE:
            if self.raw_state is State.SWITCH_ON_INHIBITED:
                return f"the drive stays in S1 (switching on inhibited) and does not obey STW1: {_SOURCE}"
            return None
        if self.table.status.is_set(self.status_word, "keypad"):
            return f"LS status bit 15: the keypad controls the drive: {_SOURCE}"
        if not self._io and not self.table.status.is_set(self.status_word, "run_granted"):
            return f"LS status bit 13: the run authority is not granted: {_SOURCE}"
        return None

    def prepare(self, deadline: int) -> Steps[None]:
        """If the drive does not obey, read which source has the control. Raises CommandError that names it."""
        yield from super().prepare(deadline)
        if self.goal is not Goal.RUN:
            return
        yield from settled(self, lambda: self.obstacle() is None, deadline)
        why = self.obstacle()
        if why is None:
            return
        if self.access is not None:
            source = yield from self._value(ParamKey("dr-06"), deadline)
            if source not in (None, t.FIELD_BUS["dr-06"]):
                raise CommandError("fault", f"dr-06 is {source}: {why}")
        if self._profile != t.PROFIDRIVE and self.table.status.is_set(self.status_word, "keypad"):
            raise CommandError("fault", why)
        # otherwise it may only be slow: the time-out says the same

    def settings(self) -> Sequence[Setting]:
        """Profile, scale and source of the set point, the order of octets, and the maps."""
        profidrive = self._profile == t.PROFIDRIVE
        per_cent = profidrive and not self._rpm
        hz = self.reference_hz
        wanted = t.PNU_930[self._profile]
        swap = int(self.octet_order == "little")
        found = [
            Setting(
                wanted=f"PNU 930 = {wanted:04X}h",
                keys=(ParamKey(t.PNU_PROFILE),),
                differs=lambda values: self._other_profile(int(values[0])),
                why=f"COM-11 = {self._profile} and COM-94 = 1: it fixes the meaning of the control and status words",
                source="4.2.11",
            ),
            equal(
                "dr-07",
                t.FIELD_BUS["dr-07"],
                "the frequency does not come from the field bus: set dr-07 = 8",
                why="8 takes the frequency from the field bus",
                source=OTHER_MANUAL,
            ),
            equal(
                "dr-20",
                hz,
                f"set dr-20 = {hz:g} or the option reference_hz = {{}}",
                unit="Hz",
                refuse=per_cent,  # otherwise a limit: set points are rpm or Hz
                why="100 % (4000h) is the maximum frequency" if per_cent else "set points are limited there",
                source="4.1",
            ),
            equal(
                "COM-68",
                swap,
                f"set COM-68 = {swap} and COM-94 = 1, or the option swap",
                why="1 swaps the octets of each word",
                source="4.2.9",
            ),
        ]
        if profidrive:
            unit = "rpm" if self._rpm else "percent"
            remedy = f"set COM-14 = {int(self._rpm)} and COM-94 = 1, or the option speed_unit (now {unit!r})"
            why = "it fixes the unit of set point and actual speed: 0 per cent of dr-20, 1 rpm"
            found.append(equal("COM-14", int(self._rpm), remedy, why=why, source="4.2.14"))
        why = "4 takes the run command from the field bus"
        found.append(equal("dr-06", t.FIELD_BUS["dr-06"], _SOURCE, why=why, source=OTHER_MANUAL))
        for option, own, room, count, refuse in (
            ("para_control", self.outputs_map, self.room(outputs=True), t.CONTROL_COUNT, True),
            ("para_status", self.inputs_map, self.room(outputs=False), t.STATUS_COUNT, self._io),
        ):
            if room:
                found.append(_mapped(option, own, room, count, refuse=refuse))
        return found

    def _other_profile(self, found: int) -> str | None:
        wanted = t.PNU_930[self._profile]
        if found == wanted:
            return None
        return (
            f"the drive has profile {found:04X} (PNU 930), the option profile says {wanted:04X}: set COM-11 to "
            f"{self._profile} and COM-94 to 1"
        )

    def _value(self, key: ParamKey, deadline: int) -> Steps[object]:
        """A parameter's value, None if the drive does not know it."""
        assert self.access is not None
        try:
            outcome = yield from self.access.read(key, deadline)
        except CommandError as error:
            if error.kind != "parameter":
                raise
            return None
        return outcome["value"]

    def _ask_trips(self, deadline: int) -> Steps[tuple[int, ...]]:
        found: list[int] = []
        for index in range(t.MESSAGES):
            number = yield from self._value(ParamKey(t.PNU_FAULTS, index=index), self.now + _ANSWER_NS)
            if not isinstance(number, int) or not number:
                break
            found.append(number)
        return tuple(found)

    def _ask_warning(self, deadline: int) -> Steps[int | None]:
        word = yield from self._value(ParamKey(t.PNU_WARNING), self.now + _ANSWER_NS)
        return word if isinstance(word, int) else None

    # -- parameters -----------------------------------------------------------------------------------------------

    def resolve(self, key: ParamKey) -> ParamRef:
        ref, where = references.resolve(key, self.drive)
        self._advised(where)
        return ref

    def _placed(self, key: ParamKey) -> record47.Place:
        """As :meth:`resolve`, for record 47."""
        ref, where = references.resolve(key, self.drive)
        self._advised(where)
        by_pnu = record47.Address(ref.pnu, ref.ind, 1 if ref.array else 0)
        address = by_pnu if where is None else record47.Address(where)
        return record47.Place(address, ref.spec, ref.label, ref.pnu, format=record47.UNSIGNED16)

    def _advised(self, where: int | None) -> None:
        if where in t.ADVISED_AGAINST:
            self._advise(where)

    # -- Para Status and Para Control -----------------------------------------------------------------------------

    def maps_changed(self) -> None:
        self._advise_maps()

    def read_by(self, field: process_data_map.MapField) -> ParamKey:
        return ParamKey(field.key)

    def called(self, name: str | int) -> str | int:
        """An address in any writing."""
        found = t.address(name) if isinstance(name, str) else name
        return name if found is None else found

    def written_by(self, key: int) -> str | None:
        """In VENDOR the two words of the drive."""
        return "start, stop and speed" if self._io and key in (t.FREQUENCY, t.OPERATION) else None


def _mapped(option: str, own: FieldMap, room: int, count: int, *, refuse: bool) -> Setting:
    """COM-31.. or COM-51.. are those of the option, as far as the telegram has words for them.

    ``count``: the address of their number; theirs follow it.
    """
    keys = tuple(ParamKey(count + place) for place in range(room + 1))

    def differs(values: Sequence[float]) -> str | None:
        number, *entries = (int(value) for value in values)
        found = paramap.STATUS.of(entries[:number])
        if process_data_map.used(found.codes) == process_data_map.used(own.codes):
            return None
        first = t.code_of(count + 1)
        return (
            f"{first}.. are {str(found) or 'empty'}, the option {option} says {str(own) or 'none'}: set {option} = "
            f"'{found}' or the codes (write_map)"
        )

    return Setting(
        wanted=f"{t.code_of(count + 1)}.. = {own}",
        keys=keys,
        differs=differs,
        refuse=refuse,
        why=f"they say what the words of the telegram carry, as the option {option}; {t.code_of(count)} is their "
        "number, COM-94 = 1 makes them act",
        source="4.2.4 to 4.2.8",
    )
