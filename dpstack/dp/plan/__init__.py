"""The plan of a bus: rotation time, cycle, T_TR, before anything is sent.

- ``cycle_check``: Check of a fixed cycle against the plan: refusals, misses and their frequency
- ``plan``: The plan of a bus before it is switched on: rotation times, watchdogs, T_TR
- ``rotation_time``: The bus rotation time from the telegrams as they are really sent; T_TR and the watchdog
"""
