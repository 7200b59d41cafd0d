"""The slave's end of DP-V1: records, alarms, connections."""
