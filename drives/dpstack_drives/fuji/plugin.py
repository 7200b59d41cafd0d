"""The master's end of a Fuji FRENIC-Multi."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Final

from dpstack.devices.drive_core import DeclaredCore
from dpstack.devices.model import DeviceFile
from dpstack.profile import (
    FAULTED,
    MAP_OPS,
    Args,
    CommandError,
    DriveProfile,
    ListedParam,
    Lookup,
    MappedCore,
    Options,
    ParamKey,
    ParamRef,
    Setting,
    Steps,
    TelegramSpec,
    listing,
    process_data_map,
    settled,
)
from dpstack_drives.fuji import pcd
from dpstack_drives.fuji import table as t

_REMOTE: Final = t.STATUS.mask("remote")
_REVERSE: Final = t.CONTROL.mask("reverse")
#: of y98: run and frequency command
_FROM_BUS: Final = 3


FieldMap = process_data_map.FieldMap


class FujiCore(MappedCore[FieldMap], DeclaredCore):
    """MRV and MAV in parts of F03.

    Options: ``reference_hz`` (F03); ``reverse``: a negative speed goes out as a negative MRV (``sign``) or by bit 11
    of CTW (``bit``); ``map_inputs`` and ``map_outputs``: the assignments that the drive has
    (:mod:`~dpstack_drives.fuji.pcd`).

    Jobs of its own: those of a :class:`MappedCore`, in PPO2 and PPO4.
    """

    channel_hint = ": take PPO2"
    inputs_at = outputs_at = 2  # PCD1 stands behind STW and MAV
    map_codes = pcd.CODES
    map_fields = pcd.MAPS
    inputs_map: FieldMap
    outputs_map: FieldMap

    def __init__(
        self, file: DeviceFile, profile: DriveProfile, name: str, telegram: TelegramSpec, options: Options
    ) -> None:
        super().__init__(file, profile, name, telegram, options)
        self._by_bit = options["reverse"] == "bit"
        self._alarm = Lookup(lambda: self.raw_state in FAULTED, self._ask)
        self.holds_outputs = bool(self.rest) and self.access is not None
        self.inputs_map, self.outputs_map = self.maps_of_options(options)
        self.refuse_zeros()
        if telegram.channel:
            self.lookups = (self._alarm,)

    def setpoint_word(self, fraction: float) -> int:
        """MRV. Raises ValueError beyond 4000h, the maximum frequency (manual, 7.2 and 8.2 (3))."""
        if not abs(fraction) <= 1:
            raise ValueError(f"speed {fraction:g} is outside -1..1: 100 % is F03 (maximum frequency), 0.5 is 50 %")
        return self.scale.encode(abs(fraction) if self._by_bit else fraction)

    def decode(self, process: bytes) -> tuple[int | None, float | None]:
        """CTW, and MRV with its sign."""
        control, setpoint = super().decode(process)
        if self._by_bit and setpoint and control is not None and control & _REVERSE:
            setpoint = -setpoint
        return control, setpoint

    def control_bits(self) -> int:
        """Bit 11 reverses."""
        return _REVERSE if self._by_bit and self.setpoint < 0 else 0

    def fault_texts(self) -> tuple[str, ...] | None:
        """By name if there is a parameter channel; STW alone does not say it."""
        if (alarm := self._alarm.value) is not None:
            return (alarm,)
        if self.access is not None:
            return None
        return ("without a name: PPO3 and PPO4 do not carry it, the keypad shows it",)

    def parameters(self) -> tuple[ListedParam, ...]:
        """All parameters; of the malfunction history only the elements that hold an alarm."""
        return listing(t.PARAMETERS, elements={**t.ARRAYS, t.PNU_ALARMS: t.ALARM_INDEXES})

    def obstacle(self) -> str | None:
        """STW bit 9, then the state that a CTW which is not obeyed leaves behind."""
        return self.refused_in_clear() or super().obstacle()

    def refused_in_clear(self) -> str | None:
        """STW bit 9; S1 says nothing while CTW is 0."""
        if not self.status_word:
            return "STW is 0000: only the option is on the bus (its own 24 V), the inverter has no power"
        return None if self._remote() else super().obstacle()

    def prepare(self, deadline: int) -> Steps[None]:
        """Without STW bit 9 CTW does nothing."""
        yield from super().prepare(deadline)
        yield from settled(self, self._remote, deadline)
        if self._remote():
            return
        why = self.obstacle() or ""
        if self.access is not None and self.status_word:
            outcome = yield from self.access.read(ParamKey("y98"), deadline)
            if outcome["value"] == _FROM_BUS:
                why = "STW bit 9 is 0 although y98 is 3: terminal LE is off, LOC is on, or y99 is not 0; they go first"
            else:
                why = f"y98 is {outcome['value']}: {why}"
        raise CommandError("fault", why)

    def settings(self) -> Sequence[Setting]:
        """F03 (scale), y98 (source), and what PCD1 to PCD4 are assigned to."""
        found = list(super().settings())
        if self.rest and self.pending is None:
            found += [
                _assigned("map_outputs", self.outputs_map, t.PNU_PCD_WRITE, "o40 to o43"),
                _assigned("map_inputs", self.inputs_map, t.PNU_PCD_READ, "o48 to o51"),
            ]
        return found

    # -- PCD1 to PCD4 ---------------------------------------------------------------------------------------------

    def order(self, op: str, args: Args) -> Steps[dict[str, object]] | None:
        if op in MAP_OPS and not self.rest:
            raise CommandError("usage", f"{op}: {self.telegram.name} has no PCD1 to PCD4: take PPO2 or PPO4")
        return super().order(op, args)

    def parse_map(self, text: str, *, outputs: bool) -> FieldMap:
        if text.strip() and not self.rest:
            raise ValueError(f"{self.telegram.name} has no PCD1 to PCD4; take PPO2 or PPO4")
        return super().parse_map(text, outputs=outputs)

    def read_by(self, field: process_data_map.MapField) -> ParamKey | None:
        """Its function code, if the group is known."""
        return ParamKey(field.name) if t.address(field.name) is not None else None

    def called(self, name: str | int) -> str | int:
        """A function code in any writing."""
        found = t.address(name) if isinstance(name, str) else None
        return name if found is None else found[0] - t.GROUP_OFFSET << 8 | found[1]

    def _remote(self) -> bool:
        return bool(self.status_word & _REMOTE)

    def _ask(self, deadline: int) -> Steps[str]:
        """PNU 947, and M16 if that stands for two alarms."""
        assert self.access is not None
        found = t.alarms(malfunction := (yield from self.access.read_raw(ParamKey(t.PNU_ALARMS, index=1), deadline)))
        if len(found) > 1:
            with contextlib.suppress(CommandError):  # then both names are shown
                code = yield from self.access.read_raw(ParamKey("M16"), deadline)
                found = [alarm for alarm in found if alarm.code == code] or found
        return " or ".join(alarm.text for alarm in found) or f"{malfunction:04X}"

    def place_of(self, key: ParamKey) -> tuple[int, int]:
        """A function code by its PNU and number, an array by its PNU."""
        ref = self.resolve(key)
        return ref.pnu, 0 if ref.array and ref.pnu in t.ARRAYS else ref.ind

    def resolve(self, key: ParamKey) -> ParamRef:
        name, index = key.name, key.place
        if key.ram:
            raise CommandError("usage", f"{self.drive} has no writes to RAM only")
        if isinstance(name, str) and (found := t.address(name)) is not None:
            if index is not None:
                raise CommandError("usage", f"function code {name} has no index")
            spec = t.PARAMETERS.get(*found)
            return ParamRef(*found, False, spec, spec.label if spec else name)
        spec = t.PARAMETERS.named(name) if isinstance(name, str) else t.PARAMETERS.get(name)
        if spec is None and isinstance(name, str):
            raise CommandError("usage", f"{name!r} is neither a function code such as F26 nor a known parameter")
        number = spec.number if spec is not None else int(name)
        if not 1 <= number <= 0x7FF:
            raise CommandError("usage", f"parameter {number}: PNUs are 1..2047")
        if index is not None and index > 0xFF:
            raise CommandError("usage", f"parameter {number}: indexes are 0..255")
        array = number in t.ARRAYS or (spec is None and index is not None)
        label = f"PNU {number}" + (f"[{index}]" if index is not None else "")
        return ParamRef(number, (1 if array else 0) if index is None else index, array, spec, label)


def _assigned(option: str, own: FieldMap, pnu: int, codes: str) -> Setting:
    """The drive's assignments are those of the option. A wrong one writes into another parameter: refused."""

    def differs(values: Sequence[float]) -> str | None:
        found = pcd.MAPS[0].of(int(value) for value in values)
        if str(found) == str(own):
            return None
        return (
            f"{codes} are {str(found) or 'empty'}, the option {option} is {str(own) or 'empty'}: set {option} = "
            f"'{found}', or write the codes (write_map over PPO2) and switch the drive off and on"
        )

    keys = tuple(ParamKey(pnu, index=index) for index in t.ARRAYS[pnu])
    return Setting(
        wanted=f"{codes} = {str(own) or 'empty'}",
        keys=keys,
        differs=differs,
        refuse=option == "map_outputs",
        why=f"they say what PCD1 to PCD4 carry, as the option {option}; a word in another's place would be another "
        "function code. They act after power-on",
        source="8.2 (4)",
    )
