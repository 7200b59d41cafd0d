"""The DP slave: its states, its services, and what an author of a device writes."""
