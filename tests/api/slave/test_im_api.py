"""I&M at both ends: what a master writes is kept by ``on_im``, I&M by slot, what is refused."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest
from api_kit import mirror, serving
from support import WorldFactory

import dpstack
from dpstack import AcyclicError, Im0, Im1, Im2, RecordRefused
from dpstack.api.control.record_orders import carry_out, parse_order
from dpstack.dpv1.pdu.im import Im, Im3, build_call, number_of
from dpstack.dpv1.pdu.read_write import WriteReq
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.record_table import RecordTable
from dpstack.sim.world import World
from dpstack.slave import DpSlave

pytestmark = pytest.mark.virtual_time


@contextlib.asynccontextmanager
async def master_of(
    slave: DpSlave, world: World, events: list[dpstack.Event] | None = None
) -> AsyncIterator[dpstack.Slave]:
    """``slave`` as its master has it, in data exchange to the end."""
    async with serving(slave, world, events) as (bus, _):
        yield bus.slave(9)
        assert bus.slave(9).ready_now


class Memory:
    """What survives a restart of the program that serves the slave."""

    def __init__(self) -> None:
        self.kept: dict[int, Im] = {0: Im0(order_id="RIG"), 1: Im1("fan", "hall"), 2: Im2("2026-01-31")}
        self.written: list[tuple[int, Im]] = []

    def slave(self) -> DpSlave:
        return mirror(im=self.kept.values(), on_im=self.keep)

    def keep(self, slot: int, record: Im) -> None:
        self.written.append((slot, record))
        self.kept[number_of(record)] = record


async def test_records_that_a_master_writes_survive_a_restart(world: WorldFactory) -> None:
    memory = Memory()
    async with master_of(memory.slave(), world()) as slave:
        await slave.write_im(Im1("pump", "cellar"))
        await slave.write_im(Im2("2026-02-01 08:00"), slot=3)
    assert memory.written == [(0, Im1("pump", "cellar")), (3, Im2("2026-02-01 08:00"))]
    async with master_of(memory.slave(), world()) as slave:
        assert await slave.im(1) == Im1("pump", "cellar")
        assert await slave.im(2, slot=1) == Im2("2026-02-01 08:00")


async def test_a_slave_that_is_served_again_has_what_was_written(world: WorldFactory) -> None:
    served = Memory().slave()
    async with master_of(served, world()) as slave:
        await slave.write_im(Im1("pump"))
    async with master_of(served, world()) as slave:
        assert await slave.im(1) == Im1("pump")
    assert served.im[1] == Im1("pump")


async def test_a_record_that_cannot_be_kept_is_refused_and_reported(world: WorldFactory) -> None:
    def keep(slot: int, record: Im) -> None:
        if record == Im1("locked"):
            raise RecordRefused(0xB6)
        raise OSError("disk full")

    events: list[dpstack.Event] = []
    async with master_of(mirror(im=[Im0(), Im1("fan")], on_im=keep), world(), events) as slave:
        with pytest.raises(AcyclicError, match="access denied"):
            await slave.write_im(Im1("locked"))
        with pytest.raises(AcyclicError, match="write error"):
            await slave.write_im(Im1("pump"))
        assert await slave.im(1) == Im1("fan")

    reported = " ".join(event.text for event in events)
    assert "its function failed (OSError: disk full)" in reported
    assert "RecordRefused" not in reported


async def test_each_slot_has_its_own_records(world: WorldFactory) -> None:
    each: dict[int, list[Im]] = {0: [Im0(order_id="HEAD"), Im1("line")], 2: [Im0(order_id="8DI"), Im3("lamps")]}
    served = mirror(im=each)

    async with master_of(served, world()) as slave:
        head, module = await slave.im(), await slave.im(slot=2)
        assert isinstance(head, Im0)
        assert isinstance(module, Im0)
        assert (head.order_id, head.supported, module.order_id, module.supported) == ("HEAD", 0b10, "8DI", 0b1000)
        with pytest.raises(AcyclicError, match="invalid slot"):
            await slave.im(slot=1)
        await slave.write_im(Im3("doors"), slot=2)
        assert (await carry_out(slave, parse_order("im", ["2"])))["im"]["3"] == {"descriptor": "doors"}

    assert (served.im_of(2)[1], served.im_of(1)) == (Im3("doors"), ())


async def test_a_record_that_the_device_announces_and_refuses(world: WorldFactory) -> None:
    async with master_of(mirror(im=[Im0(supported=0b111), Im2("2026")]), world()) as slave:
        found = (await carry_out(slave, parse_order("im", [])))["im"]
        assert list(found) == ["0", "1", "2"]
        assert "invalid range" in found["1"]["error"]
        assert found["2"] == {"date": "2026"}


async def test_i_and_m_beside_records(world: WorldFactory) -> None:
    served = mirror(im=[Im0()])
    served.serve_records(RecordTable({(1, 2): b"\x11"}))

    async with master_of(served, world()) as slave:
        assert await slave.read(1, 2) == b"\x11"
        assert await slave.im() == Im0()


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
async def test_a_slave_that_is_not_ready_is_asked_again(world: WorldFactory, code: int) -> None:
    slow = Slow(3, code)

    async with master_of(slave_of(slow), world()) as slave:
        assert await slave.im(1) == Im1("pump")
        await slave.write_im(Im1("fan"))

    read = ["5E 00 FF 44"] * 4  # as docs/reference/drives/ls-s100.md#im prints it
    assert slow.asked[:8] == ["5F 00 FF 04 08 00 FD E9"] * 4 + read
    assert len(slow.asked) == 12


@pytest.mark.parametrize(("code", "asked"), [(0xB5, 40), (0xB0, 1)])
async def test_a_slave_that_is_never_ready_or_has_no_record(world: WorldFactory, code: int, asked: int) -> None:
    slow = Slow(1000, code)

    async with master_of(slave_of(slow), world()) as slave:
        begun = asyncio.get_running_loop().time()
        with pytest.raises(AcyclicError, match="I&M1 of slot 0: slave 9 refuses Write of slot 0, index 255") as caught:
            await slave.im(1)
        assert caught.value.code_1 == code
        assert asyncio.get_running_loop().time() - begun <= 2.2

    assert asked // 2 <= len(slow.asked) <= asked * 2


async def test_a_slave_that_is_not_ready_is_asked_until_the_timeout(world: WorldFactory) -> None:
    async with master_of(slave_of(Slow(1000, 0xB5)), world()) as slave:
        begun = asyncio.get_running_loop().time()
        with pytest.raises(AcyclicError):
            await slave.im(1, timeout=0.3)
        assert asyncio.get_running_loop().time() - begun <= 0.4


def slave_of(records: Slow) -> DpSlave:
    slave = mirror()
    slave.records = records
    return slave
