"""HART telegrams, commands and records in octets of others: each with the place where it is printed."""

from __future__ import annotations

import pytest

from dpstack.errors import PduError
from dpstack.hart.commands import Identity, Range, Tag, Variables, decoded
from dpstack.hart.records import Directory, Fault, Features, Request, Response, Result
from dpstack.hart.telegram import Answer, FrameType, Telegram, request


def telegram(text: str) -> Telegram:
    return Telegram.parse(bytes.fromhex(text))


def answer(text: str) -> Answer:
    return Answer.of(telegram(text))


#: a maker's manual, a log of a maker's driver, or captured by users of others' programs: source, octets, what it says
IDENTITIES = [
    (
        "Fuji A2, issue 1 of biplabro/HART-Protocol-Fundamentals",
        "FF FF FF FF FF 06 80 00 0E 00 00 FE 15 02 05 05 03 0F 10 00 0D 91 43 A2",
        ("Fuji (0x15)", 0x02, 5, 0x0D9143, "15 02 0D 91 43", ()),
    ),
    (
        "ABB, issue 2 of DobermannFW/PyHART",
        "FF FF FF FF 06 80 00 0E 00 14 FE 1A 89 07 05 02 1B 08 01 21 63 3F 9E 00 00",
        ("ABB (0x1A)", 0x89, 5, 0x21633F, "1A 89 21 63 3F", ("more status available", "loop current saturated")),
    ),
    (
        "VEGA, HART 7, a public Korean recorder",
        "FF FF FF FF FF 06 80 00 18 00 40 FE 62 DC 05 07 05 05 10 00 1C 9C EF 05 05 01 3C 00 00 62 00 62 01 DF",
        ("VEGA (0x62)", 0x62DC, 7, 0x1C9CEF, "22 DC 1C 9C EF", ("configuration changed",)),
    ),
    (
        "Smar LD301, long frame, tests of a public simulator of the physical layer",
        "FF FF FF FF FF 86 BE 01 05 F0 4D 00 0E 00 44 FE 3E 01 05 05 05 72 20 06 05 F0 4D E3",
        ("Smar (0x3E)", 0x01, 5, 0x05F04D, "3E 01 05 F0 4D", ("configuration changed", "loop current saturated")),
    ),
    (
        "Yokogawa, log of a DTM's driver, asked by the secondary master",
        "FF FF FF FF FF FF 06 00 00 0E 00 40 FE 37 0B 05 05 03 0B 08 00 A8 AB 50 D9",
        ("Yokogawa (0x37)", 0x0B, 5, 0xA8AB50, "37 0B A8 AB 50", ("configuration changed",)),
    ),
    (
        "Brooks mass flow controller, command 11 (by tag), a public script",
        "FF FF FF FF FF 86 80 00 00 00 00 0B 0E 00 20 FE 0A 32 05 05 01 03 08 01 7E 37 72 D5",
        ("Brooks Instrument (0x0A)", 0x32, 5, 0x7E3772, "0A 32 7E 37 72", ("cold start",)),
    ),
]


@pytest.mark.parametrize(("source", "octets", "meaning"), IDENTITIES, ids=[one[0][:12] for one in IDENTITIES])
def test_identities(source: str, octets: str, meaning: tuple[str, int, int, int, str, tuple[str, ...]]) -> None:
    found = answer(octets)
    identity = Identity.parse(found.data)
    maker, device_type, revision, device_id, address, status = meaning
    assert (identity.maker, identity.device_type, identity.revision) == (maker, device_type, revision)
    assert (identity.device_id, identity.address.hex(" ").upper()) == (device_id, address)
    assert [text.partition(" (")[0] for text in found.device_status_texts] == list(status)
    assert found.response_code == 0


def test_the_counters_of_hart_7() -> None:
    identity = Identity.parse(answer(IDENTITIES[2][1]).data)
    assert (identity.configuration_changes, identity.extended_status, identity.preambles) == (316, 0, 5)
    assert (identity.device_revision, identity.software_revision, identity.hardware_revision) == (5, 5, 2)


@pytest.mark.parametrize(
    ("octets", "command", "rows"),
    [
        # public test of a HART library (a Rosemount: maker 26): request and answer of command 1
        ("FF FF 86 A6 06 BC 61 4E 01 07 00 00 06 40 B0 00 00 45", 1, [("PV", "5.5 psi")]),
        # Brooks, the same script as above
        (
            "86 0A 32 7E 37 72 02 0A 00 00 40 80 00 00 00 00 00 00 4D",
            2,
            [("loop current", "4 mA"), ("of range", "0 %")],
        ),
        # the DTM's driver as above
        (
            "86 37 0B A8 AB 50 0D 17 00 40 19 4B 4A 40 2C 31 82 08 20 82 08 20 82 08 20 82 08 20 01 01 01 F7",
            13,
            [("tag", "FT-JPB01"), ("descriptor", ""), ("date", "1901-01-01")],
        ),
        # Spectrum Controls 1769sc manual p110, command 35
        ("86 BE 02 0C 77 37 23 0B 00 00 20 44 16 00 00 C3 16 00 00 F9", 35, [("data", "20 44 16 00 00 C3 16 00 00")]),
    ],
)
def test_other_commands(octets: str, command: int, rows: list[tuple[str, str]]) -> None:
    found = answer(octets)
    assert found.command == command
    assert decoded(command, found.data) == rows


def test_four_variables_as_biffi_prints_them() -> None:
    """Biffi ICON3000 manual p70, table A-1."""
    data = bytes.fromhex("40800000 39 00000000 39 42A43333 39 00000000 20 41B80000")
    found = Variables.parse(data)
    assert found.current == 4.0
    assert [(one.name, one.unit) for one in found.variables] == [("PV", "%"), ("SV", "%"), ("TV", "%"), ("QV", "°C")]
    assert [one.text for one in found.variables] == ["0 %", "82.1 %", "0 %", "23 °C"]


def test_an_identity_as_icp_das_prints_it() -> None:
    """ICP DAS HRT-710 manual p31: an Eckardt, more status available."""
    octets = bytes.fromhex("0010 FE3F 0408 0501 101B 001B 97E8")
    found = Answer.of_data(0, octets)
    identity = Identity.parse(found.data)
    assert (identity.maker, identity.device_type, identity.preambles) == ("Foxboro Eckardt (0x3F)", 4, 8)
    assert (identity.revision, identity.device_id) == (5, 0x1B97E8)
    assert found.device_status_texts == ("more status available (command 48)",)


@pytest.mark.parametrize(
    ("octets", "number", "address"),
    [
        ("82 98 CF 38 84 F0 01 00 98", 1, "18 CF 38 84 F0"),  # ET 200iSP manual p457
        ("82 A6 06 BC 61 4E 01 00 B0", 1, "26 06 BC 61 4E"),
        ("82 BE 01 05 F0 4D 00 00 85", 0, "3E 01 05 F0 4D"),
        ("02 80 00 00 82", 0, None),
    ],
)
def test_requests(octets: str, number: int, address: str | None) -> None:
    built = request(number, address=None if address is None else bytes.fromhex(address))
    assert built.build() == bytes.fromhex(octets)
    assert Telegram.parse(built.build()) == built
    assert built.primary
    assert not built.burst


def test_a_request_with_data_of_the_brooks_script() -> None:
    """Its masters leave the bit of the primary master out."""
    built = Telegram(FrameType.REQUEST, bytes.fromhex("0A327E3772"), 0xEC, bytes.fromhex("3941A00000"))
    assert built.build() == bytes.fromhex("82 0A 32 7E 37 72 EC 05 39 41 A0 00 00 B0")


def test_request_records_as_siemens_prints_them() -> None:
    """ET 200iSP manual (11/2022) p457, tables A-35 and A-36: transparent and compact."""
    telegram = request(1, address=bytes.fromhex("18CF3884F0"))
    assert Request(telegram, preambles=5).build() == bytes.fromhex("00 05 82 98 CF 38 84 F0 01 00 98")
    assert Request(telegram, compact=True, preambles=5).build() == bytes.fromhex("20 05 01 00")
    assert Request.parse(bytes.fromhex("20 05 01 00")) == (1, b"", None)
    number, data, found = Request.parse(bytes.fromhex("00 05 82 98 CF 38 84 F0 01 00 98"))
    assert (number, data) == (1, b"")
    assert found is not None
    assert found.telegram == telegram


def test_a_directory_and_features_as_siemens_prints_them() -> None:
    """F-AI 8xI HART HA manual (09/2021) p103 and p104, with the values of its comments."""
    octets = bytes((2, 0, 255, 1, 8, 1, 149, 255, 255, *range(131, 139), *range(80, 96, 2)))
    found = Directory.parse(octets)
    assert (found.revision, found.clients, found.channels, found.offset) == ((2, 0), 1, 8, 1)
    assert found.requests == (80, 82, 84, 86, 88, 90, 92, 94)
    assert found.channel_parameters[0] == 131
    assert (found.features, found.parameters) == (149, None)
    assert found.build() == octets
    features = Features.parse(bytes.fromhex("62 00 F0"))
    assert features == Features(compact=True, shc=True, check_result=True, longest=240)
    assert features.build() == bytes.fromhex("62 00 F0")


def test_an_older_directory_has_request_records_only() -> None:
    """13 octets for four channels (ET 200iSP manual of 2010 p316: size and indexes; the layout is a reading)."""
    found = Directory.parse(bytes((1, 0, 255, 1, 4, 1, 149, 129, 255, 80, 82, 84, 86)))
    assert found.requests == (80, 82, 84, 86)
    assert found.parameters == 129
    assert found.channel_parameters == ()


@pytest.mark.parametrize(
    ("octets", "why"),
    [
        ("", "its head has 9"),
        ("02 00 FF 01 08 01 95 FF FF 50", "for 8 channels"),
        ("02 00 FF 01 00 01 95 FF FF", "for 0 channels"),
        ("02 00 FF 01 01 01 95 FF FF 83 FE", "request record 254, response"),
        ("02 00 FF 01 02 00 95 FF FF 83 84 50 52", "response \\+ 0"),
        ("02 00 FF 01 02 C8 95 FF FF 83 84 50 52", "request record 80, response \\+ 200"),
    ],
)
def test_directories_that_lie(octets: str, why: str) -> None:
    with pytest.raises(PduError, match=why):
        Directory.parse(bytes.fromhex(octets))


@pytest.mark.parametrize(
    ("octets", "fault", "text"),
    [
        # codes of ET 200iSP manual p454 to p456
        ("06 20 03", Fault.CHANNEL, "channel fault: open line: check wire and supply of the transmitter"),
        ("06 10 05", Fault.MASTER, "error of the module's HART master: HART timer expired"),
        ("06 40 88", Fault.QUERY, "the device has received a damaged request: checksum error"),
        ("06 50 84", Fault.RESPONSE, "the module has received a damaged answer, or none: no answer in time"),
        ("07 60 01", Fault.REJECTED, "the module rejects the request: compact format is not supported"),
        (
            "06 60 05",
            Fault.REJECTED,
            "the module rejects the request: the channel is in standby: ask the partner module",
        ),
        ("06 30 20", Fault.COMMAND, "command error: response code 32"),
        ("06 80 99", Fault.MAKER, "the module rejects a request of the maker's own: code 153"),
        ("06 90 00", 9, "error 9"),
    ],
)
def test_errors_of_a_module(octets: str, fault: int, text: str) -> None:
    found = Response.parse(bytes.fromhex(octets))
    assert (found.fault, found.fault_text) == (fault, text)


def test_how_far_a_request_is() -> None:
    assert [Response.parse(bytes((octet,))).result for octet in (0, 1, 2, 3, 0x43)] == [0, 1, 2, 3, 3]
    found = Response.parse(bytes.fromhex("04 00 86 A6 06 BC 61 4E 01 07 00 00 06 40 B0 00 00 45") + bytes(57))
    assert found.result is Result.SUCCESS  # a record of fixed length: what is behind the telegram does not count
    assert found.answer == Answer(1, 0, 0, bytes.fromhex("06 40 B0 00 00"), bytes.fromhex("26 06 BC 61 4E"))
    compact = Response.parse(bytes.fromhex("24 00 01 07 00 00 06 40 B0 00 00"))
    assert compact.answer == Answer(1, 0, 0, bytes.fromhex("06 40 B0 00 00"))


def test_a_telegram_without_check_octet_is_taken_and_says_so() -> None:
    assert not telegram("86 A6 06 BC 61 4E 01 07 00 00 06 40 B0 00 00").checked
    assert telegram("86 A6 06 BC 61 4E 01 07 00 00 06 40 B0 00 00 45").checked


@pytest.mark.parametrize(
    ("octets", "why"),
    [
        ("", "no octets"),
        ("FF FF FF", "nothing but preambles"),
        ("83 00", "delimiter 0x83 is neither request, answer nor burst"),
        ("86 A6 06 BC", "ends before its byte count"),
        ("86 A6 06 BC 61 4E 01 07 00 00 06", "7 octets of data by its byte count has 3"),
        ("86 A6 06 BC 61 4E 01 07 00 00 06 40 B0 00 00 46", "check octet 0x46, 0x45 is expected"),
    ],
)
def test_damaged_telegrams(octets: str, why: str) -> None:
    with pytest.raises(PduError, match=why):
        telegram(octets)


def test_expansion_octets_are_skipped() -> None:
    built = Telegram(FrameType.ANSWER, b"\x80", 1, bytes(2)).build()
    with_one = bytes((built[0] | 0x20,)) + built[1:2] + b"\x00" + built[2:-1]
    assert Telegram.parse(with_one).command == 1


@pytest.mark.parametrize(
    ("number", "data", "why"),
    [
        (0, "FE 15", "has 2 octets, at least 12 are needed"),
        (0, "00 15 02 05 05 03 0F 10 00 0D 91 43", "an identity begins with 254, not with 0"),
        (3, "40 80 00 00", "at least 9 are needed"),
        (13, "00", "at least 21 are needed"),
        (48, "", "at least 1 are needed"),
    ],
)
def test_answers_that_are_too_short(number: int, data: str, why: str) -> None:
    with pytest.raises(PduError, match=why):
        decoded(number, bytes.fromhex(data))


def test_a_range_by_its_layout() -> None:
    """Siemens SITRANS F US manual p41, table 4-14: alarm, transfer, unit, upper, lower, damping, protection."""
    data = bytes.fromhex("01 00 0C 42C80000 C1200000 3F000000 FB FA 00")
    found = Range.parse(data)
    assert (found.lower, found.upper, found.unit, found.damping) == (-10.0, 100.0, "kPa", 0.5)
    assert dict(found.rows) == {
        "range": "-10 to 100 kPa",
        "damping": "0.5 s",
        "transfer function": "linear",
        "alarm current": "low",
        "write protected": "code 251",
    }


def test_values_that_are_not_numbers_and_variables_that_are_not_used() -> None:
    data = bytes.fromhex("7FA00000 07 7F800000 FA 7FA00000 FA 7FA00000 FA 7FA00000")
    found = Variables.parse(data)
    assert (found.current, [(one.name, one.text) for one in found.variables]) == (None, [("PV", "no value")])
    assert dict(found.rows)["loop current"] == "no value"


def test_texts_of_a_device_with_control_characters_stay_texts() -> None:
    assert decoded(20, b"\x1b[31mPT".ljust(32, b"\0")) == [("long tag", "\x1b[31mPT")]  # escaped where it is shown
    assert Tag.parse(bytes(18) + bytes((32, 13, 99))).date == "no date (20 0D 63)"
