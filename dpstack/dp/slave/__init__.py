"""The DP slave: its states, its services, and what an author of a device writes.

- ``address``: The station address of a slave: from Set_Slave_Add, over restarts, back by an initial reset
- ``application``: The DP slave: the application of a passive station, around a device that somebody wrote
- ``auto_baud``: A slave that finds the baud rate by itself, as nearly all do
- ``baud_control``: Which rate a slave's receiver listens at, and how it came there
- ``cyclic_data``: The cyclic data of a slave in data exchange: double buffers for SYNC and FREEZE, Clear and Operate
- ``description``: What a slave is, as its GSD file or its maker says; the checks of Set_Prm and Chk_Cfg follow from it
- ``description_from_gsd``: From what a GSD file says to the description that a slave is made of
- ``device``: What a slave does with its data: the part of a slave application that its author writes
- ``diagnosis``: The diagnosis as a slave application keeps it: its fault bits
- ``events``: What a slave application tells and counts: events, each refusal once, counters
- ``loopback_device``: Devices that mirror their outputs to their inputs: the simulation of a slave without a drive
- ``prm_cfg_check``: What a slave makes of Set_Prm and Chk_Cfg: the judgement, and the watchdog that comes out of it
- ``services``: The services of a slave that are not cyclic: reading, Set_Prm, Chk_Cfg, Set_Slave_Add
- ``state``: What a slave application is at one moment, and its steps through the table of states
- ``state_table``: The states of a DP slave as tables: who may use which service, and what leads where
- ``user_slave``: The slave that a user builds: a description and one function from outputs and elapsed time to inputs
"""
