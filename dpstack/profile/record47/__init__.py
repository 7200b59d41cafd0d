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

from dpstack.dpv1.master.plugin_queue import ReadReq, RecordQueue, WriteReq
from dpstack.dpv1.pdu.im import Im0
from dpstack.dpv1.slave.record_table import ImRecords
from dpstack.profile.record47.client import PLUGIN, PROGRAM, Counters, Item, ParameterClient, Progress
from dpstack.profile.record47.drive_access import AcyclicAccess, Place, plain_places
from dpstack.profile.record47.formats import FORMATS, UNSIGNED16, UNSIGNED32, WORD, Format, format_of
from dpstack.profile.record47.param_lists import (
    Description,
    ReadParameter,
    defined,
    describe,
    read_limits,
    read_out,
    texts,
)
from dpstack.profile.record47.parameter_server import (
    ParameterModel,
    ParameterServer,
    Rules,
    StoreParameters,
    TimedRecords,
)
from dpstack.profile.record47.pdu import (
    INDEX,
    Address,
    Answer,
    Attribute,
    ErrorValue,
    Limits,
    Pause,
    Refused,
    Request,
    Response,
    Result,
    Service,
    Silent,
    Transport,
    Values,
)

__all__ = [
    "FORMATS",
    "INDEX",
    "PLUGIN",
    "PROGRAM",
    "UNSIGNED16",
    "UNSIGNED32",
    "WORD",
    "AcyclicAccess",
    "Address",
    "Answer",
    "Attribute",
    "Counters",
    "Description",
    "ErrorValue",
    "Format",
    "Im0",
    "ImRecords",
    "Item",
    "Limits",
    "ParameterClient",
    "ParameterModel",
    "ParameterServer",
    "Pause",
    "Place",
    "Progress",
    "ReadParameter",
    "ReadReq",
    "RecordQueue",
    "Refused",
    "Request",
    "Response",
    "Result",
    "Rules",
    "Service",
    "Silent",
    "StoreParameters",
    "TimedRecords",
    "Transport",
    "Values",
    "WriteReq",
    "defined",
    "describe",
    "format_of",
    "plain_places",
    "read_limits",
    "read_out",
    "texts",
]
