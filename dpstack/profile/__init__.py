"""API of drive plugins: declared words, states and parameters, master side, simulated drive, registry.

- ``channel/``: The parameter channel in a drive's cyclic data
- ``master/``: Master side of a drive: state machine, orders, process data maps, comparison of settings
- ``model/``: Declarations of a drive plugin: words, states, parameters, telegrams; orders and status of a drive
- ``record47/``: PROFIdrive's parameter channel over DP-V1, record 47: both ends as pure machines
- ``simulator/``: The simulated drive
- ``drive_profile``: Profile of one drive: its data for bus, configuration and simulation, and its options
- ``heard_words``: The words of a drive and its parameter access, for a program that only listens to the bus
- ``registry``: Drives by name, found by the entry point group ``dpstack.drives``; any installed package can add one
"""

from typing import TYPE_CHECKING, Final

from dpstack.namespaces import loader

if TYPE_CHECKING:
    from dpstack.dp.slave.device import Leave
    from dpstack.dpv1.slave.device import Device
    from dpstack.errors import ConfigError
    from dpstack.profile import record47
    from dpstack.profile.channel.base import (
        Clock,
        CycleTimes,
        FindSpec,
        ParameterChannel,
        ParamKey,
        find_parameter,
    )
    from dpstack.profile.channel.pkw import (
        RETRY_NS,
        ParamRef,
        Pkw,
        PkwAccess,
        PkwChannel,
        PkwDialect,
        PkwServer,
        ReplyId,
        TaskId,
    )
    from dpstack.profile.channel.stored_writes import StoredWrites
    from dpstack.profile.drive_profile import DriveProfile, OptionSpec, RateSetting
    from dpstack.profile.master.core import DriveCore, Lookup, settled
    from dpstack.profile.master.mapped_core import MAP_OPS, MapCodes, MappedCore
    from dpstack.profile.master.settings import Setting, equal, same
    from dpstack.profile.model import drivecom_states, process_data_map, profidrive_states
    from dpstack.profile.model.drive_type import CHANNEL_LEN, Options, TelegramFamily, TelegramSpec
    from dpstack.profile.model.jobs import Args, CommandError, Steps
    from dpstack.profile.model.param_errors import PARAMETER_ERRORS, error_text
    from dpstack.profile.model.param_store import ParamStore
    from dpstack.profile.model.params import POWER_ON, ListedParam, ParamSpec, ParamTable, Use, count_of, listing
    from dpstack.profile.model.states import FAULTED, MOVING, ControlTable, Goal, State, StateRow, StateTable
    from dpstack.profile.model.status import DriveStatus, SettingsState
    from dpstack.profile.model.words import SPEED, Scale, Word, signed16
    from dpstack.profile.registry import broken, find, known, refresh
    from dpstack.profile.simulator.device import DriveDevice
    from dpstack.profile.simulator.motor import AT_ONCE, NEAR, Motor, ramp
    from dpstack.units import NEVER, NS_PER_MS, NS_PER_S, NS_PER_US

__all__ = [
    "AT_ONCE",
    "CHANNEL_LEN",
    "FAULTED",
    "MAP_OPS",
    "MOVING",
    "NEAR",
    "NEVER",
    "NS_PER_MS",
    "NS_PER_S",
    "NS_PER_US",
    "PARAMETER_ERRORS",
    "POWER_ON",
    "RETRY_NS",
    "SPEED",
    "Args",
    "Clock",
    "CommandError",
    "ConfigError",
    "ControlTable",
    "CycleTimes",
    "Device",
    "DriveCore",
    "DriveDevice",
    "DriveProfile",
    "DriveStatus",
    "FindSpec",
    "Goal",
    "Leave",
    "ListedParam",
    "Lookup",
    "MapCodes",
    "MappedCore",
    "Motor",
    "OptionSpec",
    "Options",
    "ParamKey",
    "ParamRef",
    "ParamSpec",
    "ParamStore",
    "ParamTable",
    "ParameterChannel",
    "Pkw",
    "PkwAccess",
    "PkwChannel",
    "PkwDialect",
    "PkwServer",
    "RateSetting",
    "ReplyId",
    "Scale",
    "Setting",
    "SettingsState",
    "State",
    "StateRow",
    "StateTable",
    "Steps",
    "StoredWrites",
    "TaskId",
    "TelegramFamily",
    "TelegramSpec",
    "Use",
    "Word",
    "broken",
    "count_of",
    "drivecom_states",
    "equal",
    "error_text",
    "find",
    "find_parameter",
    "known",
    "listing",
    "process_data_map",
    "profidrive_states",
    "ramp",
    "record47",
    "refresh",
    "same",
    "settled",
    "signed16",
]

#: module and its public names
_PLACES: Final = """
dpstack.dp.slave.device Leave
dpstack.dpv1.slave.device Device
dpstack.errors ConfigError
record47
channel.base Clock CycleTimes FindSpec ParameterChannel ParamKey find_parameter
channel.pkw RETRY_NS ParamRef Pkw PkwAccess PkwChannel PkwDialect PkwServer ReplyId TaskId
channel.stored_writes StoredWrites
drive_profile DriveProfile OptionSpec RateSetting
master.core DriveCore Lookup settled
master.mapped_core MAP_OPS MapCodes MappedCore
master.settings Setting equal same
model.drivecom_states
model.process_data_map
model.profidrive_states
model.drive_type CHANNEL_LEN Options TelegramFamily TelegramSpec
model.jobs Args CommandError Steps
model.param_errors PARAMETER_ERRORS error_text
model.param_store ParamStore
model.params POWER_ON ListedParam ParamSpec ParamTable Use count_of listing
model.states FAULTED MOVING ControlTable Goal State StateRow StateTable
model.status DriveStatus SettingsState
model.words SPEED Scale Word signed16
registry broken find known refresh
simulator.device DriveDevice
simulator.motor AT_ONCE NEAR Motor ramp
dpstack.units NEVER NS_PER_MS NS_PER_S NS_PER_US
"""
if not TYPE_CHECKING:  # a type checker knows the names
    __getattr__ = loader(__name__, _PLACES)


def __dir__() -> list[str]:
    return __all__
