"""The simulated bus: a shared medium in virtual time, faults with a seed, and a referee that checks the wire.

- ``io_station/``: A simulated modular I/O station: slots that are pulled and plugged, channels with faults, alarms,
  records, I&M
- ``faults``: Fault injection on the medium, with one seed: bit noise, bursts and lost octets by chance; transmissions
  dropped, damaged, cut short, repeated or delayed by choice
- ``nodes``: Register of the stations on the medium: by address, by baud rate, and the listeners to all telegrams
- ``referee``: The referee: watches every transmission and fails a run on broken timing or token rules
- ``reported_diagnosis``: Diagnoses that a simulated slave reports in addition to those of its device: any number at a
  time, as one diagnosis
- ``slave_faults``: Faults of one simulated slave: late answers, refusals, wrong lengths, noise on its stub, repeated
  answers, diagnosis
- ``transmission``: A transmission: octets of one sender on the wire, and the octets that receivers at the same rate get
  of it
- ``world``: The virtual world: stations on one simulated bus line, in integer nanoseconds, driven by a heap of events
"""
