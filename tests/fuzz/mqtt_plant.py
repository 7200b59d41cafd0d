"""A plant with a drive (3), valves (8) and a pump (9) that is not in data exchange, for the nodes of MQTT."""

from __future__ import annotations

from typing import Any, Final

from dpstack.bridge.mqtt.plant_node import PlantNode
from dpstack.plant.tree import PlantTree

#: the time at which the plant is shown, and at which orders come
NOW: Final = 1_700_000_010.0
_FINE: Final[dict[str, Any]] = {
    "state": "data_exchange", "inputs_valid": True, "inputs_age_ms": 1.0, "inputs_limit_ms": 100.0,
}  # fmt: skip
_OUTPUTS: Final = [{"name": name, "type": of, "at": f"{of}@0"} for name, of in (("lamp", "bool"), ("level", "i16"))]
_PLANT: Final[dict[str, Any]] = {
    "version": 1, "started": 1_700_000_000.0, "port": "/dev/ttyUSB0", "baud": 500_000, "address": 2, "read_only": False,
    "slaves": {
        "3": {"name": "hoist", "watchdog_ms": 200.0, "drive": {"profile": "x"}},
        "8": {"name": "valves", "watchdog_ms": 0, "outputs": _OUTPUTS},
        "9": {"name": "pump", "watchdog_ms": 0, "outputs": _OUTPUTS},
    },
}  # fmt: skip
_SLAVES: Final = {"3": _FINE | {"drive": {"state": "ready"}}, "8": _FINE, "9": _FINE | {"state": "offline"}}
_WHOLE: Final = {"t": 1.0, "whole": True, "bus": {"stale": False}, "slaves": _SLAVES}


def show_plant(tree: PlantTree, node: PlantNode) -> None:
    for item in ({"plant": _PLANT}, {"snapshot": _WHOLE}):
        node.take(tree.apply(item, 0.0), NOW, 0.0)
