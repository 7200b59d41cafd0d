"""The octets of DP-V1."""
