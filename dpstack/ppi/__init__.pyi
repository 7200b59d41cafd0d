from dpstack.api.fdl_station.station import CpuConnection as CpuConnection
from dpstack.api.fdl_station.station import open_ppi as open_ppi
from dpstack.api.ppi.cpu import Cpu as Cpu
from dpstack.api.ppi.plant_cpu import PlantCpu as PlantCpu
from dpstack.errors import CpuRefused as CpuRefused
from dpstack.ppi.addresses import PpiAddress as PpiAddress
from dpstack.ppi.addresses import parse_address as parse_address
from dpstack.ppi.cpu import CpuStation as CpuStation
from dpstack.ppi.cpu import SimulatedCpu as SimulatedCpu

__all__: list[str]
