"""Master side of a drive that a device file describes: the core of all drives, fed by data."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Final, TypeVar

from dpstack.devices.model import DeviceFile, WordSpec, counts_of
from dpstack.errors import ConfigError
from dpstack.profile.channel.base import ParamKey
from dpstack.profile.master.core import DriveCore
from dpstack.profile.master.mapped_core import MappedCore
from dpstack.profile.master.settings import Setting, equal
from dpstack.profile.model.drive_type import DriveType, Options, TelegramSpec
from dpstack.profile.model.jobs import LARGEST, Args, CommandError, Steps
from dpstack.profile.model.process_data_map import FieldMap, FieldTable
from dpstack.profile.model.states import FAULTED, ControlTable

M = TypeVar("M", bound=FieldMap)
#: the order that sets free words of the outputs
SET: Final = "set"
_MESSAGES: Final = ("fault", "warning")


class DeclaredCore(DriveCore):
    """A core whose words, states, parameters, texts, obstacles and settings are those of ``file``.

    The Python of a device file derives from it; with maps from :class:`DeclaredMapCore`.
    """

    def __init__(
        self, file: DeviceFile, profile: DriveType, name: str, telegram: TelegramSpec, options: Options
    ) -> None:
        self.file = file
        self.table = self.words_and_states()
        self.safe_control = file.safe_control
        self.scan_ns = round(file.scan_ms * 1_000_000)
        has_channel = file.channel.record_slot is not None or telegram.channel
        self.parameter_table = file.parameters if has_channel or len(list(file.parameters)) else None
        self.record_slot, self.record_object = file.channel.record_slot, file.channel.record_object
        self.lock_hint, self.start_hint = file.lock_hint, file.start_hint
        self.address_parameter = self.address_parameter or file.address_parameter
        self.address_acts = file.address_acts
        self.dialect = file.channel.pkw
        self.fault_names, self.unknown_fault = file.fault.texts, file.fault.unknown
        self.warning_names, self.unknown_warning = file.warning.texts, file.warning.unknown
        self.warning_numbers = file.warning.kind == "number"
        self._options = options
        super().__init__(profile, name, telegram, options)

    def words_and_states(self) -> ControlTable:
        """Those of :attr:`file`; called first, so nothing but that is there yet."""
        return self.file.table

    def place_name(self, word: str, title: str, *, outputs: bool) -> str:
        """A word of the telegram for people, by its ``title`` in the file."""
        return title

    def obstacle(self) -> str | None:
        word = self.status_word
        return next((one.text for one in self.file.obstacles if word & one.mask == one.value), None)

    def settings(self) -> Sequence[Setting]:
        found = [*self._references()]
        for one in self.file.settings:
            wanted = self._wanted(one.equals)
            if wanted is None:
                continue
            remedy = (one.remedy or f"set {one.parameter} = {{wanted}}").replace("{wanted}", f"{wanted:g}")
            found.append(
                equal(
                    one.parameter,
                    wanted,
                    remedy,
                    unit=one.unit,
                    refuse=not one.notice,
                    why=one.why,
                    source=one.source,
                )
            )
        return found

    def _references(self) -> Iterator[Setting]:
        """What 100 % is, where a parameter of the drive holds it: compared with the option, or learned."""
        for unit in ("Hz", "rpm"):
            option = f"reference_{unit.lower()}"
            parameter = getattr(self.file.reference, unit.lower())
            if not isinstance(parameter, str):
                continue
            if given := self._wanted(option):
                remedy = f"set {parameter} = {given:g}, or the option {option} = {{}}"
                yield equal(parameter, given, remedy, unit=unit, why=f"it is 100 % of the speed ({option})")
            else:
                yield Setting(
                    wanted=f"{parameter} (100 % in {unit})",
                    keys=(ParamKey(parameter),),
                    differs=partial(self._learn, option, parameter),
                    refuse=False,
                    why=f"it is what 100 % of the speed means in {unit}: it is read from the drive",
                )

    def learns_reference(self, unit: str) -> bool:
        asked = isinstance(getattr(self.file.reference, unit.lower()), str) and self.access is not None
        return asked and not getattr(self, f"reference_{unit.lower()}")

    def _learn(self, option: str, parameter: str, values: Sequence[float]) -> str | None:
        """The drive has said what 100 % is."""
        (value,) = values
        setattr(self, option, value if 0 < value < LARGEST else 0.0)
        return None if value > 0 else f"{parameter} is {value:g}: nobody knows what 100 % of the speed is"

    def lost(self, now: int) -> None:
        super().lost(now)
        for unit in ("hz", "rpm"):  # another drive may come back
            if isinstance(getattr(self.file.reference, unit), str):
                setattr(self, f"reference_{unit}", self._wanted(f"reference_{unit}") or 0.0)

    def _wanted(self, equals: float | str) -> float | None:
        if not isinstance(equals, str):
            return equals
        if equals == "telegram":
            number = self.file.telegrams[self.telegram.name].number
            return None if number is None else float(number)
        value = self._options.get(equals)
        return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) and value else None


class DeclaredMapCore(MappedCore[M], DeclaredCore):
    """A core with the maps of ``file``, for the Python of a device file."""

    map_fields: tuple[FieldTable, FieldTable]

    def __init__(
        self, file: DeviceFile, profile: DriveType, name: str, telegram: TelegramSpec, options: Options
    ) -> None:
        assert file.maps is not None
        inputs, outputs = file.maps
        self.map_fields = (inputs.fields, outputs.fields)
        if outputs.codes.places:
            self.map_codes = (inputs.codes, outputs.codes)
        super().__init__(file, profile, name, telegram, options)


class FileCore(DeclaredCore):
    """The core of the drive in ``file``. Orders of its own: :data:`SET`, and those of the file.

    Free words of the outputs (:attr:`free`) have their neutral values until they are set, and again after the drive was
    away or its outputs were safe; so have the bits that orders of the file have set.
    """

    def __init__(
        self, file: DeviceFile, profile: DriveType, name: str, telegram: TelegramSpec, options: Options
    ) -> None:
        self._layout = layout = Layout(file, telegram.name)
        self.inputs = layout.names
        self.fault_parameter, self.warning_parameter = (
            None if layout.has(one.word, file) else one.parameter for one in (file.fault, file.warning)
        )
        self.own_ops = ((SET,) if layout.free else ()) + tuple(file.orders)
        if layout.setpoint is not None:
            self.scale = layout.setpoint.scale
        #: counts of the free words by name
        self.values: dict[str, int] = dict(layout.neutral)
        self._extra = 0
        super().__init__(file, profile, name, telegram, options)
        self.safe_outputs = bytes(self.offset) + layout.pack(file.safe_control & ~layout.clear, 0, layout.neutral)
        for obstacle in file.obstacles:  # a change of their bits is a new status
            self._event_mask |= obstacle.mask

    # -- outputs --------------------------------------------------------------------------------------------------

    def encode(self, control: int, setpoint: int) -> bytes:
        return self._layout.pack(control & ~self._layout.clear | self._extra, setpoint, self.values)

    def encode_held(self) -> bytes:
        return self._layout.pack(self.file.safe_control & ~self._layout.clear, 0, self._layout.neutral)

    def decode(self, process: bytes) -> tuple[int | None, float | None]:
        return self._layout.unpack_outputs(process, self.file)

    def control_bits(self) -> int:
        reverse = self.file.reverse
        return self._extra | (reverse if reverse is not None and self.setpoint < 0 else 0)

    def setpoint_word(self, fraction: float) -> int:
        word = self._layout.setpoint
        if word is None:
            raise ValueError(f"telegram {self.telegram.name} has no speed set point")
        percent, low, high = 100 * fraction, word.low, word.high
        if (low is not None and percent < low) or (high is not None and percent > high):
            limits = ("" if limit is None else f"{limit:g}" for limit in (low, high))
            raise ValueError(f"speed {fraction:g} is outside {'..'.join(limits)} %")
        return self.scale.encode(abs(fraction) if self.file.reverse is not None else fraction)

    def lost(self, now: int) -> None:
        self.values = dict(self._layout.neutral)
        self._extra = 0
        super().lost(now)

    def order(self, op: str, args: Args) -> Steps[dict[str, object]] | None:
        own = self.file.orders.get(op)
        if own is not None:
            return self._own(own.set, own.clear)
        if op == SET and self._layout.free:
            return self._set(
                [(str(one.name_or_number("name")), one.optional("value")) for one in args.tables("values")]
            )
        return None

    def _own(self, wanted: int, clear: int) -> Steps[dict[str, object]]:
        yield from ()
        self._extra = self._extra & ~clear | wanted
        self.update()
        return {"value": f"{self._extra:04X}"}

    def _set(self, given: Sequence[tuple[str, float | None]]) -> Steps[dict[str, object]]:
        """Free words by name; None: the neutral value."""
        yield from ()
        found = {}
        for name, value in given:
            word = self._layout.free.get(name)
            if word is None:
                raise CommandError("usage", f"{name!r} is no free word; it has {', '.join(self._layout.free)}")
            try:
                found[name] = counts_of(word, word.neutral if value is None else value)
            except ValueError as error:
                raise CommandError("usage", str(error)) from None
        self.values.update(found)
        self.dirty = True
        return {"value": dict(given)}

    # -- inputs ---------------------------------------------------------------------------------------------------

    def word(self, name: str) -> int | None:
        """The word called ``name``, or the one that has this part; unsigned. A derived value too."""
        if name in _MESSAGES:
            name = (self.file.fault if name == "fault" else self.file.warning).word or name
        place = self._layout.places.get(name)
        if place is not None:
            at, wide = place
            return self.words[at] << 16 | self.words[at + 1] if wide else self.words[at]
        derived = self.file.derived.get(name)
        if derived is None:
            return None
        word = self.word(derived.of)
        if word is None:
            return None
        return word >> derived.shift & derived.mask if word & derived.when == derived.when else 0

    def measured(self) -> tuple[float | None, float | None, float | None]:
        speed, current, torque = (self._part(part) for part in ("speed", "current", "torque"))
        turned = self.file.reversed
        if speed is not None and turned is not None and self.status_word & turned:
            speed = -speed
        return speed, current, torque

    def _part(self, part: str) -> float | None:
        """A part of the reference or of the rated value; a word in another unit is a named value only."""
        word = self.word(part)
        return None if word is None or part not in self._layout.scales else self._layout.scales[part].decode(word)

    def fault_texts(self) -> tuple[str, ...] | None:
        value = self.word("fault")
        if value is None or self.file.fault.kind == "number":
            return super().fault_texts()
        return tuple(self.fault_text(bit) for bit in range(value.bit_length()) if value >> bit & 1) or None

    def warnings(self) -> tuple[str, ...]:
        if self.word("warning") is None and self.warning_parameter is None:
            return ("warning",) if self.table.status.is_set(self.status_word, "warning") else ()
        if self.file.warning.word == self.file.fault.word and self.raw_state in FAULTED:
            return ()  # one word for both: its number is the fault's
        return super().warnings()


class Layout:
    """The words of one telegram in their places."""

    def __init__(self, file: DeviceFile, telegram: str) -> None:
        found = file.telegrams.get(telegram)
        if found is None:
            raise ConfigError(f"{file.name} has no telegram {telegram!r}; it has {', '.join(file.telegrams)}")
        self._outputs = [one if isinstance(one, int) else file.words[one] for one in found.outputs]
        self._out = struct.Struct(
            ">" + "".join("H" if isinstance(one, int) or one.octets == 2 else "I" for one in self._outputs)
        )
        #: bits of the control word that stay 0
        self.clear = file.table.control.mask(*found.clear)
        #: the words behind control word and set point that a program may set
        self.free: Mapping[str, WordSpec] = {
            one.name: one
            for one in self._outputs
            if not isinstance(one, int) and one.part not in ("control", "setpoint")
        }
        self.neutral: Mapping[str, int] = {name: counts_of(one, one.neutral) for name, one in self.free.items()}
        self.setpoint = next(
            (one for one in self._outputs if not isinstance(one, int) and one.part == "setpoint"), None
        )
        #: place (of 16 bits) and width of the input words, by name and by part
        self.places: dict[str, tuple[int, bool]] = {}
        self.scales = {}
        #: names of the words of 16 bits, as the core has them
        names: list[str] = []
        for number in found.inputs:
            word = None if isinstance(number, int) else file.words[number]
            name = f"constant {len(names)}" if word is None else word.name
            wide = word is not None and word.octets == 4
            if word is not None:
                self.places[name] = (len(names), wide)
                if word.part:
                    self.places.setdefault(word.part, (len(names), wide))
                    if word.is_part_of_reference:
                        self.scales[word.part] = word.scale
            names += [name, f"{name} low"] if wide else [name]
        self.names = tuple(names)

    def has(self, name: str, file: DeviceFile) -> bool:
        """Whether the inputs have the word called ``name``, or the word of this derived value."""
        derived = file.derived.get(name)
        return (name if derived is None else derived.of) in self.places

    def pack(self, control: int, setpoint: int, values: Mapping[str, int]) -> bytes:
        """The process data of the outputs, by counts."""
        found = []
        for one in self._outputs:
            if isinstance(one, int):
                found.append(one)
            elif one.part == "control":
                found.append(control & 0xFFFF)
            elif one.part == "setpoint":
                found.append(setpoint)
            else:
                found.append(values[one.name])
        return self._out.pack(*found)

    def unpack_outputs(self, process: bytes, file: DeviceFile) -> tuple[int | None, float | None]:
        """Control word and set point of the reference in ``process``; None if it does not have them."""
        if len(process) != self._out.size:
            return None, None
        control: int | None = None
        setpoint: float | None = None
        for one, value in zip(self._outputs, self._out.unpack(process), strict=True):
            if isinstance(one, int):
                continue
            if one.part == "control":
                control = value
            elif one.part == "setpoint":
                setpoint = one.scale.decode(value)
        if setpoint is not None and control is not None and file.reverse is not None and control & file.reverse:
            setpoint = -setpoint
        return control, setpoint
