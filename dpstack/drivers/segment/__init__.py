"""A segment made of ptys: stations of other programs on one simulated line."""
