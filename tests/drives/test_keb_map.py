"""KEB's process data map (docs/reference/drives/keb-f5.md#process-data-map): typed, checked, written over the channel,
acting after power-on."""

from __future__ import annotations

import struct
from collections.abc import Mapping

import pytest
from drive_bench import DeviceBench, PairBench, PluginBench
from hypothesis import given
from hypothesis import strategies as st

from dpstack.profile import process_data_map
from dpstack_drives.keb import DRIVE
from dpstack_drives.keb.pdmap import DEFAULT_INPUTS, DEFAULT_OUTPUTS, Entry, PdMap, check
from dpstack_drives.keb.simulator import KebDevice
from tests.drives.keb_kit import NONE, ZERO, again, device, plugin

#: the manual's example 1 of 6000h and of 6001h, and example 2
EXAMPLE_1_IN = [4, 0x2033, 1, 0, 0, 0x2035, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]
EXAMPLE_1_OUT = [4, 0x2032, 1, 0, 0, 0x2034, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]
EXAMPLE_2 = [8, 0x233B, 1, 0, 0, 0, 0, 0, 0, 0x2D00, 1, 0, 0, 0, 0, 0, 0]
#: docs/reference/drives/keb-f5.md#second-block
TEST_INPUTS = "202C:long 2033 2035 2200 2227"
TEST_OUTPUTS = "2F13:long 2032 2034 230A"


def numbered(values: list[int]) -> dict[int, int]:
    return dict(enumerate(values, 1))


# -- the records -------------------------------------------------------------------------------------------------------


def test_k8_the_examples_of_the_manual_as_records() -> None:
    assert dict(DEFAULT_INPUTS.records()) == numbered(EXAMPLE_1_IN)
    assert dict(DEFAULT_OUTPUTS.records()) == numbered(EXAMPLE_1_OUT)
    longs = PdMap((Entry(0x233B, long=True), Entry(0x2D00, long=True)))
    assert dict(longs.records()) == numbered(EXAMPLE_2)
    assert PdMap.from_records(numbered(EXAMPLE_2)) == longs
    assert PdMap.from_records(numbered(EXAMPLE_1_IN)) == DEFAULT_INPUTS
    assert str(longs) == "233B:long 2D00:long"
    assert PdMap.parse("sy.51 sy.53") == DEFAULT_INPUTS


def test_k12_the_test_map_in_two_blocks() -> None:
    inputs, outputs = PdMap.parse(TEST_INPUTS), PdMap.parse(TEST_OUTPUTS)
    assert (inputs.octets, outputs.octets) == (12, 10)
    assert check(inputs, outputs) is None
    first = [12, 0x202C, 1, 0, 0, 0, 0, 0, 0, 0x2033, 1, 0, 0, 0x2035, 1, 0, 0]
    assert dict(inputs.records(0)) == numbered(first)
    second = [0x2200, 1, 0, 0, 0x2227, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]
    assert dict(inputs.records(1)) == dict(enumerate(second, 2))
    assert PdMap.from_records(dict(inputs.records(0)), dict(inputs.records(1))) == inputs


@pytest.mark.parametrize(
    ("inputs", "outputs", "says"),
    [
        ("2033 2035 2200 2227", "2032 2034", None),
        ("233B:long 2D00:long", "2032 2034", None),
        ("202C:long 2033 2035", "2F13:long 2032 2034", None),
        ("202C:long 2033 2035", "2032 2034", "block 1 mixes longs and words"),
        ("202C:long 2033", "2F13:long 2032 2034", "block 1 mixes longs and words"),
        ("2033 2035 2200 2227 2033 202C:long", "2032", "inputs, block 2: the long value must be the first"),
        ("2033 202C:long 2035", "2033 202C:long 2035", "inputs, block 1: the long value must be the first"),
        ("202C:long 2033 202C:long", "2032", "crosses from block 1 into block 2"),
        ("2033:long", "2032:long", "inputs: sy.51 (2033h) is a word, not a long"),
        ("2033", "oP.27", "outputs: oP.27 (231Bh) cannot be process output data"),
        ("2033", "oP.35", "outputs: oP.35 (2323h) cannot be process output data"),
        ("oP.27", "oP.36", None),
        ("2033@0", "2032", "2033 has no set"),
        ("2033@256", "2032", "2033 has no set"),
        ("5F00", "2032", "5F00 is no parameter of the inverter"),
        ("2033 " * 9, "2032", "inputs: 18 octets, the operator has at most 16"),
    ],
)
def test_k7_k11_maps_are_checked_before_they_are_written(inputs: str, outputs: str, says: str | None) -> None:
    found = check(PdMap.parse(inputs), PdMap.parse(outputs))
    assert found is None if says is None else says in str(found)


@pytest.mark.parametrize("text", ["2033:word", "2033@x", "sy:long@", "x", "@1"])
def test_a_wrong_map_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"is no mapped value|neither an index"):
        PdMap.parse(text)


entries = st.builds(Entry, st.integers(0x2000, 0x5EFF), st.booleans(), st.integers(1, 255))


@given(st.lists(entries, max_size=8).map(lambda found: PdMap(tuple(found))))
def test_records_and_text_say_the_same_for_every_right_map(one: PdMap) -> None:
    assert PdMap.parse(str(one)) == one
    if check(one, one) is None:
        assert PdMap.from_records(dict(one.records(0)), dict(one.records(1))) == one
        values = {entry.key: number + 1 for number, entry in enumerate(one.fields)}
        if len(values) == len(one.fields):
            words = struct.unpack(">8H", one.put(values, 16))
            assert process_data_map.raws(one.fields, words) == values


@given(st.dictionaries(st.integers(1, 17), st.integers(0, 0x20), max_size=17))
def test_any_record_is_a_map_or_a_value_error(record: dict[int, int]) -> None:
    try:
        assert PdMap.from_records(record).octets == record.get(1, 0)
    except ValueError:
        return


# -- the plugin writes it, octet by octet ------------------------------------------------------------------------------


def test_k7_the_requests_of_write_map() -> None:
    """34 subindexes, the two enables and their check, against a drive that confirms whatever it is asked."""
    bench = plugin()
    token = bench.order("write_map", inputs="233B:long 2D00:long", outputs="2032 2034")
    seen: list[tuple[int, int, int]] = []
    while bench.result(token) is None:
        out = bench.run()
        request = (out[0] & 3, int.from_bytes(out[1:4], "big"), int.from_bytes(out[4:8], "big"))
        if out[0] & 3 and (not seen or seen[-1] != request):
            seen.append(request)
        enable = out[2:4].hex() in ("5ff8", "6002")
        error = enable and out[0] & 2
        data = "08000034" if error else "000000ff" if enable else out[4:8].hex()
        head = bytes([out[0] & 0x43 | (0x80 if error else 0)]) + out[1:4]
        bench.inputs = head + bytes.fromhex(data) + bytes(4)
    inputs = [(2, n << 16 | 0x6000, value) for n, value in enumerate(EXAMPLE_2, 1)]
    outputs = [(2, n << 16 | 0x6001, value) for n, value in enumerate(EXAMPLE_1_OUT, 1)]
    enables = [(2, 0x5FF8, 0xFF), (1, 0x5FF8, 0), (2, 0x6002, 0xFF), (1, 0x6002, 0)]
    assert seen == inputs + outputs + enables
    result = bench.done(token)
    assert result["acts"] == "after power-on"
    assert "the map has 8 octets of inputs, PCH+4/4 has 4" in bench.notices()[0]
    assert "which act from its next power-on" in bench.notices()[1]


def test_k11_k12_block_2_by_the_users_indexes_and_an_enable_that_falls_back() -> None:
    """12 octets of inputs: block 2's record has no length; its enable is not confirmed."""
    bench = plugin(block2_inputs="5FE0 5FE1", block2_outputs="5FE2 5FE3")
    outputs = TEST_OUTPUTS.replace("2F13:long", "2F13:long=1").replace("230A", "230A=8000")
    token = bench.order("write_map", inputs=TEST_INPUTS, outputs=outputs)
    seen: list[str] = []
    while bench.result(token) is None:
        out = bench.run()
        request = bytes([out[0] & 3]) + out[1:8]
        if out[0] & 3 and seen[-1:] != [request.hex(" ").upper()]:
            seen.append(request.hex(" ").upper())
        falls_back = out[0] & 1 and out[2:4].hex() == "5fe1"
        data = "00000000" if falls_back else "000000ff" if out[0] & 1 else out[4:8].hex()
        bench.inputs = bytes([out[0] & 0x43]) + out[1:4] + bytes.fromhex(data) + bytes(4)
    assert seen[0] == "02 01 60 00 00 00 00 0C"  # 12 octets
    assert "02 02 5F E0 00 00 22 00" in seen
    assert "02 06 5F E0 00 00 22 27" in seen
    assert "02 07 5F E0 00 00 00 01" in seen
    assert "02 02 5F E2 00 00 23 0A" in seen
    assert not any(request.startswith("02 01 5F E0") for request in seen)
    assert seen[-2:] == ["02 00 5F E1 00 00 00 FF", "01 00 5F E1 00 00 00 00"]
    assert "does not confirm the enable of inputs, block 2 (5FE1h is 00h)" in bench.text(token)


@pytest.mark.parametrize(
    ("maps", "says"),
    [
        ({"inputs": "2033 202C:long"}, "write_map: inputs, block 1: the long value must be the first"),
        ({"outputs": "oP.28 2032"}, "cannot be process output data"),
        ({"inputs": "cheese"}, "write_map: 'cheese': 'cheese' is neither"),
        ({"inputs": 5}, "inputs must be a text"),
        ({"inputs": "2033 2033 2033 2033 2033"}, "block 2, whose indexes on the bus are not in the manual"),
    ],
)
def test_k7_nothing_is_sent_for_a_wrong_map(maps: dict[str, object], says: str) -> None:
    bench = plugin()
    assert says in bench.misuse("write_map", **maps)
    assert bench.out()[:23] == ZERO


# -- the drive, against literal requests -------------------------------------------------------------------------------


class Requests:
    """Literal requests to the simulated drive alone; the handshake bit is kept here."""

    def __init__(self, before: Requests | None = None, *, acts: str = "power-on") -> None:
        """A new drive, or the one of ``before`` after power off and on."""
        presets = {"map_acts": acts}
        self.device: KebDevice = again(before.device, presets=presets) if before else device(presets=presets)
        self.bench = DeviceBench(self.device, "B7 A3 93")
        self.hand = 0
        #: the process data that go with every request
        self.process = "00 00 00 00"

    def ask(self, service: int, subindex: int, index: str, value: int = 0) -> str:
        self.hand ^= 0x40
        self.request = bytes([self.hand | 0x30 | service, subindex]) + bytes.fromhex(index) + value.to_bytes(4, "big")
        reply = bytes.fromhex(self.bench.send(f"{self.request.hex(' ')} {self.process}", 4))
        assert reply[0] & 0x43 == self.hand | service
        return ("error " if reply[0] & 0x80 else "") + reply[4:8].hex(" ").upper()

    def send(self, process: str, ms: float) -> str:
        """Other process data beside the same request; the process data that come back."""
        self.process = process
        return self.bench.send(f"{self.request.hex(' ')} {process}", ms)[24:]

    def write(self, record: str, values: list[int]) -> None:
        for subindex, value in enumerate(values, 1):
            assert self.ask(2, subindex, record, value) == value.to_bytes(4, "big").hex(" ").upper()


@pytest.fixture
def line() -> Requests:
    return Requests()


@pytest.fixture
def bench() -> PairBench:
    return pair("PCH+4/4")


def test_k7_a_change_resets_the_enable_and_is_lost_without_it(line: Requests) -> None:
    assert [line.ask(1, n, "60 00") for n in (1, 2, 3, 6)] == [
        "00 00 00 04",
        "00 00 20 33",
        "00 00 00 01",
        "00 00 20 35",
    ]
    assert line.ask(1, 0, "5F F8") == "00 00 00 FF"
    line.write("60 00", EXAMPLE_2)
    assert line.ask(1, 0, "5F F8") == "00 00 00 00"
    assert line.ask(1, 0, "60 02") == "00 00 00 FF"
    assert again(line.device).operator.into.map() == DEFAULT_INPUTS


def test_k7_the_enable_is_answered_by_an_error_and_the_map_acts_after_power_on(line: Requests) -> None:
    """The number of the error is a reading: 8/0/0034."""
    line.write("60 00", [2, 0x2200, 1] + 14 * [0])
    assert line.ask(2, 0, "5F F8", 0xFF) == "error 08 00 00 34"
    assert line.ask(1, 0, "5F F8") == "00 00 00 FF"
    line.device.trip("E.OL")
    assert line.bench.send(ZERO + " 00 00 00 00", 60)[24:] == "00 01 00 00"  # of the old map, from before the change
    after = Requests(line)
    after.device.trip("E.OL")
    assert after.bench.send(ZERO + " 00 00 00 00", 60)[24:] == "00 10 00 00"  # ru.00 = 16
    assert after.ask(1, 2, "60 00") == "00 00 22 00"


#: enable and run at 1500 rpm, and at 750 rpm; the inputs at 1500 rpm
RUN, SLOWER, STOP = "00 05 05 DC", "00 05 02 EE", "00 00 00 00"
AT_SPEED = "00 15 05 DC"


def running(acts: str = "power-on") -> Requests:
    line = Requests(acts=acts)
    line.ask(1, 1, "60 00")
    assert line.send(RUN, 1300) == AT_SPEED
    return line


@pytest.mark.parametrize("acts", ["power-on", "enable"])
def test_k7_outputs_are_not_obeyed_from_the_first_record_on(acts: str) -> None:
    """Neither a stop nor Clear arrives: the motor goes on with what the inverter was given last."""
    line = running(acts)
    line.ask(2, 6, "60 01", 0x230A)
    assert line.ask(1, 0, "60 02") == "00 00 00 00"
    assert line.ask(1, 0, "5F F8") == "00 00 00 FF"  # the other direction is not touched
    assert line.send(STOP, 2000) == AT_SPEED  # inputs are still read
    line.device.clear(line.bench.now)
    line.bench.pass_time(2000)
    assert line.device.motor.frequency == 1.0


@pytest.mark.parametrize("acts", ["power-on", "enable"])
def test_k7_inputs_freeze_with_a_change_of_their_map(acts: str) -> None:
    line = running(acts)
    line.ask(2, 6, "60 00", 0x2200)
    assert line.send(STOP, 2000) == AT_SPEED
    assert line.device.motor.frequency == 0  # outputs are still obeyed


@pytest.mark.parametrize("acts", ["power-on", "enable"])
def test_k7_the_length_belongs_to_both_blocks(acts: str) -> None:
    line = Requests(acts=acts)
    line.ask(2, 1, "60 00", 4)
    assert [line.ask(1, 0, index) for index in ("5F F8", "5F E1")] == ["00 00 00 00"] * 2
    line.ask(2, 1, "60 01", 4)
    assert [line.ask(1, 0, index) for index in ("60 02", "5F E3")] == ["00 00 00 00"] * 2


@pytest.mark.parametrize(("acts", "reply"), [("power-on", "error 08 00 00 34"), ("enable", "00 00 00 03")])
def test_k11_an_enable_of_single_octets_switches_the_others_off_at_once(acts: str, reply: str) -> None:
    line = running(acts)
    assert line.ask(2, 0, "60 02", 0x03) == reply  # sy.50 alone
    assert line.send(SLOWER, 1500) == AT_SPEED
    assert line.ask(2, 0, "5F F8", 0x0C) == reply.replace("03", "0C")  # sy.53 alone
    assert line.send(STOP, 2000) == ("00 15 00 00" if acts == "power-on" else "00 00 00 00")
    assert line.device.motor.frequency == 0


@pytest.mark.parametrize(("acts", "obeyed"), [("power-on", False), ("enable", True)])
def test_k11_outputs_switched_off_and_on_again(acts: str, obeyed: bool) -> None:
    """0 is confirmed in both readings; FFh switches on at once, or at the next power-on."""
    line = running(acts)
    assert line.ask(2, 0, "60 02", 0) == "00 00 00 00"
    assert line.send(STOP, 1000) == AT_SPEED
    assert line.ask(2, 0, "60 02", 0xFF) == ("00 00 00 FF" if obeyed else "error 08 00 00 34")
    line.send(STOP, 2000)
    assert (line.device.motor.frequency == 0) == obeyed
    after = Requests(line, acts=acts)
    after.ask(1, 1, "60 00")
    assert after.send(RUN, 1300) == AT_SPEED


def test_k7_read_the_other_way_the_enable_is_confirmed_and_the_map_acts_at_once() -> None:
    """The octets that stand there go to the new places: 1500 of the set speed is a limit of 18.75 Hz then."""
    line = running("enable")
    line.ask(2, 6, "60 01", 0x230A)  # oP.10 in place of sy.52
    assert line.ask(1, 1, "20 1A") == "00 00 00 34"  # the inverter still has the old map
    assert line.send("00 05 05 DC", 500) == AT_SPEED
    assert line.ask(2, 0, "60 02", 0xFF) == "00 00 00 FF"
    assert line.ask(1, 1, "20 1A") == "00 00 03 0A"
    assert line.send("00 05 05 DC", 1000) == "00 15 02 32"  # 562 of 1500 rpm
    assert line.device.store.value("oP.10") == 18.75
    line.ask(2, 6, "60 00", 0x2200)
    assert line.ask(2, 0, "5F F8", 0xFF) == "00 00 00 FF"
    assert line.send("00 05 05 DC", 60) == "00 15 00 42"


def test_k11_read_the_other_way_a_wrong_map_is_an_invalid_description() -> None:
    line = Requests(acts="enable")
    line.ask(2, 6, "60 01", 0x231C)  # oP.28, never an output
    assert line.ask(2, 0, "60 02", 0xFF) == "error 06 05 00 00"
    assert line.ask(1, 0, "60 02") == "00 00 00 00"


@pytest.mark.parametrize(
    "values",
    [
        [4, 0x2032, 1, 0, 0, 0x231C, 1, 0, 0] + 8 * [0],  # oP.28
        [4, 0x2032, 1, 0, 0, 0x2A00, 1, 0, 0] + 8 * [0],  # not provided
        [4, 0x2032, 1, 0, 0, 0, 0, 0, 0] + 8 * [0],  # sy.50 as a long
        [4, 0x230A, 1, 0, 0, 0, 0, 0, 0] + 8 * [0],  # oP.10 as a long
        [4, 0x2032, 0, 0, 0, 0x2034, 1, 0, 0] + 8 * [0],  # no set
        [8, 0x2F13, 1, 0, 0, 0, 0, 0, 0, 0x2032, 1, 0, 0, 0x2034, 1, 0, 0],  # mixed, the inputs are not
    ],
)
def test_k11_a_wrong_map_is_taken_but_not_confirmed(line: Requests, values: list[int]) -> None:
    line.write("60 01", values)
    assert line.ask(2, 0, "60 02", 0xFF).startswith("error")
    assert line.ask(1, 0, "60 02") == "00 00 00 00"
    assert again(line.device).operator.out.map() == DEFAULT_OUTPUTS


def test_k11_each_bit_of_the_enable_stands_for_an_octet(line: Requests) -> None:
    line.ask(2, 0, "5F F8", 0x03)
    after = Requests(line)
    after.device.trip("E.OL")
    assert after.bench.send(ZERO + " 00 01 03 E8", 60)[24:29] == "00 02"
    assert [entry.key for _, entry in after.device.operator.into.active[0]] == [0x2033]


def test_k11_fb23_0_restores_the_default_map_at_power_on(line: Requests) -> None:
    line.write("60 00", [2, 0x2200, 1] + 14 * [0])
    line.ask(2, 0, "5F F8", 0xFF)
    line = Requests(line)
    assert str(line.device.operator.into.map()) == "2200"
    assert line.ask(2, 0, "5F 17", 0) == "00 00 00 00"  # Fb23, at an index that is made up
    assert again(line.device).operator.into.map() == DEFAULT_INPUTS


# -- both -------------------------------------------------------------------------------------------------------------


def pair(telegram: str, options: Mapping[str, object] = NONE, drive: KebDevice | None = None) -> PairBench:
    return PairBench(DRIVE.core("it", telegram, options, simulated=True), drive or device(telegram))


def test_a_map_of_eight_octets_from_one_power_on_to_the_next() -> None:
    telegram = "PCH+8/8"
    inputs, outputs = "ru.12:long sy.51 sy.53", "cS.19:long sy.50 sy.52"
    drive = device(telegram)
    pair(telegram, drive=drive).ok("write_map", inputs=inputs, outputs=outputs)
    drive = again(drive, telegram)
    options = {"map_inputs": inputs, "map_outputs": "cS.19:long=100 sy.50 sy.52"}
    bench = pair(telegram, options, drive)
    assert bench.ok("read_map") == {
        "inputs": "220C:long 2033 2035",
        "inputs_enable": 255,
        "outputs": "2F13:long 2032 2034",
        "outputs_enable": 255,
    }
    bench.ok("speed", value=0.5)
    bench.ok("start")
    bench.ok("reached")
    bench.pass_time(300)
    assert bench.ok("inputs") == {"ru.12 (220Ch)": 20, "sy.51 (2033h)": 0x15, "sy.53 (2035h)": 750}
    assert bench.ok("output", number="cS.19", value=-5) == -5
    bench.pass_time(50)
    assert drive.store.value("cS.19") == -5
    assert "is written by start" in bench.refused("output", number="sy.50", value=1)[1]
    assert "is not in the output map" in bench.refused("output", number="sy.06", value=1)[1]
    assert "takes 32-bit integers" in bench.refused("output", number="cS.19", value=0.5)[1]


def test_k12_two_blocks_both_ways() -> None:
    telegram = "PCH+8+2/8+4 own-gsd"
    drive = device(telegram)
    pair(telegram, drive=drive).ok("write_map", inputs=TEST_INPUTS, outputs=TEST_OUTPUTS)
    options = {"map_inputs": TEST_INPUTS, "map_outputs": "2F13:long=100 2032 2034 230A=8000"}
    bench = pair(telegram, options, again(drive, telegram))
    read = bench.ok("read_map")
    assert isinstance(read, dict)
    assert (read["inputs"], read["outputs"]) == (TEST_INPUTS, TEST_OUTPUTS)
    bench.ok("output", number="oP.10", value=25 * 80)  # block 2: half of 50 Hz at most
    bench.ok("speed", value=1.0)
    bench.ok("start")
    bench.pass_time(2000)
    assert bench.core.status().speed == pytest.approx(0.5, abs=0.001)
    bench.device.trip("E.OL")
    bench.pass_time(100)
    values = bench.ok("inputs")
    assert isinstance(values, dict)
    assert values["ru.00 (2200h)"] == 16


def test_k11_a_drive_that_does_not_confirm_is_told(bench: PairBench) -> None:
    text = bench.refused("write_map", outputs="2032 2A00=1")[1]
    assert "does not confirm the enable of outputs, block 1 (6002h is 00h)" in text


def test_a_map_that_makes_no_sense_is_told(bench: PairBench) -> None:
    device = bench.device
    assert isinstance(device, KebDevice)
    device.operator.access(0x6000, 1, 3)
    assert "read_map: inputs: the record (6000h) has a value of 1 octets" in bench.refused("read_map")[1]


# -- the plugin asks before it sends -----------------------------------------------------------------------------------


def outputs_of(bench: PairBench, ms: int) -> set[str]:
    """The process data sent behind the parameter channel."""
    seen = set()
    for _ in range(ms * 1_000_000 // bench.rotation):
        seen.add(bench.run()[8:].hex(" ").upper())
    return seen


def replies(**words: int) -> dict[str, int]:
    """Answers of a drive to reads by index: the default map as the manual's table shows it."""
    table = {
        **dict(zip(("2018", "201A", "201C", "2019", "201B"), (0x32, 0x34, -1, 1, 1), strict=True)),
        **dict(zip(("2010", "2012", "2014", "2011", "2013"), (0x33, 0x35, -1, 1, 1), strict=True)),
        "6002": 0xFF,
        "5FF8": 0xFF,
        "2300": 5,
        "2301": 9,
    }
    return table | {name[1:]: value for name, value in words.items()}


@pytest.mark.parametrize(
    ("words", "sent"),
    [
        ({}, True),
        ({"_6002": -1, "_5FF8": -1}, True),  # the manual's picture shows FFFFFFFFh
        ({"_6002": 0x0F, "_5FF8": 0x0F}, True),
        ({"_6002": 0}, False),
        ({"_6002": 0x03}, False),
        ({"_5FF8": 0}, False),
        ({"_201A": 0x0F13}, False),  # cS.19 where the set speed stands
        ({"_2300": 2}, True),  # another setting refuses the start, and says nothing of the map
    ],
)
def test_k7_no_process_data_before_the_drive_has_told_its_map(words: dict[str, int], sent: bool) -> None:
    """A drive of literal octets; 500 rpm as the set point from the beginning."""
    known = replies(**words)
    bench = PluginBench(DRIVE.core("saw", "PCH+4/4", simulated=True), ZERO + " 00 01 00 00")
    bench.order("speed", value=1 / 3)
    seen: list[str] = []
    asked: list[str] = []
    for _ in range(900):
        out = bench.run()
        if out[0] & 3 == 1:
            index = out[2:4].hex().upper()
            asked += [index] if index not in asked else []
            value = known[index] & 0xFFFF_FFFF
            bench.inputs = bytes([out[0] & 0x43]) + out[1:4] + value.to_bytes(4, "big") + bytes.fromhex("00 01 00 00")
        process = out[8:].hex(" ").upper()
        if process not in seen:
            seen.append(process)
            if process == "00 00 01 F4":
                assert {"2018", "2010", "6002", "5FF8"} <= set(asked)
    assert seen == (["00 00 00 00", "00 00 01 F4"] if sent else ["00 00 00 00"])
    if not sent:
        bench.order_and_run(200, "start")
        assert bench.out()[24:] == "00 00 00 00"


def test_k7_a_map_of_parameters_never_reaches_a_drive_with_the_default_map() -> None:
    """327680 as a torque reference is 0005 0000 on the wire: enable and run in the default map."""
    options = {"map_outputs": "2F13:long=327680"}
    bench = pair("PCH+4/4", options)
    assert outputs_of(bench, 2000) == {"00 00 00 00"}
    assert not bench.device.motor.on
    assert any("the active map has 2032 2034 (sy.24 to sy.31)" in text for text in bench.notices())


def test_k11_an_enable_that_somebody_took_away_refuses_the_start() -> None:
    drive = device()
    drive.operator.access(0x6002, 0, 0)
    bench = pair("PCH+4/4", drive=drive)
    text = bench.refused_as("fault", "start")
    assert text.startswith("the enable of the outputs, block 1 (6002h) is 00h, 0Fh or FFh is needed: ")


MAP: Mapping[str, object] = {"inputs": "sy.51 ru.00", "outputs": "sy.50 sy.52"}


def test_k7_a_map_that_acts_with_its_enable_is_used_at_once() -> None:
    """Outputs are 0 from the first record until the inverter shows the new map; then the drive can start."""
    drive = device(presets={"map_acts": "enable"})
    bench = pair("PCH+4/4", drive=drive)
    bench.ok("speed", value=0.5)
    bench.run(200)
    token = bench.order("write_map", **MAP)
    sent = set()
    while bench.result(token) is None:
        sent.add(bench.run()[8:].hex(" ").upper())
    assert sent == {"00 00 00 00"}
    result = bench.done(token)
    assert result["value"] == {"inputs": "2033 2200", "outputs": "2032 2034"}
    assert "acts" not in result
    assert not any("power-on" in text for text in bench.notices())
    assert bench.core.status().setpoint == 0, "a set point for the new map is a new order"
    bench.ok("speed", value=0.5)
    bench.ok("start")
    bench.pass_time(1500)
    assert bench.ok("inputs") == {"sy.51 (2033h)": 0x15, "ru.00 (2200h)": 66}


def test_k7_a_map_that_acts_at_power_on_leaves_the_outputs_at_0_and_refuses_the_start(bench: PairBench) -> None:
    bench.ok("speed", value=0.5)
    bench.run(200)
    assert bench.do("write_map", **MAP)["acts"] == "after power-on"
    assert outputs_of(bench, 500) == {"00 00 00 00"}
    text = bench.refused_as("fault", "start")
    assert text.startswith("other maps were written to the drive, which act from its next power-on: ")


def test_k7_the_map_that_is_in_force_is_not_written_again(bench: PairBench) -> None:
    """In one of the readings it would stop the outputs until the next power-on."""
    assert "acts" not in bench.do("write_map", outputs="2032 2034")
    bench.ok("start")


def test_k7_a_write_map_that_fails_halfway_leaves_the_drive_without_outputs(bench: PairBench) -> None:
    token = bench.order_and_run(400, "write_map", **MAP, timeout_s=0.25)
    assert bench.done(token)["error"] == "timeout"
    assert outputs_of(bench, 500) == {"00 00 00 00"}
    assert "(5FF8h) is 00h" in bench.refused("start")[1]
