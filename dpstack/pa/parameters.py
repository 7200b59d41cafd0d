"""Parameters of a device by name: ``ai1.pv_scale``, ``ai1.pv_scale.eu_0``, ``tb1.lower_range``, or ``1:110``.

Also the unit of each value, and what a comparison of two devices looks at. Sources: docs/reference/decisions/pa.md.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from typing import Final, Protocol

from msgspec import Struct, structs

from dpstack.errors import UsageError
from dpstack.pa.blocks import Parameter
from dpstack.pa.datatypes import datatype
from dpstack.pa.walk import Block, Layout
from dpstack.text import brief, did_you_mean, some_of

#: slot and index as typed
_PLACE: Final = re.compile(r"(\d{1,3}):(\d{1,3})")
_HIGHEST_SLOT: Final = 254
_HIGHEST_INDEX: Final = 255


class MakersParameter(Protocol):
    """A parameter of the maker's from a device file: by block and relative index, or by slot and index."""

    @property
    def name(self) -> str: ...
    @property
    def block(self) -> str: ...
    @property
    def relative(self) -> int | None: ...
    @property
    def slot(self) -> int | None: ...
    @property
    def index(self) -> int | None: ...
    @property
    def type(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def access(self) -> str: ...
    @property
    def words(self) -> Mapping[int, str]: ...


class Group(Enum):
    """The part that a parameter has in a comparison of two devices."""

    CONFIGURATION = "configuration"
    IDENTITY = "identity"
    MEASURED = "measured"
    #: octets without a known meaning
    UNKNOWN = "unknown"


class Target(Struct, frozen=True):
    """A parameter of a device, or an element of it.

    ``name``: with its block; ``kind``: data type, empty for octets without one; ``element``: of a structure, or None;
    ``makers``: its line in the device file.
    """

    name: str
    slot: int
    index: int
    kind: str = ""
    access: str = "rw"
    storage: str = ""
    block: Block | None = None
    parameter: str = ""
    element: str | None = None
    makers: MakersParameter | None = None

    @property
    def is_writable(self) -> bool:
        return "w" in self.access or self.access == "rm"

    @property
    def group(self) -> Group:
        """The part that it has in a comparison."""
        return _group(self)


#: set by a switch at the device
_SWITCHES: Final = frozenset({"hw_write_protection", "feature"})
#: read only, kept without supply, and yet no property of the device
_COUNTED: Final = frozenset({"st_rev", "tab_actual_number", "self_calib_status"})
#: kept without supply, and yet no configuration: drag indicators and counters
_COUNTS: Final = ("max_sensor_", "min_sensor_", "max_temperature", "min_temperature", "total_valve_travel")
_NO_SETTINGS: Final = frozenset({"total_valve_travel", "set_tot", "zero_point_adjust", "self_calib_cmd"})


def _group(target: Target) -> Group:
    name = target.parameter
    if not target.kind or (target.makers is not None and target.kind.startswith("octets")):
        return Group.UNKNOWN
    if name in _SWITCHES or target.storage == "S":
        return Group.CONFIGURATION
    if target.storage == "C" or (target.storage == "N" and target.access == "r" and name not in _COUNTED):
        return Group.IDENTITY
    kept = target.storage == "N" and target.access == "rw" and name not in _NO_SETTINGS
    return Group.CONFIGURATION if kept and not name.startswith(_COUNTS) else Group.MEASURED


# --- names ----------------------------------------------------------------------------------------------------------


def targets_of(block: Block, makers: Iterable[MakersParameter] = ()) -> list[Target]:
    """The parameters of ``block`` in the order of their indices, those of the device file among them."""
    found = {one.name: _of_profile(block, one) for one in block.parameters()}
    for one in makers:
        if _place_in(block, one) is not None:
            found[one.name.lower()] = _of_maker(block, one)
    return sorted(found.values(), key=lambda one: (one.slot, one.index))


def _of_profile(block: Block, one: Parameter, name: str = "") -> Target:
    kind, place = one.kind, block.index + one.relative
    return Target(f"{block.name}.{name or one.name}", block.slot, place, kind, one.access, one.storage, block, one.name)


def _of_maker(block: Block, one: MakersParameter) -> Target:
    place = _place_in(block, one)
    assert place is not None
    slot, index = place
    storage = "S" if "w" in one.access else "D"
    name = one.name.lower()
    return Target(f"{block.name}.{name}", slot, index, one.type, one.access, storage, block, name, makers=one)


def _place_in(block: Block, one: MakersParameter) -> tuple[int, int] | None:
    """Slot and index of a maker's parameter of ``block``; None if it belongs to another one."""
    if one.relative is not None:
        index = block.index + one.relative
        mine = one.block.lower() in (block.name, block.short.lower())
        return (block.slot, index) if mine and index <= _HIGHEST_INDEX else None
    if one.slot is None or one.index is None:
        return None
    if one.block:
        return (one.slot, one.index) if one.block.lower() == block.name else None
    within = block.index <= one.index < block.index + max(block.object.parameters, 1)
    return (one.slot, one.index) if one.slot == block.slot and within else None


def find(layout: Layout, name: str, makers: Sequence[MakersParameter] = ()) -> Target:
    """The parameter that ``name`` means: block and parameter, perhaps an element of it, or slot and index.

    Raises UsageError with the nearest name.
    """
    if match := _PLACE.fullmatch(name.strip()):
        return _by_place(layout, int(match[1]), int(match[2]), makers)
    block_name, _, rest = name.strip().lower().partition(".")
    block = block_named(layout, block_name)
    if not rest:
        raise UsageError(f"{block_name} is a block: name a parameter of it, for instance {block_name}.tag_desc")
    parameter, _, element = rest.partition(".")
    parameter, element = _alias(block, parameter, element)
    known = {one.parameter: one for one in targets_of(block, makers)}
    if parameter == _VIEW and block.view_1 is not None:
        return Target(f"{block.name}.{_VIEW}", *block.view_1, access="r", block=block, parameter=_VIEW)
    if parameter not in known:
        hint = did_you_mean(parameter, [*known, *_aliases(block)], f"it has {some_of(known, 60)}")
        raise UsageError(f"{block.name} ({block.kind.words}) has no parameter {brief(parameter)}; {hint}")
    return _element_of(known[parameter], element) if element else known[parameter]


_VIEW: Final = "view_1"


def block_named(layout: Layout, name: str) -> Block:
    """The block ``name``. Raises UsageError naming those there are."""
    block = layout.block(name)
    if block is None:
        names = [one.name for one in layout.blocks]
        hint = did_you_mean(name.lower(), names, f"it has {some_of(names, 20)}.")
        raise UsageError(
            f"the device has no block {brief(name)}; {hint} Any record has its slot and index as a name: 1:110"
        )
    return block


def _element_of(found: Target, element: str) -> Target:
    elements = dict(datatype(found.kind).elements)
    if element not in elements:
        has = f"it has {', '.join(elements)}" if elements else "it has no elements"
        raise UsageError(f"{found.name} has no element {brief(element)}; {did_you_mean(element, elements, has)}")
    return structs.replace(found, name=f"{found.name}.{element}", element=element)


def _by_place(layout: Layout, slot: int, index: int, makers: Sequence[MakersParameter]) -> Target:
    """The parameter at a place if it is known, else its octets."""
    if slot > _HIGHEST_SLOT or index > _HIGHEST_INDEX:
        raise UsageError(f"{slot}:{index}: slots are 0 to {_HIGHEST_SLOT}, indices 0 to {_HIGHEST_INDEX}")
    near = [block for block in layout.blocks if block.slot == slot]
    found = [one for block in near for one in targets_of(block, makers) if (one.slot, one.index) == (slot, index)]
    if found:  # a name of the device file says more than that of the profile
        return next((one for one in found if one.makers is not None), found[0])
    return Target(f"{slot}:{index}", slot, index)


#: names that technicians use: block, then parameter and element
_ALIASES: Final[Mapping[str, Mapping[str, str]]] = {
    "AI": {"lower_range": "pv_scale.eu_0", "upper_range": "pv_scale.eu_100", "unit": "out_scale.unit"},
    "AO": {"lower_range": "pv_scale.eu_0", "upper_range": "pv_scale.eu_100", "unit": "pv_scale.unit"},
    "TOT": {"unit": "unit_tot"},
    "TB1": {"lower_range": "scale_in.eu_0", "upper_range": "scale_in.eu_100", "unit": "primary_value_unit"},
    "TB2": {"unit": "primary_value_unit"},
    "TB4": {"lower_range": "cal_point_lo", "upper_range": "cal_point_hi", "unit": "primary_value_unit"},
}


def _kind_key(block: Block) -> str:
    return f"TB{block.object.parent_class}" if block.short == "TB" else block.short


def _aliases(block: Block) -> Mapping[str, str]:
    return {"tag": "tag_desc", "mode": "mode_blk"} | dict(_ALIASES.get(_kind_key(block), {}))


def _alias(block: Block, parameter: str, element: str) -> tuple[str, str]:
    if element or parameter not in (known := _aliases(block)):
        return parameter, element
    name, _, inside = known[parameter].partition(".")
    return name, inside


# --- units ----------------------------------------------------------------------------------------------------------

#: where the unit of a value stands: the unit's place, then the parameters
_UNITS: Final[Mapping[str, Sequence[str]]] = {
    "AI": (
        "out_scale.unit: out out_scale fsafe_value alarm_hys hi_hi_lim hi_lim lo_lim lo_lo_lim hi_hi_alm hi_alm lo_alm"
        " lo_lo_alm simulate",
    ),
    "AO": ("pv_scale.unit: sp rcas_in rcas_out readback pv_scale fsafe_value", "out_scale.unit: out out_scale"),
    "TOT": (
        "unit_tot: total preset_tot alarm_hys hi_hi_lim hi_lim lo_lim lo_lo_lim hi_hi_alm hi_alm lo_alm lo_lo_alm",
    ),
    "TB1": (
        "sensor_unit: sensor_value sensor_hi_lim sensor_lo_lim cal_point_hi cal_point_lo cal_min_span trimmed_value"
        " max_sensor_value min_sensor_value",
        "primary_value_unit: primary_value scale_out",
        "temperature_unit: temperature max_temperature min_temperature",
        "secondary_value_1_unit: secondary_value_1 scale_in",
        "secondary_value_2_unit: secondary_value_2",
    ),
    "TB2": (
        "primary_value_unit: primary_value secondary_value_1 secondary_value_2 bias_1 bias_2 upper_sensor_limit"
        " lower_sensor_limit max_sensor_value_1 min_sensor_value_1 max_sensor_value_2 min_sensor_value_2 rj_temp"
        " external_rj_value",
    ),
    "TB3": (
        "zero_point_unit: zero_point",
        "nominal_size_units: nominal_size",
        *(
            f"{one}_units: {one} {one}_lo_limit {one}_hi_limit"
            for one in (
                "volume_flow",
                "mass_flow",
                "density",
                "temperature",
                "vortex_freq",
                "sound_velocity",
                "sampling_freq",
            )
        ),
    ),
    "TB4": (
        "primary_value_unit: primary_value",
        "level_unit: level level_lo level_hi level_offset",
        "sensor_unit: sensor_value sensor_offset cal_point_lo cal_point_hi sensor_high_limit sensor_low_limit"
        " max_sensor_value min_sensor_value",
        "secondary_value_1_unit: secondary_value_1",
        "secondary_value_2_unit: secondary_value_2",
        "temperature_unit: temperature max_temperature min_temperature",
    ),
}
#: units that no parameter holds
_FIXED: Final[Mapping[str, str]] = {"pv_ftime": "s", "fsafe_time": "s"}


@functools.cache
def _unit_places(key: str) -> Mapping[str, tuple[str, str | None]]:
    found: dict[str, tuple[str, str | None]] = {}
    for line in _UNITS.get(key, ()):
        place, _, names = line.partition(": ")
        parameter, _, element = place.partition(".")
        found |= dict.fromkeys(names.split(), (parameter, element or None))
    return found


def fixed_unit(target: Target) -> str:
    """The unit that the profile or the device file fixes; empty without one, or if another parameter holds it."""
    if target.makers is not None:
        return target.makers.unit
    return _FIXED.get(target.parameter, "")


def unit_target(layout: Layout, target: Target, channel: int | None = None) -> Target | None:
    """The parameter that holds the unit of ``target``; None if none does.

    ``channel``: CHANNEL of the function block, for PV_SCALE of an analogue input, whose unit is that of the transducer
    block's value.
    """
    block = target.block
    if block is None:
        return None
    if block.short == "AI" and target.parameter == "pv_scale":
        source = None if channel is None else channel_target(layout, channel)
        return None if source is None else unit_target(layout, source)
    place = _unit_places(_kind_key(block)).get(target.parameter)
    if place is None:
        return None
    parameter, element = place
    found = next((one for one in targets_of(block) if one.parameter == parameter), None)
    return found if found is None or element is None else _element_of(found, element)


def channel_target(layout: Layout, channel: int) -> Target | None:
    """The value of a transducer block that CHANNEL names: number of the block, then relative index."""
    number, relative = divmod(channel, 0x100)
    block = layout.block(f"tb{number}")
    if block is None or not relative:
        return None
    return next((one for one in targets_of(block) if one.index == block.index + relative), None)


# --- overviews ------------------------------------------------------------------------------------------------------

#: the parameters of an overview by kind of block, besides tag, mode and alarms
_SHOWN: Final[Mapping[str, str]] = {
    "PB": "software_revision hardware_revision device_man_id device_id device_ser_num diagnosis diagnosis_extension"
    " descriptor device_message device_instal_date write_locking ident_number_selector hw_write_protection feature",
    "AI": "out pv_scale out_scale lin_type channel simulate",
    "DI": "out_d channel simulate",
    "AO": "sp readback pos_d check_back out pv_scale simulate",
    "DO": "sp_d readback_d out_d check_back simulate",
    "TOT": "total unit_tot mode_tot channel",
    "TB1": "sensor_value primary_value temperature scale_in scale_out lin_type sensor_lo_lim sensor_hi_lim",
    "TB2": "primary_value secondary_value_1 lin_type sensor_connection lower_sensor_limit upper_sensor_limit"
    " input_fault_gen",
    "TB3": "volume_flow mass_flow density temperature volume_flow_hi_limit",
    "TB4": "primary_value level sensor_value cal_point_lo cal_point_hi level_lo level_hi temperature",
    "TB5": "rated_travel lin_type actuator_action self_calib_status",
}
_ALWAYS: Final = "tag_desc target_mode mode_blk alarm_sum"


def shown_targets(block: Block, makers: Iterable[MakersParameter] = ()) -> list[Target]:
    """The parameters of ``block`` that an overview reads: tag, mode, alarms, then values, ranges and identity."""
    wanted = f"{_ALWAYS} {_SHOWN.get(_kind_key(block), '')}".split()
    known = {one.parameter: one for one in targets_of(block)}
    return [known[name] for name in wanted if name in known]


#: limits of a sensor within which a range must lie: parameter, then those of the lower and the upper limit; all in one
#: unit
LIMITED: Final[Mapping[str, Mapping[str, tuple[str, str]]]] = {
    "TB1": dict.fromkeys(("cal_point_lo", "cal_point_hi"), ("sensor_lo_lim", "sensor_hi_lim")),
    "TB4": dict.fromkeys(("cal_point_lo", "cal_point_hi"), ("sensor_low_limit", "sensor_high_limit")),
}


def limits_of(target: Target) -> tuple[str, str] | None:
    """The parameters of the block with the least and the greatest value of ``target``; None without them."""
    return None if target.block is None else LIMITED.get(_kind_key(target.block), {}).get(target.parameter)
