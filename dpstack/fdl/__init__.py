"""FDL: telegrams, codec, token ring, active and passive stations.

- ``active/``: The active station: token, exchange, ring
- ``passive/``: Passive stations
- ``allowance``: The share of the bus time that polls of addresses may take at which there may be no station
- ``baud_search``: Search for the baud rate by listening only, and the rule that recognises a rate
- ``codec``: Telegrams to octets and back: SD1, SD2, SD3, SD4 and SC, the FC octet, address extension octets, FCS
- ``commands``: Orders to the link layer of an active station, and actions at a passive station
- ``decoder``: Octets as they arrive to telegrams: incremental, driven by length, resynchronising octet by octet
- ``describe``: Telegrams and wire logs as text
- ``events``: Events of the link layer: the token ring, stations that come and go, requests that fit into no cycle
- ``interface``: Interfaces of the link layer: to its users, to the application of a passive station, to the medium
- ``livelist``: The live list: which stations 0..126 are on the bus, of what type and how ready, asked by FDL status
- ``telegram``: FDL telegrams as values: kinds, function codes, service access points
"""
