"""The simulated bus: a shared medium in virtual time, faults with a seed, and a referee that watches the wire.

- ``io_station/``: A simulated modular I/O station: slots that are pulled and plugged, channels with faults, alarms
- ``adapter``: A station behind a USB serial adapter, in virtual time: what the adapter does to octets and to time
- ``faults``: Faults on the medium, all from one seed: bit noise, and what happens to chosen transmissions
- ``medium``: The shared medium: who sends when, and who hears what of it
- ``nodes``: The stations on the medium and how they are found: by address, by rate, and those who hear everything
- ``referee``: The referee: watches every transmission and fails a run on broken timing or token rules
- ``token_watch``: The token rules as the referee sees them: only the holder initiates, the token ascends
- ``transmission``: One transmission: octets of one sender on the wire, and what becomes of them on the way
- ``uart``: What receivers make of damaged octets and collisions
- ``world``: The virtual world: stations on one medium, in integer nanoseconds, driven by a heap of events
"""
