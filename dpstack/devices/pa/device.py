"""The simulated PA device of a device file: its cyclic values, and what its actuators do.

The blocks behind the values belong to somebody else: whoever simulates them sets :attr:`PaDevice.values` and
:attr:`PaDevice.status`, and reads :attr:`PaDevice.set_points`.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Final

from dpstack.devices.pa.configurations import layout_of_telegram
from dpstack.devices.pa.layout import Layout, Part, Place
from dpstack.devices.pa.model import PaFile
from dpstack.dp.slave.device import Leave
from dpstack.dpv1.slave.device import Device
from dpstack.errors import ConfigError
from dpstack.profile.drive_profile import DeviceProfile
from dpstack.profile.model.drive_type import Options, TelegramSpec
from dpstack.units import NS_PER_S

#: status of a value: good; of a set point: this and above is good
GOOD: Final = 0x80
#: no value may come before the first exchange
BAD: Final = 0x00
_FORMATS: Final = {"f32": ">f", "u8": ">B", "u16": ">H", "i16": ">h", "u32": ">I", "i32": ">i"}
#: the bit of CHECKBACK for the fail-safe position, by its name in the base
_FAIL_SAFE: Final = "fail_safe"
#: the ends of the range of a set point in per cent, which POS_D calls closed and open (Samson KH 8384-4, page 8)
_CLOSED, _OPEN = 0.5, 99.5
#: SET_TOT and MODE_TOT
_RESET: Final = 1
_PRESET: Final = 2
_HOLD: Final = 3


class SetPoint:
    """A set point as it arrived: value, and status octet."""

    __slots__ = ("status", "value")

    def __init__(self, value: float = 0.0, status: int = BAD) -> None:
        self.value = value
        self.status = status

    @property
    def good(self) -> bool:
        """Whether the actuator follows it."""
        return self.status >= GOOD


class PaDevice(Device):
    """Values are 0 and good until somebody sets others. An actuator follows its set point at once while the status is
    good, and goes to :attr:`fail_safe_value` else; a totaliser adds :attr:`rates` a second."""

    def __init__(
        self,
        file: PaFile,
        profile: DeviceProfile,
        telegram: TelegramSpec,
        options: Options,
        presets: Mapping[str, object],
    ) -> None:
        self.file, self.profile, self.telegram = file, profile, telegram
        self.name, self.ident, self.fail_safe = profile.name, profile.ident, profile.fail_safe
        #: values by name; a value without an entry is 0
        self.values: dict[str, float] = {}
        #: status octets by the name of the value; one without an entry is good
        self.status: dict[str, int] = {}
        #: set points, display values and control octets as they arrived, by the name of the output
        self.set_points: dict[str, SetPoint] = {}
        #: position of the actuators without a good set point
        self.fail_safe_value = 0.0
        #: what totalisers add in a second, by the name of their total
        self.rates: dict[str, float] = {}
        #: value of a totaliser after a preset, by the name of its total
        self.presets: dict[str, float] = {}
        self._layout: Layout = layout_of_telegram(file, telegram.name)
        self._at: int | None = None
        self._checkback: dict[str, int] = {}
        for name, value in presets.items():
            if name not in self._layout.inputs:
                known = ", ".join((*profile.device_options, *self._layout.inputs))
                raise ConfigError(f"simulated {file.name}: there is no option or value {name!r}; known: {known}")
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
                raise ConfigError(f"simulated {file.name}: {name} = {value!r} is no number; give for instance 1.5")
            self.values[name] = float(value)

    def __repr__(self) -> str:
        return f"<PaDevice {self.name}>"

    # -- from outside --------------------------------------------------------------------------------------------------

    @property
    def layout(self) -> Layout:
        """The places of its values."""
        return self._layout

    def put(self, name: str, value: float, status: int | None = None) -> None:
        """Set a value of the inputs, and its status octet; None leaves that as it is. Raises ValueError."""
        place = self._layout.inputs.get(name)
        if place is None:
            raise ValueError(f"{name!r} is no value of this device; it has {', '.join(self._layout.inputs)}")
        _packed(place.part, value)
        self.values[name] = value
        if status is not None:
            self.status[name] = status

    def set_inputs(self, octets: bytes) -> None:
        """Take values, status and CHECKBACK from the octets of the inputs."""
        for name, place in self._layout.inputs.items():
            own = octets[place.at : place.at + place.part.octets - place.part.status]
            if place.part.name.startswith("CHECKBACK"):
                self._checkback[name] = int.from_bytes(own, "little")
            elif place.part.type in _FORMATS:
                self.values[name] = struct.unpack(_FORMATS[place.part.type], own)[0]
            else:
                self.values[name] = int.from_bytes(own, "big")
            if place.part.status:
                self.status[name] = octets[place.status_at]

    def set_checkback(self, name: str, bits: int) -> None:
        """Set bits of the CHECKBACK called ``name`` beside those that the device sets itself."""
        self._checkback[name] = bits

    def inherit(self, before: PaDevice) -> None:
        """Take over the values of the same device before it was switched off and on."""
        self.values, self.status, self.rates, self.presets = before.values, before.status, before.rates, before.presets

    @property
    def injected(self) -> tuple[str, ...]:
        """Faults from outside, written as the commands of ``dpstack ctl``: it has none of its own."""
        return ()

    # -- Device --------------------------------------------------------------------------------------------------------

    def check_cfg(self, config: bytes) -> str | None:
        return None if self.profile.telegrams_of(config) else super().check_cfg(config)

    def enter(self, config: bytes, now: int) -> None:
        if self.telegram.config != config:
            self.telegram = self.profile.telegrams_of(config)[0]
            self._layout = layout_of_telegram(self.file, self.telegram.name)
        self._forget()

    def exchange(self, outputs: bytes, now: int) -> bytes:
        elapsed = 0 if self._at is None else now - self._at
        self._at = now
        for name, place in self._layout.outputs.items():
            if len(outputs) > place.status_at:
                self.set_points[name] = _set_point(place, outputs)
        self._act(elapsed / NS_PER_S)
        return self.inputs()

    def clear(self, now: int) -> None:
        self._forget()
        self._act(0.0)

    def leave(self, reason: Leave, now: int) -> None:
        self._forget()
        self._act(0.0)

    # -- inside ------------------------------------------------------------------------------------------------------

    def inputs(self) -> bytes:
        """The octets of its inputs."""
        found = b""
        for name, place in self._layout.inputs.items():
            if place.part.name.startswith("CHECKBACK"):
                found += self._checkback_bits(name, place).to_bytes(3, "little")
            else:
                found += _packed(place.part, self.values.get(name, 0.0))
            if place.part.status:
                found += bytes([self.status.get(name, GOOD)])
        return found

    def _forget(self) -> None:
        """Set points are gone."""
        self.set_points = {name: SetPoint() for name in self._layout.outputs}

    def _act(self, seconds: float) -> None:
        for name, place in self._layout.inputs.items():
            match place.part.name:
                case "READBACK" | "RCAS_OUT":
                    self.values[name] = self._position(place)
                case "POS_D":
                    position = self._position(place)
                    self.values[name] = 1 if position < _CLOSED else 2 if position > _OPEN else 3
                case "READBACK_D" | "RCAS_OUT_D":
                    point = self._point_of(place)
                    self.values[name] = point.value if point.good else 0.0
                case "TOTAL":
                    self._count(name, place, seconds)

    def _point_of(self, place: Place) -> SetPoint:
        """The set point of the slot of ``place``, that of the remote cascade if it has no other."""
        points = (self.set_points.get(one.name) for one in self._layout.outputs.values() if one.slot is place.slot)
        return next((one for one in points if one is not None), SetPoint())

    def _position(self, place: Place) -> float:
        point = self._point_of(place)
        return point.value if point.good and math.isfinite(point.value) else self.fail_safe_value

    def _count(self, name: str, place: Place, seconds: float) -> None:
        """Add up, as SET_TOT and MODE_TOT say."""
        control = {
            one.part.name: int(self.set_points[one.name].value)
            for one in self._layout.outputs.values()
            if one.slot is place.slot and one.name in self.set_points
        }
        order = control.get("SET_TOT", 0)
        if order in (_RESET, _PRESET):
            self.values[name] = 0.0 if order == _RESET else self.presets.get(name, 0.0)
        rate, mode = self.rates.get(name, 0.0), control.get("MODE_TOT", 0)
        counts = (True, rate > 0, rate < 0, False)[mode] if 0 <= mode <= _HOLD else True
        if counts:
            self.values[name] = self.values.get(name, 0.0) + rate * seconds

    def _checkback_bits(self, name: str, place: Place) -> int:
        bits = self._checkback.get(name, 0)
        if place.part.name == "CHECKBACK" and not self._point_of(place).good and _FAIL_SAFE in self.file.checkback:
            bits |= 1 << self.file.checkback[_FAIL_SAFE]
        return bits


def _set_point(place: Place, outputs: bytes) -> SetPoint:
    part = place.part
    own = outputs[place.at : place.at + part.octets - part.status]
    value = float(struct.unpack(_FORMATS[part.type], own)[0]) if part.type in _FORMATS else 0.0
    return SetPoint(value, outputs[place.status_at] if part.status else GOOD)


def _packed(part: Part, value: float) -> bytes:
    """Raises ValueError for a value that the octets cannot have."""
    try:
        if part.type == "f32":
            return struct.pack(">f", value)
        whole = int(value)
        return struct.pack(_FORMATS[part.type], whole) if part.type in _FORMATS else whole.to_bytes(3, "big")
    except (OverflowError, struct.error, ValueError):
        raise ValueError(f"{value!r} does not fit into {part.type}") from None
