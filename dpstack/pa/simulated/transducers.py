"""Transducer blocks: pressure, temperature, level, flow, actuator, plain ones.

Each computes its values from the process (:attr:`ProcessDevice.process`, in bar, degC, m, m³/h, %) in the units that
its parameters name. Sources: docs/reference/decisions/pa.md#simulated-devices.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.errors import RecordRefused
from dpstack.pa.blocks import TRANSDUCER
from dpstack.pa.datatypes import ParameterValue
from dpstack.pa.simulated import tables
from dpstack.pa.simulated.block import AUTO, OUT_OF_SERVICE, Block, ratio
from dpstack.pa.simulated.conversion import convert
from dpstack.pa.simulated.faults import HIGH, LOW, PASSIVE, SENSOR

BAR, CELSIUS, METRE, PERCENT, CUBIC_METRES_PER_HOUR = 1137, 1001, 1010, 1342, 1349
KILOGRAMS_PER_HOUR, DENSITY, HERTZ, METRES_PER_SECOND, MILLIMETRE = 1324, 1097, 1077, 1061, 1013
#: no sensor value exists while the sensor is broken
_BROKEN_WIRE: Final = 0x04


class Transducer(Block):
    """The common part of transducer blocks. ``unit``: of the process value of :attr:`quantity`."""

    permitted = AUTO | OUT_OF_SERVICE
    #: name of the process value, and its unit
    quantity, unit = "", PERCENT
    #: parameters with the limits of the sensor (high, low), and their unit; empty without limits
    limits: tuple[str, str, str] | tuple[()] = ()
    #: parameters that keep the extremes of another one: highest, lowest, whose; a write sets them anew
    extremes: tuple[tuple[str, str, str], ...] = ()
    #: the value that function blocks get unless CHANNEL names another one
    primary = "primary_value"

    def __init__(self, number: int, parent: int, of_class: int, values: Mapping[str, ParameterValue]) -> None:
        self.table: tables.PointTable | None = None
        super().__init__(f"TB{number}", TRANSDUCER, parent, of_class, values)

    def reset(self) -> None:
        super().reset()
        if "tab_max_number" in self.parameters:
            self.table = tables.PointTable(self)
        self._fresh = {high for high, _, _ in self.extremes}

    def process(self, name: str = "") -> float:
        """A process value in its own unit; that of the block if none is named."""
        return self.device.process[name or self.quantity]

    def written(self, name: str, before: ParameterValue) -> None:
        super().written(name, before)
        if self.table is not None and name in tables.OWN:
            try:
                self.table.written(name)
            except RecordRefused:
                self.put(name, before)
                raise
        for high, low, _ in self.extremes:
            if name in (high, low):
                self._fresh.add(high)

    def unit_of(self, name: str) -> int:
        """The unit that a parameter has."""
        return self.whole(next(unit for unit, followers in self.units.items() if name in followers))

    def value_of(self, name: str) -> tuple[float, int]:
        """Value and status of a parameter, for a function block."""
        if self.parameters[name].kind in ("value", "value_d"):
            return self.part(name, "value"), int(self.part(name, "status"))
        return self.number_of(name), self.status

    @property
    def status(self) -> int:
        """The status octet of the measured values."""
        if self.mode == OUT_OF_SERVICE:
            return PASSIVE[self.device.condensed]
        return self.device.status | self._limited()

    def _limited(self) -> int:
        if not self.limits:
            return 0
        high, low, unit = self.limits
        value = convert(self.process(), self.unit, self.whole(unit))
        return HIGH if value > self.number_of(high) else LOW if value < self.number_of(low) else 0

    def is_outside(self) -> bool:
        """Whether the process value is outside the limits of the sensor."""
        return bool(self._limited())

    def step(self, seconds: float) -> None:
        if self.mode == OUT_OF_SERVICE:
            for one in self.parameters.values():
                if one.kind == "value" and one.storage == "D":
                    self.put_value(one.name, self.part(one.name, "value"), PASSIVE[self.device.condensed])
            return
        if SENSOR not in self.device.active:
            self.measure()
        self.show()
        for high, low, source in self.extremes:
            self._keep(high, low, self.value_of(source)[0])

    def measure(self) -> None:
        """Compute the values from the process."""

    def show(self) -> None:
        """Give every measured value the status that it has now."""
        status = self.status
        for one in self.parameters.values():
            if one.kind == "value" and one.storage == "D":
                self.put_value(one.name, self.part(one.name, "value"), status)

    def _keep(self, high: str, low: str, value: float) -> None:
        if high in self._fresh:
            self._fresh.discard(high)
            self.put(high, value)
            self.put(low, value)
        if value > self.number_of(high):
            self.put(high, value)
        if value < self.number_of(low):
            self.put(low, value)


class PressureTransducer(Transducer):
    """SENSOR_VALUE, trimmed by CAL_POINT_LO and _HI, scaled by SCALE_IN, LIN_TYPE and SCALE_OUT."""

    quantity, unit = "pressure", BAR
    limits = ("sensor_hi_lim", "sensor_lo_lim", "sensor_unit")
    view = ("primary_value",)
    linearisations = (tables.NONE, tables.TABLE, tables.ROOT)
    extremes = (
        ("max_sensor_value", "min_sensor_value", "sensor_value"),
        ("max_temperature", "min_temperature", "temperature"),
    )
    units = {
        "sensor_unit": (
            "sensor_value", "sensor_hi_lim", "sensor_lo_lim", "cal_point_hi", "cal_point_lo", "cal_min_span",
            "trimmed_value", "sensor_max_static_pressure", "max_sensor_value", "min_sensor_value",
        ),
        "primary_value_unit": ("primary_value", "scale_out"),
        "temperature_unit": ("temperature", "max_temperature", "min_temperature"),
        "secondary_value_1_unit": ("secondary_value_1", "scale_in"),
        "secondary_value_2_unit": ("secondary_value_2",),
    }  # fmt: skip

    def __init__(self, number: int, parent: int, of_class: int, values: Mapping[str, ParameterValue]) -> None:
        super().__init__(number, parent, of_class, values)

    def reset(self) -> None:
        super().reset()
        #: trim: of the sensor's value, and added to it
        self._gain, self._zero = 1.0, 0.0

    def measure(self) -> None:
        unit = self.whole("sensor_unit")
        sensor = convert(self.process(), BAR, unit)
        self.put("sensor_value", sensor)
        trimmed = self._zero + self._gain * sensor
        self.put_value("trimmed_value", trimmed, 0)
        first = convert(trimmed, unit, self.whole("secondary_value_1_unit"))
        self.put_value("secondary_value_1", first, 0)
        share = share_of(self, "scale_in", first)
        self.put_value("secondary_value_2", share * 100, 0)
        kind = self.whole("lin_type")
        if kind == tables.ROOT and share * 100 < self.number_of("low_flow_cut_off"):
            share = 0.0
        self.put_value("primary_value", value_at(self, "scale_out", tables.linearised(kind, share, self.table)), 0)
        temperature = convert(self.process("temperature"), CELSIUS, self.whole("temperature_unit"))
        self.put_value("temperature", temperature, 0)

    def check(self, name: str, value: ParameterValue) -> None:
        super().check(name, value)
        if name in ("cal_point_hi", "cal_point_lo") and isinstance(value, float):
            self._check_trim(name, value)

    def _check_trim(self, name: str, value: float) -> None:
        """The point is inside the limits of the sensor, and the span is not too small."""
        other = self.number_of("cal_point_lo" if name == "cal_point_hi" else "cal_point_hi")
        inside = self.number_of("sensor_lo_lim") <= value <= self.number_of("sensor_hi_lim")
        span = value - other if name == "cal_point_hi" else other - value
        if not inside or span < self.number_of("cal_min_span"):
            raise RecordRefused(Code.INVALID_RANGE)

    def written(self, name: str, before: ParameterValue) -> None:
        super().written(name, before)
        sensor = self.number_of("sensor_value")
        if name == "cal_point_lo":
            self._zero = self.number_of(name) - self._gain * sensor
        elif name == "cal_point_hi":
            low = self.number_of("cal_point_lo")
            low_sensor = ratio(low - self._zero, self._gain)
            if sensor != low_sensor and self.number_of(name) != low:
                self._gain = (self.number_of(name) - low) / (sensor - low_sensor)
                self._zero = low - self._gain * low_sensor
        elif name == "sensor_unit" and isinstance(before, int):
            self._zero = convert(self._zero, before, self.whole(name))


class TemperatureTransducer(Transducer):
    """Two sensors with BIAS_1 and _2; SENSOR_MEAS_TYPE makes PRIMARY_VALUE of them."""

    quantity, unit = "temperature", CELSIUS
    limits = ("upper_sensor_limit", "lower_sensor_limit", "primary_value_unit")
    view = ("primary_value",)
    linearisations = (tables.NONE, 102, 128, 134)
    extremes = (
        ("max_sensor_value_1", "min_sensor_value_1", "secondary_value_1"),
        ("max_sensor_value_2", "min_sensor_value_2", "secondary_value_2"),
    )
    units = {
        "primary_value_unit": (
            "primary_value", "secondary_value_1", "secondary_value_2", "upper_sensor_limit", "lower_sensor_limit",
            "max_sensor_value_1", "min_sensor_value_1", "max_sensor_value_2", "min_sensor_value_2", "rj_temp",
            "external_rj_value",
        ),
    }  # fmt: skip
    #: SENSOR_MEAS_TYPE: from the two sensors to PRIMARY_VALUE
    _TYPES: Final = {
        0: lambda one, two: one,
        1: lambda one, two: two,
        128: lambda one, two: one - two,
        129: lambda one, two: two - one,
        192: lambda one, two: (one + two) / 2,
    }

    def measure(self) -> None:
        unit = self.whole("primary_value_unit")
        one = convert(self.process(), CELSIUS, unit) + self.number_of("bias_1")
        two = convert(self.process("second_temperature"), CELSIUS, unit) + self.number_of("bias_2")
        self.put_value("secondary_value_1", one, 0)
        self.put_value("secondary_value_2", two, 0)
        self.put_value("primary_value", self._TYPES[self.whole("sensor_meas_type")](one, two), 0)
        self.put("rj_temp", convert(self.process("ambient"), CELSIUS, unit))

    def show(self) -> None:
        super().show()
        fault = _BROKEN_WIRE if SENSOR in self.device.active else 0
        self.put("input_fault_1", fault)
        self.put("input_fault_gen", 1 if fault else 0)

    def check(self, name: str, value: ParameterValue) -> None:
        super().check(name, value)
        if name == "sensor_meas_type" and value not in self._TYPES:
            raise RecordRefused(Code.INVALID_RANGE)


class LevelTransducer(Transducer):
    """SENSOR_VALUE with its offset, calibrated to LEVEL, linearised to PRIMARY_VALUE."""

    quantity, unit = "level", METRE
    limits = ("sensor_high_limit", "sensor_low_limit", "sensor_unit")
    view = ("primary_value",)
    linearisations = (tables.NONE, tables.TABLE, tables.CYLINDER, tables.SPHERE)
    extremes = (
        ("max_sensor_value", "min_sensor_value", "sensor_value"),
        ("max_temperature", "min_temperature", "temperature"),
    )
    units = {
        "primary_value_unit": ("primary_value", "lin_volume"),
        "level_unit": ("level", "level_lo", "level_hi", "level_offset"),
        "sensor_unit": (
            "sensor_value", "sensor_offset", "cal_point_lo", "cal_point_hi", "sensor_high_limit", "sensor_low_limit",
            "max_sensor_value", "min_sensor_value",
        ),
        "secondary_value_1_unit": ("secondary_value_1",),
        "secondary_value_2_unit": ("secondary_value_2",),
        "temperature_unit": ("temperature", "max_temperature", "min_temperature"),
    }  # fmt: skip

    def measure(self) -> None:
        sensor = convert(self.process(), METRE, self.whole("sensor_unit"))
        self.put("sensor_value", sensor)
        empty, full = self.number_of("cal_point_lo"), self.number_of("cal_point_hi")
        share = ratio(sensor + self.number_of("sensor_offset") - empty, full - empty)
        low, high = self.number_of("level_lo"), self.number_of("level_hi")
        level = low + share * (high - low) + self.number_of("level_offset")
        self.put("level", level)
        filled = tables.linearised(self.whole("lin_type"), ratio(level - low, high - low), self.table)
        if self.whole("lin_type") in (tables.CYLINDER, tables.SPHERE):
            primary = filled * self.number_of("lin_volume")
        else:
            primary = low + filled * (high - low)
        self.put_value("primary_value", primary, 0)
        self.put_value(
            "secondary_value_1", convert(sensor, self.whole("sensor_unit"), self.whole("secondary_value_1_unit")), 0
        )
        self.put_value("secondary_value_2", share * 100, 0)
        self.put("temperature", convert(self.process("temperature"), CELSIUS, self.whole("temperature_unit")))

    def check(self, name: str, value: ParameterValue) -> None:
        super().check(name, value)
        others = {
            "cal_point_lo": "cal_point_hi",
            "cal_point_hi": "cal_point_lo",
            "level_lo": "level_hi",
            "level_hi": "level_lo",
        }
        if name in others and value == self.get(others[name]):
            raise RecordRefused(Code.INVALID_RANGE)


class FlowTransducer(Transducer):
    """Volume and mass flow of one meter, its density and temperature."""

    quantity, unit = "flow", CUBIC_METRES_PER_HOUR
    limits = ("volume_flow_hi_limit", "volume_flow_lo_limit", "volume_flow_units")
    primary = "volume_flow"
    view = ("volume_flow", "mass_flow", "density", "temperature")
    units = {
        "volume_flow_units": ("volume_flow", "volume_flow_lo_limit", "volume_flow_hi_limit", "low_flow_cutoff"),
        "mass_flow_units": ("mass_flow", "mass_flow_lo_limit", "mass_flow_hi_limit"),
        "density_units": ("density", "density_lo_limit", "density_hi_limit"),
        "temperature_units": ("temperature", "temperature_lo_limit", "temperature_hi_limit"),
        "vortex_freq_units": ("vortex_freq", "vortex_freq_lo_limit", "vortex_freq_hi_limit"),
        "sound_velocity_units": ("sound_velocity", "sound_velocity_lo_limit", "sound_velocity_hi_limit"),
        "sampling_freq_units": ("sampling_freq",),
        "nominal_size_units": ("nominal_size",),
        "zero_point_unit": ("zero_point",),
    }
    #: hertz of the vortices at one cubic metre per hour
    _VORTICES: Final = 2.5

    def measure(self) -> None:
        unit = self.whole("volume_flow_units")
        zero = convert(self.number_of("zero_point"), self.whole("zero_point_unit"), CUBIC_METRES_PER_HOUR)
        flow = (self.process() - zero) * self.number_of("calibr_factor")
        flow = -flow if self.whole("flow_direction") else flow
        shown = convert(flow, CUBIC_METRES_PER_HOUR, unit)
        # mode 0 measures in one direction
        if abs(shown) < self.number_of("low_flow_cutoff") or (flow < 0 and not self.whole("measurement_mode")):
            flow = shown = 0.0
        density = self.process("density")
        self.put_value("volume_flow", shown, 0)
        self.put_value("mass_flow", convert(flow * density, KILOGRAMS_PER_HOUR, self.whole("mass_flow_units")), 0)
        self.put_value("density", convert(density, DENSITY, self.whole("density_units")), 0)
        temperature = convert(self.process("temperature"), CELSIUS, self.whole("temperature_units"))
        self.put_value("temperature", temperature, 0)
        self.put_value("vortex_freq", abs(flow) * self._VORTICES, 0)
        self.put_value("sound_velocity", 1480.0, 0)
        self.put_value("sampling_freq", 20.0, 0)

    def check(self, name: str, value: ParameterValue) -> None:
        super().check(name, value)
        if name in ("measurement_mode", "flow_direction", "zero_point_adjust") and value not in (0, 1):
            raise RecordRefused(Code.INVALID_RANGE)

    def written(self, name: str, before: ParameterValue) -> None:
        super().written(name, before)
        if name == "zero_point_adjust" and self.whole(name):
            # what flows now is the zero point from now on
            self.put("zero_point", convert(self.process(), CUBIC_METRES_PER_HOUR, self.whole("zero_point_unit")))
            self.put(name, 0)


class ActuatorTransducer(Transducer):
    """The drive of a valve: it moves to :attr:`target` with its stroke times."""

    quantity = "position"
    primary = ""
    linearisations = (tables.NONE, tables.TABLE)
    #: seconds of a self-calibration
    CALIBRATION_S: Final = 10.0

    def __init__(self, number: int, parent: int, of_class: int, values: Mapping[str, ParameterValue]) -> None:
        super().__init__(number, parent, of_class, values)
        #: position to go to, 0..100 % open
        self.target = 0.0
        #: position, 0..100 % open
        self.position = 0.0
        #: seconds of a self-calibration to go
        self.calibrating = 0.0
        #: it cannot move
        self.blocked = False

    def value_of(self, name: str) -> tuple[float, int]:
        return (self.position, self.status) if not name else super().value_of(name)

    def step(self, seconds: float) -> None:
        self.calibrating = max(self.calibrating - seconds, 0.0)
        if self.put_calibration(done=not self.calibrating):
            self._move(seconds)
        self.device.process[self.quantity] = self.position

    def put_calibration(self, *, done: bool) -> bool:
        """Show whether a self-calibration runs; True if the valve follows its set point."""
        self.put("self_calib_status", 0 if done else 1)
        return done and not self.blocked and self.mode != OUT_OF_SERVICE

    @property
    def has_arrived(self) -> bool:
        """Whether it is as near to its target as DEADBAND wants; at the ends it goes all the way."""
        way = abs(self.target - self.position)
        return not way or (way <= self.number_of("deadband") and self.target not in (0.0, 100.0))

    def _move(self, seconds: float) -> None:
        if self.has_arrived:
            return
        way = self.target - self.position
        stroke = self.number_of("act_stroke_time_inc" if way > 0 else "act_stroke_time_dec")
        slowed = self.number_of("travel_rate_inc" if way > 0 else "travel_rate_dec")
        longest = 100.0 * seconds / max(stroke, slowed) if max(stroke, slowed) > 0 else 100.0
        moved = max(-longest, min(longest, way))
        self.position += moved
        self.put("total_valve_travel", self.number_of("total_valve_travel") + abs(moved) / 100)

    def check(self, name: str, value: ParameterValue) -> None:
        super().check(name, value)
        if name == "self_calib_cmd" and value not in (0, 1):
            raise RecordRefused(Code.INVALID_RANGE)
        if name in ("travel_rate_inc", "travel_rate_dec") and isinstance(value, float) and value < 0:
            raise RecordRefused(Code.INVALID_RANGE)

    def written(self, name: str, before: ParameterValue) -> None:
        super().written(name, before)
        if name == "self_calib_cmd" and self.whole(name):
            self.calibrating = self.CALIBRATION_S


class PlainTransducer(Transducer):
    """A transducer block without parameters of its own: a switch, the coil of a valve, a value that is as it is."""

    primary = ""

    def __init__(
        self, number: int, parent: int, of_class: int, values: Mapping[str, ParameterValue], *, quantity: str
    ) -> None:
        super().__init__(number, parent, of_class, values)
        self.quantity = quantity

    def value_of(self, name: str) -> tuple[float, int]:
        return (self.process(), self.status) if not name else super().value_of(name)


def share_of(block: Block, scale: str, value: float) -> float:
    """``value`` as a share 0..1 of a range or scaling."""
    low, high = block.part(scale, "eu_0"), block.part(scale, "eu_100")
    return ratio(value - low, high - low)


def value_at(block: Block, scale: str, share: float) -> float:
    """The value at a share 0..1 of a range or scaling."""
    low, high = block.part(scale, "eu_0"), block.part(scale, "eu_100")
    return low + share * (high - low)
