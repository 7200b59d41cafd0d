"""Several drives in one slave: slots and octets, orders, record 47, faults of one of them, and what each door shows."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from api_kit import bench_of, bus_of, operating
from ends.telegrams import told
from hypothesis import given, settings
from hypothesis import strategies as st

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.bus.compose import plan_bus, several_of
from dpstack.api.bus.live import slave_plant
from dpstack.api.bus.picture import picture_of
from dpstack.api.commissioning.sheet import make_sheets
from dpstack.api.config.config import make_config, parse_config, slave_config
from dpstack.api.control.drive_orders import carry_out, find_order
from dpstack.api.control.handlers import run_status
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.api.slave.drive import DrivePlugin
from dpstack.dp.acyclic.job import Outcome
from dpstack.dpv1.pdu.read_write import ReadReq, WriteReq
from dpstack.plant.items import SlavePlant, all_of
from dpstack.profile import State
from dpstack.profile.master.several_drives import SeveralDrives
from dpstack.testing.wire import Watched

AXIS1: dict[str, object] = {"name": "axis1", "file": "profidrive", "telegram": "1"}
AXIS2: dict[str, object] = {"name": "axis2", "file": "profidrive", "telegram": "2", "object": 2}
CU320: dict[str, object] = {
    "name": "cu320",
    "address": 5,
    "ident": 0x80E5,
    "dpv1": True,
    "user_prm": "C0 00 00",
    "drives": [AXIS1, AXIS2],
}
#: telegram 1 at rest: ZSW1 with "ready to switch on" and "control requested"; 100 % is 0x4000
REST = "0231 0000"
RUNS = "0337 1000"
MS = 1_000_000
HERE = Path(__file__).parent
pytestmark = pytest.mark.virtual_time


def plugin(*drives: dict[str, object], **changes: object) -> SeveralDrives:
    return several_of(slave_config(CU320 | {"drives": list(drives or (AXIS1, AXIS2))} | changes))


def simulated(bus: dpstack.Bus, name: str) -> dpstack.profile.DriveDevice:
    device = bench_of(bus).drive(name)[1]
    assert isinstance(device, dpstack.profile.DriveDevice)
    return device


def order(joined: SeveralDrives, name: str, op: str, token: int = 1, now: int = 0, **arguments: object) -> None:
    joined.command(op, {"drive": name, "arguments": arguments}, token, now)


def sent(joined: SeveralDrives, inputs: str, now: int) -> str:
    return joined.cyclic(bytes.fromhex(inputs), now).hex(" ", 2).upper()


class TestOctets:
    def test_identifiers_slots_and_safe_outputs(self) -> None:
        slave = slave_config(CU320)
        assert slave.params.config.hex(" ").upper() == "C3 C1 C1 FD 00 01 C3 C3 C3 FD 00 02"
        assert slave.params.safe_outputs.hex(" ", 2) == "047e 0000 047e 0000 0000 0000"
        assert [(one.inputs, one.outputs, one.slots) for one in slave.drives] == [
            ((0, 4), (0, 4), (1,)),
            ((4, 12), (4, 12), (2,)),
        ]
        assert {name: field.octet for name, field in slave.input_fields.fields.items()} == {
            "axis1_speed": 2,
            "axis2_speed_b": 6,
            "axis2_status_2": 10,
        }

    def test_a_slot_further_on_leaves_empty_slots(self) -> None:
        slave = slave_config(CU320 | {"drives": [AXIS1, AXIS2 | {"slot": 4}]})
        assert slave.params.config.hex(" ").upper() == "C3 C1 C1 FD 00 01 00 00 C3 C3 C3 FD 00 02"
        assert [one.slots for one in slave.drives] == [(1,), (4,)]

    def test_each_drive_has_its_own_words(self) -> None:
        joined = plugin()
        assert sent(joined, f"{REST} {REST} 0000 0000", 10 * MS) == "047E 0000 047E 0000 0000 0000"
        order(joined, "axis2", "speed", value=0.25)
        order(joined, "axis2", "start", now=11 * MS)
        assert sent(joined, f"{REST} {REST} 0000 0000", 20 * MS) == "047E 0000 047F 1000 0000 0000"
        order(joined, "axis1", "speed", value=-0.5)
        assert sent(joined, f"{REST} {RUNS} 0000 0000", 30 * MS) == "047E E000 047F 1000 0000 0000"
        assert [one.state for one in joined.status().values()] == [State.READY_TO_SWITCH_ON, State.RUNNING]
        results = [(one["drive"], one["ok"]) for one in joined.take_events() if one["type"] == "result"]
        assert results == [("axis1", True), ("axis2", True), ("axis2", True)]

    def test_a_fault_of_one_drive_stops_no_other(self) -> None:
        joined = plugin()
        sent(joined, f"{REST} {REST} 0000 0000", 10 * MS)
        order(joined, "axis1", "start")
        sent(joined, f"{REST} {REST} 0000 0000", 20 * MS)
        assert sent(joined, f"{RUNS} {REST} 0000 0000", 30 * MS) == "047F 0000 047E 0000 0000 0000"
        assert sent(joined, f"{RUNS} 0248 0000 0000 0000", 40 * MS)[:9] == "047F 0000"
        status = joined.status()
        assert (status["axis1"].state, status["axis2"].state) == (State.RUNNING, State.FAULT)

    def test_a_loss_ends_the_orders_of_all(self) -> None:
        joined = plugin()
        sent(joined, f"{REST} {REST} 0000 0000", 10 * MS)
        order(joined, "axis1", "start", 7, now=11 * MS)
        order(joined, "axis2", "start", 8, now=11 * MS)
        joined.lost(12 * MS)
        ended = [(one["drive"], one["token"], one["error"]) for one in joined.take_events() if one["type"] == "result"]
        assert ended == [("axis1", 7, "lost"), ("axis2", 8, "lost")]
        assert sent(joined, "", 20 * MS) == "047E 0000 047E 0000 0000 0000"

    def test_an_order_without_a_drive_reaches_none(self) -> None:
        joined = plugin()
        joined.command("start", {}, 3, 0)
        joined.command("start", {"drive": "axis3", "arguments": {}}, 4, 0)
        assert [(one["token"], one["ok"]) for one in joined.take_events()] == [(3, False), (4, False)]
        assert sent(joined, f"{REST} {REST} 0000 0000", 10 * MS) == "047E 0000 047E 0000 0000 0000"


_OPS = st.sampled_from(["start", "stop", "quick_stop", "coast", "acknowledge", "speed", "set", "cancel", "read"])


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(_OPS, st.floats(-1.9, 1.9), st.binary(min_size=8, max_size=8)), min_size=1, max_size=12))
def test_orders_and_inputs_of_one_drive_never_change_an_octet_of_the_other(
    steps: list[tuple[str, float, bytes]],
) -> None:
    joined, alone = plugin(), plugin(AXIS1).cores["axis1"]
    still, now = bytes.fromhex(REST), 10 * MS
    for op, value, inputs in steps:
        arguments: dict[str, Any] = {"value": value} if op == "speed" else {}
        order(joined, "axis2", op, now=now, **arguments)
        now += MS
        assert joined.cyclic(still + inputs, now)[:4] == alone.cyclic(still, now)
        assert joined.status()["axis1"] == alone.status()


def joined_reference(asked: list[str]) -> str:
    """Reference, id, object and number of the last request."""
    return [one for one in asked if one != "read"][-1]


class TestRecord47:
    def test_each_drive_has_its_object_and_its_turn(self) -> None:
        joined = plugin()
        records = joined.records
        assert records is not None
        sent(joined, f"{REST} {REST} 0000 0000", 10 * MS)
        order(joined, "axis2", "read", 1, now=10 * MS, number=1120)
        order(joined, "axis1", "read", 2, now=10 * MS, number=1121)
        for number, (request, response) in enumerate(
            [
                ("40 01 02 01 10 00 04 60 00 00", "40 01 02 01 08 01 3F 80 00 00"),  # axis2 was the first to ask
                ("01 01 01 01 10 00 04 61 00 00", "01 01 01 01 08 01 40 00 00 00"),
            ]
        ):
            write = self.next_request(joined, (20 + 2 * number) * MS)
            assert write.request.data.hex(" ").upper() == request
            write.outcome = Outcome()
            read = self.next_request(joined, (21 + 2 * number) * MS)  # the response, before a request of the other
            assert (type(read.request), read.request.slot, read.request.index) == (ReadReq, 0, 47)
            read.outcome = Outcome(data=bytes.fromhex(response))
        sent(joined, f"{REST} {REST} 0000 0000", 30 * MS)
        values = {one["drive"]: one["value"] for one in joined.take_events() if one["type"] == "result"}
        assert values == {"axis1": 2.0, "axis2": 1.0}
        assert records.take() is None

    def test_what_one_drive_began_in_clear_holds_up_no_drive_in_operate(self) -> None:
        sample: dict[str, object] = {"name": "axis1", "file": str(HERE / "sample.toml"), "telegram": "2"}
        joined = plugin(sample, AXIS2)
        for now in (0, 2_000 * MS):
            joined.watch(bytes.fromhex("0231 0000 0000 0000" * 2), now)
        assert joined.records is not None
        begun = joined.records.take()
        assert begun is not None
        assert begun.request.data.hex(" ") == "01 01 01 01 10 00 03 9a 00 00"  # p0922 of the first drive
        order(joined, "axis2", "read", 1, now=2_001 * MS, number=1120)
        joined.cyclic(bytes.fromhex("0231 0000 0000 0000" * 2), 2_002 * MS)
        assert begun.cancelled
        asked = []
        for now in range(2_003, 2_040):
            joined.cyclic(bytes.fromhex("0231 0000 0000 0000" * 2), now * MS)
            if (found := joined.records.take()) is not None:
                asked.append(found.request.data[:4].hex(" ") if isinstance(found.request, WriteReq) else "read")
                found.outcome = Outcome(data=bytes.fromhex(f"{joined_reference(asked)} 08 01 3F 80 00 00"))
        assert "40 01 02 01" in asked

    @staticmethod
    def next_request(joined: SeveralDrives, now: int) -> Any:
        assert joined.records is not None
        sent(joined, f"{REST} {REST} 0000 0000", now)
        sent(joined, f"{REST} {REST} 0000 0000", now)
        found = joined.records.take()
        assert found is not None
        return found

    async def test_the_simulated_slave_answers_for_the_object(self) -> None:
        async with operating(CU320) as bus:
            log = core_of(bus).world
            assert log is not None
            assert await bus.drive("axis2").read(944) == 0
            writes = [entry.octets for entry in log.log if b"\x5f\x00\x2f" in entry.octets]
            assert [one[one.index(b"\x5f") :][:14].hex(" ") for one in writes[:1]] == [
                "5f 00 2f 0a 40 01 02 01 10 00 03 b0 00 00"
            ]

    def test_two_drives_with_one_object_are_refused(self) -> None:
        with pytest.raises(dpstack.ConfigError, match="axis1 and axis2 both have object 1 in record 47; give each"):
            slave_config(CU320 | {"drives": [AXIS1, AXIS2 | {"object": 1}]})
        slave_config({key: CU320[key] for key in ("name", "address", "ident")} | {"drives": [AXIS1, AXIS2]})


class TestBus:
    async def test_a_drive_starts_follows_and_trips_beside_another(self) -> None:
        async with operating(CU320) as bus:
            first, second = bus.drives
            assert (first.name, second.name, first.address, second.address) == ("axis1", "axis2", 5, 5)
            second.speed = 0.5
            await second.start()
            await second.reached()
            slave = bus.slave("cu320")
            assert slave.outputs.hex(" ", 2) == "047e 0000 047f 2000 0000 0000"
            assert slave["axis2_speed_b"] == pytest.approx(50, abs=0.6)
            assert slave["axis1_speed"] == 0
            assert (first.status.running, second.status.running) == (False, True)
            simulated(bus, "axis2").trip("1")
            await bus.until(lambda: second.status.faults == ("number 1",), 5)
            assert first.status.faults == ()
            assert bus.slave("cu320").fault is None
            await second.acknowledge()
            for which in (5, "cu320"):
                with pytest.raises(dpstack.UsageError, match="has several drives: name one of axis1, axis2"):
                    bus.drive(which)
            with pytest.raises(dpstack.UsageError, match="its drive plugin makes the outputs"):
                slave.outputs = bytes(12)

    async def test_a_defect_in_one_core_makes_all_outputs_of_the_slave_safe(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        async with operating(CU320) as bus:
            first, second = bus.drives
            second.speed = 0.5
            await second.start()
            plugin_of_axis1 = core_of(bus).parts.plugins[5][0]
            assert isinstance(plugin_of_axis1, DrivePlugin)

            def fail(*_: object) -> bytes:
                raise KeyError("map")

            monkeypatch.setattr(plugin_of_axis1.core, "cyclic", fail)
            with pytest.raises(dpstack.DriveError, match="its plugin failed: CoreError: drive axis1: KeyError: 'map'"):
                await second.stop()
            await bus.rotated(bus.stats.rotations + 2, 10)
            assert bus.slave("cu320").outputs.hex(" ", 2) == "047e 0000 047e 0000 0000 0000"
            assert [one.status.state for one in bus.drives] == [State.OFFLINE, State.OFFLINE]
            fault = bus.slave("cu320").fault
            assert fault is not None
            assert "drive axis1: KeyError: 'map'" in fault.text
            with pytest.raises(dpstack.UsageError, match="is faulted: its plugin failed"):
                await first.start()

    @pytest.mark.parametrize("way", ["clear", "remove", "close"])
    async def test_safe_outputs_on_every_way_out(self, way: str) -> None:
        bus = bus_of(CU320)
        async with bus:
            await bus.operate()
            await bus.ready()
            bus.drive("axis2").speed = 0.5
            await bus.drive("axis2").start()
            world = core_of(bus).world
            assert world is not None
            sent_octets: list[bytes] = []
            world.log.listener = lambda entry: sent_octets.append(entry.octets)
            await bus.rotated(bus.stats.rotations + 2, 1)
            if way == "clear":
                await bus.clear()
            elif way == "remove":
                await bus.remove("cu320")
            else:
                await bus.close()
            await asyncio.sleep(0.3)
        words = told(sent_octets, 5)
        running = words.index("047e0000047f200000000000")
        assert next(one for one in words[running + 1 :] if one != "clear") == "047e0000047e000000000000"
        assert not any("047f" in one for one in words[running + 1 :])

    async def test_a_slave_that_was_away_starts_none_of_its_drives(self) -> None:
        async with operating(CU320) as bus:
            second = bus.drive("axis2")
            second.speed = 0.5
            await second.start()
            bench = bench_of(bus)
            bench.power(5, False)
            await bus.until(lambda: not bus.slave(5).ready_now, 5)
            assert [one.status.state for one in bus.drives] == [State.OFFLINE] * 2
            bench.power(5, True)
            await bus.slave(5).ready()
            await second.settled()
            assert not second.status.running
            assert bus.slave(5).outputs.hex(" ", 2) == "047e 0000 047e 2000 0000 0000"


def notes_of(config: dpstack.Config) -> list[str]:
    return list(plan_bus(config).notes)


class TestDoors:
    async def test_status_summary_stream_and_remark_show_every_drive(self) -> None:
        async with operating(CU320) as bus:
            simulated(bus, "axis2").trip("1")
            await bus.until(lambda: bus.drive("axis2").status.faults == ("number 1",), 5)
            shown = json.loads(json.dumps(bus.stats.summary()))["slaves"]["5"]
            assert "drive" not in shown
            assert {name: (one["state"], one["faults"]) for name, one in shown["drives"].items()} == {
                "axis1": ("ready_to_switch_on", []),
                "axis2": ("fault", ["number 1"]),
            }
            values = all_of(picture_of(core_of(bus), bus.slave(5)))
            assert values["drive"] is None
            assert [one["state"] for one in values["drives"].values()] == ["ready_to_switch_on", "fault"]
            assert values["remark"] == {"text": "drive fault: axis2 number 1", "severity": "error"}
            plant = msgspec.convert(slave_plant(core_of(bus), bus.slave(5)), SlavePlant)
            assert {name: one.telegram for name, one in (plant.drives or {}).items()} == {"axis1": "1", "axis2": "2"}
            assert plant.drive is None

    async def test_ctl_names_the_drive(self) -> None:
        async with operating(CU320) as bus:
            answer = await carry_out(*find_order(bus, ["axis2", "speed", "0.25"]))
            assert (answer["drive"], answer["address"], answer["status"]["setpoint"]) == ("axis2", 5, 0.25)
            with pytest.raises(dpstack.UsageError, match="name one of axis1, axis2"):
                find_order(bus, ["cu320", "start"])
            handlers = slave_handlers(bench_of(bus))
            handlers["trip"](["axis1", "1"])
            await bus.until(lambda: bool(bus.drive("axis1").status.faults), 5)
            with pytest.raises(dpstack.UsageError, match="it has several, name one of axis1, axis2"):
                handlers["trip"](["cu320", "1"])
            shown = run_status(bus)["slaves"]["5"]  # type: ignore[index]
            assert [one["state"] for one in shown["drives"].values()] == ["fault", "ready_to_switch_on"]
            assert shown["injected"] == ["axis1 trip 1"]

    def test_the_line_is_judged_by_the_control_word_of_each_drive(self) -> None:
        watched = Watched.of(slave_config(CU320))
        for octets, is_safe in (
            ("047e 0000 047e 0000 0000 0000", True),
            ("047c 0000 047a 2000 0000 0000", True),
            ("0000 0000 0000 0000 0000 0000", False),
            ("047e 0000 047f 0000 0000 0000", False),
            ("047f 0000 047e 0000 0000 0000", False),
        ):
            assert watched.is_safe(bytes.fromhex(octets)) is is_safe, octets

    def test_a_connector_beside_several_drives_is_told_what_it_publishes(self) -> None:
        config = parse_config(PLANT + '[metrics]\nlisten = "127.0.0.1:9464"\n')
        assert any(
            "metrics: the named values of its drives are published, not their" in one for one in notes_of(config)
        )
        assert not any("named values of its drives" in one for one in notes_of(parse_config(PLANT)))

    async def test_a_sheet_for_each_drive(self) -> None:
        sheets = make_sheets(make_config("virtual", 500_000, slaves=[CU320]))
        assert [(one.name, one.kind) for one in sheets] == [("cu320, axis1", "drive"), ("cu320, axis2", "drive")]
        assert sheets[1].remarks[0] == "slot 2, octets in 4 to 11, out 4 to 11; object in record 47: 2"


DRIVES = """drives = [
    { name = "axis1", file = "profidrive", telegram = "1" },
    { name = "axis2", file = "profidrive", telegram = "2" },
]
"""
PLANT = f"""[bus]
port = "virtual"
baud = 500000
[[slave]]
name = "cu320"
address = 5
ident = 0x80E5
{DRIVES}"""


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('name = "axis2"', 'name = "axis1"', "drives 2: two drives are called 'axis1'; give each a name of its own"),
        ('name = "axis2"', 'name = "cu320"', "are both 'cu320'; give each a name of its own"),
        ('name = "axis2"', 'name = "axis 2"', "drives 2: name = 'axis 2'; begin with a letter"),
        ('name = "axis2", ', "", "drives 2: no name; add name"),
        ('telegram = "2" }', 'telegram = "2", slot = 1 }', "slot 1 is taken, the next free one is 2"),
        ('telegram = "2" }', 'telegram = "9" }', "profidrive has no telegram '9'"),
        ('telegram = "2" }', 'telegram = "2", axis = 1 }', "unknown key 'axis'"),
        ("ident = 0x80E5", 'drive = "profidrive"', "drive beside drives; give file to each drive of the list"),
        ("ident = 0x80E5", 'config = "71"', "config beside drives; leave config out"),
        ("ident = 0x80E5", 'outputs = { a = "i16@0" }', "outputs beside drives: their plugins make the outputs"),
        (DRIVES, "drives = 1", "drives = 1 is no list of tables"),
        (DRIVES, "drives = []", "0 drives; give 1 to 16 in one slave"),
        ('file = "profidrive", telegram = "2"', 'file = "profidriv"', "no drive is called 'profidriv'; did you mean"),
    ],
)
async def test_a_mistake_is_reported_by_line(old: str, new: str, text: str) -> None:
    with pytest.raises(dpstack.ConfigError) as caught:
        parse_config(PLANT.replace(old, new, 1), "plant.toml")
    assert text in str(caught.value)
    assert str(caught.value).startswith("plant.toml:")


async def test_a_name_never_means_the_values_of_two_drives(tmp_path: Path) -> None:
    base = 'format = 1\nname = "own"\ntitle = "own"\nbase = "profidrive"\n[words]\nb_speed = { type = "n2" }\n'
    (tmp_path / "own.toml").write_text(
        base + '[telegrams]\n1 = { out = ["control", "setpoint"], in = ["status", "b_speed"] }\n'
    )
    drives = [{"name": "a", "file": str(tmp_path / "own.toml")}, {"name": "a_b", "file": "profidrive"}]
    with pytest.raises(dpstack.ConfigError, match="the input 'a_b_speed' would be one of a_b and one of another drive"):
        slave_config({"name": "cu320", "address": 5, "ident": 0x80E5, "drives": drives})


async def test_drives_of_different_slaves_are_refused() -> None:
    drives = [AXIS1, {"name": "axis2", "file": "keb-f5"}]
    with pytest.raises(dpstack.ConfigError, match="keb-f5 and profidrive differ in ident, and are one slave; name the"):
        slave_config({"name": "cu320", "address": 5, "drives": drives})


GSD = """#Profibus_DP
GSD_Revision = 3
Vendor_Name = "dpstack"
Model_Name = "two axes"
Revision = "1"
Ident_Number = 0x1234
Protocol_Ident = 0
Station_Type = 0
FMS_supp = 0
Hardware_Release = "1"
Software_Release = "1"
500_supp = 1
MaxTsdr_500 = 100
Modular_Station = 1
Max_Module = 8
Max_Input_Len = 60
Max_Output_Len = 60
Max_Data_Len = 120
Module = "Standard telegram 1, PZD-2/2" 0x71
1
EndModule
Module = "Standard telegram 2, PZD-4/4" 0x73
2
EndModule
Module = "Axis separator" 0x00
3
EndModule
"""


@pytest.fixture
def gsd(tmp_path: Path) -> Path:
    path = tmp_path / "two.gsd"
    path.write_text(GSD)
    return path


async def test_modules_follow_from_the_telegrams(gsd: Path) -> None:
    table = {"name": "cu320", "address": 5, "gsd": str(gsd), "drives": [AXIS1, AXIS2 | {"slot": 3}]}
    slave = slave_config(table)
    assert slave.params.config == bytes.fromhex("71 00 73")
    with_modules = table | {
        "modules": ["Standard telegram 1, PZD-2/2", "Axis separator", "Standard telegram 2, PZD-4/4"],
        "drives": [AXIS1, AXIS2],
    }
    assert [one.slots for one in slave_config(with_modules).drives] == [(1,), (3,)]
    with pytest.raises(dpstack.ConfigError, match="do not have 4 octets of inputs and 4 of outputs, as 1 of axis1"):
        slave_config(with_modules | {"drives": [AXIS1 | {"slot": 3}]})
    async with operating(with_modules) as bus:
        await bus.drive("axis2").start()
        assert bus.slave(5).outputs.hex(" ", 2) == "047e 0000 047f 0000 0000 0000"
