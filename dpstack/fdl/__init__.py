"""FDL: services of the link layer for programs; telegrams, codec, token ring, active and passive stations.

::

    async with dpstack.open_fdl(port="/dev/ttyUSB0", baud=187_500, address=1) as fdl:
        answer = await fdl.srd(5, bytes.fromhex("01 02"), dsap=16, ssap=16)
        async with await fdl.sap(20, on_receive=print):
            ...

docs/how-to/fdl.md is the guide. The names of :data:`__all__` are public and loaded at their first use.

- ``active/``: The active station: token, exchange, ring
- ``passive/``: Passive stations
- ``services/``: FDL services for programs: requests with their confirmations, and service access points of one's own
- ``allowance``: Limit of the bus time for polls of addresses where no station may be
- ``baud_search``: Search for the baud rate by listening only, and the rule that recognises a rate
- ``codec``: Codec between telegrams and octets: SD1, SD2, SD3, SD4 and SC, the FC octet, address extension octets, FCS
- ``commands``: Orders to the link layer of an active station, and actions at a passive station
- ``decoder``: Incremental decoder from octets to telegrams: driven by length, resynchronising octet by octet
- ``events``: Events of the link layer: the token ring, stations that come and go, requests that fit into no cycle
- ``interface``: Interfaces of the link layer: to its users, to the application of a passive station, to the medium
- ``livelist``: The live list: stations 0..126 on the bus with type and readiness, polled by FDL status
- ``service_names``: Names of the services of the link layer and of DP, by function code and service access point
- ``standing``: A request that its user gives again and again
- ``telegram``: FDL telegrams as values: kinds, function codes, service access points
"""

from typing import Final

from dpstack.namespaces import namespace

#: module and its public names (their types: ``__init__.pyi``; the core imports nothing of the API)
_PLACES: Final = """
dpstack.api.fdl.fdl Fdl FdlAnswer
dpstack.api.fdl.sap Sap
dpstack.api.fdl_station.station FdlStation open_fdl
dpstack.errors FdlError
dpstack.fdl.events AddressCollision MasterSeen RingJoined RingLeft StationFound TokenLost
dpstack.fdl.services.confirmations ALLOWED Confirmation FdlService
dpstack.fdl.services.identity Ident SapStatus
dpstack.fdl.services.orders FdlIndicated
dpstack.fdl.telegram StationType
"""
__getattr__, __dir__, __all__ = namespace(__name__, _PLACES)
