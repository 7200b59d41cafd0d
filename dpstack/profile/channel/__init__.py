"""The parameter channel in a drive's cyclic data.

- ``base``: A drive's parameters as the rest sees them, by PKW, a maker's own channel or record 47
- ``pkw``: The parameter channel of PPO1 and PPO2: eight octets PKE IND PWE with a handshake, both ends
- ``pkw_access``: Parameters over PKW as orders: named, scaled, checked before anything is sent
- ``read_many``: Several parameters by one order: in few requests where the way to the drive has them
"""
