"""The master's end of DP-V1: Read and Write, alarms, connections.

- ``alarm_handler``: Alarms of the slaves of a master: recognised in diagnoses, delivered once, acknowledged (Alarm_Ack)
- ``alarm_orders``: Alarms of DP-V1 and the ends of class 2 connections: orders of programs to a master, and events for
  every program
- ``ms1``: MS1 of a class 1 master: Read and Write, and the steps that every MS1 service has
- ``ms2``: Class 2 connections (MS2) of a master: opened through the resource manager of a slave (DSAP 49)
- ``ms2_connection``: State of a class 2 connection, and the jobs over it: services, Idle, Abort
- ``orders``: Orders of programs to the DP-V1 services of a master, and the events that answer them. Plain data
- ``plugin_queue``: Read and Write of a drive plugin to its own slave: it puts orders into a queue
- ``srd_polling``: Polling of a slave for one service of DP-V1, and the check of its answer
"""
