"""Outputs and drives that connectors have ordered, and what becomes of them when their connector is lost
(``on_connector_loss``)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Final, NamedTuple

from dpstack.api.bus.bus import Bus
from dpstack.api.config.connectors import KEEP
from dpstack.api.control.orders import LASTING, carry_out
from dpstack.api.slave.slave import Slave, put_values
from dpstack.errors import BusError, DpError, SlaveError, UsageError
from dpstack.plant.orders import HALTS, Argument, DriveOrder, PlantOrder, SetCpuValues, SetOctets, SetOutputs
from dpstack.text import shortened
from dpstack.trace import Severity

#: characters of the names in one remark
_MOST_NAMES: Final = 150


class _Effect(NamedTuple):
    """``value``: of an output; None: of a drive."""

    connector: str
    value: Argument | None = None


class OutsideOrders:
    """Carries out the orders of connectors on ``bus``, and knows which of them are in effect: named outputs that still
    have the ordered value, and drives that were started or got a set point. ``tell`` takes remarks."""

    def __init__(self, bus: Bus, tell: Callable[[str, Severity], object]) -> None:
        self._bus = bus
        self._tell = tell
        #: by address and name of the output, "" for a drive
        self._effects: dict[tuple[int, str], _Effect] = {}

    @property
    def in_effect(self) -> bool:
        """Whether a connector has set an output, or moves a drive."""
        return bool(self._effects)

    async def carry_out(self, connector: str, order: SetOutputs | DriveOrder) -> object:
        """Carry out ``order`` of ``connector``. Raises as :func:`~dpstack.api.control.orders.carry_out`: whoever gives
        an order by a connector does not stand beside the plant, so outputs that cannot reach their slave now are
        refused."""
        before = self._note(connector, order)  # while it is under way, too: the connector may be lost meanwhile
        try:
            return await carry_out(self._bus, order, now=True)
        except (UsageError, BusError, SlaveError):  # the run has refused it
            for key, effect in before.items():
                self._set(key, effect)
            raise

    def _note(self, connector: str, order: SetOutputs | DriveOrder) -> dict[tuple[int, str], _Effect | None]:
        """Note the effects of ``order``; returns those before it."""
        effects: dict[tuple[int, str], _Effect | None] = {}
        match order:
            case SetCpuValues():
                pass  # its program controls its outputs, and nothing of it is safe or unsafe by itself
            case SetOutputs(address, values):
                effects = {(address, name): _Effect(connector, value) for name, value in values.items()}
            case DriveOrder(address, operation) if operation in LASTING:
                effects = {(address, ""): _Effect(connector)}
            case DriveOrder(address, operation) if operation in HALTS:
                effects = {(address, ""): None}
        before: dict[tuple[int, str], _Effect | None] = {}
        for key, effect in effects.items():
            before[key] = self._effects.get(key)
            self._set(key, effect)
        return before

    def _set(self, key: tuple[int, str], effect: _Effect | None) -> None:
        if effect is None:
            self._effects.pop(key, None)
        else:
            self._effects[key] = effect

    async def lose(self, connectors: Collection[str]) -> None:
        """The ``connectors`` are lost: their outputs get safe values and their drives stop, or all stays with
        ``on_connector_loss = "keep"``. Both are reported."""
        lost = {key: effect for key, effect in self._effects.items() if effect.connector in connectors}
        self._effects = {key: effect for key, effect in self._effects.items() if key not in lost}
        orders = list(self._safe_orders(lost))
        if not orders:
            return
        names = shortened(", ".join(name for name, _ in orders), _MOST_NAMES)
        who = ", ".join(dict.fromkeys(effect.connector for effect in lost.values()))
        if self._bus.config.bus.on_connector_loss == KEEP:
            self._tell(f'{names}: stay as {who} ordered them (on_connector_loss = "keep")', Severity.WARNING)
            return
        self._tell(
            f'{names}: safe values are set and drives stop, as {who} had ordered them (on_connector_loss = "safe")',
            Severity.WARNING,
        )
        await asyncio.gather(*(self._carry_out_safe(name, order) for name, order in orders))

    def _safe_orders(self, lost: Mapping[tuple[int, str], _Effect]) -> Iterator[tuple[str, PlantOrder]]:
        """The orders that make ``lost`` safe, each with the names of what it changes."""
        slaves = {slave.address: slave for slave in self._bus.slaves}
        drives = {drive.slave.address: drive.name for drive in self._bus.drives}
        outputs: dict[Slave, list[str]] = {}
        for (address, name), effect in lost.items():
            slave = slaves.get(address)
            if slave is not None and effect.value is not None and _has(slave, name, effect.value):
                outputs.setdefault(slave, []).append(name)
            elif effect.value is None and address in drives:
                yield drives[address], DriveOrder(address, "stop")
        for slave, names in outputs.items():
            text = ", ".join(f"{slave.name}.{name}" for name in names)
            if slave.has_free_words:  # its plugin makes the octets, and knows what is safe
                yield text, SetOutputs(slave.address, dict.fromkeys(names))
            else:
                yield text, SetOctets(slave.address, _with_safe(slave, names))

    async def _carry_out_safe(self, name: str, order: PlantOrder) -> None:
        try:
            await carry_out(self._bus, order)
        except DpError as error:  # a stop without data exchange stays, and goes out with the first outputs
            self._tell(f"{name}: {error}", Severity.ERROR)


def _has(slave: Slave, name: str, value: Argument) -> bool:
    """Whether the output ``name`` still has ``value``: somebody else may have set it, or changed the slave."""
    held = slave.outputs_held
    try:
        return put_values(slave, held, {name: value}) == held
    except UsageError:
        return False


def _with_safe(slave: Slave, names: Iterable[str]) -> bytes:
    """The outputs of ``slave`` with the safe values of those that are named."""
    mask = 0
    for name in names:
        mask |= slave.output_field(name).mask
    held, safe = (int.from_bytes(octets, "little") for octets in (slave.outputs_held, slave.setup.safe_outputs))
    return (held & ~mask | safe & mask).to_bytes(len(slave.outputs_held), "little")
