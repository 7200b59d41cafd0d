"""What a drive plugin is written against: declared words, states and parameters, the two ends, the registry."""

from dpstack.dp.device import Device, Leave
from dpstack.dp.image import CyclicUnit
from dpstack.errors import ConfigError
from dpstack.profile import acyclic, datamap, drivecom, profidrive, standard
from dpstack.profile.channel import CHANNEL_LEN, ChannelServer, ParameterChannel, ParamKey
from dpstack.profile.core import OPS, DriveCore
from dpstack.profile.declared import Declaration, DeclaredCore
from dpstack.profile.device import DriveDevice
from dpstack.profile.drive import DriveProfile, OptionSpec, RateSetting, TelegramFamily, TelegramSpec
from dpstack.profile.jobs import Args, CommandError, Steps
from dpstack.profile.listing import ListedParam, listing
from dpstack.profile.lookup import Lookup
from dpstack.profile.many import per_request
from dpstack.profile.mapped import MAP_OPS, MappedCore
from dpstack.profile.motion import settled
from dpstack.profile.motor import AT_ONCE, NEAR, Motor, ramp
from dpstack.profile.param_errors import PARAMETER_ERRORS, error_text
from dpstack.profile.params import ParamSpec, ParamTable, count_of
from dpstack.profile.pkw import Order, Pkw, PkwClient, PkwDialect, PkwServer, Reply
from dpstack.profile.pkw_access import RETRY_NS, ParamRef, PkwAccess, PkwChannel
from dpstack.profile.plain import PLAIN_PKW, plain_resolver, plain_server
from dpstack.profile.registry import broken, find, known, refresh
from dpstack.profile.settings import Setting, SettingsState, equal, same
from dpstack.profile.states import FAULTED, MOVING, ControlTable, Goal, State, StateRow, StateTable
from dpstack.profile.status import DriveStatus
from dpstack.profile.store import ParamStore
from dpstack.profile.words import N4, SPEED, Scale, Word, signed16
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S, NS_PER_US, ns_to_s, s_to_ns

__all__ = [
    "AT_ONCE",
    "CHANNEL_LEN",
    "FAULTED",
    "MAP_OPS",
    "MOVING",
    "N4",
    "NEAR",
    "NEVER",
    "NS_PER_MS",
    "NS_PER_S",
    "NS_PER_US",
    "OPS",
    "PARAMETER_ERRORS",
    "PLAIN_PKW",
    "RETRY_NS",
    "SPEED",
    "Args",
    "ChannelServer",
    "CommandError",
    "ConfigError",
    "ControlTable",
    "CyclicUnit",
    "Declaration",
    "DeclaredCore",
    "Device",
    "DriveCore",
    "DriveDevice",
    "DriveProfile",
    "DriveStatus",
    "Goal",
    "Leave",
    "ListedParam",
    "Lookup",
    "MappedCore",
    "Motor",
    "OptionSpec",
    "Order",
    "ParamKey",
    "ParamRef",
    "ParamSpec",
    "ParamStore",
    "ParamTable",
    "ParameterChannel",
    "Pkw",
    "PkwAccess",
    "PkwChannel",
    "PkwClient",
    "PkwDialect",
    "PkwServer",
    "RateSetting",
    "Reply",
    "Scale",
    "Setting",
    "SettingsState",
    "State",
    "StateRow",
    "StateTable",
    "Steps",
    "TelegramFamily",
    "TelegramSpec",
    "Word",
    "acyclic",
    "broken",
    "count_of",
    "datamap",
    "drivecom",
    "equal",
    "error_text",
    "find",
    "known",
    "listing",
    "ns_to_s",
    "per_request",
    "plain_resolver",
    "plain_server",
    "profidrive",
    "ramp",
    "refresh",
    "s_to_ns",
    "same",
    "settled",
    "signed16",
    "standard",
]
