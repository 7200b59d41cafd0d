"""FDL: telegrams, codec, token ring, active and passive stations.

- ``active/``: The active station: token, exchange, ring
- ``passive/``: Passive stations
- ``allowance``: Limit of the bus time for polls of addresses where no station may be
- ``baud_search``: Search for the baud rate by listening only, and the rule that recognises a rate
- ``codec``: Codec between telegrams and octets: SD1, SD2, SD3, SD4 and SC, the FC octet, address extension octets, FCS
- ``commands``: Orders to the link layer of an active station, and actions at a passive station
- ``decoder``: Incremental decoder from octets to telegrams: driven by length, resynchronising octet by octet
- ``events``: Events of the link layer: the token ring, stations that come and go, requests that fit into no cycle
- ``interface``: Interfaces of the link layer: to its users, to the application of a passive station, to the medium
- ``livelist``: The live list: stations 0..126 on the bus with type and readiness, polled by FDL status
- ``service_names``: Names of the services of the link layer and of DP, by function code and service access point
- ``telegram``: FDL telegrams as values: kinds, function codes, service access points
"""
