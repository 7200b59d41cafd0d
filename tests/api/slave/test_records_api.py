"""``slave.read``, ``slave.write``, ``slave.im``: both ends in one world, every error typed; the key ``dpv1``."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager
from typing import Any, cast

import pytest
from api_kit import RAW, begun, bus_of, cancelled, mirror, serving
from support import WorldFactory, instance

import dpstack
from dpstack import AcyclicError, Im0, Im1, Im2, Im3, RecordRefused
from dpstack.api.config.config import parse_config
from dpstack.api.control.record_orders import carry_out, parse_order
from dpstack.api.slave_side.slave_server import ServedSlave
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.pdu.prm_blocks import PrmBlock
from dpstack.dpv1.pdu.im import Im, build_call, number_of
from dpstack.dpv1.pdu.read_write import WriteReq
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.record_table import RecordTable
from dpstack.errors import ConfigError, SlaveTimeout
from dpstack.sim.world import World
from dpstack.slave import DpSlave

pytestmark = pytest.mark.virtual_time


class Store:
    """Records that take their time; what is odd is by index."""

    def __init__(self) -> None:
        self.records = {(1, 2): b"\x11\x22\x33"}

    async def read(self, slot: int, index: int) -> bytes:
        await asyncio.sleep(0.02)
        match index:
            case 9:
                raise RecordRefused(0xB5, 3)
            case 10:
                raise ZeroDivisionError("broken")
            case 11:
                await asyncio.sleep(60)
            case 12:
                return cast(bytes, "text")
        if (slot, index) not in self.records:
            raise RecordRefused(0xB0)
        return self.records[slot, index]

    async def write(self, slot: int, index: int, data: bytes) -> None:
        await asyncio.sleep(0.02)
        self.records[slot, index] = data


def rig(
    world: World, events: list[dpstack.Event] | None = None, **keys: Any
) -> AbstractAsyncContextManager[tuple[dpstack.Bus, ServedSlave]]:
    """A slave with the records of a :class:`Store` and with I&M, and its bus."""
    store = Store()
    slave = mirror(on_read=store.read, on_write=store.write, im=[Im0(order_id="RIG"), Im1()])
    return serving(slave, world, events, **keys)


async def test_read_write_and_im(world: WorldFactory) -> None:
    events: list[dpstack.Event] = []
    async with rig(world(), events) as (bus, served):
        slave = bus.slave("rig")
        assert await slave.read(1, 2) == b"\x11\x22\x33"
        assert await slave.read(1, 2, 2) == b"\x11\x22"
        await slave.write(3, 4, bytes(range(240)))
        assert await slave.read(3, 4) == bytes(range(240))
        im0 = instance(await slave.im(), Im0)
        assert (im0.order_id, im0.supported) == ("RIG", 0b10)
        await slave.write_im(Im1("pump", "cellar"), slot=2)
        assert await slave.im(1) == Im1("pump", "cellar")
        assert instance(served.device, DpSlave).im == (im0, Im1("pump", "cellar"))
        # many at once: each gets its own
        found = await asyncio.gather(*(slave.read(1, 2, n) for n in range(4)), slave.read(3, 4, 1))
        assert found == [b"", b"\x11", b"\x11\x22", b"\x11\x22\x33", b"\0"]
        assert slave.ready_now
        assert slave.retries == slave.timeouts == 0

    assert not [event for event in events if "refused" in event.text]


async def test_im_calls_at_once_each_get_their_own(world: WorldFactory) -> None:
    records: dict[int, list[Im]] = {0: [Im0(order_id="RIG"), Im1("pump")], 3: [Im0(order_id="3")]}
    async with serving(mirror(im=records), world()) as (bus, _):
        slave = bus.slave("rig")
        calls = (slave.im(), slave.im(1), slave.write_im(Im1("fan")), slave.im(slot=3), slave.im(1))
        found = list(await asyncio.gather(*calls))
        own = Im0(order_id="RIG", supported=0b10)
        assert found == [own, Im1("pump"), None, Im0(order_id="3"), Im1("fan")]
        with pytest.raises(
            AcyclicError, match=r"^I&M1 of slot 3: slave 9 refuses Write of slot 3, index 255: "
        ) as caught:
            await slave.im(1, slot=3)
        assert (caught.value.service, caught.value.slot, caught.value.index) == ("Write", 3, 255)
        # a caller that waits for its turn waits no longer than its timeout, and delays no other caller
        first, late = await asyncio.gather(slave.im(), slave.im(1, timeout=0.001), return_exceptions=True)
        assert first == own
        assert isinstance(late, SlaveTimeout)
        assert "I&M1 of slot 0 had no turn within 0.001 s: another I&M call is under way" in str(late)
        assert await slave.im(1) == Im1("fan")


@pytest.mark.parametrize(
    ("index", "code", "text"),
    [
        (9, (0x80, 0xB5, 3), r"slave 9 refuses Read of slot 1, index 9: state conflict \(80 B5 03.*ask again"),
        (10, (0x80, 0xA0, 0), r"read error"),
        (12, (0x80, 0xA0, 0), r"read error"),
        (99, (0x80, 0xB0, 0), r"invalid index"),
    ],
)
async def test_negative_answers(world: WorldFactory, index: int, code: tuple[int, int, int], text: str) -> None:
    events: list[dpstack.Event] = []
    async with rig(world(), events) as (bus, served):
        with pytest.raises(AcyclicError, match=text) as caught:
            await bus.slave(9).read(1, index)
        error = caught.value
        assert (error.address, error.service, error.slot, error.index) == (9, "Read", 1, index)
        assert (error.error_decode, error.code_1, error.code_2) == code
        assert (error.error_class, error.error_code) == divmod(code[1], 16)
        assert await bus.slave(9).read(1, 2) == b"\x11\x22\x33"
        assert served.failure is None

    reported = " ".join(event.text for event in events)
    assert ("ZeroDivisionError: broken" in reported) is (index == 10)
    assert ("on_read returned str, a record is bytes" in reported) is (index == 12)


async def test_a_function_that_is_cancelled_inside_is_answered(world: WorldFactory) -> None:
    async def cancelled(slot: int, index: int) -> bytes:
        inner: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        inner.cancel()
        return await inner

    events: list[dpstack.Event] = []
    async with serving(mirror(on_read=cancelled), world(), events) as (bus, _):
        with pytest.raises(AcyclicError, match="read error"):
            await bus.slave(9).read(1, 2)

    assert any("its function failed (CancelledError: " in event.text for event in events)


async def test_other_errors(world: WorldFactory) -> None:
    async with rig(world(), dpv1={"response_timeout_ms": 50}) as (bus, served):
        slave = bus.slave(9)
        with pytest.raises(dpstack.SlaveTimeout, match=r"had no answer within 0\.05 s \(its C1_Response_Timeout\)"):
            await slave.read(1, 11)
        with pytest.raises(dpstack.UsageError, match="slot 255 does not exist"):
            await slave.read(255, 0)
        with pytest.raises(dpstack.UsageError, match="241 octets"):
            await slave.write(0, 0, bytes(241))
        with pytest.raises(dpstack.UsageError, match="I&M0 is what the device is"):
            await slave.write_im(Im0())
        with pytest.raises(dpstack.UsageError, match="descriptor"):
            await slave.write_im(Im3("x" * 55))
        with pytest.raises(dpstack.UsageError, match="there is no I&M5"):
            await slave.im(5)
        with pytest.raises(AcyclicError, match="invalid range"):
            await slave.im(4)
        served.restart()
        await asyncio.sleep(0.05)
        if not slave.ready_now:
            with pytest.raises(dpstack.SlaveFault, match="not in data exchange"):
                await slave.read(1, 2)
        await slave.ready()
        assert await slave.read(1, 2) == b"\x11\x22\x33"


async def test_a_slave_may_take_longer_than_10_s_where_that_is_known() -> None:
    async def read(slot: int, index: int) -> bytes:
        await asyncio.sleep(11)
        return b"\x07"

    slave = mirror(on_read=read, ms2=1)
    async with (
        serving(slave, baud=9600, dpv1={"response_timeout_ms": 12_000}) as (bus, _),  # few telegrams
        bus.class2.connect(9, response_timeout=12) as connection,
    ):
        first, second = await asyncio.gather(bus.slave(9).read(1, 1), connection.read(1, 1))
    assert first == second == b"\x07"


async def test_the_slave_goes_while_it_is_read(world: WorldFactory) -> None:
    async with rig(world()) as (bus, served):
        reading = await begun(bus.slave(9).read(1, 11), 0.1)
        served.restart()
        with pytest.raises(dpstack.SlaveFault, match=r"left data exchange|not in data exchange"):
            await reading
        await cancelled(await begun(bus.slave(9).read(1, 2), 0))


async def test_a_slave_without_dpv1(world: WorldFactory) -> None:
    async with bus_of(RAW) as bus:
        await bus.ready()
        with pytest.raises(dpstack.UsageError, match=r"slave 9 \(raw\) is not parameterised for DP-V1"):
            await bus.slave(9).read(0, 0)
    with pytest.raises(dpstack.UsageError, match="the bus is not open"):
        await bus.slave(9).read(0, 0)
    # asked for, but the (simulated) slave has none of it
    async with bus_of(RAW | {"dpv1": True, "user_prm": "00 00 00"}) as bus:
        await bus.ready()
        with pytest.raises(dpstack.ServiceRefused, match="SAP 51 is closed") as caught:
            await bus.slave(9).read(0, 0)
        assert (caught.value.service, caught.value.status) == ("Read", "RS")


async def test_services_without_a_function_are_refused(world: WorldFactory) -> None:
    async def nothing(slot: int, index: int) -> bytes:
        return b""

    async with serving(mirror(on_read=nothing), world()) as (bus, _):
        assert await bus.slave(9).read(0, 0) == b""
        with pytest.raises(AcyclicError, match="access denied"):
            await bus.slave(9).write(0, 0, b"\1")
        with pytest.raises(AcyclicError):
            await bus.slave(9).im()


# --- the key dpv1 ---------------------------------------------------------------------------------------------------

HEAD = '[bus]\nport = "virtual"\nbaud = 500000\n[[slave]]\nname = "io"\naddress = 9\n'
OCTETS = 'ident = 1\nconfig = "10"\nuser_prm = "00 00 00 07"\n'


def setup(keys: str) -> tuple[Dpv1 | None, str]:
    slave = parse_config(HEAD + keys, "tests/gsd/files/plant.toml").slaves[0].params
    return slave.dpv1, slave.user_octets(None).hex(" ")


@pytest.mark.parametrize(
    ("keys", "octets"),
    [
        ("", "00 00 00 07"),
        ("dpv1 = false\n", "00 00 00 07"),
        ("dpv1 = true\n", "80 00 00 07"),
        ("dpv1 = { check_cfg_mode = true, prm_cmd = true }\n", "80 01 80 07"),
        ('dpv1 = { alarms = ["process", "pull_plug"], alarm_mode = 2 }\n', "80 c0 02 07"),
        ("fail_safe = true\nwatchdog_ms = 5\nwd_base_1ms = true\ndpv1 = true\n", "c0 00 00 07"),
        (
            'dpv1 = { blocks = [{ type = 0x81, data = "01 02" }, { type = 2, slot = 3 }] }\n',
            "80 00 08 05 81 00 00 07 06 81 00 00 01 02 08 02 03 00 00 00 00 00",
        ),
        (
            'dpv1 = { blocks = [{ type = "user_prm", data = "01" }, '
            '{ type = "prm_cmd", specifier = 8, function = 1, output_hold_time = 100 }] }\n',
            "80 00 08 05 81 00 00 07 05 81 00 00 01 08 02 00 08 01 00 00 64",
        ),
        (
            'dpv1 = { blocks = [{ type = "dxb_links", entries = '
            "[{ publisher = 4, publisher_length = 8, sample_offset = 2, sample_length = 6 }] }] }\n",
            "80 00 08 05 81 00 00 07 09 03 00 00 01 04 08 02 06",
        ),
        (
            'dpv1 = { blocks = [{ type = "isochronous", t_dp = 8, t_mapc = 2 }, '
            '{ type = 8, data = "00 0A 00 00 00 00 00 00 00 00" }] }\n',
            "80 00 08 05 81 00 00 07 1c 04 00 00 01 00 00 05 dc 00 08 02 00 00 05 dc 00 00 00 00 00 00 00 00"
            " 00 0c 00 00 0e 08 00 00 00 0a 00 00 00 00 00 00 00 00",
        ),
    ],
)
def test_dpv1_keys_become_parameter_octets(keys: str, octets: str) -> None:
    assert setup(OCTETS + keys)[1] == octets


def test_bits_that_stand_in_the_parameters_stay() -> None:
    assert setup(OCTETS.replace("00 00 00", "04 C1 8F") + "dpv1 = true\n")[1] == "84 c1 8f 07"
    off = "dpv1 = { check_cfg_mode = false, alarms = [], alarm_mode = 0, prm_cmd = false }\n"
    assert setup(OCTETS.replace("00 00 00", "00 FD 8F") + off)[1] == "80 00 08 07"


def test_left_out_it_is_on_where_the_parameters_say_so() -> None:
    assert setup(OCTETS)[0] is None
    assert setup(OCTETS.replace("00 00 00", "80 00 00"))[0] == Dpv1()
    assert setup(OCTETS.replace("00 00 00", "80 00 00") + "dpv1 = false\n")[0] is None


ALARMS = "it is a list of these: pull_plug, process, diagnostic, manufacturer, status, update"


@pytest.mark.parametrize(
    ("dpv1", "text"),
    [
        ("1", " = 1 is an integer; it must be a table of its keys, true or false"),
        ("{ alarm = 1 }", ": unknown key 'alarm'; did you mean 'alarms'?"),
        ('{ alarms = ["fire"] }', f": alarms holds 'fire', which is unknown; {ALARMS}"),
        ('{ alarms = ["process", "pull"] }', f": alarms holds 'pull', which is unknown; {ALARMS}"),
        ('{ alarms = [["process"]] }', f": alarms holds ['process'], which is unknown; {ALARMS}"),
        (
            "{ alarm_mode = 8 }",
            ": alarm_mode = 8 is outside 0..7; 0: one of each kind at a time, 1..7: 2, 4, 8 ... 32 in all",
        ),
        ("{ blocks = 1 }", ': blocks is no list of tables; write [{ type = 0x81, slot = 0, data = "00 01" }]'),
    ],
)
def test_the_refusal_of_dpv1_names_line_key_and_remedy(dpv1: str, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        setup(f"{OCTETS}dpv1 = {dpv1}\n")
    assert str(caught.value).partition(":")[2] == f"10: [[slave]] io: dpv1{text}"


LINK = "{ publisher = 0, publisher_length = 0, sample_offset = 0, sample_length = 0 }"


@pytest.mark.parametrize(
    ("block", "text"),
    [
        ("slot = 1", 'no type; "user_prm" (0x81), "prm_cmd" (2) ...; its manual knows the others'),
        ("type = 1, slot = 255", "slot = 255 is outside 0..254; correct it or leave it out"),
        (
            'type = "prm"',
            "there is no type 'prm'; a number, or one of these: prm_cmd, dxb_links, isochronous, f_parameters, "
            "dxb_subscribers, time_ar, user_prm",
        ),
        (
            'type = "prm_cmd", colour = 1',
            "unknown key 'colour'; known keys: type, slot, specifier, data, function, properties, output_hold_time",
        ),
        ('type = 2, data = "01 02"', "type 2 (prm_cmd) has 4 octets of data, there are 2; correct it"),
        ('type = 2, data = "", function = 1', "function beside data; leave function out, or data"),
        ("type = 2, function = 256", "PrmCmd: function = 256 does not fit its octets; correct it"),
        ("type = 3", f"entries is no list of tables; write [{LINK}]"),
        ("type = 3, entries = [{ publisher = 1 }]", f"entries 1: no publisher_length; write {LINK}"),
        (
            f'type = 1, data = "{"00" * 231}"',
            "parameter block of type 1: 231 octets, 230 are possible; correct it",
        ),
    ],
)
def test_the_refusal_of_a_block_names_its_number_and_the_remedy(block: str, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        setup(f"{OCTETS}dpv1 = {{ blocks = [{{ {block} }}] }}\n")
    assert str(caught.value).partition(":")[2] == f"10: [[slave]] io: dpv1: blocks 1: {text}"


def test_dpv1_needs_its_three_octets_and_room_for_its_blocks() -> None:
    with pytest.raises(ConfigError, match="three DPV1_Status octets, 0 are there"):
        setup('ident = 1\nconfig = "10"\ndpv1 = true\n')
    with pytest.raises(ConfigError, match="242 octets of user parameters"):
        setup(f'{OCTETS}dpv1 = {{ blocks = [{{ type = 1, data = "{"00" * 230}" }}] }}\n')


def test_a_block_that_cannot_be() -> None:
    for kind, slot, data in ((256, 0, b""), (0, 255, b""), (0, 0, bytes(231))):
        with pytest.raises(ConfigError):
            PrmBlock(kind, slot, data)
    with pytest.raises(ConfigError, match="there is no 'fire' alarm"):
        Dpv1(alarms=("fire",))
    with pytest.raises(ConfigError, match="alarm_mode 8"):
        Dpv1(alarm_mode=8)
    with pytest.raises(ConfigError, match="241 octets"):
        Dpv1(c1_max_data_len=241)


# --- I&M at both ends: what a master writes is kept by ``on_im``, I&M by slot, what is refused ----------------------


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
