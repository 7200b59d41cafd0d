"""The master's end of DP-V1: Read and Write, alarms, connections."""
