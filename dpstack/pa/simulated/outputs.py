"""Function blocks of actuators: analogue output and discrete output.

A set point counts while its status is good. Otherwise the block waits FSAFE_TIME and goes to fail-safe; the status
"initiate fail-safe" sends it there at once. Sources: docs/reference/decisions/pa.md#simulated-devices.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, cast

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.errors import RecordRefused
from dpstack.pa.datatypes import ParameterValue
from dpstack.pa.simulated import tables
from dpstack.pa.simulated.block import AUTO, LOCAL, MAN, OUT_OF_SERVICE, RCAS
from dpstack.pa.simulated.faults import GOOD, HIGH, LOW
from dpstack.pa.simulated.inputs import FunctionBlock, is_bad
from dpstack.pa.simulated.transducers import ActuatorTransducer, share_of, value_at
from dpstack.units import NEVER, NS_PER_S

#: status octets without limits by which a control block orders fail-safe
_INITIATE: Final = (0xA0, 0xE0)
#: FSAFE_TYPE: FSAFE_VALUE, the last set point, the position without supply
_VALUE, _LAST, _WITHOUT_SUPPLY = range(3)
#: POS_D
NOT_INITIALISED, CLOSED, OPEN, BETWEEN = range(4)
#: percent from the end at which the valve counts as closed or open
_AT_END: Final = 0.5
#: CHECK_BACK: octet, bit
FAIL_SAFE, LOCAL_OPERATION, OVERRIDE, TRAVEL_TIME = (0, 0), (0, 2), (0, 3), (0, 7)
OPENS, CLOSES, UPDATED, SIMULATED, CONTROL_ERROR, INACTIVE, SELF_TEST = (
    (1, 0),
    (1, 1),
    (1, 2),
    (1, 3),
    (1, 5),
    (1, 6),
    (1, 7),
)
TRAVEL_LIMIT: Final = (2, 0)
_ALL: Final = (
    FAIL_SAFE, LOCAL_OPERATION, OVERRIDE, TRAVEL_TIME, OPENS, CLOSES, UPDATED, SIMULATED, CONTROL_ERROR, INACTIVE,
    SELF_TEST, TRAVEL_LIMIT,
)  # fmt: skip


def _check_back(bits: Mapping[tuple[int, int], bool]) -> bytes:
    octets = bytearray(3)
    for (octet, bit), on in bits.items():
        octets[octet] |= on << bit
    return bytes(octets)


class Output(FunctionBlock):
    """The common part of AO and DO: which set point counts, and when fail-safe begins."""

    permitted = OUT_OF_SERVICE | MAN | AUTO | RCAS
    #: set point, and the one of the mode RCAS
    set_point, remote = "sp", "rcas_in"

    def __init__(self, name: str, of_class: int, values: Mapping[str, ParameterValue]) -> None:
        #: time in ns since which no set point is good; None: one is
        self._missing_since: int | None = 0
        #: the fail-safe of the set point is in force
        self.is_safe = True
        self._moves = 0.0
        super().__init__(name, 2, of_class, values)
        self.put("check_back_mask", _check_back(dict.fromkeys(_ALL, True)))

    def actual_mode(self) -> int:
        wanted = super().actual_mode()
        if self.device.is_local and wanted != OUT_OF_SERVICE:
            return LOCAL
        if wanted == RCAS and int(self.part(self.remote, "status")) < GOOD:
            return AUTO
        return wanted

    @property
    def due(self) -> int:
        """When fail-safe begins, in ns; NEVER while a good set point stands, or if it has begun."""
        if self._missing_since is None or self.is_safe:
            return NEVER
        return self._missing_since + round(self.number_of("fsafe_time") * NS_PER_S)

    def supervise(self) -> None:
        """Judge the status of the set point."""
        status = int(self.part(self._source_of_set_point, "status"))
        if self.mode in (MAN, LOCAL, OUT_OF_SERVICE):
            self._missing_since, self.is_safe = None, False
        elif status & 0xFC in _INITIATE:
            self._missing_since, self.is_safe = self.device.now, True
        elif status >= GOOD:
            self._missing_since, self.is_safe = None, False
        else:
            if self._missing_since is None:
                self._missing_since = self.device.now
            self.is_safe = self.is_safe or self.device.now >= self.due

    @property
    def _source_of_set_point(self) -> str:
        return self.remote if self.mode == RCAS else self.set_point

    def wanted(self) -> float | None:
        """The set point that counts; None: the position without supply."""
        if self.device.fails_safe or self.mode == OUT_OF_SERVICE:
            return None
        if not self.is_safe:
            if self._missing_since is None:
                self._good = float(cast("float", self.value(self._source_of_set_point)))
            return self._good
        kind = self.whole("fsafe_type")
        return self._safe_value() if kind == _VALUE else self._good if kind == _LAST else None

    _good = 0.0

    def _safe_value(self) -> float:
        raise NotImplementedError

    def _bits(self, position: float, aim: float) -> dict[tuple[int, int], bool]:
        device = self.device
        return {
            FAIL_SAFE: self.is_safe or device.fails_safe,
            LOCAL_OPERATION: device.is_local,
            OVERRIDE: device.fails_safe,
            TRAVEL_TIME: device.is_blocked,
            OPENS: self._moves > 0,
            CLOSES: self._moves < 0,
            UPDATED: self.is_updated,
            SIMULATED: self.is_simulated,
            CONTROL_ERROR: device.is_blocked,
            INACTIVE: self.mode in (MAN, OUT_OF_SERVICE),
        }


class AnalogueOutput(Output):
    """AO: SP becomes a position of the valve; READBACK, POS_D and CHECK_BACK say where it is."""

    output, channel = "out", "out_channel"
    view = ("readback", "pos_d", "check_back")

    def __init__(self, number: int, values: Mapping[str, ParameterValue]) -> None:
        super().__init__(f"AO{number}", 1, values)

    @property
    def actuator(self) -> ActuatorTransducer | None:
        """The transducer block of the valve."""
        found = self.source
        return found[0] if found is not None and isinstance(found[0], ActuatorTransducer) else None

    def _safe_value(self) -> float:
        return self.number_of("fsafe_value")

    def step(self, seconds: float) -> None:
        actuator = self.actuator
        if actuator is None:
            return
        self.supervise()
        self._drive(actuator)
        self._moves = 0.0 if actuator.blocked or actuator.has_arrived else actuator.target - actuator.position
        self._report(actuator)

    def _drive(self, actuator: ActuatorTransducer) -> None:
        wanted = self.wanted()
        if self.device.is_local:
            return
        if wanted is None:
            # ACTUATOR_ACTION: 1 opens without supply, 2 closes
            actuator.target = {1: 100.0, 2: 0.0}.get(actuator.whole("actuator_action"), actuator.position)
        else:
            if self.mode != MAN:
                share = min(max(share_of(self, "pv_scale", wanted), 0.0), 1.0)
                share = 1 - share if self.whole("increase_close") else share
                self.put_value("out", value_at(self, "out_scale", share), GOOD)
            actuator.target = self._cut(actuator, 100 * share_of(self, "out_scale", float(self.part("out", "value"))))

    @staticmethod
    def _cut(actuator: ActuatorTransducer, percent: float) -> float:
        """The position with tight closing, the table, and full opening."""
        percent = min(max(percent, 0.0), 100.0)
        low, high = actuator.number_of("setp_cutoff_dec"), actuator.number_of("setp_cutoff_inc")
        if percent <= low:
            return 0.0
        if high and percent >= high:
            return 100.0
        return 100 * tables.linearised(actuator.whole("lin_type"), percent / 100, actuator.table)

    def _report(self, actuator: ActuatorTransducer) -> None:
        share = actuator.position / 100
        share = 1 - share if self.whole("increase_close") else share
        value, status = value_at(self, "pv_scale", share), actuator.status
        if self.is_simulated:
            value, status = self.part("simulate", "value"), int(self.part("simulate", "status"))
        elif self.mode == OUT_OF_SERVICE:
            status = 0x1F if not self.device.condensed else 0x23
        at_end = LOW if actuator.position <= 0 else HIGH if actuator.position >= 100 else 0
        status = status | at_end if not is_bad(status) and not self.is_simulated else status
        self.put_value("readback", value, status)
        self.put("pos_d", {"value": _position(actuator.position), "status": status & 0xFC if at_end else status})
        set_point = float(cast("float", self.value(self._source_of_set_point)))
        self.put("setp_deviation", set_point - value)
        self.put_value("rcas_out", set_point, int(self.part(self._source_of_set_point, "status")))
        bits = self._bits(actuator.position, actuator.target)
        limit = actuator.number_of("total_valve_travel_limit")
        bits[SELF_TEST] = actuator.calibrating > 0
        bits[TRAVEL_LIMIT] = 0 < limit < actuator.number_of("total_valve_travel")
        self.put_octets("check_back", _check_back(bits))

    def check(self, name: str, value: ParameterValue) -> None:
        super().check(name, value)
        if name == "fsafe_value" and isinstance(value, float):
            low, high = sorted((self.part("pv_scale", "eu_0"), self.part("pv_scale", "eu_100")))
            if not low <= value <= high:
                raise RecordRefused(Code.INVALID_RANGE)


class DiscreteOutput(Output):
    """DO: SP_D switches the output of the process; READBACK_D says how it stands."""

    output, set_point, remote = "out_d", "sp_d", "rcas_in_d"
    view = ("readback_d", "check_back")

    def __init__(self, number: int, values: Mapping[str, ParameterValue]) -> None:
        super().__init__(f"DO{number}", 2, values)

    def _safe_value(self) -> float:
        return float(self.whole("fsafe_val_d"))

    def step(self, seconds: float) -> None:
        found = self.source
        if found is None:
            return
        self.supervise()
        wanted = self.wanted()
        process, name = self.device.process, found[0].quantity
        if not self.device.is_local and not self.device.is_blocked:
            if self.mode == MAN:
                value = int(self.part("out_d", "value"))
            else:
                value = int(bool(wanted or 0) ^ bool(self.whole("invert")))
                self.put("out_d", {"value": value, "status": GOOD})
            process[name] = float(value > 0)
        self._report(int(process[name] > 0) ^ self.whole("invert"), found[0].status)

    def _report(self, state: int, status: int) -> None:
        if self.is_simulated:
            state, status = int(self.part("simulate", "value")), int(self.part("simulate", "status"))
        elif self.mode == OUT_OF_SERVICE:
            status = 0x1F if not self.device.condensed else 0x23
        self.put("readback_d", {"value": state, "status": status})
        source = self._source_of_set_point
        self.put("rcas_out_d", {"value": int(self.part(source, "value")), "status": int(self.part(source, "status"))})
        self.put_octets("check_back", _check_back(self._bits(state, state)))


def _position(percent: float) -> int:
    """POS_D of a position."""
    return CLOSED if percent <= _AT_END else OPEN if percent >= 100 - _AT_END else BETWEEN
