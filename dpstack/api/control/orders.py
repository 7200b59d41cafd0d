"""Orders to a running bus, typed (:mod:`dpstack.plant.orders`): they are carried out here and nowhere else.

Named values of an S7-200 (``ppi``) are written at once, one after the other.

Connectors (MQTT, OPC UA, EPICS) hand them over as they are; the control socket makes them of texts. With ``now`` an
order is from outside: somebody who may not see the bus (a connector, the page) gets a refusal for outputs that cannot
reach their slave at this moment, as an output that waits would act at any time later. The API and `dpstack ctl` may
prepare values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.bus.parts import SEARCHING
from dpstack.api.slave.slave import Slave, check_words, put_values
from dpstack.errors import BusError, SlaveError
from dpstack.plant.orders import DriveOrder, ModeOrder, PlantOrder, SetCpuValues, SetOctets, SetOutputs

if TYPE_CHECKING:
    from dpstack.api.slave.drive import Drive

#: orders that set the speed: as a part of the reference, in Hz, in rpm
SET_POINTS: Final = ("speed", "frequency", "rpm")
#: operations of a drive whose effect lasts only as long as a master sends it
LASTING: Final = frozenset({"start", "order", *SET_POINTS})


async def carry_out(bus: Bus, order: PlantOrder, *, now: bool = False) -> object:
    """Carry out ``order``, and return as :func:`put_out` or :func:`perform`. Raises the errors of :func:`octets_of` and
    :func:`put_out`, :func:`drive_for` and :func:`perform`, or of ``Bus.operate``."""
    match order:
        case SetCpuValues(address, values):
            await core_of(bus).cpu(address).set_values(values)
        case SetOutputs() | SetOctets():
            return await put_out(bus, octets_of(bus, [order], now=now))
        case DriveOrder(address, operation, value):
            drive = drive_for(bus, address, operation, now=now)
            return await perform(drive, operation, {} if value is None else {"value": value})
        case ModeOrder("operate"):
            await bus.operate()
        case ModeOrder():
            await bus.clear()
    return None


#: outputs by slave: octets, or the free words of a drive by name
Wanted = dict[Slave, bytes | dict[str, object]]


def octets_of(bus: Bus, orders: Sequence[SetOutputs | SetOctets], *, now: bool = False) -> Wanted:
    """The output octets that ``orders`` mean, or the free words of a drive; several orders to one slave add up.

    Raises UsageError for outputs that a slave does not have or a drive plugin makes, and for values that do not fit;
    SlaveError for outputs that would be withheld when the slave is back (``after_return``); with ``now`` BusError or
    SlaveError for the first slave that outputs do not reach now.
    """
    wanted: Wanted = {}
    for order in orders:
        slave = bus.slave(order.address)
        before = wanted.get(slave, slave.outputs_held)
        if isinstance(order, SetOctets):
            wanted[slave] = order.octets
        elif slave.has_free_words:
            check_words(slave, order.values)
            wanted[slave] = {**(before if isinstance(before, dict) else {}), **order.values}
        else:
            assert isinstance(before, bytes)
            wanted[slave] = put_values(slave, before, order.values)
    if now:
        for slave in wanted:
            _refuse_held(bus, slave)
    for slave, octets in wanted.items():
        if not isinstance(octets, bytes):
            continue
        slave.check_outputs(octets)
        if now:  # a slave that is away was refused above
            continue
        setup = slave.setup
        if setup.after_return == "safe" and not slave.ready_now and octets != setup.safe_outputs:
            why = f'{slave.held_because}; after_return = "safe": set its outputs when it is back'
            raise SlaveError(slave.address, why)
    return wanted


async def put_out(bus: Bus, wanted: Mapping[Slave, bytes | dict[str, object]]) -> dict[str, dict[str, str]] | None:
    """Set outputs that :func:`octets_of` has made, and wait until the master has them. Raises OrderDropped if it does
    not take them in time.

    Returns ``held``: by the name of a slave that does not get its outputs yet, why and until when; None if all slaves
    get theirs.
    """
    view = core_of(bus).view
    for slave, octets in wanted.items():
        if isinstance(octets, bytes):
            view.set_outputs(slave.address, octets)
        else:
            slave.update(octets)
    await bus.outputs_taken()
    held = {
        slave.name: f"held until {'operate' if _waits_for_operate(bus, slave) else 'data exchange'}: {why}"
        for slave in wanted
        if (why := slave.held_because) is not None
    }
    return {"held": held} if held else None


def drive_for(bus: Bus, which: str | int, operation: str, *, now: bool = False) -> Drive:
    """The drive ``which``, if it takes ``operation`` at present.

    Raises UsageError for a drive that does not exist, BusError while the bus searches its baud rate or is read only;
    with ``now`` as :func:`octets_of` for an operation of :data:`LASTING`.
    """
    if bus.searching:
        raise BusError(f"{SEARCHING}: the drives are known once it is found")
    if bus.config.bus.read_only:
        raise BusError("this run is read only: it gives no drive an order; end it and run without read_only")
    drive = bus.drive(which)
    if now and operation in LASTING:
        _refuse_held(bus, drive.slave)
    return drive


async def perform(drive: Drive, operation: str, values: Mapping[str, Any]) -> object:
    """Carry out an operation of ``drive``, which is the name of one of its methods, or of an order of its plugin.
    ``values``: its keyword arguments. Returns the result of the method, and raises its errors."""
    if operation in SET_POINTS:
        return await drive.order(operation, **values)
    return await getattr(drive, operation)(**values)


def _refuse_held(bus: Bus, slave: Slave) -> None:
    """Raises BusError or SlaveError if outputs do not reach ``slave`` now."""
    if (why := slave.held_because) is not None:
        raise BusError(why) if _waits_for_operate(bus, slave) else SlaveError(slave.address, why)


def _waits_for_operate(bus: Bus, slave: Slave) -> bool:
    """Whether the bus holds the outputs of ``slave`` back, and not its absence."""
    return slave.ready_now or bus.forced_clear is not None
