"""The simulated drive.

- ``device``: The common part of a simulated drive: a DP device with an internal scan, a motor and a parameter channel
- ``motor``: The simulated motor: first order, per unit of the rated values, on a fixed grid of 1 ms of the bus's
  clock
- ``several_drives``: The simulated slave with several drives
"""
