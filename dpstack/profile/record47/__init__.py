"""PROFIdrive's parameter channel over DP-V1, record 47: both ends as pure machines.

- ``client``: The master's end of record 47: a Write, then Reads until the drive has its response ready
- ``drive_access``: Parameters over record 47 as orders of a drive plugin: named, scaled
- ``formats``: The formats of values in record 47: number, octets of one value, and what its octets mean
- ``param_lists``: What a drive tells of itself over record 47: its limits (974), the list of its parameters
- ``pdu``: The octets of record 47, the parameter access of PROFIdrive's base mode: requests and responses, both ends
- ``server``: The drive's end of record 47: takes a request by Write, carries it out, gives the response by Read
- ``server_model``: A drive's parameters over its ParamStore, as record 47 shows them
- ``split``: Any number of parameters as requests that the drive takes, and their answers put together again
- ``transport``: The services that record 47 travels by, as a talk: who wants them says which
"""

from dpstack.dpv1.master.plugin_queue import ReadReq, RecordQueue, WriteReq
from dpstack.dpv1.pdu.im import Im0
from dpstack.dpv1.slave.record_table import ImRecords
from dpstack.profile.record47.client import PLUGIN, PROGRAM, Counters, NoRecordError, ParameterClient, Progress
from dpstack.profile.record47.drive_access import AcyclicAccess, ChosenAccess, Place, Placed, plain_places
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
from dpstack.profile.record47.pdu import (
    INDEX,
    Address,
    Attribute,
    ErrorValue,
    Request,
    RequestId,
    Response,
    Result,
    Values,
)
from dpstack.profile.record47.server import ParameterModel, ParameterServer, RecordServer, Rules, TimedRecords
from dpstack.profile.record47.server_model import StoreParameters
from dpstack.profile.record47.split import Item, Limits
from dpstack.profile.record47.transport import Answer, Pause, Refused, Service, Silent, Talk

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
    "ChosenAccess",
    "Counters",
    "Description",
    "ErrorValue",
    "Format",
    "Im0",
    "ImRecords",
    "Item",
    "Limits",
    "NoRecordError",
    "ParameterClient",
    "ParameterModel",
    "ParameterServer",
    "Pause",
    "Place",
    "Placed",
    "Progress",
    "ReadParameter",
    "ReadReq",
    "RecordQueue",
    "RecordServer",
    "Refused",
    "Request",
    "RequestId",
    "Response",
    "Result",
    "Rules",
    "Service",
    "Silent",
    "StoreParameters",
    "Talk",
    "TimedRecords",
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
