"""A block of a simulated device: its parameters as octets, and the rules of reading and writing.

Sources: docs/reference/decisions/pa.md#simulated-devices.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Protocol, cast

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.errors import RecordRefused
from dpstack.pa.blocks import Parameter, block_class
from dpstack.pa.datatypes import ParameterValue, Scalar, datatype, encode_value, parse_value
from dpstack.pa.simulated.conversion import convert, quantity_of
from dpstack.units import NS_PER_S

#: modes, as in TARGET_MODE and MODE_BLK
OUT_OF_SERVICE, LOCAL, MAN, AUTO, RCAS = 0x80, 0x20, 0x10, 0x08, 0x02
#: ALARM_SUM: a static parameter was written, for so many seconds (classic, condensed)
UPDATE_EVENT: Final = 0x80
UPDATE_S: Final = (10, 20)
#: relative indexes between the last parameter of the profile and view 1, which makers use
_RESERVED: Final = 5
_VALUE: Final = struct.Struct(">fB")
_LARGEST: Final = 3.4e38
#: octets of a record
MAX_RECORD: Final = 240

#: parameters whose numbers are a list
_CHOICES: Final[Mapping[str, Sequence[int]]] = {
    "fsafe_type": (0, 1, 2),
    "set_tot": (0, 1, 2),
    "mode_tot": (0, 1, 2, 3),
    "fail_tot": (0, 1, 2),
    "invert": (0, 1),
    "increase_close": (0, 1),
    "local_op_ena": (0, 1),
    "cond_status_diag": (0, 1),
    "write_locking": (0, 2457),
    "factory_reset": (1, 2506, 2712),
    "ident_number_selector": (0, 1, 127),
}
#: parameters that are never negative
_POSITIVE: Final = frozenset({"pv_ftime", "alarm_hys", "fsafe_time", "deadband", "low_flow_cutoff", "low_flow_cut_off"})


class Surroundings(Protocol):
    """:class:`~dpstack.pa.simulated.device.ProcessDevice`, without what blocks need not know of it."""

    #: time in ns
    now: int
    #: values of the process by name
    process: dict[str, float]
    #: keys of the events that somebody ordered
    active: set[str]
    #: fail-safe is ordered
    fails_safe: bool
    #: somebody operates it on site
    is_local: bool
    #: a master ordered the address 126
    address_reset: bool

    @property
    def condensed(self) -> bool: ...

    @property
    def revision(self) -> int:
        """Profile_Revision of its block objects."""

    @property
    def status(self) -> int:
        """The status octet of a measured value, without limits."""

    @property
    def transducers(self) -> Sequence[Any]:
        """The transducer blocks in their order."""

    @property
    def events(self) -> Sequence[Any]:
        """The events of DIAGNOSIS that stand."""

    @property
    def is_checked(self) -> bool: ...

    @property
    def is_blocked(self) -> bool: ...

    def reset(self) -> None: ...

    def unit_changed(self, block: Any, name: str, before: int) -> None: ...


class Block:
    """A physical, function or transducer block. ``name``: ``PB``, ``AI1``, ``TB1``; ``values``: as delivered.

    Its place (``slot``, ``index``) and its device are set when a device is built. The octets of each parameter of the
    profile's table are kept, so a reader gets what was written. Refusals are
    :class:`~dpstack.errors.RecordRefused` with the codes of DP-V1.
    """

    #: modes that TARGET_MODE may have
    permitted = AUTO
    #: parameters with a unit: unit parameter -> the parameters that are in it and follow its change
    units: Mapping[str, Sequence[str]] = {}
    #: parameters of view 1 behind ST_REV, MODE_BLK and ALARM_SUM
    view: Sequence[str] = ()
    #: LIN_TYPE that the block can have
    linearisations: Sequence[int] = (0,)

    device: Surroundings

    def __init__(
        self, name: str, kind: int, parent: int, number: int, values: Mapping[str, ParameterValue] | None = None
    ) -> None:
        self.name = name
        self.kind, self.parent, self.number = kind, parent, number
        self.slot = self.index = 0
        #: slot and index that a device file gives it; 0: the next slot, the index of the profile
        self.wanted_slot = self.wanted_index = 0
        #: octets that somebody set in place of what the block computes, by parameter
        self.held: dict[str, bytes] = {}
        self.parameters = block_class(kind, parent, number).parameters
        self._by_relative = {one.relative: one for one in self.parameters.values()}
        self._octets: dict[str, bytes] = {}
        #: values of the octets, parsed when they are asked for
        self._parsed: dict[str, ParameterValue] = {}
        self._update_until = 0
        #: bits of ALARM_SUM that stand, beside the update event
        self.alarms = 0
        self._delivered = dict(values or {})
        self.reset()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name} slot {self.slot} index {self.index}>"

    def reset(self) -> None:
        """All parameters as delivered."""
        for one in self.parameters.values():
            blank = b" " if one.kind.startswith("text") else b"\0"
            self.put_octets(one.name, blank * datatype(one.kind).length)
        self.put("target_mode", AUTO)
        self.put("mode_blk", {"actual": AUTO, "permitted": self.permitted, "normal": AUTO})
        for name, value in self._delivered.items():
            self.put(name, value)

    # -- values --------------------------------------------------------------------------------------------------------

    def get(self, name: str) -> ParameterValue:
        """The value of a parameter."""
        found = self._parsed.get(name)
        if found is None:
            found = self._parsed[name] = parse_value(self.parameters[name].kind, self._octets[name])
        return found

    def number_of(self, name: str) -> float:
        """The value of a parameter that is a number."""
        return cast("float", self.get(name))

    def whole(self, name: str) -> int:
        """The value of a parameter that is a whole number."""
        return cast("int", self.get(name))

    def part(self, name: str, element: str) -> float:
        """An element of a structure."""
        return cast("float", cast("Mapping[str, Scalar]", self.get(name))[element])

    def put(self, name: str, value: ParameterValue) -> None:
        """Set a parameter, without any rule; a number that no 32 bit float has becomes the nearest one, or 0."""
        if isinstance(value, float):
            value = nearest_f32(value)
        elif isinstance(value, Mapping):
            value = {key: nearest_f32(one) if isinstance(one, float) else one for key, one in value.items()}
        self.put_octets(name, encode_value(self.parameters[name].kind, value))

    def octets_of(self, name: str) -> bytes:
        """The octets of a parameter."""
        return self._octets[name]

    def put_octets(self, name: str, octets: bytes) -> None:
        """Set the octets of a parameter, whatever they are."""
        self._octets[name] = octets
        self._parsed.pop(name, None)

    def put_value(self, name: str, value: float, status: int) -> None:
        """As :meth:`put`, for a parameter that has a value and its status octet."""
        octets = _VALUE.pack(nearest_f32(value), status)
        if octets != self._octets[name]:
            self.put_octets(name, octets)

    @property
    def mode(self) -> int:
        """The actual mode."""
        return int(self.part("mode_blk", "actual"))

    @property
    def last(self) -> int:
        """The highest relative index of the profile."""
        return max(self._by_relative)

    @property
    def count(self) -> int:
        """Number_Of_Parameters: relative indexes in use with the gaps between them, without the views."""
        return self.last + _RESERVED

    # -- access over records -------------------------------------------------------------------------------------------

    def has(self, relative: int) -> bool:
        """Whether a record stands at the relative index."""
        return relative in self._by_relative or relative == self.count

    def read(self, relative: int) -> bytes:
        """The record at a relative index. Raises RecordRefused."""
        if relative == self.count:
            return self.view_1()
        if relative == 0:
            return self.block_object()
        one = self._found(relative)
        if one.access == "w":
            raise RecordRefused(Code.ACCESS_DENIED)
        return self._octets[one.name]

    def write(self, relative: int, octets: bytes) -> None:
        """Write the record at a relative index. Raises RecordRefused."""
        one = self._found(relative)
        if one.access == "r":
            raise RecordRefused(Code.ACCESS_DENIED)
        if len(octets) != datatype(one.kind).length:
            raise RecordRefused(Code.WRITE_LENGTH_ERROR)
        value = parse_value(one.kind, octets)
        if not _is_finite(value):
            raise RecordRefused(Code.TYPE_CONFLICT)
        if one.access == "rm" and not self.mode & (MAN | OUT_OF_SERVICE):
            raise RecordRefused(Code.STATE_CONFLICT)
        self.check(one.name, value)
        before = self.get(one.name)
        self.put_octets(one.name, octets)
        if one.storage == "S":
            self.revise()
        self.written(one.name, before)

    def _found(self, relative: int) -> Parameter:
        if relative == self.count:
            raise RecordRefused(Code.ACCESS_DENIED)
        one = self._by_relative.get(relative)
        if one is None:
            raise RecordRefused(Code.INVALID_INDEX)
        return one

    def revise(self) -> None:
        """A static parameter changed: ST_REV counts up (after 65535 comes 1), the update event stands for a time."""
        self.put("st_rev", self.whole("st_rev") % 0xFFFF + 1)
        self._update_until = self.device.now + UPDATE_S[self.device.condensed] * NS_PER_S

    @property
    def is_updated(self) -> bool:
        """Whether the update event stands."""
        return self.device.now < self._update_until

    def block_object(self) -> bytes:
        """The block object, with the address of view 1."""
        return encode_value(
            "block",
            {
                "reserved": 250,
                "object": self.kind,
                "parent_class": self.parent,
                "class": self.number,
                "device_revision": 1,
                "compatible_revision": 1,
                "dd_revision": 0,
                "profile": 0x4002,
                "profile_revision": self.device.revision,
                "execution_time": 0,
                "parameters": self.count,
                "view_1": self.slot << 8 | (self.index + self.count) & 0xFF,
                "views": 1,
            },
        )

    def view_1(self) -> bytes:
        """View 1: ST_REV, MODE_BLK, ALARM_SUM and what changes."""
        return b"".join(self._octets[name] for name in ("st_rev", "mode_blk", "alarm_sum", *self.view))

    # -- for subclasses ------------------------------------------------------------------------------------------------

    def check(self, name: str, value: ParameterValue) -> None:
        """Raises RecordRefused for a value that this parameter cannot have."""
        if name == "target_mode":
            # one mode at a time, of those that are permitted
            _need(isinstance(value, int) and value.bit_count() == 1 and bool(value & self.permitted))
        elif name in _CHOICES:
            _need(value in _CHOICES[name])
        elif name == "lin_type":
            _need(value in self.linearisations)
        elif name in _POSITIVE:
            _need(isinstance(value, float) and value >= 0)
        elif name in self.units:
            _need(quantity_of(self.whole(name)) == quantity_of(cast("int", value)) is not None)
        elif self.parameters[name].kind in ("range", "scaling"):
            span = cast("Mapping[str, Scalar]", value)
            _need(span["eu_100"] != span["eu_0"])
        elif self.parameters[name].kind in ("simulate", "simulate_d"):
            _need(cast("Mapping[str, Scalar]", value)["enabled"] in (0, 1))

    def written(self, name: str, before: ParameterValue) -> None:
        """A parameter was written over a record."""
        if name in self.units:
            self.change_unit(name, cast("int", before))

    def change_unit(self, name: str, before: int) -> None:
        """Convert the parameters in the unit that ``name`` has, from that it had before."""
        after = self.whole(name)
        for follower in self.units[name]:
            self.map_numbers(follower, lambda value: convert(value, before, after))
        self.device.unit_changed(self, name, before)

    def map_numbers(self, name: str, change: Callable[[float], float]) -> None:
        """Change the number of a parameter, or those of its range."""
        value = self.get(name)
        if not isinstance(value, Mapping):
            self.put(name, change(self.number_of(name)))
            return
        numbers = {key: change(one) for key, one in value.items() if isinstance(one, float)}
        self.put(name, {**value, **numbers})

    def step(self, seconds: float) -> None:
        """Compute the block, ``seconds`` after the last time."""

    def settle(self) -> None:
        """MODE_BLK follows TARGET_MODE; ALARM_SUM has the alarms."""
        actual = self.actual_mode()
        if actual != self.mode:
            self.put("mode_blk", {"actual": actual, "permitted": self.permitted, "normal": AUTO})
        for name, octets in self.held.items():
            self.put_octets(name, octets)
        current = self.alarms | (UPDATE_EVENT if self.is_updated else 0)
        if self._octets["alarm_sum"][0] != current:
            self.put_octets("alarm_sum", bytes((current, 0)) + self._octets["alarm_sum"][2:])

    def actual_mode(self) -> int:
        """The mode that the block can have now."""
        return self.whole("target_mode")


def _need(fits: bool) -> None:
    if not fits:
        raise RecordRefused(Code.INVALID_RANGE)


def _is_finite(value: ParameterValue) -> bool:
    parts = value.values() if isinstance(value, Mapping) else (value,)
    return all(math.isfinite(part) for part in parts if isinstance(part, float))


def nearest_f32(value: float) -> float:
    """The nearest number within the range of a 32 bit float; 0 if it is not a number."""
    return 0.0 if math.isnan(value) else min(max(value, -_LARGEST), _LARGEST)


def ratio(part: float, whole: float) -> float:
    """``part`` of ``whole``; 0 of nothing."""
    return part / whole if whole else 0.0
