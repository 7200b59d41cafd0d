"""Telegrams of a whole plant with the names of its configuration, and without it by ident numbers and GSD files."""

from __future__ import annotations

import asyncio
import functools
import json
import tracemalloc
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from octet_slave import DL, sd2
from plant_files import plant_text
from property_kit import examples

import dpstack
from dpstack.api.config.config import parse_config
from dpstack.api.listen.names import decode_names
from dpstack.capture.transmission import Transmission
from dpstack.decode.names import NO_NAMES, Names
from dpstack.decode.telegram import Explained, Explainer, explain
from dpstack.fdl.codec import encode_sd2
from dpstack.trace import WireEntry

SAW_OPTIONS = {"control_bits": "simulated", "status_bits": "simulated", "rpm_per_count": 1.0}
VALVE_NAMES = {"inputs": {"limit": "bool@0.0"}, "outputs": {"flap": "bool@0.1", "level": "u8@1"}}
IO = {"gsd": "io-station", "modules": ["8 DI", "8 DO", "2 AI"], "parameters": {"Wire break": "on"}}
PLANT: list[dict[str, object]] = [
    {"name": "hoist", "address": 3, "drive": "demag-dedrive", "simulated": {"412": 1}},
    {"name": "pump", "address": 4, "drive": "ls-s100"},
    {"name": "fan", "address": 5, "drive": "fuji-frenic"},
    {"name": "mixer", "address": 6, "drive": "imo-hd2", "options": {"set_map": True}},
    {"name": "saw", "address": 7, "drive": "keb-f5", "options": SAW_OPTIONS},
    {"name": "valves", "address": 8, "ident": 0x1234, "config": "21 10", **VALVE_NAMES},
    {"name": "io", "address": 9, **IO},
]
DRIVES = ("hoist", "pump", "fan", "mixer", "saw")


@functools.cache
def _config() -> Any:
    return parse_config(plant_text(*PLANT, baud=1_500_000, address=2))


@functools.cache
def _names() -> Names:
    return decode_names(_config())


@functools.cache
def _others() -> Names:
    """Without a configuration: what GSD files and drives of ours say."""
    return decode_names()


@functools.cache
def _wire() -> tuple[Transmission, ...]:
    """Bring-up; each drive runs at a quarter of its speed, a parameter is read, outputs are set, a module is pulled."""
    world = dpstack.World(keep=1_000_000)
    bench = dpstack.simulate(world, _config().slaves, baud=1_500_000)

    async def main() -> list[WireEntry]:
        async with dpstack.open_bus(_config(), world=world) as bus:
            await bus.ready()
            await bus.operate()
            bus.slave("valves")["flap"], bus.slave("valves")["level"] = True, 7
            for name in DRIVES:
                bus.drive(name).speed = 0.25
            await asyncio.gather(*(bus.drive(name).start() for name in DRIVES))
            await bus.drive("hoist").read(412)
            station = bench.device(9)
            assert isinstance(station, dpstack.IoStation)
            station.pull(1)
            await asyncio.sleep(0.05)
            return list(world.log)

    wire = dpstack.run_virtual(main())
    return tuple(Transmission(entry.octets, entry.start_ns, 1_500_000) for entry in wire)


@functools.cache
def _log(names: Names = NO_NAMES) -> tuple[Explained, ...]:
    return tuple(explain(_wire(), names))


def _last(names: Names, service: str, station: int, *, request: bool) -> Explained:
    return next(
        one
        for one in reversed(_log(names))
        if one.service == service
        and one.telegram is not None
        and one.telegram.data
        and one.telegram.is_request is request
        and station == (one.telegram.da if request else one.telegram.sa)
    )


def _data(names: Names, station: int, *, request: bool) -> dict[str, Any]:
    return _last(names, "Data_Exchange", station, request=request).fields


def test_a_plant_is_explained_without_an_error() -> None:
    for names in (_names(), _others()):
        log = _log(names)
        assert [one.text for one in log if one.error is not None or one.step.remarks] == []


def test_process_data_have_the_names_of_the_configuration() -> None:
    assert _data(_names(), 8, request=True)["outputs"] == {"flap": True, "level": 7}
    assert _data(_names(), 8, request=False)["inputs"] == {"limit": False}
    one = _last(_names(), "Data_Exchange", 8, request=True)
    assert one.text == "Data_Exchange request 2 -> 8 [valves], 2 octets (SRD high, FCV=1 FCB=1)".replace(
        "FCB=1", f"FCB={one.as_dict()['fcb']:d}"
    )
    assert one.as_dict()["names"] == {"sender": None, "receiver": "valves"}


@pytest.mark.parametrize("configured", [True, False])
def test_modules_have_the_names_of_the_gsd_file(configured: bool) -> None:
    names = _names() if configured else _others()
    chk_cfg = _last(names, "Chk_Cfg", 9, request=True).fields
    assert [(one["slot"], one["module"]) for one in chk_cfg["Cfg_Data"]] == [(1, "8 DI"), (2, "8 DO"), (3, "2 AI")]  # type: ignore[attr-defined]
    assert _data(names, 9, request=False)["modules"] == [
        {"slot": 1, "module": "8 DI", "data": "00"},
        {"slot": 3, "module": "2 AI", "data": "00000000"},
    ]
    # user parameters in the words of the file; without a configuration they are known when the modules are
    told = _last(names, "Set_Prm" if configured else "Chk_Cfg", 9, request=True).fields
    assert told["Parameters"] == {
        "Process alarm on rising edges": "on",
        "Process alarm on falling edges": "off",
        "Wire break": "on",
    }
    diagnosis = _last(names, "Slave_Diag", 9, request=False).fields
    assert diagnosis["texts"] == ["module status: slot 1 no module", "slots with a diagnosis: 1 (8 DI)"]


def test_modules_of_a_slave_that_no_file_knows_are_those_of_its_chk_cfg() -> None:
    assert _data(_others(), 8, request=True)["modules"] == [{"slot": 1, "module": None, "data": "0207"}]
    assert _data(NO_NAMES, 8, request=True) == _data(NO_NAMES, 3, request=True) == {}


def _drive_words(name: str, *, request: bool, running: bool = True) -> list[dict[str, Any]]:
    station = 3 + DRIVES.index(name)
    found = []
    for one in _log(_names()):
        telegram = one.telegram
        if telegram is not None and "drive" in one.fields and telegram.is_request is request:
            address = telegram.da if request else telegram.sa
            words: Any = one.fields["drive"]
            if address == station and (request or not running or words["state"] == "running"):
                found.append(words)
    return found


@pytest.mark.parametrize("name", DRIVES)
def test_words_of_a_drive_are_those_that_its_program_gave_and_got(name: str) -> None:
    ran = [words for words in _drive_words(name, request=True) if words.get("setpoint")]
    assert {round(words["setpoint"], 3) for words in ran} == {0.25}
    assert all(int(words["control_word"], 16) for words in ran[-5:])
    speeds = [words["speed"] for words in _drive_words(name, request=False)]
    assert 0 < max(speeds) <= 0.26


def test_the_parameter_channel_is_explained_at_both_ends() -> None:
    orders = [words["PKW"] for words in _drive_words("hoist", request=True) if words["PKW"]]
    replies = [words["PKW"] for words in _drive_words("hoist", request=False, running=False) if words["PKW"]]
    order = next(one for one in orders if one["PNU"] == 412)
    reply = next(one for one in replies if one["PNU"] == 412)
    assert (order["AK"], order["what"], order["text"][:9]) == (6, "read array", "read arra")
    assert (reply["AK"], reply["what"], reply["value"], reply["PWE"]) == (4, "array word", 1, "0x00000001")
    assert "412" in reply["text"]
    own = [words["PKW"] for words in _drive_words("saw", request=False, running=False) if words["PKW"]]
    assert {(one["service"], one["name"][:2]) for one in own} >= {("read", "oP"), ("read", "sy")}


@pytest.mark.parametrize(
    ("octets", "order", "text"),
    [
        ("619C 0100 00000000 000F 1000", True, "read array 412 (Local/Remote), control word 000F (switch_on enable_v"),
        ("819C 0100 00000001 0000 0000", True, "write array long 412 (Local/Remote) = 1, control word 0000 (no bit"),
        ("719C 0100 00000002 0240 0000", False, "error 412 (Local/Remote): error 2, "),
        ("819C 0100 00000000 0240 0000", False, "no control 412 (Local/Remote)"),
        (
            "F3FF 0000 00000005 0240 F000",
            False,
            "reply 15 1023[0] = 0x5, status word 0240: switch_on_inhibited, speed -25.0%",
        ),
        ("0000 0000 00000000 0008 0000", False, "status word 0008: fault, speed 0.0%"),
        ("0000 0000 00000000 0008", False, ""),  # another length: no words
    ],
)
def test_words_of_a_drive_literally(octets: str, order: bool, text: str) -> None:
    data = bytes.fromhex(octets)
    sent = encode_sd2(3, 2, 0x5D, data) if order else encode_sd2(2, 3, DL, data)
    (one,) = explain([Transmission(sent)], _names())
    words: Any = one.fields.get("drive", {"text": ""})
    assert words["text"].startswith(text)
    assert bool(words["text"]) is bool(text)


# --- record 47 -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "octets", "text"),
    [
        (True, "01 01 01 01 10 00 03 AC 00 00", "read parameter 940"),
        (True, "02 02 01 01 10 00 03 AC 00 00 42 01 00 05", "change parameter 940 = 5"),
        (
            True,
            "03 01 01 02 10 03 03 B3 00 00 20 00 00 0A 00 00",
            "read parameter 947[0..2]; description of parameter 10",
        ),
        (False, "01 01 01 01 42 01 12 34", "read: 4660"),
        (False, "01 01 01 01 08 01 41 20 00 00", "read: 10.0"),
        (False, "02 02 01 01", "change: 1 done"),
        (False, "01 81 01 01 44 02 00 02 00 03", "read refused: error 2, low or high limit exceeded (subindex 3)"),
        (False, "01 81 01 01 44 01 00 00", "read refused: error 0, illegal parameter number"),
        (False, "01 01 01 01 99 01 00 00", "record 47: format 0x99 is none of the profile's"),
    ],
)
def test_record_47_in_words(request_: bool, octets: str, text: str) -> None:
    content = bytes.fromhex(octets)
    unit = bytes((0x5F if request_ else 0x5E, 1, 47, len(content))) + content
    sent = sd2(4, 2, 0x5D, 51, 51, unit) if request_ else sd2(2, 4, DL, 51, 51, unit)
    (one,) = explain([Transmission(sent)], _others())
    assert f"data {len(content)}: {text} (" in one.text
    record: Any = one.fields["Parameter_Access"]
    assert record["text"] == text
    json.dumps(one.as_dict())


def test_another_record_47_is_shown_as_octets() -> None:
    unit = bytes.fromhex("5F 01 2F 02 AA BB")
    (one,) = explain([Transmission(sd2(4, 2, 0x5D, 51, 51, unit))], _others())
    assert "Parameter_Access" not in one.fields
    assert one.fields["data"] == "aabb"


# --- anything --------------------------------------------------------------------------------------------------------

_SAPS = st.sampled_from([None, 0, 48, 49, 50, 51, 56, 57, 58, 59, 60, 61, 62])
_TELEGRAMS = st.builds(
    lambda da, sa, fc, saps, unit: encode_sd2(da, sa, fc, unit, *saps),
    st.integers(2, 10),
    st.integers(2, 10),
    st.sampled_from([0x5D, 0x7D, 0x6D, 0x08, 0x0A, 0x00, 0x46, 0x49]),
    st.tuples(_SAPS, _SAPS),
    st.binary(min_size=1, max_size=40),
)


@examples(25)
@given(st.lists(st.one_of(st.integers(0, 400), _TELEGRAMS, st.binary(max_size=40)), max_size=30), st.booleans())
def test_nothing_fails_on_any_sequence_with_names(parts: list[int | bytes], configured: bool) -> None:
    """True telegrams of the plant and octets of any kind in any order; some of the former with a wrong octet."""
    wire = _wire()
    octets = [wire[part].octets if isinstance(part, int) else part for part in parts]
    octets += [one[:-3] + bytes((one[-3] ^ 0x10,)) + one[-2:] for one in octets if len(one) > 9]
    for one in explain(map(Transmission, octets), _names() if configured else _others()):
        json.dumps(one.as_dict(), allow_nan=False)
        assert one.text


def test_a_foreign_slave_at_an_address_of_the_configuration_keeps_only_its_name() -> None:
    """A diagnosis of the I/O station from the address of the valves."""
    diagnosis = sd2(2, 8, DL, 62, 60, bytes.fromhex("00 0C 00 02 10 D5"))
    inputs = encode_sd2(2, 8, DL, bytes(1))
    first, second = explain([Transmission(diagnosis), Transmission(inputs)], _names())
    assert first.fields["Configured_Ident_Number"] == "0x1234"
    assert "8 [valves]" in first.text
    assert "inputs" not in second.fields


def test_values_with_a_scale_are_explained_with_it() -> None:
    level, target = {"at": "i16@0", "scale": 0.1, "unit": "bar"}, {"at": "i16@0", "scale": 0.1, "offset": 100}
    boiler = {"name": "boiler", "address": 8, "ident": 0x1234, "config": "50 60"}
    plant = plant_text({**boiler, "inputs": {"level": level}, "outputs": {"target": target}})
    names = decode_names(parse_config(plant, "plant.toml"))
    octets = [encode_sd2(8, 2, 0x7D, bytes.fromhex("fff6")), encode_sd2(2, 8, DL, bytes.fromhex("007b"))]
    request, answer = explain(map(Transmission, octets), names)
    assert (request.fields["outputs"], answer.fields["inputs"]) == ({"target": 99.0}, {"level": 12.3})


def test_a_long_log_needs_no_more_memory_than_a_short_one() -> None:
    """Ident numbers and modules change with each telegram. 450 explained telegrams that stayed would be over 400 kB."""

    def sent(numbers: range) -> Iterator[Transmission]:
        for number in numbers:
            da, sa, two = number % 127, number // 127 % 127, number.to_bytes(2, "big")
            yield Transmission(encode_sd2(da, sa, 0x5D, bytes(2) + two))
            yield Transmission(sd2(sa, da, DL, 62, 60, bytes.fromhex("00 0C 00 02") + two + bytes(3)))
            yield Transmission(sd2(da, sa, 0x7D, 62, 62, bytes((number % 3 + 0x10, number % 5 + 0x20))))

    explainer = Explainer(_others())
    for one in sent(range(150)):  # what is read of files once is not traced, which takes five times as long
        explainer.add(one).as_dict()

    def explain_all(numbers: range) -> int:
        for one in sent(numbers):
            explainer.add(one).as_dict()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        before = explain_all(range(150))
        assert explain_all(range(150)) < before + 200_000
    finally:
        tracemalloc.stop()
