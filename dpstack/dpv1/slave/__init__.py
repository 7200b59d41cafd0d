"""The slave's end of DP-V1: records, alarms, connections.

- ``alarms``: Alarms and status messages of a slave: raised by its application, shown in the diagnosis
- ``clock_receiver``: The clock of a slave, which follows Time_Event and Clock_Value of a class 3 master
- ``description``: The description of a type of slave; the checks of Set_Prm and Chk_Cfg follow from it
- ``description_from_gsd``: The description of a slave from its GSD file
- ``description_to_gsd``: The GSD file of a slave by its description, so that the engineering tool of a PLC knows the
  slave
- ``device``: The base class of a device with DP-V1: its records, alarms and class 2 connections
- ``dxb_links``: Data exchange broadcast at a slave: publisher, and subscriber with its links
- ``loopback_device``: Devices that mirror their outputs to their inputs: the simulation of a slave without a drive
- ``ms2_states``: The states of one class 2 connection at the slave as a table: trigger, action, source
- ``record_requests``: A request for a record and its answer, the same for MS1 and MS2
- ``record_table``: Ready-made records of a slave: a table of octets, and I&M at index 255
- ``resource_manager``: MS2 of a slave: the resource manager at SAP 49, the connections that it gives out
- ``user_slave``: The slave that a user builds: a description and one function from outputs and elapsed time to inputs
"""
