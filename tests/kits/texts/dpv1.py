"""Cases for the texts of the room dpv1: refusals of PDUs, codes of errors, records, descriptions, GSD files."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from texts import transcripts
from texts.snapshot import Case, Group, attempt

from dpstack.dp.pdu.alarm_blocks import Alarm
from dpstack.dp.pdu.prm_blocks import PrmBlock
from dpstack.dpv1 import timeouts
from dpstack.dpv1.pdu.error_codes import AGAIN, class_text, code_text, negative_text, remedy
from dpstack.dpv1.pdu.im import Im, Im0, Im1, Im2, Im3, Im4, build_call, parse_answer, parse_call
from dpstack.dpv1.pdu.ms2 import Abort, Address, InitiateReq, InitiateRes, ResourceManagerRes
from dpstack.dpv1.pdu.read_write import (
    FUNCTIONS,
    AlarmAck,
    DataTransport,
    Function,
    Negative,
    ReadReq,
    ReadRes,
    UnacceptableError,
    WriteReq,
    WriteRes,
    parse_request,
    parse_response,
)
from dpstack.dpv1.slave.alarms import AlarmSupport
from dpstack.dpv1.slave.description import SlaveDescription, SlaveModule, SlaveParameter
from dpstack.dpv1.slave.description_to_gsd import as_gsd_file, gsd_octets
from dpstack.dpv1.slave.ms2_states import TABLE as MS2_STATES
from dpstack.dpv1.slave.record_table import ImRecords
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.gsd.model import DiagText
from dpstack.units import NS_PER_MS

FILE = "texts_dpv1.jsonl"


def _codes() -> Iterator[Case]:
    for code in (0, *range(0xA0, 0xA4), *range(0xA8, 0xAB), *range(0xB0, 0xBB), *range(0xC0, 0xC5), 0xC8, 0xD0):
        yield f"code {code:02X}", f"{code_text(code)} | {remedy(code)}{' | again' if code in AGAIN else ''}"
    for number in (0, *range(10, 14)):
        yield f"class {number}", class_text(number)
    for decode, code_2 in ((0, 0), (0x80, 0), (0x80, 7), (0xFE, 0), (0xFF, 0)):
        yield f"decode {decode:02X} {code_2}", negative_text(decode, 0xB2, code_2)


def _request(octets: bytes) -> object:
    try:
        return parse_request(octets)
    except UnacceptableError as error:
        return f"{error}: {error.negative.build().hex(' ')}"


def _records() -> Iterator[Case]:
    for function in sorted(FUNCTIONS):
        yield f"function {function:02X}", Function(function).title
        octets = bytes((function, 1, 2, 0))
        yield f"{octets.hex(' ')}", f"{attempt(_request, octets)[1]} | {attempt(parse_response, octets)[1]}"
    for text in (
        "", "00", "4D010200", "5E", "5E010200", "5E0102F0", "5E0102F1", "5EFE0200", "5EFF0200", "5E010201AA",
        "5E010202AA", "5F010201AA", "5F010201", "5F0102F1", "5FFF0200", "DE80B200", "DF80B2", "51010201AA",
        "51010202AA",
    ):  # fmt: skip
        octets = bytes.fromhex(text)
        results = [attempt(call, octets)[1] for call in (_request, parse_response, DataTransport.parse, Negative.parse)]
        yield text, " | ".join(results)
    for service in (
        ReadReq(254, 255, 240), ReadReq(255, 0), ReadReq(0, 256), ReadReq(0, 0, 241), WriteReq(1, 2, bytes(240)),
        WriteReq(1, 2, bytes(241)), DataTransport(1, 2, bytes(241)), DataTransport(1, 2, b"\1"), ReadRes(1, 2, b"\1"),
        WriteRes(1, 2, 3),
    ):  # fmt: skip
        yield attempt(service.build)[0] + repr(service)[:60], f"{attempt(service.build)[1]} {service.title}"
    for text in ("5C", "5C01020300", "5D010203", "5C0102FF"):
        yield attempt(AlarmAck.parse, bytes.fromhex(text))
    yield "acknowledgement", repr(AlarmAck.of(Alarm(2, 3, 1, 17, b"\1", add_ack=True)))
    for ack in (AlarmAck(256, 1), AlarmAck(1, 1, 0, 32), AlarmAck(1, 1)):
        yield repr(ack), attempt(ack.build)[1]
    for negative in (Negative(0x5E, 256), Negative(0x5F, 1)):
        yield repr(negative), attempt(negative.build)[1]


def _connections() -> Iterator[Case]:
    far = Address(1, 2, bytes(7))
    for pdu in (
        ResourceManagerRes(48, 10_000_000), ResourceManagerRes(49, 0), ResourceManagerRes(0, -10_000_000),
        ResourceManagerRes(0, 655_350_000_000), ResourceManagerRes(0, 655_350_000_001), ResourceManagerRes(0, 1),
        InitiateReq(0), InitiateReq(1, source=far), InitiateReq(1, destination=far), InitiateReq(1, features=0x10000),
        InitiateRes(), InitiateRes(256), Abort(16), Abort(3),
    ):  # fmt: skip
        yield repr(pdu), attempt(pdu.build)[1]
    reasons = {0: (*range(5), *range(9, 16)), 1: (*range(10), 15)}
    aborts = [(0, instance, reason) for instance in reasons for reason in reasons[instance]]
    for subnet, instance, reason in (*aborts, (1, 0, 1), (2, 1, 1), (3, 0, 0), (0, 2, 0), (0, 3, 0)):
        yield f"abort {subnet} {instance} {reason}", Abort(reason, instance, subnet).text
    octets = bytes.fromhex("57 00 00 00 01 90 01 00 00 00 00 00 00 02 00 02 00 00 00 00")
    for length in (0, 19, 20):
        yield attempt(InitiateReq.parse, octets[:length])
    for place, value in ((0, 0x58), (12, 1), (14, 1)):
        changed = octets[:place] + bytes((value,)) + octets[place + 1 :]
        yield f"octet {place + 1} {value}", attempt(InitiateReq.parse, changed)[1]
    for (state, trigger), row in MS2_STATES.items():
        yield f"{state.value}, {trigger.value}", f"{row.act.value}: {row.source}"
    for baud in (9600, 500_000, 12_000_000):
        yield f"least send time-out at {baud}", repr(timeouts.least_send_timeout(baud))
    yield "pauses", repr([timeouts.pause_before(polls) for polls in range(12)])
    yield "service", repr([timeouts.service_timeout(ns) for ns in (0, NS_PER_MS, 100_000 * NS_PER_MS)])


def _im() -> Iterator[Case]:
    records: tuple[Any, ...] = (
        Im0(), Im0(order_id="x" * 20), Im0(order_id="x" * 21), Im0(order_id="ä"), Im0(order_id="a\n"),
        Im0(serial_number="1" * 17), Im0(serial_number="1" * 16), Im0(manufacturer_id=65536), Im0(revision_counter=-1),
        Im0(software_revision="P255.0.1", version=(2, 3), supported=30, profile_id=0x3A00, profile_type=1),
        *(Im0(software_revision=text) for text in ("", "X1.2.3", "V1.2", "V1.2.256", "V1.2.x", "v1.2.3", "VV1.2.3")),
        Im0(version=(256, 0)), Im1("ä" * 32, "y" * 22), Im1("x" * 33), Im1("", "y" * 23), Im1("\u20ac"), Im2("x" * 16),
        Im2("x" * 17), Im3("x" * 54), Im3("x" * 55), Im4(b"\1\2"), Im4(bytes(54)),
    )  # fmt: skip
    for record in records:
        text = attempt(record.build)[1]
        if "Error" not in text:
            text = f"{record.build().hex()} {type(record).parse(record.build() + b'x') == record}"
        yield repr(record)[:150], text
    yield attempt(Im4, bytes(55))
    for letter in (b"V", b"\0", b"\xe4"):
        changed = Im0().build()[:50] + letter + bytes((1, 2, 3)) + Im0().build()[54:]
        yield f"letter {letter.hex()}", repr(Im0.parse(changed))
    for text in ("", "0800FD", "0800FDE8", "0900FDE8", "0800FDE7", "0800FEAF", "0800FEB0", "08FFFDE8AA"):
        octets = bytes.fromhex(text)
        yield text, f"{attempt(parse_call, octets)[1]} | {attempt(parse_answer, octets, 1)[1]}"
    yield "call", build_call(3).hex()
    yield "change", build_call(3, Im3("x")).hex()
    tables: tuple[Any, ...] = (
        {255: [Im0()]},
        {-1: [Im0()]},
        {254: [Im1("a")]},
        {"1": []},
        "text",
        Im0(),
        5,
        [5],
        [Im1("x" * 40)],
    )
    for given in tables:
        case, text = attempt(lambda given: ImRecords(given).of(254), given)
        yield case[:120], text
    slots: dict[int, list[Im]] = {0: [Im0(supported=1), Im2("now")], 3: []}
    found = ImRecords(slots)
    yield "I&M of slots", repr([found.of(slot) for slot in (0, 1, 3)])


def _descriptions() -> Iterator[Case]:
    base: dict[str, Any] = {"ident": 0x1234, "name": "tank", "configs": (b"\x11\x20",)}
    modular: dict[str, Any] = base | {"configs": (), "modules": (SlaveModule("a", b"\x10"), SlaveModule("b", b"\x21"))}
    for change in (
        {}, {"ident": -1}, {"ident": 0x10000}, {"configs": ()}, {"modules": (SlaveModule("a", b"\x10"),)},
        {"presets": (SlaveModule("a", b"\x10"),)}, {"max_input_len": 1}, {"max_input_len": 2}, {"max_output_len": 0},
        {"max_output_len": 1}, {"max_data_len": 2}, {"max_data_len": 3}, {"user_prm_len": (-1, 3)},
        {"user_prm_len": (4, 3)}, {"user_prm_len": (0, 237)}, {"user_prm_len": (0, 238)}, {"ms2": -1}, {"ms2": 49},
        {"dpv1": True, "user_prm_len": (0, 2)}, {"dpv1": True, "user_prm_len": (0, 3)}, {"alarms": ("process",)},
        {"alarm_sequence": 2}, {"extra_alarm_sap": True}, {"dpv1": True, "alarms": ("fire",)}, {"max_diag_len": 245},
        {"dpv1": True, "alarm_sequence": 1}, {"dpv1": True, "alarm_sequence": 33}, {"max_diag_len": 5},
        {"dpv1": True, "alarms": ("process",), "max_diag_len": 9}, {"max_diag_len": 6}, {"ms2_max_len": 241},
        {"dpv1": True, "alarms": ("process",), "max_diag_len": 10}, {"ms2_max_len": 0}, {"ms2_max_initiate": 19},
        {"ms2_max_initiate": 20}, {"ms2_max_initiate": 245}, {"ms2": 10},
    ):  # fmt: skip
        yield repr(change), attempt(lambda given: SlaveDescription(**given), base | change)[1]
    yield repr({"max_modules": 0}), attempt(lambda given: SlaveDescription(**given), modular | {"max_modules": 0})[1]
    yield attempt(SlaveModule, "empty", b"")
    yield attempt(SlaveDescription.simple, 1, inputs=3, outputs=2, dpv1=True, ms2=1, alarms=("update",))
    for sequence in (0, 1, 2, 32, 33):
        yield attempt(AlarmSupport, frozenset({"process"}), sequence)
    two = SlaveDescription(**modular | {"max_modules": 2, "presets": (SlaveModule("p", b"\x30"),), "max_output_len": 3})
    one = SlaveDescription(**base)
    for config in ("", "30", "3010", "301021", "30102110", "10", "3020", "302121", "1120", "112021", "30102F"):
        yield f"config {config}", " | ".join(attempt(slave.check_cfg, bytes.fromhex(config))[1] for slave in (one, two))
    yield "default", f"{two.default_config.hex()} {SlaveDescription(**modular).default_config.hex()}"
    yield attempt(two.table, 5)
    yield attempt(two.table, 5, b"\x30\x10")
    for extra in (
        {}, {"alarms": ("process", "update")}, {"alarms": ("process",), "alarm_sequence": 5},
        {"alarms": ("process",), "alarm_sequence": 32}, {"prm_blocks_required": True}, {"prm_blocks": False},
        {"min_slave_interval_ns": 100_001, "user_prm_len": (5, 9)},
    ):  # fmt: skip
        slave = SlaveDescription(**base | {"dpv1": True} | extra)
        yield f"table {extra}", repr(slave.table(7))
        for prm in ("", "000000", "000008", "00000804200000", "0000080420", "0000000102030405060708"):
            octets = bytes.fromhex(prm)
            yield f"{extra} {prm}", f"{attempt(slave.check_prm, octets)[1]} {attempt(slave.blocks, octets)[1]}"
    for given in (
        {"safe": b"\1\2\3"}, {"config": b"\x12"}, {"ms2": 50}, {"config": 5}, {"safe": 5}, {"ms2": "1"},
        {"on_prm": 5}, {"im": [Im1("x" * 40)]}, {"colour": 1},
        {"parameters": PrmBlock},
    ):  # fmt: skip
        yield repr(given)[:60], attempt(lambda given: DpSlave(one, lambda outputs, now: b"", **given), given)[1][:200]
    yield attempt(DpSlave, "slave", print)
    yield "modular and safe", attempt(lambda: DpSlave(two, lambda outputs, now: b"", safe=b""))[1]


def _gsd_files() -> Iterator[Case]:
    base: dict[str, Any] = {"ident": 0x1234, "name": "tank", "configs": (b"\x11\x20",)}
    valve = SlaveParameter("Valve", 1, "Bit(3)", 1, ((0, 1),), {0: "shut", 1: "open"})
    modules = (SlaveModule("a", b"\x10", b"\1", (SlaveParameter("P", 2, "Unsigned16", 7),)), SlaveModule("b", b"\x21"))
    texts = (
        DiagText("area", 8, 11, 5, "hot", "wait"), DiagText("area", 8, 11, 6, "cold", ""),
        DiagText("bit", 0, 0, 1, "x", ""), DiagText("area", 9, 11, 5, "other", ""),
        DiagText("area", 16, 17, 3, "c", ""), DiagText("not_bit", 1, 1, 0, "y", "z"),
        DiagText("channel", None, None, 16, "stuck", ""), DiagText("channel", None, None, 31, "gone", "look"),
    )  # fmt: skip
    changes: tuple[dict[str, Any], ...] = (
        {}, {"name": "x" * 32}, {"name": "x" * 33}, {"name": 'a"b'}, {"vendor": "a\nb"}, {"name": "\u0416"},
        {"name": "Ã¤"}, {"revision": " V2 "}, {"vendor": "Mustermann & Söhne"}, {"configs": (b"",)},
        {"configs": (b"\x10", b"\x20", b"\x10")}, {"configs": (), "modules": (SlaveModule("e", b"\0"),)},
        {"configs": (), "modules": modules, "max_modules": 500, "presets": modules[:1]},
        {"configs": (), "modules": (*modules, SlaveModule("e", b"\0")), "max_input_len": 9, "max_data_len": 10},
        {"user_prm_len": (3, 9)}, {"rates": {9600: 0, 12_000_000: 0, 500_000: 99}}, {"rates": {1234: 1}},
        {"dpv1": True, "alarms": ("update", "process"), "alarm_sequence": 4, "extra_alarm_sap": True},
        {"dpv1": True, "alarm_sequence": 4, "extra_alarm_sap": True, "max_diag_len": 9},
        {"dpv1": True, "alarm_sequence": 4, "extra_alarm_sap": True, "max_diag_len": 10},
        {"dpv1": True, "prm_blocks_required": True, "prm_blocks": False}, {"prm_blocks_required": True},
        {"dpv1": True, "prm_blocks": False, "fail_safe_required": True}, {"ms2": 3, "ms2_max_len": 9},
        {"ms2_max_len": 9, "ms2_max_initiate": 30}, {"sync": False, "freeze": False, "set_slave_add": True},
        {"wd_base_1ms": True, "fail_safe": True, "min_slave_interval_ns": 100_001, "max_diag_len": 33},
        {"parameters": (valve,)}, {"parameters": (valve, valve, SlaveParameter("S", 5, "Signed16", -2))},
        {"parameters": (SlaveParameter("V", 0, "Float"),)}, {"parameters": (SlaveParameter("V", -1),)},
        {"parameters": (SlaveParameter("V", 2),), "dpv1": True},
        {"parameters": (SlaveParameter("V", 3),), "dpv1": True},
        {"parameters": (SlaveParameter("V", 9),), "user_prm_len": (0, 9)}, {"parameters": (SlaveParameter("", 0),)},
        {"parameters": (SlaveParameter("V", 0, default=256),)}, {"parameters": (SlaveParameter("V", 0, default=255),)},
        {"parameters": (SlaveParameter("V", 0, allowed=((0, 256),)),)},
        {"parameters": (SlaveParameter("V", 0, allowed=((3, 2),)),)},
        {"parameters": (SlaveParameter("V", 0, allowed=((1, 2), (5, 5)), default=3),)},
        {"parameters": (SlaveParameter("V", 0, allowed=((1, 2), (5, 5)), default=5, texts={5: "x", 1: "y"}),)},
        {"parameters": (SlaveParameter("V", 0, texts={256: "x"}),)},
        {"parameters": (SlaveParameter("V", 0, "BitArea(2-5)", 3, texts={1: "x" * 201}),)},
        {"parameters": (SlaveParameter("V", 0, "BitArea(2-5)", 3, texts={1: "x" * 200}),)},
        {"configs": (), "modules": (SlaveModule("m", b"\x10", bytes(238)),)},
        {"configs": (), "modules": (SlaveModule("m", b"\x10", b"", (SlaveParameter("V", 237),)),)},
        {"configs": (), "modules": (SlaveModule("m", b"\x10", b"", (SlaveParameter("V", 236),)),)},
        {"diag_texts": texts}, {"diag_texts": texts[:2]}, {"diag_texts": (DiagText("what", 1, 1, 1, "t", ""),)},
        *(
            {"diag_texts": (DiagText(kind, first, last, value, "t", ""),)}
            for kind, first, last, value in (
                ("channel", None, None, 15), ("channel", None, None, 32), ("bit", None, None, 1),
                ("bit", 1951, 1951, 1), ("bit", 1952, 1952, 1), ("bit", -1, -1, 1), ("bit", 3, 3, 0),
                ("not_bit", 3, 3, 1),
                ("area", 3, None, 1), ("area", 3, 2, 0), ("area", 3, 4, 4), ("area", 3, 4, 3), ("area", 3, 1952, 1),
                ("area", 3, 4, -1), ("area", 3, 1951, 1), ("area", 3, 3, 1),
            )
        ),
    )  # fmt: skip
    for change in changes:
        case = repr(change)[:200]
        slave = SlaveDescription(**base | change)
        file = attempt(gsd_octets, slave)[1]
        yield case, file if "Error" in file else f"{as_gsd_file(slave)[1]} {_told(gsd_octets(slave))}"


def _told(file: bytes) -> str:
    """The lines of a file that differ from those of the plainest one."""
    plain = (
        gsd_octets(SlaveDescription(ident=0x1234, name="tank", configs=(b"\x11\x20",))).decode("cp1252").splitlines()
    )
    lines = file.decode("cp1252").splitlines()
    return (
        " / ".join([f"{len(lines)} lines", *(line for line in lines if line not in plain)])
        if lines != plain
        else (" / ".join(plain))
    )


#: cases that are one call each
PLAIN: dict[str, Group] = {
    "codes": _codes,
    "records": _records,
    "connections": _connections,
    "im": _im,
    "descriptions": _descriptions,
    "gsd_files": _gsd_files,
}
#: cases that run a bus
TRANSCRIPTS: dict[str, Group] = {
    "ms1_outcomes": transcripts.ms1_outcomes,
    "ms2_outcomes": transcripts.ms2_outcomes,
    "alarms": transcripts.alarms,
    "services_cut_short": transcripts.services_cut_short,
}
GROUPS = PLAIN | TRANSCRIPTS
