"""The simulated S7-200: memory, mode and clock."""

from __future__ import annotations

import datetime

import pytest

from dpstack.fdl.codec import encode
from dpstack.fdl.interface import Reply
from dpstack.fdl.telegram import Kind, Resp, Telegram
from dpstack.ppi.addresses import PpiAddress, parse_address
from dpstack.ppi.cpu import CpuStation, SimulatedCpu
from dpstack.ppi.pdu import (
    clock_request,
    negotiate_request,
    negotiated,
    parse_clock,
    parse_pdu,
    read_items,
    read_request,
    run_request,
    set_clock_request,
    stop_request,
    user_data,
    write_request,
    written,
)
from dpstack.units import NS_PER_MS, NS_PER_S


def ask(cpu: SimulatedCpu, text: str) -> object:
    addresses = [parse_address(text)]
    return read_items(parse_pdu(cpu.answer(read_request(0, addresses).octets, 0)), addresses)[0]


def test_values_come_back() -> None:
    cpu = SimulatedCpu()
    for text, value in {
        "VW100": 1234,
        "VD8:real": 2.5,
        "M0.3": True,
        "AIW4": -7,
        "T37": 99,
        "C5": 12,
        "I1.7": True,
    }.items():
        cpu[text] = value
        assert ask(cpu, text) == value
    assert ask(cpu, "SM0.0") is True
    assert ask(cpu, "VB100[2]") == bytes((1234 >> 8, 1234 & 0xFF))


def test_many_items_with_filling_octets() -> None:
    cpu = SimulatedCpu()
    cpu["VB0"], cpu["VB1"], cpu["C0"] = 1, 2, 0x1234
    addresses = [parse_address(text) for text in ("VB0", "C0", "V9999.0", "VB10239", "VB10240", "VB1")]
    values = read_items(parse_pdu(cpu.answer(read_request(0, addresses).octets, 0)), addresses)
    assert values == [1, 0x1234, False, 0, 5, 2]


@pytest.mark.parametrize(("text", "code"), [("AQW0", 3), ("VB10240", 5), ("AIW64", 5), ("T256", 5)])
def test_what_it_does_not_let_read(text: str, code: int) -> None:
    assert ask(SimulatedCpu(), text) == code


def write(cpu: SimulatedCpu, address: PpiAddress, value: int) -> int:
    return written(parse_pdu(cpu.answer(write_request(0, address, value).octets, 0)))


def test_writes() -> None:
    cpu = SimulatedCpu()
    assert write(cpu, parse_address("VW100"), 258) == 0xFF
    assert cpu["VB101"] == 2
    assert write(cpu, parse_address("AQW2"), 5) == 0xFF
    assert cpu["AQW2"] == 5
    assert write(cpu, parse_address("AIW2"), 5) == 3
    assert write(cpu, parse_address("M0.1"), True) == 0xFF
    assert cpu["MB0"] == 2
    assert write(cpu, parse_address("VB10240"), 1) == 5


def test_mode_and_clock() -> None:
    cpu = SimulatedCpu()
    assert negotiated(parse_pdu(cpu.answer(negotiate_request(0).octets, 0))) == 240
    modes = []
    for request in (stop_request(1), run_request(1)):
        cpu.answer(request.octets, 0)
        modes.append(cpu.running)
    assert modes == [False, True]
    cpu.locked = True
    assert parse_pdu(cpu.answer(stop_request(1).octets, 0)).error == 0x8001
    time = datetime.datetime(2026, 11, 28, 12, 0, 0)
    user_data(parse_pdu(cpu.answer(set_clock_request(2, time).octets, NS_PER_S)))
    read = user_data(parse_pdu(cpu.answer(clock_request(3).octets, 3 * NS_PER_S)))
    assert parse_clock(read) == time + datetime.timedelta(seconds=2)


def test_damaged_requests_are_refused() -> None:
    cpu = SimulatedCpu()
    assert parse_pdu(cpu.answer(b"\x32", 0)).error == 0x8104
    assert parse_pdu(cpu.answer(bytes.fromhex("32 01 0000 0000 0001 0000 99"), 0)).error == 0x8104


def test_polls_get_rr_until_the_answer_is_there() -> None:
    station = CpuStation(answer_ns=20 * NS_PER_MS)
    request = Telegram(Kind.SD2, 2, 0, 0x6C, data=read_request(0, [parse_address("QB0")]).octets)
    poll = Telegram(Kind.SD1, 2, 0, 0x5C)
    assert station.serve(poll, 0) == Reply(Resp.NR)
    assert station.serve(request, 0).short  # type: ignore[union-attr]
    assert station.serve(poll, 10 * NS_PER_MS) == Reply(Resp.RR)
    reply = station.serve(poll, 20 * NS_PER_MS)
    assert reply is not None
    assert reply.status is Resp.DL
    assert station.serve(poll, 21 * NS_PER_MS) == Reply(Resp.NR)
    # the answer on the wire, as libnodave expects it: from 2 to 0 with FC 08
    assert encode(Telegram(Kind.SD2, 0, 2, 0x08, data=reply.data))[4:7] == bytes((0, 2, 8))


def test_a_request_to_a_sap_is_refused() -> None:
    request = Telegram(Kind.SD2, 2, 0, 0x6C, dsap=60, ssap=62, data=b"1")
    assert CpuStation().serve(request, 0) == Reply(Resp.RS)


#: requests of libnodave's testPPI (netdata-be/libnodave at 4ae3906) with -m, -w and -n, and the answers that it took
LIBNODAVE = (
    (  # an octet of I, four of M, data block 6, system information, M, AI, AQ
        "320100000002005600000407120a10020001000081000000120a10020004000083000000120a100200020006840000a0120a1002002800"
        "0003000000120a10020002000083000060120a10040002000006000000120a10040002000007000000",
        "3203000000020002002800000407ff0400080100ff040020000102030a0000000a000000ff0400100000ff0400200000000003000000",
    ),
    ("320100000005000e00080501120a10020004000083000060000400203f8ccccd", "3203000000050002000100000501ff"),
    ("320100000007000e00050501120a100100010000820000040003000101", "3203000000070002000100000501ff"),
    ("320100000004000e00000401120a10010000000184000001", "3203000000040002000500000401ff03000101"),
    ("32010000000a000e00000401120a10040001000007000000", "32030000000a000200040000040103000000"),
    ("32010000000b000e00060501120a10040001000007000000000400102509", "32030000000b0002000100000501ff"),
    (
        "32010000000d000e00000401120a101e000300001e000000",
        "32030000000d0002000d00000401ff090009000000000000000000",
    ),
    ("3201000000020010000029000000000009505f50524f4752414d", "32030000000200010000000029"),
)


@pytest.mark.parametrize(("request_octets", "answer"), LIBNODAVE)
def test_a_session_of_libnodave(request_octets: str, answer: str) -> None:
    cpu = SimulatedCpu()
    cpu["IB0"], cpu["MD0"], cpu["V0.1"] = 1, 0x0001_0203, True
    assert cpu.answer(bytes.fromhex(request_octets), 0).hex() == answer
