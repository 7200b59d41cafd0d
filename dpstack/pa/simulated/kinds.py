"""The kinds of simulated process devices: their transducer blocks, what their function blocks can follow, the process.

A device is built of a kind and of rows: kind of function block, name and slot, in the order of the slots.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

from dpstack.errors import UsageError
from dpstack.pa.datatypes import ParameterValue
from dpstack.pa.simulated import transducers as tb
from dpstack.pa.simulated.block import Block
from dpstack.pa.simulated.conversion import convert, quantity_of
from dpstack.pa.simulated.device import ProcessDevice
from dpstack.pa.simulated.directory_records import Layout
from dpstack.pa.simulated.inputs import AnalogueInput, DiscreteInput, FunctionBlock, Totaliser
from dpstack.pa.simulated.outputs import AnalogueOutput, DiscreteOutput
from dpstack.pa.simulated.physical import PhysicalBlock
from dpstack.pa.simulated.transducers import Transducer

CUBIC_METRE, KILOGRAM = 1034, 1088
#: unit code: the value has none
_NO_UNIT: Final = 1997
#: function blocks of a device with as many blocks as a directory may have
_MANY: Final = 253
_FAR: Final = 1e9
#: class of a physical block: not used
_UNUSED: Final = 250


class Channel(NamedTuple):
    """A value of the transducer blocks: CHANNEL, the range 0..100 % and its unit as delivered."""

    channel: int
    low: float
    high: float
    unit: int


class Row(NamedTuple):
    """A function block: ``AI``, ``AO``, ``DI``, ``DO`` or ``TOT``; the name of its value, its slot (0: the next one),
    the unit code of its value (0: that of the channel). ``at``: index of its block object (0: that of the profile)."""

    block: str
    name: str
    slot: int = 0
    unit: int = 0
    at: int = 0


class Kind(NamedTuple):
    """A kind of device.

    ``words``: for people; ``parent``: parent class of its physical block; ``transducers``: makes its transducer blocks;
    ``channels``: what analogue inputs and totalisers can follow, by name; ``rows``: the function blocks unless others
    are given; ``process``: the values around it, the first one is that which it measures or moves.
    """

    words: str
    parent: int
    transducers: Callable[[], list[Transducer]]
    channels: Mapping[str, Channel]
    rows: Sequence[Row]
    process: Mapping[str, float]


def _range(low: float, high: float) -> ParameterValue:
    return {"eu_100": high, "eu_0": low}


def _scaling(low: float, high: float, unit: int, decimals: int = 2) -> ParameterValue:
    return {"eu_100": high, "eu_0": low, "unit": unit, "decimals": decimals}


def _pressure() -> list[Transducer]:
    values: dict[str, ParameterValue] = {
        "tag_desc": "sensor",
        "sensor_hi_lim": 10.0,
        "sensor_lo_lim": -1.0,
        "cal_point_hi": 10.0,
        "cal_min_span": 0.1,
        "sensor_unit": tb.BAR,
        "sensor_type": 103,
        "sensor_serial_number": 1001,
        "primary_value_unit": tb.BAR,
        "sensor_max_static_pressure": 100.0,
        "temperature_unit": tb.CELSIUS,
        "secondary_value_1_unit": tb.BAR,
        "secondary_value_2_unit": tb.PERCENT,
        "scale_in": _range(0, 10),
        "scale_out": _range(0, 10),
    }
    return [tb.PressureTransducer(1, 1, 3, values)]


def _temperature() -> list[Transducer]:
    values: dict[str, ParameterValue] = {
        "tag_desc": "sensor",
        "primary_value_unit": tb.CELSIUS,
        "upper_sensor_limit": 850.0,
        "lower_sensor_limit": -200.0,
        "lin_type": 102,
        "sensor_connection": 2,
    }
    return [tb.TemperatureTransducer(1, 2, 2, values)]


def _level() -> list[Transducer]:
    values: dict[str, ParameterValue] = {
        "tag_desc": "sensor",
        "primary_value_unit": tb.PERCENT,
        "level_unit": tb.PERCENT,
        "sensor_unit": tb.METRE,
        "secondary_value_1_unit": tb.METRE,
        "secondary_value_2_unit": tb.PERCENT,
        "cal_point_hi": 10.0,
        "level_hi": 100.0,
        "lin_volume": 100.0,
        "sensor_high_limit": 20.0,
        "temperature_unit": tb.CELSIUS,
    }
    return [tb.LevelTransducer(1, 4, 2, values)]


def _flow() -> list[Transducer]:
    values: dict[str, ParameterValue] = {
        "tag_desc": "meter",
        "calibr_factor": 1.0,
        "nominal_size": 50.0,
        "nominal_size_units": tb.MILLIMETRE,
        "zero_point_unit": tb.CUBIC_METRES_PER_HOUR,
        "volume_flow_units": tb.CUBIC_METRES_PER_HOUR,
        "volume_flow_hi_limit": 100.0,
        "volume_flow_lo_limit": -100.0,
        "mass_flow_units": tb.KILOGRAMS_PER_HOUR,
        "mass_flow_hi_limit": 100_000.0,
        "mass_flow_lo_limit": -100_000.0,
        "density_units": tb.DENSITY,
        "density_hi_limit": 5000.0,
        "temperature_units": tb.CELSIUS,
        "temperature_hi_limit": 150.0,
        "temperature_lo_limit": -40.0,
        "vortex_freq_units": tb.HERTZ,
        "sound_velocity_units": tb.METRES_PER_SECOND,
        "sampling_freq_units": tb.HERTZ,
        "measurement_mode": 1,
    }
    return [tb.FlowTransducer(1, 3, 1, values)]


def _positioner() -> list[Transducer]:
    values: dict[str, ParameterValue] = {
        "tag_desc": "valve",
        "act_stroke_time_dec": 5.0,
        "act_stroke_time_inc": 5.0,
        "deadband": 0.1,
        "setp_cutoff_dec": 0.5,
        "setp_cutoff_inc": 99.5,
        "rated_travel": {"value": 20.0, "status": 0x80},
        "travel_limit_low": {"value": 0.0, "status": 0x80},
        "travel_limit_up": {"value": 100.0, "status": 0x80},
        "total_valve_travel_limit": 1e6,
        "actuator_man": "simulated",
        "actuator_type": 1,
        "actuator_action": 2,
    }
    return [tb.ActuatorTransducer(1, 5, 2, values)]


def _valve() -> list[Transducer]:
    return [tb.PlainTransducer(1, 6, 2, {"tag_desc": "coil"}, quantity="switch")]


_TEMPERATURE: Final = Channel(0, -50, 150, tb.CELSIUS)
_CLIMATE: Final = {"temperature": 20.0}
KINDS: Final[Mapping[str, Kind]] = {
    "pressure": Kind(
        "pressure transmitter",
        1,
        _pressure,
        {"pressure": Channel(0x0112, 0, 10, tb.BAR), "temperature": _TEMPERATURE._replace(channel=0x011B)},
        [Row("AI", "pressure")],
        {"pressure": 1.0, **_CLIMATE},
    ),
    "temperature": Kind(
        "temperature transmitter",
        1,
        _temperature,
        {
            "temperature": Channel(0x0108, 0, 100, tb.CELSIUS),
            "sensor_1": Channel(0x010A, 0, 100, tb.CELSIUS),
            "sensor_2": Channel(0x010B, 0, 100, tb.CELSIUS),
        },
        [Row("AI", "temperature")],
        {"temperature": 20.0, "second_temperature": 21.0, "ambient": 22.0},
    ),
    "level": Kind(
        "level transmitter",
        1,
        _level,
        {
            "level": Channel(0x0108, 0, 100, tb.PERCENT),
            "distance": Channel(0x010E, 0, 10, tb.METRE),
            "temperature": _TEMPERATURE._replace(channel=0x0120),
        },
        [Row("AI", "level")],
        {"level": 5.0, **_CLIMATE},
    ),
    "flow": Kind(
        "flow meter with totaliser",
        127,
        _flow,
        {
            "flow": Channel(0x0111, 0, 50, tb.CUBIC_METRES_PER_HOUR),
            "mass_flow": Channel(0x0115, 0, 50_000, tb.KILOGRAMS_PER_HOUR),
            "density": Channel(0x0119, 0, 2000, tb.DENSITY),
            "temperature": _TEMPERATURE._replace(channel=0x011D),
        },
        [Row("AI", "flow"), Row("AI", "mass_flow"), Row("TOT", "total")],
        {"flow": 10.0, "density": 1000.0, **_CLIMATE},
    ),
    "positioner": Kind("valve positioner", 2, _positioner, {}, [Row("AO", "position")], {"position": 0.0}),
    "valve": Kind(
        "on/off valve with feedback", 3, _valve, {}, [Row("DO", "valve"), Row("DI", "feedback")], {"switch": 0.0}
    ),
    "values": Kind("device with values of its own", 127, list, {}, [Row("AI", "value")], {}),
    "255 blocks": Kind(
        "transmitter with 255 blocks",
        1,
        _pressure,
        {"pressure": Channel(0x0112, 0, 10, tb.BAR)},
        [Row("AI", "pressure") for _ in range(_MANY)],
        {"pressure": 1.0, **_CLIMATE},
    ),
}


class Builder:
    """Puts the blocks of a device together: function blocks of ``rows`` at the channels of a kind."""

    def __init__(self, kind: Kind, rows: Sequence[Row]) -> None:
        self._kind = kind
        self.transducers = kind.transducers()
        self.process = dict(kind.process)
        self._left = [*kind.channels]
        self._counts: dict[str, int] = {}
        self.functions: dict[str, FunctionBlock] = {}
        self._names = [row.name for row in rows]
        for row in rows:
            self._add(row)

    def _add(self, row: Row) -> None:
        number = self._counts[row.block] = self._counts.get(row.block, 0) + 1
        block = getattr(self, f"_{row.block.lower()}")(row, number)
        block.wanted_slot, block.wanted_index = row.slot, row.at
        self.functions[row.name if row.name not in self.functions else block.name] = block

    def _ai(self, row: Row, number: int) -> FunctionBlock:
        found = self._channel(row)
        if row.unit and row.unit != found.unit and quantity_of(row.unit) == quantity_of(found.unit) is not None:
            low, high = (convert(value, found.unit, row.unit) for value in (found.low, found.high))
            shown = _scaling(low, high, row.unit)
        else:
            low, high = found.low, found.high
            shown = _scaling(low, high, found.unit)
        span = high - low
        return AnalogueInput(
            number,
            {
                "tag_desc": row.name[:32],
                "pv_scale": _range(found.low, found.high),
                "out_scale": shown,
                "channel": found.channel,
                "fsafe_type": 1,
                "alarm_hys": span / 200,
                "hi_hi_lim": _FAR,
                "hi_lim": _FAR,
                "lo_lim": -_FAR,
                "lo_lo_lim": -_FAR,
            },
        )

    def _channel(self, row: Row) -> Channel:
        """The channel of an input: the one of its name, else the next one that no other input is called after, else a
        value of its own."""
        known = self._kind.channels
        name = row.name if row.name in known else next((one for one in self._left if one not in self._names), "")
        if not name and len(known) == 1:
            name = next(iter(known))
        if name:
            self._left = [one for one in self._left if one != name]
            return known[name]
        return Channel(self._plain(row.name, 8, 1) << 8, 0, 100, row.unit or _NO_UNIT)

    def _plain(self, quantity: str, parent: int, of_class: int) -> int:
        """The number of a transducer block for a process value of its own."""
        number = len(self.transducers) + 1
        self.process.setdefault(quantity, 0.0)
        tag = {"tag_desc": quantity[:32]}
        self.transducers.append(tb.PlainTransducer(number, parent, of_class, tag, quantity=quantity))
        return number

    def _tot(self, row: Row, number: int) -> FunctionBlock:
        flows = [one for one in self._kind.channels.values() if quantity_of(one.unit) in ("volume flow", "mass flow")]
        source = flows[0] if flows else None
        is_mass = quantity_of(row.unit) == "mass" and len(flows) > 1
        source = flows[1] if is_mass else source
        unit = row.unit if quantity_of(row.unit) in ("volume", "mass") else CUBIC_METRE
        limits = {"hi_hi_lim": _FAR, "hi_lim": _FAR, "lo_lim": -_FAR, "lo_lo_lim": -_FAR}
        channel = 0 if source is None else source.channel
        tag = {"tag_desc": row.name[:32]}
        return Totaliser(number, {**tag, "unit_tot": unit, "channel": channel, "fail_tot": 1, **limits})

    def _ao(self, row: Row, number: int) -> FunctionBlock:
        if not self.transducers or not isinstance(self.transducers[0], tb.ActuatorTransducer):
            self.transducers[:0] = _positioner()
            self.process = {"position": 0.0, **self.process}
        percent = _scaling(0, 100, tb.PERCENT, 1)
        values: dict[str, ParameterValue] = {
            "tag_desc": row.name[:32],
            "pv_scale": percent,
            "out_scale": percent,
            "out_channel": 0x0100,
            "fsafe_time": 1.0,
            "fsafe_type": 2,
        }
        return AnalogueOutput(number, values)

    def _switch(self, row: Row) -> int:
        """CHANNEL of a discrete block: the coil of a valve, else a switch of its own."""
        at = next((n for n, one in enumerate(self.transducers, 1) if one.parent == 6 and one.number == 2), 0)
        return (at or self._plain(row.name, 6, 2 if row.block == "DO" else 1)) << 8

    def _di(self, row: Row, number: int) -> FunctionBlock:
        return DiscreteInput(number, {"tag_desc": row.name[:32], "channel": self._switch(row), "fsafe_type": 1})

    def _do(self, row: Row, number: int) -> FunctionBlock:
        values: dict[str, ParameterValue] = {"fsafe_time": 1.0, "fsafe_type": 0, "channel": self._switch(row)}
        return DiscreteOutput(number, {"tag_desc": row.name[:32], **values})


def process_device(
    kind: str,
    rows: Sequence[Row] = (),
    *,
    layout: Layout | None = None,
    condensed: bool = False,
    lie: str = "",
    identity: Mapping[str, ParameterValue] | None = None,
) -> ProcessDevice:
    """A simulated device of one of :data:`KINDS`, as delivered; ``rows``: its function blocks, those of the kind if
    left out; ``identity``: parameters of its physical block. Raises UsageError."""
    if kind not in KINDS:
        raise UsageError(f"no simulated process device {kind!r}; known: {', '.join(KINDS)}")
    found = KINDS[kind]
    built = Builder(found, rows or found.rows)
    texts: dict[str, ParameterValue] = {
        "tag_desc": found.words[:32],
        "software_revision": "1.0",
        "hardware_revision": "1.0",
        "device_man_id": 0xFFFF,
        "device_id": found.words[:16],
        "device_ser_num": "SIM-0001",
        "device_certification": "none, simulated",
        "descriptor": "simulated device",
        "device_instal_date": "2026-01-31",
        **(identity or {}),
    }
    blocks: list[Block] = [PhysicalBlock(found.parent, _UNUSED, texts)]
    device = ProcessDevice(
        [*blocks, *built.functions.values(), *built.transducers],
        built.process,
        layout=layout,
        condensed=condensed,
        lie=lie,
    )
    device.names = {block.name: name for name, block in built.functions.items()}
    return device
