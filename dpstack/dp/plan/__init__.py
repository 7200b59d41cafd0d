"""The plan of a bus: rotation time, cycle, T_TR, before anything is sent."""
