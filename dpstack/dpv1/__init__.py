"""The acyclic services of DP-V1.

- ``master/``: The master's end of DP-V1: Read and Write, alarms, connections
- ``pdu/``: The octets of DP-V1
- ``slave/``: The slave's end of DP-V1: records, alarms, connections
- ``describe``: What is in telegrams of DP-V1, in words: services with slot and index, refusals, Abort and its reason
- ``timeouts``: How long things take in DP-V1, at either end: one place for its time-outs and pauses, all in ns
"""
