"""The plan of a bus: rotation time, cycle, T_TR, before anything is sent.

- ``cycle_check``: A fixed cycle held against the plan: what is refused, what will miss its time and how often
- ``findings``: What is out of bounds on a planned bus, why, and what to do; and what is as it is, but worth knowing
- ``plan``: What a bus will do before it is switched on: rotation times, watchdogs, T_TR
- ``rotation_time``: The bus rotation time from the telegrams as they are really sent; T_TR and the watchdog
"""
