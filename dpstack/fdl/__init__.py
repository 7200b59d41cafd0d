"""FDL: telegrams, codec, token ring, active and passive stations.

- ``active/``: The active station: token, exchange, ring
- ``passive/``: Passive stations
- ``allowance``: The share of the bus time that polls of addresses may take where nobody may be
- ``baud_search``: Finding the baud rate by listening only, and the rule by which it is recognised
- ``codec``: Telegrams to octets and back: SD1, SD2, SD3, SD4 and SC, the FC octet, address extension octets, FCS
- ``commands``: Orders to a station: to an active one's link layer, and what is done at a passive one itself
- ``decoder``: Octets as they arrive to telegrams: incremental, driven by length, resynchronising octet by octet
- ``describe``: Telegrams and wire logs in words, for people
- ``events``: Events of the link layer: the token ring, stations that come and go, requests that fit into no cycle
- ``interface``: Interfaces of the link layer: to its users, to the application of a passive station, to the medium
- ``livelist``: The live list: which stations 0..126 are on the bus, of what type and how ready, asked by FDL status
- ``telegram``: FDL telegrams as values: kinds, function codes, service access points
"""
