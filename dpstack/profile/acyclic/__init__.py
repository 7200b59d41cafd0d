"""PROFIdrive's parameter channel over DP-V1, record 47: both ends as pure machines.

``record47``: the octets; ``formats``: of values; ``client``: asks, splits, waits; ``lists``: what a drive
tells of itself; ``access``, ``choice``: for drive plugins; ``server``, ``model``: the drive's end; ``services``: what
carries them.
"""

from dpstack.dp.v1.device_records import ImRecords
from dpstack.dp.v1.im import Im0
from dpstack.dp.v1.unit_records import ReadReq, RecordQueue, WriteReq
from dpstack.profile.acyclic.access import AcyclicAccess, Place, Placed, plain_places
from dpstack.profile.acyclic.choice import ChosenAccess
from dpstack.profile.acyclic.client import PLUGIN, PROGRAM, Counters, NoRecordError, ParameterClient, Progress
from dpstack.profile.acyclic.formats import FORMATS, UNSIGNED16, UNSIGNED32, WORD, Format, format_of
from dpstack.profile.acyclic.lists import (
    Description,
    ReadParameter,
    defined,
    describe,
    read_limits,
    read_out,
    texts,
)
from dpstack.profile.acyclic.model import StoreParameters
from dpstack.profile.acyclic.record47 import (
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
from dpstack.profile.acyclic.server import ParameterModel, ParameterServer, RecordServer, Rules, TimedRecords
from dpstack.profile.acyclic.services import (
    Answer,
    Pause,
    Refused,
    Service,
    Silent,
    Talk,
)
from dpstack.profile.acyclic.split import Item, Limits

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
