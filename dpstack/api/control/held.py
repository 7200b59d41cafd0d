"""Outputs that cannot reach their slave now: refused where the order is from outside, else held until operate.

Somebody outside (MQTT, OPC UA, the page) may not see the bus, and an output that waits would act at any time later.
Their orders begin with :data:`~dpstack.api.control.commands.NOW`. The API and `dpstack ctl` may prepare values.
"""

from __future__ import annotations

from collections.abc import Iterable

from dpstack.api.bus.bus import Bus
from dpstack.api.slave.slave import Slave
from dpstack.errors import BusError, SlaveError


def refuse_held(bus: Bus, slaves: Iterable[Slave]) -> None:
    """Raises BusError or SlaveError for the first of ``slaves`` that outputs do not reach now."""
    for slave in slaves:
        if (why := slave.held_because) is not None:
            raise BusError(why) if _waits_for_operate(bus, slave) else SlaveError(slave.address, why)


def held_answer(bus: Bus, slaves: Iterable[Slave]) -> dict[str, dict[str, str]] | None:
    """The answer to an order that has set outputs of ``slaves``: ``held``, by name the reason why a slave does not get
    them yet, and until when; None where all of them get theirs."""
    held = {
        slave.name: f"held until {'operate' if _waits_for_operate(bus, slave) else 'data exchange'}: {why}"
        for slave in slaves
        if (why := slave.held_because) is not None
    }
    return {"held": held} if held else None


def _waits_for_operate(bus: Bus, slave: Slave) -> bool:
    """Whether the bus holds the outputs of ``slave`` back, and not its absence."""
    return slave.ready_now or bus.forced_clear is not None
