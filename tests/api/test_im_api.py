"""I&M at both ends: what a master writes is kept by ``on_im``, I&M by slot, what is refused."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from api_kit import bus_of, virtual
from support import WorldFactory

import dpstack
from dpstack import AcyclicError, DpSlave, Im0, Im1, Im2, RecordRefused, SlaveDescription
from dpstack.api.acyclic_words import carry_out
from dpstack.dp.v1.device_records import RecordTable
from dpstack.dp.v1.im import Im, Im3, number_of
from dpstack.sim.world import World

RIG = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True)


def with_slave(
    world: World, served: DpSlave, program: Callable[[dpstack.Slave], Coroutine[Any, Any, None]]
) -> list[str]:
    """``program`` with the slave in data exchange; what the slave told."""
    told: list[str] = []

    async def main() -> None:
        async with (
            dpstack.serve_slave(served, world=world, address=9, on_event=lambda event: told.append(event.text)),
            bus_of(RIG.table(9), world=world) as bus,
        ):
            await bus.ready()
            await program(bus.slave(9))
            assert bus.slave(9).ready_now

    virtual(main())
    return told


class Memory:
    """What survives a restart of the program that serves the slave."""

    def __init__(self) -> None:
        self.kept: dict[int, Im] = {0: Im0(order_id="RIG"), 1: Im1("fan", "hall"), 2: Im2("2026-01-31")}
        self.told: list[tuple[int, Im]] = []

    def slave(self) -> DpSlave:
        return DpSlave(RIG, lambda outputs, elapsed: outputs, im=self.kept.values(), on_im=self.keep)

    def keep(self, slot: int, record: Im) -> None:
        self.told.append((slot, record))
        self.kept[number_of(record)] = record


def test_what_a_master_writes_survives_a_restart(world: WorldFactory) -> None:
    memory = Memory()

    async def write(slave: dpstack.Slave) -> None:
        await slave.write_im(Im1("pump", "cellar"))
        await slave.write_im(Im2("2026-02-01 08:00"), slot=3)

    async def read(slave: dpstack.Slave) -> None:
        assert await slave.im(1) == Im1("pump", "cellar")
        assert await slave.im(2, slot=1) == Im2("2026-02-01 08:00")

    with_slave(world(), memory.slave(), write)
    assert memory.told == [(0, Im1("pump", "cellar")), (3, Im2("2026-02-01 08:00"))]
    with_slave(world(), memory.slave(), read)


def test_served_again_it_has_what_was_written(world: WorldFactory) -> None:
    slave = Memory().slave()

    async def write(seen: dpstack.Slave) -> None:
        await seen.write_im(Im1("pump"))

    async def read(seen: dpstack.Slave) -> None:
        assert await seen.im(1) == Im1("pump")

    with_slave(world(), slave, write)
    with_slave(world(), slave, read)
    assert slave.im[1] == Im1("pump")


def test_what_cannot_be_kept_is_refused_and_told(world: WorldFactory) -> None:
    def keep(slot: int, record: Im) -> None:
        if record == Im1("locked"):
            raise RecordRefused(0xB6)
        raise OSError("disk full")

    async def program(slave: dpstack.Slave) -> None:
        with pytest.raises(AcyclicError, match="access denied"):
            await slave.write_im(Im1("locked"))
        with pytest.raises(AcyclicError, match="write error"):
            await slave.write_im(Im1("pump"))
        assert await slave.im(1) == Im1("fan")

    served = DpSlave(RIG, lambda outputs, elapsed: outputs, im=[Im0(), Im1("fan")], on_im=keep)
    told = " ".join(with_slave(world(), served, program))
    assert "its function failed (OSError: disk full)" in told
    assert "RecordRefused" not in told


def test_by_slot(world: WorldFactory) -> None:
    each: dict[int, list[Im]] = {0: [Im0(order_id="HEAD"), Im1("line")], 2: [Im0(order_id="8DI"), Im3("lamps")]}
    served = DpSlave(RIG, lambda outputs, elapsed: outputs, im=each)

    async def program(slave: dpstack.Slave) -> None:
        head, module = await slave.im(), await slave.im(slot=2)
        assert isinstance(head, Im0)
        assert isinstance(module, Im0)
        assert (head.order_id, head.supported, module.order_id, module.supported) == ("HEAD", 0b10, "8DI", 0b1000)
        with pytest.raises(AcyclicError, match="invalid slot"):
            await slave.im(slot=1)
        await slave.write_im(Im3("doors"), slot=2)
        assert (await carry_out(slave, "im", ["2"]))["im"]["3"] == {"descriptor": "doors"}

    with_slave(world(), served, program)
    assert (served.im_of(2)[1], served.im_of(1)) == (Im3("doors"), ())


def test_a_device_that_says_it_has_what_it_refuses(world: WorldFactory) -> None:
    served = DpSlave(RIG, lambda outputs, elapsed: outputs, im=[Im0(supported=0b111), Im2("2026")])

    async def program(slave: dpstack.Slave) -> None:
        found = (await carry_out(slave, "im", []))["im"]
        assert list(found) == ["0", "1", "2"]
        assert "invalid range" in found["1"]["error"]
        assert found["2"] == {"date": "2026"}

    with_slave(world(), served, program)


def test_i_and_m_beside_records(world: WorldFactory) -> None:
    served = DpSlave(RIG, lambda outputs, elapsed: outputs, im=[Im0()])
    served.serve_records(RecordTable({(1, 2): b"\x11"}))

    async def program(slave: dpstack.Slave) -> None:
        assert await slave.read(1, 2) == b"\x11"
        assert await slave.im() == Im0()

    with_slave(world(), served, program)
