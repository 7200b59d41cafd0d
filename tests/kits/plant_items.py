"""Items of the live stream of a plant with a drive (3) and valves (8), for its tree and its connectors."""

from __future__ import annotations

from typing import Any, Final

PLANT: Final[dict[str, Any]] = {
    "version": 1,
    "started": 1_700_000_000.0,
    "port": "/dev/ttyUSB0",
    "baud": 500_000,
    "address": 2,
    "read_only": False,
    "slaves": {
        "3": {"name": "hoist", "watchdog_ms": 200.0, "drive": {"profile": "demag-dedrive"}},
        "8": {
            "name": "valves",
            "watchdog_ms": 0,
            "inputs": [
                {"name": "level", "type": "i16", "at": "i16@0", "scale": 0.5, "unit": "bar", "dead_band": 1.0},
                {"name": "limit", "type": "bool", "at": "bool@2.0"},
                {"name": "count", "type": "i8", "at": "i8@3"},
            ],
            "outputs": [
                {"name": "lamp", "type": "bool", "at": "bool@0.1"},
                {"name": "speed", "type": "u8", "at": "u8@1"},
            ],
        },
    },
}
#: the values of a slave in data exchange
FINE: Final[dict[str, Any]] = {
    "state": "data_exchange",
    "inputs_valid": True,
    "inputs_age_ms": 1.5,
    "inputs_limit_ms": 100.0,
}
VALVES: Final[dict[str, Any]] = FINE | {
    "fields": {"level": 12.5, "limit": True, "count": -3, "lamp": False, "speed": 9},
    "exchanges": 5,
}
HOIST: Final[dict[str, Any]] = FINE | {
    "drive": {"state": "running", "running": True, "speed": 0.5, "setpoint": 0.5, "faults": [], "warnings": []}
}
