"""The acyclic services of DP-V1."""
