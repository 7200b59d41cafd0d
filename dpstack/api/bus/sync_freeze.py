"""SYNC and FREEZE: one Global_Control, and groups of slaves that change and sample at one moment."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from typing import TypeVar

from dpstack.api.bus.parts import BusBase
from dpstack.api.slave.slave import Slave
from dpstack.argcheck import Sealed
from dpstack.dp.master.commands import SendControl
from dpstack.dp.master.events import ControlFailed, ControlSent, PictureTaken
from dpstack.errors import BusError, SlaveFault, UsageError
from dpstack.units import NS_PER_US, ns_to_s

#: A group number 1..8, several of them, 0 or nothing for all slaves.
Groups = int | Iterable[int]
T = TypeVar("T", ControlSent, PictureTaken)


async def send_control(bus: BusBase, groups: Groups, **what: bool) -> ControlSent:
    """Send one Global_Control. Returns when its last bit has left the line.

    Raises UsageError if this mode or these slaves do not allow it, SlaveFault if a slave is not in data exchange and
    all have to be, BusError if the bus can no longer send it.
    """
    sent = await _order_control(bus, ControlSent, groups, **what)
    ahead = sent.t_ns - bus.runtime.now()
    if ahead > 0:
        await asyncio.sleep(ns_to_s(ahead + NS_PER_US))  # the rounding of the float must not make it early
    return sent


async def _order_control(bus: BusBase, kind: type[T], groups: Groups, **what: bool) -> T:
    """Order a Global_Control. Returns the event of ``kind`` that answers it."""
    token = bus.services.token()
    event = await bus.services.answer_to(SendControl(token, group_numbers(groups), **what), kind, ControlFailed)
    if isinstance(event, kind):
        return event
    assert isinstance(event, ControlFailed)
    if event.address is not None:
        raise SlaveFault(event.address, event.reason)
    raise BusError(f"SYNC or FREEZE was not sent: {event.reason}")


def group_numbers(groups: Groups) -> tuple[int, ...]:
    """Group numbers; empty for all slaves."""
    given = (groups,) if isinstance(groups, int) else tuple(groups)
    return () if given == (0,) else given


class Group(Sealed):
    """The slaves of some groups (none: all slaves), for common outputs and inputs. Made by ``Bus.group``.

    ::

        async with bus.group(1) as valves:
            await valves.write({"north": b"\\x01", "south": b"\\x01"})    # all change within one telegram
            picture = await valves.read()                               # inputs of one moment, by name

    Leaving the block ends SYNC and FREEZE. At the end of the bus the slaves apply safe values in spite of SYNC.
    """

    def __init__(self, bus: BusBase, groups: Groups) -> None:
        self._bus = bus
        self._groups = group_numbers(groups)
        if not self.members:
            known = ", ".join(str(g) for g in sorted({g for s in bus.slaves for g in s.setup.groups})) or "none"
            raise UsageError(f"no slave is in group {', '.join(map(str, self._groups))}; groups of this bus: {known}")
        self._seal(Group)

    @property
    def members(self) -> tuple[Slave, ...]:
        """Its slaves in service, by address."""
        wanted = set(self._groups)
        in_service = (slave for slave in self._bus.slaves if not slave.deactivated)
        return tuple(slave for slave in in_service if not wanted or wanted & set(slave.setup.groups))

    async def write(self, outputs: Mapping[str | int, bytes]) -> None:
        """New outputs, by name or address; all slaves apply them with one telegram. The others keep their outputs.

        The order on the wire: SYNC (unless it is on), the outputs in one whole Data_Exchange with every slave of the
        group, SYNC. It changes nothing if any of ``outputs`` is wrong. Raises UsageError, SlaveFault, BusError as
        ``Bus.sync`` does.
        """
        members = self.members
        wanted = {self._member(which, members): octets for which, octets in outputs.items()}
        for slave, octets in wanted.items():
            slave.check_outputs(octets)
        if not all(slave.synced for slave in members):
            await send_control(self._bus, self._groups, sync=True, settle=True)
        for slave, octets in wanted.items():
            slave.outputs = octets
        await send_control(self._bus, self._groups, sync=True, settle=True)

    async def read(self) -> dict[str, bytes]:
        """The inputs of all slaves of the group at one moment, by name: FREEZE, then one Data_Exchange with each."""
        taken = await _order_control(self._bus, PictureTaken, self._groups, freeze=True, picture=True)
        return {self._bus.slave(address).name: octets for address, octets in taken.inputs.items()}

    async def exchange(self, outputs: Mapping[str | int, bytes]) -> dict[str, bytes]:
        await self.write(outputs)
        return await self.read()

    async def release(self) -> None:
        """End SYNC and FREEZE: outputs and inputs are live again."""
        await send_control(self._bus, self._groups, unsync=True, unfreeze=True)

    async def __aenter__(self) -> Group:
        return self

    async def __aexit__(self, *_: object) -> None:
        held = any(slave.synced or slave.frozen for slave in self.members)
        if held and self._bus.is_open:
            await self.release()

    def _member(self, which: str | int, members: tuple[Slave, ...]) -> Slave:
        slave = self._bus.slave(which)
        if slave not in members:
            names = ", ".join(s.name for s in members)
            raise UsageError(f"slave {slave.address} ({slave.name}) is not in this group; in it are: {names}")
        return slave
