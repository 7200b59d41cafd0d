from dpstack.api.fdl.fdl import Fdl as Fdl
from dpstack.api.fdl.fdl import FdlAnswer as FdlAnswer
from dpstack.api.fdl.sap import Sap as Sap
from dpstack.api.fdl_station.station import FdlStation as FdlStation
from dpstack.api.fdl_station.station import open_fdl as open_fdl
from dpstack.errors import FdlError as FdlError
from dpstack.fdl.events import AddressCollision as AddressCollision
from dpstack.fdl.events import MasterSeen as MasterSeen
from dpstack.fdl.events import RingJoined as RingJoined
from dpstack.fdl.events import RingLeft as RingLeft
from dpstack.fdl.events import StationFound as StationFound
from dpstack.fdl.events import TokenLost as TokenLost
from dpstack.fdl.services.confirmations import ALLOWED as ALLOWED
from dpstack.fdl.services.confirmations import Confirmation as Confirmation
from dpstack.fdl.services.confirmations import FdlService as FdlService
from dpstack.fdl.services.identity import Ident as Ident
from dpstack.fdl.services.identity import SapStatus as SapStatus
from dpstack.fdl.services.orders import FdlIndicated as FdlIndicated
from dpstack.fdl.telegram import StationType as StationType

__all__ = [
    "ALLOWED",
    "AddressCollision",
    "Confirmation",
    "Fdl",
    "FdlAnswer",
    "FdlError",
    "FdlIndicated",
    "FdlService",
    "FdlStation",
    "Ident",
    "MasterSeen",
    "RingJoined",
    "RingLeft",
    "Sap",
    "SapStatus",
    "StationFound",
    "StationType",
    "TokenLost",
    "open_fdl",
]
