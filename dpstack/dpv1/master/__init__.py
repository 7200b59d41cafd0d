"""The master's end of DP-V1: Read and Write, alarms, connections.

- ``alarm_ack``: Alarm_Ack of a class 1 master (MS1): to SAP 51 between Read and Write
- ``alarm_events``: What is told, ordered and known about the alarms of a slave, at its master. Plain data
- ``alarm_handler``: Alarms of one slave at its master: recognised in its diagnoses, delivered once, acknowledged
- ``alarm_repeats``: An acknowledged alarm that stands in the diagnosis once more: still, or is it the next one
- ``ms1``: Read and Write of a class 1 master to its slaves (MS1)
- ``ms1_job``: The course of one service at MS1, whichever it is: what an earlier one left behind, the request, polls
- ``ms2``: Class 2 connections (MS2) of a master: opened through the resource manager of a slave (DSAP 49)
- ``ms2_commands``: Orders to the class 2 connections (MS2) of a master, and what is told of them. Plain data
- ``ms2_connection``: One class 2 connection at the master: what is known of it
- ``ms2_initiate``: How a class 2 connection is opened: Initiate at the resource manager (SAP 49)
- ``ms2_jobs``: What goes over class 2 connections: services, Idle, and Abort at the end
- ``plugin_queue``: Read and Write of a cyclic unit (a drive plugin) to its own slave: it puts orders into a queue
- ``response_check``: What an answer to Read, Write or Data_Transport comes to, for a master of either class
- ``srd_polling``: How a slave is asked for one service of DP-V1, at MS1 or over a class 2 connection
"""
