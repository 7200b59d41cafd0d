"""FDL services for programs: requests to any station, service access points of one's own.

- ``requests``: ``Fdl``: the services, as ``open_fdl()`` and ``bus.fdl`` give them
- ``sap``: ``Sap``: an own service access point: indications, handlers, reply data
"""
