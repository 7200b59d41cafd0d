"""Function blocks of transmitters: analogue input, discrete input, totaliser.

Sources: docs/reference/decisions/pa.md#simulated-devices.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Final, cast

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.errors import RecordRefused, UsageError
from dpstack.pa.blocks import FUNCTION
from dpstack.pa.datatypes import ParameterValue, Scalar
from dpstack.pa.simulated import tables
from dpstack.pa.simulated.block import AUTO, MAN, OUT_OF_SERVICE, Block, nearest_f32, ratio
from dpstack.pa.simulated.conversion import convert, per_hour
from dpstack.pa.simulated.faults import CONSTANT, GOOD, HIGH, INITIAL, LAST_USABLE, LOW, PASSIVE, SUBSTITUTE

if TYPE_CHECKING:
    from dpstack.pa.simulated.transducers import Transducer

_H: Final = 3600.0
_UPDATED: Final = 0x84
#: bits of ALARM_SUM
HI_HI, HI, LO_LO, LO = 0x02, 0x04, 0x08, 0x10
#: limit parameter, alarm parameter, bit of ALARM_SUM, status if the value is good; the most serious first
_LIMITS: Final = (
    ("hi_hi_lim", "hi_hi_alm", HI_HI, 0x8E),
    ("lo_lo_lim", "lo_lo_alm", LO_LO, 0x8D),
    ("hi_lim", "hi_alm", HI, 0x8A),
    ("lo_lim", "lo_alm", LO, 0x89),
)
#: FSAFE_TYPE and FAIL_TOT
_VALUE, _LAST, _AS_IT_IS = range(3)
_RUN, _HOLD, _MEMORY = range(3)


def is_bad(status: int) -> bool:
    """Whether the quality in a status octet is bad."""
    return status < 0x40


class FunctionBlock(Block):
    """The common part of function blocks: CHANNEL to a transducer block, mode, simulation."""

    permitted = OUT_OF_SERVICE | MAN | AUTO
    #: the output, and the channel that it follows
    output, channel = "out", "channel"

    def __init__(self, name: str, parent: int, of_class: int, values: Mapping[str, ParameterValue]) -> None:
        super().__init__(name, FUNCTION, parent, of_class, values)

    @property
    def source(self) -> tuple[Transducer, str] | None:
        """The transducer block and its parameter in the channel; None without one."""
        return self._source(self.whole(self.channel))

    def _source(self, channel: int) -> tuple[Transducer, str] | None:
        number, relative = channel >> 8, channel & 0xFF
        found: Sequence[Transducer] = self.device.transducers
        if not 1 <= number <= len(found):
            return None
        block = found[number - 1]
        if not relative:
            return block, block.primary
        name = next((one.name for one in block.parameters.values() if one.relative == relative), "")
        return (block, name) if name and block.parameters[name].kind in ("value", "f32") else None

    def check(self, name: str, value: ParameterValue) -> None:
        super().check(name, value)
        if name.endswith("channel") and value and self._source(cast("int", value)) is None:
            raise RecordRefused(Code.INVALID_RANGE)

    def measured(self) -> tuple[float, int]:
        """Value and status from the channel, or from SIMULATE."""
        simulate = cast("Mapping[str, Scalar]", self.get("simulate")) if "simulate" in self.parameters else {}
        if simulate.get("enabled"):
            return cast("float", simulate["value"]), cast("int", simulate["status"])
        found = self.source
        if found is None:
            return 0.0, 0x04 if not self.device.condensed else 0x00
        return found[0].value_of(found[1])

    @property
    def is_simulated(self) -> bool:
        """Whether SIMULATE is in force."""
        return "simulate" in self.parameters and bool(self.part("simulate", "enabled"))

    def step(self, seconds: float) -> None:
        if self.mode == OUT_OF_SERVICE:
            self.pass_out()
        elif self.mode != MAN:
            self._compute(seconds)

    def _compute(self, seconds: float) -> None:
        """The output in AUTO, ``seconds`` after the last time."""

    def pass_out(self) -> None:
        """Out of service: the output keeps its value."""
        self.put(self.output, {"value": self.value(self.output), "status": PASSIVE[self.device.condensed]})

    def value(self, name: str) -> Scalar:
        """The value of a parameter with status."""
        return cast("Mapping[str, Scalar]", self.get(name))["value"]


class Alarms:
    """The limits of a block with hysteresis: bits of ALARM_SUM, alarm parameters, status octets."""

    def __init__(self, block: FunctionBlock) -> None:
        self._block = block
        self._standing: set[str] = set()

    def judge(self, value: float, status: int) -> int:
        """The status with the limits that ``value`` is beyond."""
        block = self._block
        hysteresis = block.number_of("alarm_hys")
        bits, result = 0, status
        for limit, alarm, bit, shown in _LIMITS:
            beyond = self._is_beyond(limit, value, hysteresis)
            self._note(alarm, beyond, value)
            if beyond:
                bits |= bit
                if result == status:
                    result = shown if status == GOOD else status | (HIGH if shown & HIGH else LOW)
        block.alarms = bits
        return result

    def _is_beyond(self, limit: str, value: float, hysteresis: float) -> bool:
        edge = self._block.number_of(limit)
        stands = hysteresis if limit in self._standing else 0.0
        beyond = value >= edge - stands if limit.startswith("hi") else value <= edge + stands
        (self._standing.add if beyond else self._standing.discard)(limit)
        return beyond

    def _note(self, alarm: str, beyond: bool, value: float) -> None:
        block = self._block
        known = cast("Mapping[str, Scalar]", block.get(alarm))
        if bool(known["state"]) == beyond:
            return
        time = (block.device.now // 1_000_000).to_bytes(8, "big")
        block.put(alarm, {**known, "state": int(beyond), "time": time, "value": value})


class AnalogueInput(FunctionBlock):
    """AI: PV_SCALE, LIN_TYPE, OUT_SCALE, filter, limits, fail-safe."""

    view = ("out",)
    linearisations = (tables.NONE, tables.ROOT)

    def __init__(self, number: int, values: Mapping[str, ParameterValue]) -> None:
        super().__init__(f"AI{number}", 1, 1, values)
        self._alarms = Alarms(self)
        self._filtered: float | None = None
        self._usable: float | None = None

    def follow_unit(self, change: Callable[[float], float]) -> None:
        """The unit of the channel changed: PV_SCALE follows, OUT stays."""
        self.map_numbers("pv_scale", change)
        self._filtered = None if self._filtered is None else change(self._filtered)

    def _compute(self, seconds: float) -> None:
        measured, status = self.measured()
        value = self._scaled(self._filter(measured, seconds))
        if self.device.fails_safe or is_bad(status):
            value, status = self._fail_safe(value, status)
        else:
            self._usable = value
        status = self._alarms.judge(value, status) if not is_bad(status) else status
        if status == GOOD and self.is_updated:
            status = _UPDATED
        self.put_value("out", value, status)

    def _filter(self, value: float, seconds: float) -> float:
        time = self.number_of("pv_ftime")
        if self._filtered is None or time <= 0:
            self._filtered = value
        else:
            self._filtered += (value - self._filtered) * -math.expm1(-seconds / time)
        return self._filtered

    def _scaled(self, value: float) -> float:
        low, high = self.part("pv_scale", "eu_0"), self.part("pv_scale", "eu_100")
        share = tables.linearised(self.whole("lin_type"), ratio(value - low, high - low))
        low, high = self.part("out_scale", "eu_0"), self.part("out_scale", "eu_100")
        return low + share * (high - low)

    def _fail_safe(self, value: float, status: int) -> tuple[float, int]:
        condensed = self.device.condensed
        if not is_bad(status):
            status = 0x00  # somebody ordered fail-safe, and the sensor is whole
        kind = self.whole("fsafe_type")
        if kind == _VALUE:
            return self.number_of("fsafe_value"), SUBSTITUTE[condensed]
        if kind == _AS_IT_IS:
            return value, status
        if self._usable is None:
            return float(self.part("out", "value")), INITIAL[condensed]
        return self._usable, LAST_USABLE[condensed]


class DiscreteInput(FunctionBlock):
    """DI: the state of a switch, inverted or not, with fail-safe."""

    output = "out_d"
    view = ("out_d",)

    def __init__(self, number: int, values: Mapping[str, ParameterValue]) -> None:
        super().__init__(f"DI{number}", 1, 2, values)
        self._usable: int | None = None

    def _compute(self, seconds: float) -> None:
        measured, status = self.measured()
        value = int(bool(measured) ^ bool(self.whole("invert"))) if not self.is_simulated else int(measured)
        condensed = self.device.condensed
        if self.device.fails_safe or is_bad(status):
            kind = self.whole("fsafe_type")
            if kind == _VALUE:
                value, status = self.whole("fsafe_val_d"), SUBSTITUTE[condensed]
            elif kind == _LAST:
                known = self._usable is not None
                value, status = self._usable or 0, (LAST_USABLE if known else INITIAL)[condensed]
        else:
            self._usable = value
            status = _UPDATED if status == GOOD and self.is_updated else status
        self.put("out_d", {"value": value & 0xFF, "status": status})


class Totaliser(FunctionBlock):
    """TOT: the integral of a flow over the machine's time, in UNIT_TOT."""

    output = "total"
    view = ("total",)
    units: Mapping[str, Sequence[str]] = {
        "unit_tot": ("total", "preset_tot", "alarm_hys", "hi_hi_lim", "hi_lim", "lo_lim", "lo_lo_lim")
    }

    def __init__(self, number: int, values: Mapping[str, ParameterValue]) -> None:
        super().__init__(f"TOT{number}", 5, 8, values)
        self._alarms = Alarms(self)
        #: the sum, more exact than the 32 bits of TOTAL
        self._sum = 0.0
        self._flow = 0.0

    def change_unit(self, name: str, before: int) -> None:
        super().change_unit(name, before)
        self._sum = convert(self._sum, before, self.whole(name))

    def preset(self, value: float) -> None:
        """Count on from ``value``."""
        self._sum = value

    def written(self, name: str, before: ParameterValue) -> None:
        super().written(name, before)
        if name == "total":
            self._sum = float(self.part("total", "value"))

    def _compute(self, seconds: float) -> None:
        flow, status = self.measured()
        if self.device.fails_safe:
            status = 0x00
        if is_bad(status):
            flow, status = self._failed(flow, status)
        else:
            self._flow = flow
        self._sum = nearest_f32(self._sum + self._counted(flow) * seconds / _H)
        if preset := self.whole("set_tot"):
            self._sum = self.number_of("preset_tot") if preset == 2 else 0.0
            status = status if is_bad(status) else status | CONSTANT
        self.put_value("total", self._sum, self._alarms.judge(self._sum, status) if not is_bad(status) else status)

    def _failed(self, flow: float, status: int) -> tuple[float, int]:
        kind = self.whole("fail_tot")
        if kind == _MEMORY:
            return self._flow, LAST_USABLE[self.device.condensed]
        return (0.0, status) if kind == _HOLD else (flow, 0x40 if not self.device.condensed else 0x68)

    def _counted(self, flow: float) -> float:
        """What the flow gives in an hour, in UNIT_TOT and as MODE_TOT counts it."""
        mode = self.whole("mode_tot")
        source = self.source
        if mode == 3 or source is None:
            return 0.0
        counted = per_hour(flow, source[0].unit_of(source[1]), self.whole("unit_tot"))
        return max(counted, 0.0) if mode == 1 else min(counted, 0.0) if mode == 2 else counted

    def check(self, name: str, value: ParameterValue) -> None:
        super().check(name, value)
        if name == "channel" and (found := self._source(cast("int", value))) is not None:
            try:
                per_hour(0, found[0].unit_of(found[1]), self.whole("unit_tot"))
            except (UsageError, StopIteration):
                raise RecordRefused(Code.INVALID_RANGE) from None
