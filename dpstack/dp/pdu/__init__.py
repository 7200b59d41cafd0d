"""The octets of DP-V0: requests, diagnosis, and what they mean."""
