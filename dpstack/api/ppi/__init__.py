"""S7-200 over PPI for programs: the CPU behind FDL services, and CPUs of a plant.

- ``cpu``: ``Cpu``: values, mode and clock of one S7-200
- ``orders``: Orders of ``dpstack ppi``: words, parser, execution, through a run too
- ``plant_cpu``: ``PlantCpu``: an S7-200 of the plant file for programs
- ``poll_plan``: The time on the bus that the polls of a CPU take
- ``polling``: ``CpuPolling``: reads named values again and again beside the DP master; their quality
"""
