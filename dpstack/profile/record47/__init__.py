"""PROFIdrive's parameter channel over DP-V1, record 47: both ends without clock and bus.

- ``client``: The master's end of record 47: a Write, then Reads until the drive has its response ready; requests one
  by one, within the drive's limits
- ``drive_access``: Parameter access of a drive plugin over record 47: parameters by name, scaled values, checks
  before sending
- ``formats``: The data formats of values in record 47: number, octets of one value, conversion
- ``param_lists``: Limits (PNU 974), parameter list (980 to 989), descriptions and texts of a drive, read over record
  47
- ``parameter_server``: The drive's end of record 47: takes a request by Write, carries it out, returns the response by
Read
- ``pdu``: PDUs of record 47 (parameter access of PROFIdrive's base mode): requests and responses, both ends; their
  services
"""

from typing import TYPE_CHECKING, Final

from dpstack.namespaces import namespace

if TYPE_CHECKING:
    from dpstack.dpv1.master.plugin_queue import ReadReq as ReadReq
    from dpstack.dpv1.master.plugin_queue import RecordQueue as RecordQueue
    from dpstack.dpv1.master.plugin_queue import WriteReq as WriteReq
    from dpstack.dpv1.pdu.im import Im0 as Im0
    from dpstack.dpv1.slave.record_table import ImRecords as ImRecords
    from dpstack.profile.record47.client import PLUGIN as PLUGIN
    from dpstack.profile.record47.client import PROGRAM as PROGRAM
    from dpstack.profile.record47.client import Counters as Counters
    from dpstack.profile.record47.client import Item as Item
    from dpstack.profile.record47.client import ParameterClient as ParameterClient
    from dpstack.profile.record47.client import Progress as Progress
    from dpstack.profile.record47.drive_access import AcyclicAccess as AcyclicAccess
    from dpstack.profile.record47.drive_access import Place as Place
    from dpstack.profile.record47.drive_access import plain_places as plain_places
    from dpstack.profile.record47.formats import FORMATS as FORMATS
    from dpstack.profile.record47.formats import UNSIGNED16 as UNSIGNED16
    from dpstack.profile.record47.formats import UNSIGNED32 as UNSIGNED32
    from dpstack.profile.record47.formats import WORD as WORD
    from dpstack.profile.record47.formats import Format as Format
    from dpstack.profile.record47.formats import format_of as format_of
    from dpstack.profile.record47.param_lists import Description as Description
    from dpstack.profile.record47.param_lists import ReadParameter as ReadParameter
    from dpstack.profile.record47.param_lists import defined as defined
    from dpstack.profile.record47.param_lists import describe as describe
    from dpstack.profile.record47.param_lists import read_limits as read_limits
    from dpstack.profile.record47.param_lists import read_out as read_out
    from dpstack.profile.record47.param_lists import texts as texts
    from dpstack.profile.record47.parameter_server import ParameterModel as ParameterModel
    from dpstack.profile.record47.parameter_server import ParameterServer as ParameterServer
    from dpstack.profile.record47.parameter_server import Rules as Rules
    from dpstack.profile.record47.parameter_server import StoreParameters as StoreParameters
    from dpstack.profile.record47.parameter_server import TimedRecords as TimedRecords
    from dpstack.profile.record47.pdu import INDEX as INDEX
    from dpstack.profile.record47.pdu import Address as Address
    from dpstack.profile.record47.pdu import Answer as Answer
    from dpstack.profile.record47.pdu import Attribute as Attribute
    from dpstack.profile.record47.pdu import ErrorValue as ErrorValue
    from dpstack.profile.record47.pdu import Limits as Limits
    from dpstack.profile.record47.pdu import Pause as Pause
    from dpstack.profile.record47.pdu import Refused as Refused
    from dpstack.profile.record47.pdu import Request as Request
    from dpstack.profile.record47.pdu import Response as Response
    from dpstack.profile.record47.pdu import Result as Result
    from dpstack.profile.record47.pdu import Service as Service
    from dpstack.profile.record47.pdu import Silent as Silent
    from dpstack.profile.record47.pdu import Transport as Transport
    from dpstack.profile.record47.pdu import Values as Values

#: module and its public names
_PLACES: Final = """
dpstack.dpv1.master.plugin_queue ReadReq RecordQueue WriteReq
dpstack.dpv1.pdu.im Im0
dpstack.dpv1.slave.record_table ImRecords
client PLUGIN PROGRAM Counters Item ParameterClient Progress
drive_access AcyclicAccess Place plain_places
formats FORMATS UNSIGNED16 UNSIGNED32 WORD Format format_of
param_lists Description ReadParameter defined describe read_limits read_out texts
parameter_server ParameterModel ParameterServer Rules StoreParameters TimedRecords
pdu INDEX Address Answer Attribute ErrorValue Limits Pause Refused Request Response Result Service Silent Transport
pdu Values
"""
if not TYPE_CHECKING:  # a type checker knows the names
    __getattr__, __dir__, __all__ = namespace(__name__, _PLACES)
