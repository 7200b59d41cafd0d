"""The acyclic services of DP-V1.

- ``master/``: The master's end of DP-V1: Read and Write, alarms, connections
- ``pdu/``: The octets of DP-V1
- ``slave/``: The slave's end of DP-V1: records, alarms, connections
- ``timeouts``: The time-outs and pauses of DP-V1 at both ends, in ns
"""
