"""``slave.alarms()`` with both ends in one world: order, acknowledgement, listeners, end with the bus."""

from __future__ import annotations

import asyncio
import dataclasses
import gc
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from api_kit import RAW, begun, cancelled, mirror, serving
from gsd_kit import device, made
from msgspec import structs
from support import WorldFactory, present

import dpstack
from dpstack import AlarmType, SlaveAlarm, Specifier, StatusType
from dpstack.api.bus.events_json import event_json
from dpstack.api.config.config import parse_config
from dpstack.api.slave_side.slave_server import ServedSlave
from dpstack.dp.master.slave_reports import SlaveReports
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.alarm_handler import AlarmBook, AlarmHandler
from dpstack.dpv1.master.alarm_orders import AlarmRaised, StatusTold
from dpstack.drivers.process.client import worded
from dpstack.errors import AlarmError, ConfigError, SlaveFault, UsageError
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.sim.world import World
from dpstack.slave import ModuleState, SlaveDescription
from dpstack.trace import Severity

pytestmark = pytest.mark.virtual_time

ALL = ("pull_plug", "process", "diagnostic", "manufacturer", "status", "update")
TYPE_MODE = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True, alarms=ALL)
RIG = dataclasses.replace(TYPE_MODE, alarm_sequence=8)
PROCESS = AlarmType.PROCESS


def rig(
    world: World, events: list[dpstack.Event] | None = None, description: SlaveDescription = RIG
) -> AbstractAsyncContextManager[tuple[dpstack.Bus, ServedSlave]]:
    """A slave whose alarms are all enabled, and its bus."""
    mode = 3 if description.alarm_sequence else 0
    return serving(mirror(description), world, events, dpv1={"alarms": list(ALL), "alarm_mode": mode})


def raised(slave: ServedSlave, slot: int) -> asyncio.Task[None]:
    """A process alarm of ``slot``, under way until it is acknowledged."""
    return asyncio.create_task(slave.alarm(PROCESS, slot))


async def first_of(alarms: Any, count: int) -> list[SlaveAlarm]:
    return [await anext(alarms) for _ in range(count)]


@pytest.mark.parametrize("description", [RIG, TYPE_MODE])
async def test_alarms_in_order_acknowledged_when_read(world: WorldFactory, description: SlaveDescription) -> None:
    events: list[dpstack.Event] = []
    async with rig(world(), events, description=description) as (bus, slave):
        alarms = bus.slave("rig").alarms()
        raising = [asyncio.create_task(slave.alarm(PROCESS, slot, data=bytes((slot,)))) for slot in range(20)]
        await asyncio.sleep(2)
        assert not any(task.done() for task in raising)  # the program has read none
        found = []
        async for alarm in alarms:
            found.append(alarm)
            if len(found) == 20:
                break
        assert [(alarm.type, alarm.slot, alarm.data) for alarm in found] == [(2, n, bytes((n,))) for n in range(20)]
        await asyncio.gather(*raising)
        await asyncio.sleep(0.1)
        counts = present(bus.slave("rig").alarm_counts)
        assert (counts.raised, counts.acknowledged, counts.too_many, counts.repeated) == (20, 20, 0, 0)
        assert bus.stats.slaves[9].as_dict()["alarms"] == structs.asdict(counts)

    assert len([event for event in events if isinstance(event, AlarmRaised)]) == 20


async def test_the_attributes_of_an_alarm(world: WorldFactory) -> None:
    events: list[dpstack.Event] = []
    async with rig(world(), events) as (bus, slave):
        alarms = bus.slave("rig").alarms()
        raising = asyncio.create_task(slave.alarm(AlarmType.DIAGNOSIS, 3, Specifier.APPEARS, b"\x11", add_ack=True))
        alarm = await anext(alarms)
        assert (alarm.appears, alarm.disappears, alarm.slot_good, alarm.user_ack) == (True, False, False, True)
        assert (alarm.title, alarm.address, alarm.name, alarm.sequence) == ("diagnosis alarm", 9, "rig", 0)
        assert alarm.text.startswith("slave 9 (rig): diagnosis alarm, slot 3, appears, slot disturbed, data 11, wants")
        assert alarm.diagnosis.ext.startswith(b"\x05\x01\x03\x05\x11")
        assert repr(alarm) == f"<SlaveAlarm {alarm.text}>"
        await raising
        others = {2: (False, True, True), 3: (False, True, False), 0: (False, False, None)}
        for specifier, expected in others.items():
            raising = asyncio.create_task(slave.alarm(AlarmType.DIAGNOSIS, 3, Specifier(specifier)))
            alarm = await anext(alarms)
            assert (alarm.appears, alarm.disappears, alarm.slot_good) == expected
            await raising

    raised = [event for event in events if isinstance(event, AlarmRaised)]
    assert [event.severity for event in raised[:2]] == [Severity.WARNING, Severity.INFO]
    line = present(event_json(raised[0], 1.0))
    assert line | {"text": ""} == {
        "event": "alarm", "t": 1.0, "address": 9, "name": "rig", "type": 1, "title": "diagnosis alarm", "slot": 3,
        "specifier": "appears", "data": "11", "number": 1, "held": True, "sequence": 0, "user_ack": True, "texts": [],
        "text": "",
    }  # fmt: skip


async def test_the_station_acknowledges_alarms_without_a_listener(world: WorldFactory) -> None:
    events: list[dpstack.Event] = []
    async with rig(world(), events) as (_, slave):
        await asyncio.gather(*(slave.alarm(PROCESS, slot) for slot in range(10)))

    raised = [event for event in events if isinstance(event, AlarmRaised)]
    assert [event.alarm.slot for event in raised] == [*range(10)]
    assert not any(event.held for event in raised)


@pytest.mark.parametrize("how", ["break", "close", "cancel"])
async def test_a_listener_that_leaves_delays_no_alarm(world: WorldFactory, how: str) -> None:
    async with rig(world()) as (bus, slave):
        raising = [raised(slave, slot) for slot in range(5)]
        if how == "break":
            async for alarm in bus.slave(9).alarms():
                assert alarm.slot == 0
                break
        elif how == "close":
            stream = bus.slave(9).alarms()
            assert (await anext(stream)).slot == 0
            stream.close()
            stream.close()
            with pytest.raises(StopAsyncIteration):
                await first_of(stream, 9)
        else:

            async def reads() -> None:
                async for _ in bus.slave(9).alarms():
                    await asyncio.sleep(60)

            task = await begun(reads(), 0.1)
            await cancelled(task)
            del task
        gc.collect()
        await asyncio.gather(*raising)


async def test_acknowledgement_by_the_program(world: WorldFactory) -> None:
    async with rig(world()) as (bus, slave):
        alarms = bus.slave(9).alarms(acknowledge=False)
        raising = [raised(slave, slot) for slot in range(3)]
        first, second, third = await first_of(alarms, 3)
        await asyncio.sleep(1)
        assert not any(task.done() for task in raising)
        await third.acknowledge()
        await third.acknowledge()
        await raising[2]
        assert not raising[0].done()
        await asyncio.gather(first.acknowledge(), second.acknowledge(), *raising)


async def test_an_alarm_waits_until_both_listeners_have_read_it(world: WorldFactory) -> None:
    async with rig(world()) as (bus, slave):
        one, other = bus.slave(9).alarms(), bus.slave(9).alarms()
        task = raised(slave, 7)
        assert (await anext(one)).slot == 7
        await asyncio.sleep(1)
        assert not task.done()
        assert (await anext(other)).slot == 7
        await task
        del one  # the other one goes on
        gc.collect()
        task = raised(slave, 8)
        await asyncio.sleep(1)
        assert not task.done()
        await anext(other)
        await task


async def test_alarms_of_a_slave_that_leaves_data_exchange_and_comes_back(world: WorldFactory) -> None:
    async with rig(world()) as (bus, slave):
        found = bus.slave(9)
        alarms = found.alarms(acknowledge=False)
        task = raised(slave, 1)
        lost = await anext(alarms)
        waiting = raised(slave, 2)
        await asyncio.sleep(0.1)
        await found.deactivate()
        with pytest.raises(AlarmError):
            await task
        with pytest.raises(AlarmError):
            await waiting
        await found.activate()
        await found.ready()
        with pytest.raises(SlaveFault, match=r"slave 9 \(rig\) left data exchange: its alarms are void"):
            await lost.acknowledge()
        assert (await anext(alarms)).slot == 2  # what was delivered stays delivered
        task = raised(slave, 3)
        alarm = await anext(alarms)
        assert alarm.slot == 3
        await alarm.acknowledge()
        await task
        await found.reparameterise(watchdog_ms=500)
        task = raised(slave, 4)
        await (await anext(alarms)).acknowledge()
        await task


async def test_alarms_end_with_the_bus_and_with_the_slave(world: WorldFactory) -> None:
    async with rig(world()) as (bus, slave):
        found = bus.slave(9)
        alarms, statuses = found.alarms(), found.status_messages()
        task = raised(slave, 1)
        await asyncio.sleep(0.2)
        await bus.remove(found)
        assert [alarm.slot async for alarm in alarms] == [1]  # an alarm that came before can still be read
        assert [status async for status in statuses] == []
        with pytest.raises(AlarmError):
            await task
        added = await bus.add_slave(RIG.table(9))
        await added.ready()
        alarms, statuses = added.alarms(acknowledge=False), added.status_messages()
        task = raised(slave, 2)
        alarm = await anext(alarms)
        acknowledging = asyncio.create_task(alarm.acknowledge())
        task.cancel()
        await asyncio.sleep(0)
    assert [alarm async for alarm in alarms] == []
    assert [status async for status in statuses] == []
    with pytest.raises(dpstack.BusError, match="was not acknowledged: the bus is closed"):
        await acknowledging


async def test_an_alarm_of_a_removed_slave_is_none_of_the_slave_that_is_added_later(world: WorldFactory) -> None:
    async with rig(world()) as (bus, slave):
        old_stream = bus.slave(9).alarms(acknowledge=False)
        task = raised(slave, 1)
        old = await anext(old_stream)
        await bus.remove(bus.slave(9))
        with pytest.raises(AlarmError):
            await task
        added = await bus.add_slave(RIG.table(9))
        await added.ready()
        alarms = added.alarms(acknowledge=False)
        task = raised(slave, 2)
        new = await anext(alarms)
        for _ in range(2):
            with pytest.raises(SlaveFault, match="left data exchange: its alarms are void"):
                await old.acknowledge()
        await asyncio.sleep(1)
        assert not task.done()
        await new.acknowledge()
        await task


@pytest.mark.parametrize("listens", [True, False])
async def test_dpv1_off_and_on_again(world: WorldFactory, listens: bool) -> None:
    async with rig(world()) as (bus, slave):
        found = bus.slave(9)
        alarms = found.alarms()
        await asyncio.gather(slave.alarm(PROCESS, 1), anext(alarms))
        await found.reparameterise(dpv1=False)
        await found.ready()
        if not listens:
            alarms.close()
        await found.reparameterise(dpv1={"alarms": list(ALL)})
        await found.ready()
        task = raised(slave, 2)
        if listens:
            assert (await anext(alarms)).slot == 2
        await task
        await asyncio.sleep(0.1)
        assert present(found.alarm_counts).raised == 2


async def test_status_messages(world: WorldFactory) -> None:
    events: list[dpstack.Event] = []
    async with rig(world(), events) as (bus, slave):
        statuses = bus.slave(9).status_messages()
        slave.status(StatusType.MESSAGE, 3, Specifier.APPEARS, b"\x01")
        status = await anext(statuses)
        assert (status.type, status.slot, status.data) == (1, 3, b"\x01")
        slave.module_status([ModuleState.OK, ModuleState.MISSING])
        assert (await anext(statuses)).modules[:2] == (ModuleState.OK, ModuleState.MISSING)
        for number in range(70):
            slave.status(40, 1, data=bytes((number,)))
            await asyncio.sleep(0.02)
        assert (await anext(statuses)).data == b"\x06"
        assert statuses.dropped == 6
        assert bus.slave(9).diagnosis_texts[-1].startswith("vendor status 40, slot 1")

    line = present(event_json(next(event for event in events if isinstance(event, StatusTold)), 0))
    assert (line["event"], line["title"], line["data"]) == ("status_message", "status message", "01")


async def test_misuse(world: WorldFactory) -> None:
    bus = dpstack.open_bus(port="virtual", baud=500_000, slaves=[RAW])
    with pytest.raises(UsageError, match="the bus is not open"):
        bus.slave(9).alarms()
    async with bus:
        with pytest.raises(UsageError, match=r"slave 9 \(raw\) is not parameterised for DP-V1"):
            bus.slave(9).alarms()
        with pytest.raises(UsageError, match=r"slave 9 \(raw\) is not parameterised for DP-V1: no status messages"):
            bus.slave(9).status_messages()
        assert bus.slave(9).alarm_counts is None


async def test_misuse_beside_a_listener(world: WorldFactory) -> None:
    async with rig(world()) as (bus, _):
        found = bus.slave("rig")
        listening = found.alarms()
        await found.reparameterise(dpv1=False)
        with pytest.raises(UsageError, match="not parameterised for DP-V1"):
            found.alarms()
        await bus.close()
        with pytest.raises(UsageError, match="the bus is not open"):
            found.alarms()
        listening.close()


# --- Alarms and the GSD file: its texts in either process, kinds that it excludes, kinds that it requires -----------


ALL = ("pull_plug", "process", "diagnostic", "manufacturer", "status", "update")


@pytest.mark.parametrize("rest", ["", "42 01 80 40 30"])
def test_the_texts_of_the_gsd_file_in_either_process(rest: str) -> None:
    texts = DiagTexts(device("diagnosis"), [None])
    setup = SlaveParams(
        address=9, name="rig", ident=1, config=b"\x10", user_prm=bytes(3), dpv1=Dpv1(alarms=ALL), texts=texts
    )
    diagnosis = Diagnosis(8, 0x0C, 0, 2, 1, bytes.fromhex("05 21 03 01 01" + rest))
    events: list[dpstack.Event] = []
    for of in (setup, structs.replace(setup, texts=None)):  # the bus process has none
        handler: Any = SimpleNamespace(setup=of, reports=SlaveReports(of, events.append, 2, set()), want_diagnosis=None)
        AlarmHandler(handler, AlarmBook()).read(diagnosis, True, 1, 7)
    own, foreign = events
    assert isinstance(own, AlarmRaised)
    assert own.texts[0] == "fuse blown"
    if rest:
        module, channel = own.texts[-2:]
        assert module == "slots with a diagnosis: 1"
        assert channel == "slot 1, input channel 0 (bit): sensor missing (plug it in)"
    assert isinstance(foreign, AlarmRaised)
    assert worded(foreign, setup) == own


GSD = """#Profibus_DP
GSD_Revision = 5
Vendor_Name = "none"
Model_Name = "rig"
Revision = "1"
Ident_Number = 0x1234
Protocol_Ident = 0
Station_Type = 0
Hardware_Release = "1"
Software_Release = "1"
500_supp = 1
MaxTsdr_500 = 100
Slave_Family = 0
Max_Diag_Data_Len = 64
User_Prm_Data_Len = 3
User_Prm_Data = 0x00,0x08,0x00
Modular_Station = 0
DPV1_Slave = 1
C1_Read_Write_supp = 1
C1_Max_Data_Len = 64
C1_Response_Timeout = 100
Diagnostic_Alarm_supp = 1
Process_Alarm_supp = 1
Process_Alarm_required = 1
Status_Alarm_supp = 1
Extra_Alarm_SAP_supp = 1
Alarm_Sequence_Mode_Count = 4
Module = "io" 0x20, 0x10
EndModule
"""


def setup_of(folder: Path, dpv1: str) -> SlaveParams:
    """The parameters of a slave with the GSD file above and the key ``dpv1``."""
    (folder / "rig.gsd").write_text(GSD, encoding="latin-1")
    table = f'name = "rig"\naddress = 9\ngsd = "rig.gsd"\nmodules = ["io"]\ndpv1 = {dpv1}\n'
    text = f'[bus]\nport = "virtual"\nbaud = 500000\n[[slave]]\n{table}'
    return parse_config(text, str(folder / "plant.toml")).slaves[0].params


@pytest.mark.parametrize(
    ("dpv1", "message"),
    [
        (
            '{ alarms = ["diagnostic"] }',
            "alarms lacks process, but its GSD file says Process_Alarm_required = 1; add it",
        ),
        ('{ alarms = ["update", "process"] }', "alarms holds update, but its GSD file says Update_Alarm_supp = 0"),
        ("{ alarm_mode = 3 }", "alarm_mode 3 is 8 alarms at a time, its GSD file says Alarm_Sequence_Mode_Count = 4"),
    ],
)
def test_alarms_that_the_gsd_file_excludes(tmp_path: Path, dpv1: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message.replace(".", r"\.")):
        setup_of(tmp_path, dpv1)


@pytest.mark.parametrize(
    ("dpv1", "sent"),
    [
        ("true", "80 48 00"),  # kinds that it requires, and kinds that its parameters enable
        ('{ alarms = ["process", "diagnostic"], alarm_mode = 2 }', "80 60 02"),
    ],
)
def test_enabled_alarms_in_dpv1_status(tmp_path: Path, dpv1: str, sent: str) -> None:
    setup = setup_of(tmp_path, dpv1)
    assert setup.user_octets(None).hex(" ") == sent
    assert setup.dpv1 is not None
    assert setup.dpv1.extra_alarm_sap


def test_a_module_status_counts_the_slots_as_the_gsd_file_does_in_either_process() -> None:
    """Modul_Offset = 0: the head station is slot 0. Octets: INVALID, WRONG, OK, MISSING."""
    gsd = "#Profibus_DP\nGSD_Revision = 3\nModular_Station = 1\nMax_Module = 4\nModul_Offset = 0\n"
    texts = DiagTexts(made(gsd).device, [None])
    setup = SlaveParams(
        address=9, name="rig", ident=1, config=b"\x10", user_prm=bytes(3), dpv1=Dpv1(alarms=ALL), texts=texts
    )
    diagnosis = Diagnosis(8, 0x0C, 0, 2, 1, bytes.fromhex("05 82 00 00 c9"))
    said = "module status: slot 0 data invalid, slot 1 wrong module, slot 3 no module"
    assert setup.block_texts(diagnosis) == (said,)
    events: list[dpstack.Event] = []
    for of in (setup, structs.replace(setup, texts=None)):
        handler: Any = SimpleNamespace(setup=of, reports=SlaveReports(of, events.append, 2, set()), want_diagnosis=None)
        AlarmHandler(handler, AlarmBook()).read(diagnosis, True, 1, 7)
    own, foreign = events
    assert own.text == f"slave 9 (rig): {said}"
    assert isinstance(foreign, StatusTold)
    assert worded(foreign, setup) == own
