"""The DP slave: its states, its services, and the device that its author writes.

- ``application``: The application of a passive station around a device: Data_Exchange, Global_Control, time
- ``auto_baud``: Slaves that find the baud rate by themselves, as nearly all do
- ``cyclic_data``: The cyclic data of a slave in data exchange: double buffers for SYNC and FREEZE, Clear and Operate
- ``device``: The base class of a device: its data, its checks, its reaction to a lost master
- ``events``: Events and counters of a slave application; each refusal is reported once
- ``extension``: Services of a device beyond those of DP-V0 (MS1, MS2), and their blocks in the diagnosis
- ``prm_cfg_check``: Checks of Set_Prm and Chk_Cfg at a slave
- ``services``: The services of a slave that are not cyclic: reading, Set_Prm, Chk_Cfg, Set_Slave_Add
- ``state``: State, lock, watchdog and address of a slave application, and its steps through the table of states
- ``state_table``: The states of a DP slave as tables: access to each service, and the transitions
"""
