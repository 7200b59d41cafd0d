"""S7-200 over PPI for programs: the CPU behind FDL services.

- ``cpu``: ``Cpu``: values, mode and clock of one S7-200; ``open_ppi``: the station that asks it
"""
