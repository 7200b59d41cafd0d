"""The parameter channel in a drive's cyclic data.

- ``base``: Parameter channel of a drive: common interface of PKW, makers' own channels and record 47; shared checks
- ``indexed``: Parameter channel with a 16-bit index and a handshake bit (SEW MOVILINK, KEB): eight octets, both ends
- ``pkw``: The parameter channel of PPO1 and PPO2 (PKW): eight octets PKE IND PWE with a handshake, both ends
- ``stored_writes``: Limit of the writes that a drive stores: its EEPROM wears out, often after 100 000 writes of a
  parameter
"""
