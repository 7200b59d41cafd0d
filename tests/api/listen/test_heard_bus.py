"""A bus as a listener hears it: literal octets of a master and a slave in; readings, live list and stories out."""

from __future__ import annotations

import pytest
from api_kit import virtual
from octet_slave import frame, sd1, sd2

from dpstack.api.config.config import Config, make_config, slave_config
from dpstack.api.listen.heard_bus import HeardBus
from dpstack.api.slave.station_report import station_report
from dpstack.capture.listener import Listener
from dpstack.capture.transmission import Transmission
from dpstack.why.story import Story
from tests.why.fault_plants import bring
from tests.why.fault_table import ALL

S = 1_000_000_000
EPOCH = 1_790_000_000 * S
SC = b"\xe5"
VALVES = {"name": "valves", "address": 8, "ident": 0x1234, "config": "20 10", "inputs": {"limit": "bool@0.3"}}
PUMP = {"name": "pump", "address": 9, "ident": 0x4321, "config": "20 10"}


def config() -> Config:
    return make_config("/dev/ttyX", 500_000, 2, where="test", slaves=(slave_config(VALVES), slave_config(PUMP)))


class Line:
    """Telegrams of master 2 on the line, a millisecond apart."""

    def __init__(self) -> None:
        self.heard = HeardBus(begun_ns=EPOCH)
        self.t_ns = EPOCH

    def put(self, *telegrams: bytes) -> None:
        for octets in telegrams:
            self.heard.add(Transmission(octets, self.t_ns, 500_000))
            self.t_ns += 1_000_000

    def token(self, times: int = 3) -> None:
        for _ in range(times):
            self.put(bytes.fromhex("DC 02 02"))

    def diagnosis(self, octets: str, fc: int = 0x6D) -> None:
        self.put(sd2(8, 2, fc, 60, 62, b""), sd2(2, 8, 0x08, 62, 60, bytes.fromhex(octets)))

    def bring_up(self) -> None:
        self.diagnosis("02 05 00 FF 12 34")
        self.put(sd2(8, 2, 0x5D, 61, 62, bytes.fromhex("B8 14 0B 0B 12 34 00")), SC)
        self.put(sd2(8, 2, 0x7D, 62, 62, bytes.fromhex("20 10")), SC)
        self.diagnosis("00 0C 00 02 12 34", 0x5D)

    def exchange(self, outputs: int = 0x55, inputs: int = 0x08, fc: int = 0x7D) -> None:
        self.put(frame(bytes((8, 2, fc, outputs))), frame(bytes((2, 8, 0x08, inputs))))


@pytest.fixture
def line() -> Line:
    made = Line()
    made.token()
    return made


def test_a_bring_up_gives_the_whole_reading(line: Line) -> None:
    line.bring_up()
    line.exchange()
    line.exchange(fc=0x5D)
    reading = line.heard.reading(8, 5)
    assert (reading.source, reading.own, reading.status) == ("heard", None, "")
    assert (reading.diagnosis, reading.config) == ("000c00021234", "2010")
    assert (reading.inputs, reading.outputs) == ("08", "55")
    report = station_report(reading, config().find("valves"))
    assert (report["answers"], report["healthy"], report["state"]) == (True, True, "data_exchange")
    assert report["inputs"]["fields"] == {"limit": True}


def test_a_slave_in_data_exchange_whose_diagnosis_nobody_read_is_neither_healthy_nor_ill(line: Line) -> None:
    for _ in range(4):
        line.exchange()
        line.exchange(fc=0x5D)
    report = station_report(line.heard.reading(8, 5), config().find("valves"))
    assert (report["answers"], report["healthy"]) == (True, None)
    assert (report["state"], report["master"], report["diagnosis"]) == ("data_exchange", 2, None)
    assert report["findings"] == ["its diagnosis is not known: its master did not ask for it in 5 s of listening"]
    assert report["inputs"]["fields"] == {"limit": True}
    assert report["outputs"]["octets"] == "55"


def test_a_slave_that_its_master_asks_in_vain_does_not_answer(line: Line) -> None:
    for _ in range(4):
        line.put(sd2(8, 2, 0x6D, 60, 62, b""))
        line.token(1)
    report = station_report(line.heard.reading(8, 5))
    assert (report["answers"], report["healthy"]) == (False, False)
    assert report["findings"][0].startswith("does not answer")
    assert report["errors"] == {"Slave_Diag": "its master asked in vain in 5 s of listening"}


@pytest.mark.parametrize(
    ("address", "why"),
    [(77, "nobody asked station 77 in 5 s of listening"), (11, "it was only looked for in 5 s of listening")],
)
def test_of_a_station_that_nobody_asks_nothing_is_claimed(line: Line, address: int, why: str) -> None:
    line.put(sd1(11, 2, 0x49))
    report = station_report(line.heard.reading(address, 5))
    assert (report["answers"], report["healthy"], report["state"]) == (None, None, None)
    assert report["findings"] == [f"its diagnosis is not known: {why}"]


def test_of_a_master_it_says_so(line: Line) -> None:
    assert station_report(line.heard.reading(2, 5))["findings"] == [
        "is a master in the token ring: it has no diagnosis of a slave"
    ]


def test_the_live_list_has_masters_slaves_and_their_states(line: Line) -> None:
    line.bring_up()
    line.exchange()
    line.put(sd1(11, 2, 0x49))  # nobody is there
    line.put(sd1(12, 2, 0x49), sd1(2, 12, 0x00))
    found = line.heard.stations({8: "valves"})
    nothing = {"ident": None, "state": None, "master": None, "config": None, "name": None}
    assert found == [
        {"address": 2, "type": "master_in_ring", **nothing},
        {
            "address": 8,
            "type": "slave",
            "ident": "0x1234",
            "state": "data_exchange",
            "master": 2,
            "config": "20 10",
            "name": "valves",
        },
        {"address": 12, "type": "slave", **nothing},
    ]


def test_a_story_of_a_refused_configuration(line: Line) -> None:
    for _ in range(2):
        line.bring_up()
        line.diagnosis("05 05 00 FF 12 34", 0x7D)
        line.put(sd2(8, 2, 0x5D, 59, 62, b""), sd2(2, 8, 0x08, 62, 59, bytes.fromhex("20 20 10")))
    story = line.heard.story(config(), config().slaves[0])
    assert (story.source, story.state, story.first.cause) == ("heard", "fault", "module_extra")
    assert story.lines()[0] == "slave 8 (valves): fault, seen by a listener, who asked nobody"


def test_beside_a_plc_the_master_of_the_slave_is_the_plc(line: Line) -> None:
    """A configuration that is read only has an address that no station has; the PLC here is master 2."""
    line.bring_up()
    line.exchange()
    slaves = (slave_config(VALVES),)
    beside = make_config("/dev/ttyX", 500_000, 7, where="test", slaves=slaves, bus={"read_only": True})
    assert line.heard.story(beside, slaves[0]).first.cause == "healthy"
    of_seven = make_config("/dev/ttyX", 500_000, 7, where="test", slaves=slaves)
    assert line.heard.story(of_seven, slaves[0]).first.cause != "healthy"


def test_nothing_heard_is_no_story_of_a_slave() -> None:
    """A bus that stands still: the master is missing, and of the slave nothing is known."""
    story = HeardBus(begun_ns=EPOCH).story(config(), config().slaves[0])
    assert [one.cause for one in story.causes] == ["no_token"]


# --- the plants of the table of faults, heard only ------------------------------------------------------------------

#: a listener cannot name them: they need a question, or a look into the master
UNHEARABLE = {
    "other_address",
    "watchdog_short",
    "duplicate_address",
    "noise_on_stub",
    "bus_jammed",
    "second_master_same_address",
    "answers_too_soon",
    "deactivated",
}


def story_of(fault: str, seed: int) -> tuple[frozenset[str], Story]:
    """The wanted causes, and the story of a listener."""
    plant = ALL[fault](seed)

    async def program() -> Story:
        heard = HeardBus()
        plant.world.add(Listener(plant.world.now, heard.add, baud=plant.baud, epoch_ns=EPOCH), name="listener")
        async with bring(plant) as bus:
            slave = bus.config.find(plant.name)
            assert slave is not None
            return heard.story(bus.config, slave)

    return plant.causes, virtual(program())


def _right(fault: str, seed: int) -> bool:
    wanted, story = story_of(fault, seed)
    wrong = [one.cause for one in story.causes if one.confidence >= 0.9 and one.cause not in wanted]
    assert not wrong, (fault, seed, wrong)
    return story.first.cause in wanted


@pytest.mark.parametrize("fault", ["locked"])
def test_a_listener_names_the_cause(fault: str) -> None:
    assert _right(fault, 0)


@pytest.mark.soak
def test_a_listener_names_most_causes_and_is_never_sure_and_wrong() -> None:
    outcomes = [_right(fault, seed) for fault in ALL for seed in range(3) if fault not in UNHEARABLE]
    assert sum(outcomes) >= 0.9 * len(outcomes)
