"""FDL services for programs: requests to any station, service access points of one's own.

- ``fdl``: ``Fdl``: the services, as ``open_fdl()`` and ``bus.fdl`` give them
- ``link``: The FDL services of one bus from the inside: attached at the first use, orders, events, the end
- ``orders``: Orders of ``dpstack fdl``, one FDL service by hand: words, parser, execution, answers in JSON
- ``sap``: ``Sap``: an own service access point: indications, handlers, reply data
"""
