"""``Slave`` and ``Drive`` of the public API: process data, records, alarms, class 2 services.

- ``alarms``: ``slave.alarms()``: alarms of DP-V1 and their acknowledgement
- ``block_units``: Units of named values, read from the function blocks of a PROFIBUS PA device
- ``class2``: ``bus.class2``: the services of a class 2 master, and its connections (MS2) to slaves
- ``device_orders``: The orders of a device that is no drive, with their answers
- ``drive``: ``Drive``: orders, status and parameters of a drive
- ``hart``: HART transmitters behind a module of a slave: commands, and all that they say of themselves
- ``host``: Protocol of the bus that slaves, drives and class 2 services use
- ``quality``: The quality of the process data of a slave at a moment: what its diagnosis, its inputs and their age say
  together
- ``quality_events``: Events about the quality of named values by the slave's diagnosis and alarms: one a second for a
  slave at most
- ``record_parameters``: PROFIdrive parameter access (record 47) for asyncio programs
- ``records``: Read, Write, I&M and PROFIdrive parameters of DP-V1 at one slave, over MS1 or MS2
- ``service_errors``: Exceptions of failed acyclic services
- ``services``: Pending acyclic services of a bus: requests, results, cancellation
- ``slave``: ``Slave``: state, diagnosis, process data and records of a slave
- ``station_report``: Report on one station, read by the class 2 services: diagnosis, configuration, inputs and outputs,
  in words
- ``typed``: process data as classes: inputs and outputs of a slave with types that a type checker knows
"""
