"""The simulated bus: a shared medium in virtual time, faults with a seed, and a referee that checks the wire.

- ``io_station/``: A simulated modular I/O station: slots that are pulled and plugged, channels with faults, alarms,
  records, I&M
- ``adapter``: A station behind a USB serial adapter, in virtual time: delay and packing of octets
- ``faults``: Faults on the medium, all from one seed: bit noise; chosen transmissions dropped, damaged or delayed
- ``medium``: The shared medium: transmissions, collisions, and the delivery of telegrams and octets to the stations
- ``nodes``: Register of the stations on the medium: by address, by rate, and those that hear everything
- ``referee``: The referee: watches every transmission and fails a run on broken timing or token rules
- ``token_watch``: Checks of the token rules: only the holder sends requests, the token goes to the next higher
  address, there is one
- ``transmission``: One transmission: octets of one sender on the wire, and what receivers at its rate get of damaged
  ones
- ``world``: The virtual world: stations on one medium, in integer nanoseconds, driven by a heap of events
"""
