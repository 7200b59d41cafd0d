"""I&M at both ends: what a master writes is kept by ``on_im``, I&M by slot, what is refused."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from api_kit import bus_of, virtual
from support import WorldFactory

import dpstack
from dpstack import AcyclicError, DpSlave, Im0, Im1, Im2, RecordRefused, SlaveDescription
from dpstack.api.control.record_orders import carry_out, parse_order
from dpstack.dpv1.pdu.im import Im, Im3, build_call, number_of
from dpstack.dpv1.pdu.read_write import WriteReq
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.record_table import RecordTable
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
        assert (await carry_out(slave, parse_order("im", ["2"])))["im"]["3"] == {"descriptor": "doors"}

    with_slave(world(), served, program)
    assert (served.im_of(2)[1], served.im_of(1)) == (Im3("doors"), ())


def test_a_device_that_says_it_has_what_it_refuses(world: WorldFactory) -> None:
    served = DpSlave(RIG, lambda outputs, elapsed: outputs, im=[Im0(supported=0b111), Im2("2026")])

    async def program(slave: dpstack.Slave) -> None:
        found = (await carry_out(slave, parse_order("im", [])))["im"]
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


class Slow:
    """A slave whose calls take their time: it is not ready as often as ``busy`` says, with these codes."""

    def __init__(self, busy: int, code: int) -> None:
        self.busy = busy
        self.code = code
        self.asked: list[str] = []
        self._left = busy

    def ask(self, request: RecordRequest) -> None:
        self.asked.append(request.service.build().hex(" ").upper())
        self._left -= 1
        if self._left >= 0:
            request.refuse(self.code)
            return
        self._left = self.busy
        request.answer(b"" if isinstance(request.service, WriteReq) else build_call(1) + Im1("pump").build())


@pytest.mark.parametrize("code", [0xB5, 0xC0, 0xC2])
def test_a_slave_that_is_not_ready_is_asked_again(world: WorldFactory, code: int) -> None:
    slow = Slow(3, code)

    async def program(slave: dpstack.Slave) -> None:
        assert await slave.im(1) == Im1("pump")
        await slave.write_im(Im1("fan"))

    with_slave(world(), served(slow), program)
    read = ["5E 00 FF 44"] * 4  # as docs/drives/ls-s100.md#im prints it
    assert slow.asked[:8] == ["5F 00 FF 04 08 00 FD E9"] * 4 + read
    assert len(slow.asked) == 12


@pytest.mark.parametrize(("code", "asked"), [(0xB5, 40), (0xB0, 1)])
def test_one_that_never_is_ready_and_one_that_has_none(world: WorldFactory, code: int, asked: int) -> None:
    slow = Slow(1000, code)

    async def program(slave: dpstack.Slave) -> None:
        begun = asyncio.get_running_loop().time()
        with pytest.raises(AcyclicError, match="I&M1 of slot 0: slave 9 refuses Write of slot 0, index 255") as caught:
            await slave.im(1)
        assert caught.value.code_1 == code
        assert asyncio.get_running_loop().time() - begun <= 2.2

    with_slave(world(), served(slow), program)
    assert asked // 2 <= len(slow.asked) <= asked * 2


def test_one_that_is_not_ready_is_asked_for_as_long_as_was_said(world: WorldFactory) -> None:
    async def program(slave: dpstack.Slave) -> None:
        begun = asyncio.get_running_loop().time()
        with pytest.raises(AcyclicError):
            await slave.im(1, timeout=0.3)
        assert asyncio.get_running_loop().time() - begun <= 0.4

    with_slave(world(), served(Slow(1000, 0xB5)), program)


def served(records: Slow) -> DpSlave:
    slave = DpSlave(RIG, lambda outputs, elapsed: outputs)
    slave.records = records
    return slave
