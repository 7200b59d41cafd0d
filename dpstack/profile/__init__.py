"""API of drive plugins: declared words, states and parameters, master side, simulated drive, registry.

- ``channel/``: The parameter channel in a drive's cyclic data
- ``master/``: Master side of a drive: state machine, orders, process data maps, comparison of settings
- ``model/``: Declarations of a drive plugin: words, states, parameters, telegrams; orders and status of a drive
- ``record47/``: PROFIdrive's parameter channel over DP-V1, record 47: both ends as pure machines
- ``simulator/``: The simulated drive
- ``core_description``: The description of a drive that its core has by itself
- ``drive_profile``: Profile of one drive: its data for bus, configuration and simulation, and its options
- ``heard_words``: The words of a drive and its parameter access, for a program that only listens to the bus
- ``registry``: Drives by name, found by the entry point group ``dpstack.drives``; any installed package can add one
"""

from typing import TYPE_CHECKING, Final

from dpstack.namespaces import namespace

if TYPE_CHECKING:
    from dpstack.dp.slave.device import Leave as Leave
    from dpstack.dpv1.slave.device import Device as Device
    from dpstack.errors import ConfigError as ConfigError
    from dpstack.profile import record47 as record47
    from dpstack.profile.channel.base import Clock as Clock
    from dpstack.profile.channel.base import CycleTimes as CycleTimes
    from dpstack.profile.channel.base import FindSpec as FindSpec
    from dpstack.profile.channel.base import MapCodes as MapCodes
    from dpstack.profile.channel.base import ParameterChannel as ParameterChannel
    from dpstack.profile.channel.base import ParamKey as ParamKey
    from dpstack.profile.channel.base import ParamRef as ParamRef
    from dpstack.profile.channel.base import find_parameter as find_parameter
    from dpstack.profile.channel.indexed import DIALECTS as DIALECTS
    from dpstack.profile.channel.indexed import MOVILINK as MOVILINK
    from dpstack.profile.channel.indexed import IndexedChannel as IndexedChannel
    from dpstack.profile.channel.indexed import IndexedDialect as IndexedDialect
    from dpstack.profile.channel.indexed import IndexedServer as IndexedServer
    from dpstack.profile.channel.indexed import RefusedAccess as RefusedAccess
    from dpstack.profile.channel.pkw import PAGED_PKW as PAGED_PKW
    from dpstack.profile.channel.pkw import RETRY_NS as RETRY_NS
    from dpstack.profile.channel.pkw import Pkw as Pkw
    from dpstack.profile.channel.pkw import PkwAccess as PkwAccess
    from dpstack.profile.channel.pkw import PkwChannel as PkwChannel
    from dpstack.profile.channel.pkw import PkwDialect as PkwDialect
    from dpstack.profile.channel.pkw import PkwServer as PkwServer
    from dpstack.profile.channel.pkw import ReplyId as ReplyId
    from dpstack.profile.channel.pkw import TaskId as TaskId
    from dpstack.profile.channel.stored_writes import StoredWrites as StoredWrites
    from dpstack.profile.core_description import speed_range as speed_range
    from dpstack.profile.drive_profile import DriveProfile as DriveProfile
    from dpstack.profile.drive_profile import OptionSpec as OptionSpec
    from dpstack.profile.drive_profile import RateSetting as RateSetting
    from dpstack.profile.drive_profile import TelegramSetting as TelegramSetting
    from dpstack.profile.master.core import DriveCore as DriveCore
    from dpstack.profile.master.core import settled as settled
    from dpstack.profile.master.lookup import Lookup as Lookup
    from dpstack.profile.master.mapped_core import MAP_OPS as MAP_OPS
    from dpstack.profile.master.mapped_core import MappedCore as MappedCore
    from dpstack.profile.master.messages import FAULT_CODES as FAULT_CODES
    from dpstack.profile.master.messages import FAULT_NUMBERS as FAULT_NUMBERS
    from dpstack.profile.master.messages import MessageParameter as MessageParameter
    from dpstack.profile.master.settings import Setting as Setting
    from dpstack.profile.master.settings import equal as equal
    from dpstack.profile.master.settings import same as same
    from dpstack.profile.model import drivecom_states as drivecom_states
    from dpstack.profile.model import process_data_map as process_data_map
    from dpstack.profile.model import profidrive_states as profidrive_states
    from dpstack.profile.model.description import MADE_UP as MADE_UP
    from dpstack.profile.model.description import OTHER_MANUAL as OTHER_MANUAL
    from dpstack.profile.model.description import READING as READING
    from dpstack.profile.model.description import Check as Check
    from dpstack.profile.model.description import DescribedBit as DescribedBit
    from dpstack.profile.model.description import DescribedCode as DescribedCode
    from dpstack.profile.model.description import DescribedLed as DescribedLed
    from dpstack.profile.model.description import DescribedMessage as DescribedMessage
    from dpstack.profile.model.description import DescribedParameter as DescribedParameter
    from dpstack.profile.model.description import DescribedPlace as DescribedPlace
    from dpstack.profile.model.description import DescribedRange as DescribedRange
    from dpstack.profile.model.description import DescribedStep as DescribedStep
    from dpstack.profile.model.description import DescribedTelegram as DescribedTelegram
    from dpstack.profile.model.description import DescribedWord as DescribedWord
    from dpstack.profile.model.description import DeviceDescription as DeviceDescription
    from dpstack.profile.model.description import described_word as described_word
    from dpstack.profile.model.description import messages as messages
    from dpstack.profile.model.description import places as places
    from dpstack.profile.model.description import states_of as states_of
    from dpstack.profile.model.drive_type import CHANNEL_LEN as CHANNEL_LEN
    from dpstack.profile.model.drive_type import Options as Options
    from dpstack.profile.model.drive_type import TelegramFamily as TelegramFamily
    from dpstack.profile.model.drive_type import TelegramSpec as TelegramSpec
    from dpstack.profile.model.jobs import Args as Args
    from dpstack.profile.model.jobs import CommandError as CommandError
    from dpstack.profile.model.jobs import Steps as Steps
    from dpstack.profile.model.param_errors import PARAMETER_ERRORS as PARAMETER_ERRORS
    from dpstack.profile.model.param_errors import error_text as error_text
    from dpstack.profile.model.param_store import ParamStore as ParamStore
    from dpstack.profile.model.param_types import ParamType as ParamType
    from dpstack.profile.model.params import POWER_ON as POWER_ON
    from dpstack.profile.model.params import ListedParam as ListedParam
    from dpstack.profile.model.params import ParamSpec as ParamSpec
    from dpstack.profile.model.params import ParamTable as ParamTable
    from dpstack.profile.model.params import Use as Use
    from dpstack.profile.model.params import count_of as count_of
    from dpstack.profile.model.params import listing as listing
    from dpstack.profile.model.states import FAULTED as FAULTED
    from dpstack.profile.model.states import MOVING as MOVING
    from dpstack.profile.model.states import ControlTable as ControlTable
    from dpstack.profile.model.states import Goal as Goal
    from dpstack.profile.model.states import State as State
    from dpstack.profile.model.states import StateRow as StateRow
    from dpstack.profile.model.states import StateTable as StateTable
    from dpstack.profile.model.status import DriveStatus as DriveStatus
    from dpstack.profile.model.status import SettingsState as SettingsState
    from dpstack.profile.model.words import SPEED as SPEED
    from dpstack.profile.model.words import Scale as Scale
    from dpstack.profile.model.words import Word as Word
    from dpstack.profile.model.words import signed16 as signed16
    from dpstack.profile.registry import broken as broken
    from dpstack.profile.registry import find as find
    from dpstack.profile.registry import known as known
    from dpstack.profile.registry import refresh as refresh
    from dpstack.profile.simulator.device import DriveDevice as DriveDevice
    from dpstack.profile.simulator.motor import AT_ONCE as AT_ONCE
    from dpstack.profile.simulator.motor import NEAR as NEAR
    from dpstack.profile.simulator.motor import Motor as Motor
    from dpstack.profile.simulator.motor import ramp as ramp
    from dpstack.units import NEVER as NEVER
    from dpstack.units import NS_PER_MS as NS_PER_MS
    from dpstack.units import NS_PER_S as NS_PER_S
    from dpstack.units import NS_PER_US as NS_PER_US

#: module and its public names
_PLACES: Final = """
dpstack.dp.slave.device Leave
dpstack.dpv1.slave.device Device
dpstack.errors ConfigError
record47
channel.base Clock CycleTimes FindSpec MapCodes ParameterChannel ParamKey ParamRef find_parameter
channel.indexed DIALECTS MOVILINK IndexedChannel IndexedDialect IndexedServer RefusedAccess
channel.pkw PAGED_PKW RETRY_NS Pkw PkwAccess PkwChannel PkwDialect PkwServer ReplyId TaskId
channel.stored_writes StoredWrites
core_description speed_range
drive_profile DriveProfile OptionSpec RateSetting TelegramSetting
master.core DriveCore settled
master.lookup Lookup
master.mapped_core MAP_OPS MappedCore
master.messages FAULT_CODES FAULT_NUMBERS MessageParameter
master.settings Setting equal same
model.drivecom_states
model.process_data_map
model.profidrive_states
model.description MADE_UP OTHER_MANUAL READING Check DescribedBit DescribedCode
model.description DescribedLed DescribedMessage DescribedParameter DescribedPlace DescribedRange DescribedStep
model.description DescribedTelegram DescribedWord DeviceDescription described_word messages places
model.description states_of
model.drive_type CHANNEL_LEN Options TelegramFamily TelegramSpec
model.jobs Args CommandError Steps
model.param_errors PARAMETER_ERRORS error_text
model.param_store ParamStore
model.param_types ParamType
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
    __getattr__, __dir__, __all__ = namespace(__name__, _PLACES)
