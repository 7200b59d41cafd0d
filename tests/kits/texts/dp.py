"""Cases for the texts of the room dp: refusals of PDUs, faults of slaves, plans, fields, tables of states."""

from __future__ import annotations

import random
from collections.abc import Iterable, Iterator
from typing import Any

from bus_kit import setup
from msgspec import structs
from msgspec.structs import astuple
from texts import transcripts
from texts.snapshot import Case, Group, attempt

from dpstack.dp.error_origin import error_text
from dpstack.dp.field_map import FieldMap
from dpstack.dp.master import fault_texts
from dpstack.dp.master.slave_states import TABLE as BRING_UP
from dpstack.dp.master.verdicts import deviations
from dpstack.dp.pdu.alarm_blocks import Alarm, Status, kind_of, message_dict
from dpstack.dp.pdu.diag_bits import FLAGS
from dpstack.dp.pdu.diag_blocks import (
    ChannelBlock,
    UserDiag,
    channel_block,
    device_block,
    identifier_block,
    revision_block,
    split_blocks,
)
from dpstack.dp.pdu.diag_texts import block_texts, conspicuous_text
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.pdu.prm_blocks import PrmBlock, parse_blocks
from dpstack.dp.pdu.prm_contents import BlockType, DxbLink, DxbSubscription, DxbTable, Isochronous, PrmCmd, TimeAr
from dpstack.dp.pdu.redundancy import PrmFunction, RedState, Redundancy
from dpstack.dp.pdu.requests import GlobalControl, SetPrm, SetSlaveAdd
from dpstack.dp.plan.plan import make_plan
from dpstack.dp.plan.rotation_time import OtherMasters
from dpstack.dp.process_data import Field, field_of, with_scale
from dpstack.dp.slave.cyclic_data import wrong_inputs
from dpstack.dp.slave.events import (
    AddressChanged,
    DeviceFailed,
    Report,
    RequestRefused,
    SlaveAppEvent,
    SlaveAppStateChanged,
    WatchdogExpired,
)
from dpstack.dp.slave.state_table import ACCESS, CONNECTION, AppTrigger, SlaveAppState
from dpstack.dp.slave.state_table import TABLE as SLAVE_STATES
from dpstack.dp.slave_params import SlaveParams, WatchdogTime
from dpstack.fdl.interface import Failure
from dpstack.params import BusParams
from dpstack.units import BAUD_RATES, NS_PER_MS

FILE = "texts_dp.jsonl"


def _pdus() -> Iterator[Case]:
    yield attempt(Diagnosis(0, 4, 0, None, 1, bytes(239)).build)
    yield attempt(Diagnosis(0, 4, 0, None, 0x10000).build)
    yield attempt(SetPrm(1, bytes(238)).build)
    yield attempt(SetPrm(1, watchdog=(256, 1)).build)
    for length in (0, 245):
        yield attempt(SetPrm.parse, bytes(length))
    yield attempt(GlobalControl(group_mask=256).build)
    yield attempt(GlobalControl.parse, bytes(3))
    for add in (SetSlaveAdd(126, 1), SetSlaveAdd(1, 0x10000), SetSlaveAdd(1, 1, False, bytes(241))):
        yield attempt(add.build)
    yield attempt(SetSlaveAdd.parse, b"\0")


def _diag_blocks() -> Iterator[Case]:
    for ext in ("", "00", "01", "4112", "800102", "C5", "42FF41"):
        yield attempt(split_blocks, bytes.fromhex(ext))
    for size in range(8):
        direction = size % 4
        block = channel_block(63, 62, size + 4 * direction, size=size, input=bool(direction & 1), output=direction > 1)
        yield f"channel {block.octets.hex()}", f"{block.text} | {block.place('AI 4', 0)}"
    for error in range(11):
        yield f"error {error}", ChannelBlock(b"", 0, 0, False, False, 0, error).cause
    for call in (
        (device_block, b"\1"),
        (device_block, bytes(63)),
        (identifier_block, [0, 7, 8], 9),
        (identifier_block, [9], 9),
        (identifier_block, [], 0),
        (identifier_block, [], 496),
        (channel_block, 64, 0, 1),
        (channel_block, 0, 64, 1),
        (channel_block, 0, 0, 32),
        (revision_block, 63),
        (revision_block, 64),
        (UserDiag, "text"),
    ):
        yield attempt(call[0], *call[1:])
    full = UserDiag(bytes.fromhex("0301024101C5"), fault=True, stat=True)
    for room in (0, 1, 4, 6):
        yield f"limited to {room}", repr(full.limited(room))
    yield "octets that are no blocks", repr(UserDiag(bytes.fromhex("030102FF00")).limited(4))
    for args in ({}, {"fault": True}, {"stat": True}):
        yield attempt(UserDiag.of, **args)
    yield attempt(UserDiag.of, device_block(b"\1"), overflow=True)


def _diagnoses() -> Iterator[Case]:
    for octet, bit in ((0, 0), (0, 1), (0, 4), (1, 1), (1, 2), (1, 3), (2, 0)):
        status = [0, 0, 0]
        status[octet] = 1 << bit
        read = Diagnosis(status[0], status[1], status[2], None, 0x1234)
        yield (
            f"octet {octet + 1} bit {bit}",
            f"{read.texts} {[f.name for f in read.conspicuous(exchanging=True)]} "
            f"{[f.name for f in read.conspicuous(exchanging=False)]} {list(deviations(read, 1))} {read.always_one}",
        )
    for ext, dpv1 in (
        ("", False), ("0401020000", False), ("0401020000", True), ("0481000003", True), ("020041", False),
        ("4281", False), ("8281C5", False), ("06810000AABB", True),
    ):  # fmt: skip
        read = Diagnosis(8, 12, 0, 129, 0x1234, bytes.fromhex(ext))
        yield (
            f"{ext} {dpv1=}",
            f"{block_texts(read, dpv1=dpv1)} {conspicuous_text(read, dpv1=dpv1, exchanging=True)!r} "
            f"{conspicuous_text(read, dpv1=dpv1, exchanging=False)!r} {list(deviations(read, 1))}",
        )
    for flag in FLAGS:
        yield flag.name, repr(astuple(flag))


def _alarms() -> Iterator[Case]:
    for kind in (0, 1, 2, 3, 4, 5, 6, 7, 30, 31, 32, 127):
        specifier = kind % 4
        alarm, status = Alarm(kind, 3, specifier, 31, b"\xaa\xbb", add_ack=True), Status(kind, 3, specifier, b"\7")
        yield f"alarm {kind} {specifier}", f"{alarm.full_text} | {message_dict(alarm)} | {attempt(alarm.build)[1]}"
        yield f"status {kind} {specifier}", f"{status.full_text} | {message_dict(status)}"
    for kind in (2, 32, 127):
        yield attempt(kind_of, kind)
    for block in (
        Alarm(1, 255),
        Alarm(1, 1, data=bytes(60)),
        Alarm(1, 1, sequence=32),
        Status(1, 1, reserved=63),
    ):
        yield attempt(block.build)
    yield "module status", Status(2, 0, data=b"\xe4\x1b").full_text
    for count in (2, 3):
        yield f"PrmCmdAck of {count} octets", Status(30, 0, 2, bytes((0x4E, 0x01, 0x7E, 9, 9)[:count]), 5).full_text
    every = Redundancy(31, PrmFunction(0xFF), RedState(0xFF), RedState(0))
    yield "all bits", every.text + every.octets.hex(" ")


def _parameter_blocks() -> Iterator[Case]:
    for number in (0, 2, 3, 4, 5, 7, 8, 255):
        yield PrmBlock(number, 1, b"").title, PrmBlock(number, 1, b"\1\2", 8).octets.hex(" ")
    for number, data, specifier in ((256, b"", 0), (2, bytes(231), 0), (2, b"", 256)):
        yield attempt(PrmBlock, number, 0, data, specifier)
    contents: tuple[Any, ...] = (
        PrmCmd(),
        PrmCmd(1, 2, 0x304),
        Isochronous(),
        Isochronous(1, 2, 3, 4, 5, 6, 7, 8, 9, 10),
        TimeAr(),
        TimeAr(1, 2, 3),
        DxbTable(1, (DxbLink(1, 2, 3, 4), DxbLink(5, 6, 7, 8))),
        DxbTable(257, (DxbSubscription(1, 2, 3, 4, 5, 6),)),
    )
    for content in contents:
        block = PrmBlock.of(content, 3, specifier=16)
        yield repr(content), f"{block.octets.hex(' ')} {block.content!r}"
    yield attempt(PrmBlock.of, DxbTable(1, ()))
    yield attempt(PrmBlock.of, DxbTable(1, ()), kind=BlockType.DXB_LINKS)
    yield attempt(PrmBlock.of, PrmCmd(output_hold_time=0x10000))
    for number, length in ((2, 0), (2, 4), (3, 0), (3, 1), (3, 5), (4, 0), (7, 0), (7, 7), (8, 0), (8, 10)):
        content = attempt(lambda number, length: PrmBlock(number, 0, bytes(length)).content, number, length)[1]
        yield f"{length} octets of type {number}", content
    for octets in ("", "040500", "0405000005050000", "0402000000", "0605000001020405FF00"):
        yield attempt(parse_blocks, bytes.fromhex(octets))
    yield attempt(parse_blocks, bytes.fromhex("040500"), 11)
    for given in (
        {"alarms": ("process", "fire")},
        {"alarm_mode": 8},
        {"alarm_mode": 7},
        {"c1_max_data_len": 241},
    ):
        yield attempt(Dpv1, **given)
    block = PrmBlock(32, 1, b"\xaa")
    every_alarm = ("pull_plug", "process", "diagnostic", "manufacturer", "status", "update")
    for dpv1, octets in (
        (Dpv1(), "000000"),
        (Dpv1(), "FFFFF7"),
        (Dpv1(alarms=()), "FFFFF7"),
        (Dpv1(alarms=every_alarm, alarm_mode=5), "00000804200000"),
        (Dpv1(required_alarms=("update", "status")), "000000"),
        (Dpv1(check_cfg_mode=True, prm_cmd=True), "000000"),
        (Dpv1(check_cfg_mode=False, prm_cmd=False), "FFFFF7"),
        (Dpv1(blocks=(block, block)), "000000"),
        (Dpv1(blocks=(block, block)), "FFFFFF0405"),
        (Dpv1(structured=True), "0000000102"),
    ):
        yield repr(dpv1), f"{octets}: {attempt(_applied, dpv1, bytes.fromhex(octets))[1]}"


def _applied(dpv1: Dpv1, octets: bytes) -> bytes:
    changed = bytearray(octets)
    dpv1.apply(changed)
    return bytes(changed)


def _faults() -> Iterator[Case]:
    slave = setup(7)
    doubtful = structs.replace(slave, prm_note="read its file otherwise")
    fault_texts_of: dict[str, Iterable[tuple[Any, ...]]] = {
        "absent": [(7, 1_500_000), (7, 9600, Failure.GARBLED)],
        "lost": [("Data_Exchange", Failure.NO_ANSWER), ("Data_Exchange", Failure.GARBLED)],
        "bus_gone": [("the port is gone",)],
        "wrong_ident": [(0x1234, 0xAB), (None, 1)],
        "not_adapted": [(0x9700, 0x4531, "Prm_Fault", b"\1\2")],
        "adapts": [(0x9700, 0x4531)],
        "locked": [(Diagnosis(0, wd, 0, 5, 1), 5, masters) for wd, masters in ((0, None), (0, ()), (8, ()), (0, (5,)))],
        "refusal": [
            (one, Diagnosis(bits, 0, 0, 1, 1, ext), bytes(7) + user)
            for one, bits, ext, user in (
                (slave, 0x40, b"", b""),
                (slave, 0x40, b"\2\1", b"\3\4"),
                (slave, 0x10, b"", b""),
                (slave, 0x04, b"", b""),
                (doubtful, 0x40, b"", b""),
            )
        ],
        "statically_ill": [(10,)],
        "refused": [("Slave_Diag", code) for code in ("RS", "RR", "UE", "NR")],
        "prm_silent": [(b"\1\2",)],
        "left": [(Diagnosis(0, bits, 0, 1, 1), status) for bits, status in ((0, ""), (0, "RS"), (0, "UE"), (8, ""))],
        "plugin": [(ValueError("no"),)],
    }
    for name, rows in fault_texts_of.items():
        for row in rows:
            yield (
                f"{name}{tuple(value for value in row if not isinstance(value, SlaveParams))!r}",
                repr(getattr(fault_texts, name)(*row)),
            )
    config = slave.config
    for fault, *configs in (
        (fault_texts.cfg_fault(slave), None, config, config[:-1] + b"\x77", config + b"\0"),
        (fault_texts.not_ready(slave, 10), None, config[:-1] + b"\x77"),
        (fault_texts.not_taken(slave), None),
        (fault_texts.wrong_length(slave, 3, 1), None),
        (fault_texts.cfg_silent(slave), None),
    ):
        for actual in configs:
            yield f"{fault.kind} compared with {actual!r}", repr(fault.compared(actual))
    yield "watching", fault_texts.NOT_WATCHING
    yield attempt(error_text, ValueError())


def _fields() -> Iterator[Case]:
    for spec in (
        "bool@0.3", "bool@0.7", "bool@0.8", "bool@0", "bool@0.1:2", "u8@0", "u8@0.1", "i16le@2", "boolle@0.1",
        "bytes@4:3", "bytes@4", "bytes@4:0", "u16 @ 1", "f64@0", "u8@1234", "u8@12345", "", "x" * 60 + "@1",
    ):  # fmt: skip
        case, text = attempt(Field.parse, "level", spec)
        if "Field(" in text:
            text += f" {Field.parse('level', spec).spec} {Field.parse('level', spec).mask:x}"
        yield case, text
    for name in ("1a", "x" * 60 + "!"):
        yield attempt(field_of, name, "u8@0", 1, "inputs")
    for spec, length in (("u16@1", 2), ("u8@0", 1)):
        yield attempt(field_of, "a", spec, length, "inputs")
    fields = FieldMap({"a": Field.parse("a", "u16@0")}, 2)
    for length in (0, 3):
        yield attempt(fields.fitted, length, "inputs")
    tenth, shifted = {"scale": 0.1}, {"scale": 0.1, "offset": -5, "unit": "C"}
    puts: tuple[tuple[str, dict[str, Any], Any], ...] = (
        ("u8@0", {}, 0), ("u8@0", {}, 255), ("u8@0", {}, 256), ("u8@0", {}, 0.5), ("u8@0", {}, True),
        ("u8@0", {"unit": "bar"}, -1), ("u8@0", tenth, 0), ("u8@0", tenth, float("nan")), ("u8@0", tenth, False),
        ("u8@0", shifted, -128), ("u8@0", shifted, 0.5), ("u8@0", {"scale": -2.0}, 0), ("i16le@0", {}, -2),
        ("i16le@0", {"scale": 1e-16}, 0.5), ("f32@0", {}, 1e39), ("f32@0", {}, None), ("f32@0", shifted, 0),
        ("f32@0", {"scale": -2.0}, float("nan")), ("bool@0.1", {}, 0), ("bool@0.1", {}, 1), ("bool@0.1", {}, 2),
        ("bytes@0:2", {}, 0), ("bytes@0:2", {}, b"\1\2"), ("bytes@0:2", {}, b"\1"),
    )  # fmt: skip
    for spec, scale, value in puts:
        yield f"{spec} {scale} = {value!r}", attempt(with_scale(Field.parse("n", spec), scale).put, bytes(9), value)[1]
    gets: tuple[tuple[str, dict[str, Any]], ...] = (
        ("u8@0", {}), ("u8@0", tenth), ("u8@0", {"offset": 3}), ("i16le@0", shifted), ("f32@0", tenth),
        ("bool@0.1", {}), ("bool@0.2", {}), ("bytes@0:2", {}),
    )  # fmt: skip
    for spec, scale in gets:
        yield f"{spec} {scale}", repr(with_scale(Field.parse("n", spec), scale).get(bytes(range(3, 11))))
    reads: tuple[tuple[str, dict[str, Any], str], ...] = (
        ("u8@0", {}, " 0x10 "), ("u8@0", {}, "1.5"), ("f32@0", {"unit": "bar"}, "1 bar"), ("bool@0.1", {}, "on"),
        ("bool@0.1", {}, "zwei" * 20), ("bytes@0:2", {}, "aa bb"), ("bytes@0:2", {}, "1"),
    )  # fmt: skip
    for spec, scale, text in reads:
        yield f"{spec} {scale} read {text!r}", attempt(with_scale(Field.parse("n", spec), scale).read, text)[1]
    for spec, given in (
        ("bool@0.1", {"scale": 0}), ("bool@0.1", {"unit": "m"}), ("u8@0", {"scale": 0}),
        ("u8@0", {"scale": 2.0, "dead_band": 0.5}),
    ):  # fmt: skip
        yield attempt(with_scale, Field.parse("n", spec), given)


def _slave_params() -> Iterator[Case]:
    base: dict[str, Any] = {"address": 5, "name": "pump", "ident": 1, "config": b"\x11\x20"}
    for change in (
        {"address": -1}, {"address": 126}, {"address": 127}, {"ident": 0x10000}, {"watchdog_ms": 650_251},
        {"groups": (1, 9)}, {"every": 10_001}, {"max_diag_len": 5}, {"max_diag_len": 245}, {"config": b""},
        {"config": bytes(244)}, {"user_prm": bytes(237)}, {"user_prm": bytes(238)},
        {"wd_base_1ms": True}, {"wd_base_1ms": True, "user_prm": bytes(3)},
        {"fail_safe_told": True, "user_prm": b"\0"}, {"dpv1": Dpv1()},
        {"dpv1": Dpv1(blocks=(PrmBlock(32, 0, bytes(230)),)), "user_prm": bytes(3)},
        {"dpv1": Dpv1(blocks=(PrmBlock(32, 0, bytes(230)),)), "user_prm": bytes(4)},
        {"config": b"\x1f" * 16}, {"safe": b"\1\2"}, {"initial": b"\1\2"},
    ):  # fmt: skip
        _, text = attempt(lambda given: SlaveParams(**given), base | change)
        yield repr(change), text
    for wished_ms, fine in ((0, False), (1, True), (10, True), (11, False), (2551, False), (65_025, True)):
        made = SlaveParams(**base | {"wd_base_1ms": fine, "user_prm": bytes(3), "watchdog_ms": wished_ms})
        found = made.watchdog(30)
        yield f"watchdog {wished_ms} {fine}", f"{found} {found and found.ms} {made.user_octets(found).hex()}"
    yield "default watchdog", f"{SlaveParams(**base).watchdog(30)} {SlaveParams(**base).watchdog(0)}"
    yield "time", repr((WatchdogTime((2, 3)).ns, WatchdogTime((2, 3), 1).ms))


def _plans() -> Iterator[Case]:
    dice = random.Random(7)
    for number in range(36):
        baud = dice.choice(BAUD_RATES)
        slaves = []
        for address in dice.sample(range(3, 60), dice.choice((1, 1, 2, 3, 5, 9))):
            ways = [bytes([0x10 * way | dice.randrange(16)]) for way in dice.choice(((1,), (2,), (1, 2), (3,)))]
            slaves.append(
                SlaveParams(
                    address=address,
                    name=f"s{address}",
                    ident=dice.choice((None, 0x4711)),
                    config=b"".join(ways),
                    every=dice.choice((1, 1, 1, 2, 3)),
                    watchdog_ms=dice.choice((None, None, 0, 10, 50, 211, 1000)),
                    min_tsdr=dice.choice((11, 11, 60, 200)),
                    min_slave_interval_ns=dice.choice((0, 0, 100_000, 3_000_000, 40_000_000)),
                    max_diag_len=dice.choice((None, 6, 32)),
                    max_tsdr=dice.choice(({}, {baud: 60}, {baud: 400})),
                    ignore_auto_clear=dice.random() < 0.2,
                    on_loss=dice.choice(("", "coasts")),
                )
            )
        params = BusParams.preset(baud)
        others = dice.choice((None, OtherMasters(1), OtherMasters(2, (5000,)), OtherMasters(0, (90_000, 4000))))
        given: dict[str, Any] = {} if others is None else {"others": others}
        free = make_plan(params, slaves, **given)
        if number % 3 == 2:
            given["cycle_ns"] = round(free.figures.ns(dice.choice(list(free.rotations))) * dice.choice((0.9, 1.05, 2)))
        if number % 3 == 1:
            given |= {"data_control_ns": dice.choice((20, 5000)) * NS_PER_MS, "host_slack_ns": 2 * NS_PER_MS}
        plan = make_plan(params, slaves, pty=number % 4 == 0, **given)
        shown = plan.as_dict()
        del shown["baud"], shown["address"], shown["rotation_us"], shown["parameters"]
        yield f"plan {number} at {baud}", f"{shown} {plan.watchdog_ms}"
        if plan.cycle is not None:
            yield f"refusals {number}", repr(plan.refusals)


def _tables() -> Iterator[Case]:
    for sap, access in ACCESS.items():
        states = sorted(state.name for state in access.states)
        yield f"access {sap}", f"{access.name} {states} {access.owner_only} {access.clause}"
    yield "connection", repr((CONNECTION.name, len(CONNECTION.states), CONNECTION.owner_only, CONNECTION.clause))
    for (state, event), row in SLAVE_STATES.items():
        yield f"slave {state.value}, {event.value}", f"{row.next.value}: {row.clause}"
    for (before, trigger), step in BRING_UP.items():
        yield f"master {before.value}, {trigger.value}", repr(astuple(step))


def _slave_events() -> Iterator[Case]:
    slave: dict[str, Any] = {"t_ns": 1, "address": 7, "name": "pump"}
    events: list[SlaveAppEvent] = [
        *(
            AddressChanged(**slave | {"address": address}, before=before, master=master, fixed=fixed, kept=kept)
            for address, before, master, fixed, kept in (
                (7, 126, None, False, True),
                (7, 126, 2, True, False),
                (126, None, None, False, True),
                (None, 3, None, False, True),
            )
        ),
        SlaveAppStateChanged(**slave, state=SlaveAppState.WAIT_CFG, why=AppTrigger.PRM_GOOD, master=4),
        SlaveAppStateChanged(**slave, state=SlaveAppState.WAIT_PRM, why=AppTrigger.POWER_ON, master=None),
        WatchdogExpired(**slave, master=3, watchdog_ns=1_999_999),
        RequestRefused(**slave, service="Set_Prm", master=3, reason="octet 8"),
        DeviceFailed(**slave, during="Set_Prm", error="ValueError: no", origin="f(), a.py line 3"),
        DeviceFailed(**slave, during="Set_Prm", error="ValueError"),
    ]
    yield from ((f"{type(event).__name__} {number}", event.text) for number, event in enumerate(events))
    report = Report("pump", None)
    for number in range(60):
        for _ in range(2):
            report.refused("Set_Prm", 3, f"reason {number}", number)
    report.refused("Set_Prm", 4, "reason 0", 0)
    report.failed("Chk_Cfg", ValueError("no"), 5)
    report.report_again()
    report.refused("Set_Prm", 3, "reason 0", 9)
    yield "reported", " | ".join(f"{event.t_ns} {event.text}" for event in report.take_events()[48:])
    yield "counted", f"{report.stats} {report.baud} {report.address} {report.take_events()}"
    for inputs in (b"\1\2", "text"):
        yield attempt(wrong_inputs, inputs, 3)


PLAIN: dict[str, Group] = {
    "slave_events": _slave_events,
    "pdus": _pdus,
    "diag_blocks": _diag_blocks,
    "diagnoses": _diagnoses,
    "alarms": _alarms,
    "parameter_blocks": _parameter_blocks,
    "faults": _faults,
    "fields": _fields,
    "slave_params": _slave_params,
    "plans": _plans,
    "tables": _tables,
}
TRANSCRIPTS: dict[str, Group] = {
    "bring_ups": transcripts.bring_ups,
    "controls": transcripts.controls,
    "class2_outcomes": transcripts.class2_outcomes,
}
GROUPS = PLAIN | TRANSCRIPTS
