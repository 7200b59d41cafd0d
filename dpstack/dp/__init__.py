"""DP: service PDUs, process image, master, slave application, rotation plan."""
