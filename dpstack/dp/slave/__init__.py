"""The DP slave: its states, its services, and what an author of a device writes.

- ``application``: The DP slave: the application of a passive station, around a device that somebody wrote
- ``auto_baud``: A slave that finds the baud rate by itself, as nearly all do
- ``baud_control``: Which rate a slave's receiver listens at, and how it came there
- ``cyclic_data``: The cyclic data of a slave in data exchange: double buffers for SYNC and FREEZE, Clear and Operate
- ``device``: What a slave does with its data: the part of a slave application that its author writes
- ``diagnosis``: The diagnosis as a slave application keeps it: its fault bits
- ``events``: What a slave application tells and counts: events, each refusal once, counters
- ``extension``: Services of a device beyond those of DP-V0 (MS1, MS2), and their blocks in the diagnosis
- ``prm_cfg_check``: What a slave makes of Set_Prm and Chk_Cfg: the judgement, and the watchdog that comes out of it
- ``services``: The services of a slave that are not cyclic: reading, Set_Prm, Chk_Cfg, Set_Slave_Add
- ``state``: What a slave application is at one moment, and its steps through the table of states
- ``state_table``: The states of a DP slave as tables: who may use which service, and what leads where
"""
