"""S7-200 over PPI: values, mode and clock of a CPU, asked by SRD services of :mod:`dpstack.fdl`.

::

    async with dpstack.ppi.open_ppi(2, port="/dev/ttyUSB0", baud=9600) as cpu:
        level = await cpu.read("VW100")

docs/how-to/ppi.md is the guide. The names of :data:`__all__` are public and loaded at their first use.

- ``addresses``: Addresses as STEP 7-Micro/WIN writes them: ``VW100``, ``M0.3``, ``AIW4``, ``T37``
- ``cpu``: A simulated CPU: memory areas, mode and clock behind the same PDUs
- ``pdu``: Requests and answers of the CPU: read, write, run, stop, clock, and its errors in words
"""

from typing import Final

from dpstack.namespaces import namespace

#: module and its public names (their types: ``__init__.pyi``; the core imports nothing of the API)
_PLACES: Final = """
dpstack.api.fdl_station.station CpuConnection open_ppi
dpstack.api.ppi.cpu Cpu
dpstack.api.ppi.plant_cpu PlantCpu
dpstack.errors CpuRefused
dpstack.ppi.addresses PpiAddress parse_address
dpstack.ppi.cpu CpuStation SimulatedCpu
"""
__getattr__, __dir__, __all__ = namespace(__name__, _PLACES)
