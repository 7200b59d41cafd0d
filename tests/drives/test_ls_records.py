"""Record 47 of the LS S100 (docs/reference/drives/ls-s100.md#record-47), each end against the manual's octets, and PKW
where the module has none."""

from __future__ import annotations

import pytest
from acyclic_kit import octets, outcome
from drive_bench import ALONE, PluginBench
from support import present

from dpstack.dpv1.master.plugin_queue import ServiceFailure
from dpstack.dpv1.pdu.read_write import parse_request
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.profile.record47 import RecordQueue, Refused, WriteReq
from dpstack_drives.ls import DRIVE
from dpstack_drives.ls.simulator import LsDevice
from tests.drives.ls_kit import ZERO, LsBench, sim

BUSY = "DE 80 B5 00"


def drive() -> LsBench:
    bench = sim("PPO3", {"COM-07": 7})
    bench.send("00 00 00 00")
    return bench


def service(bench: LsBench, request: str) -> str:
    """A DU of DP-V1 in octets, and the drive's at the time of its last scan."""
    function, slot, index, length, *_ = du = octets(request)
    server = present(bench.device.record47)
    now = bench.device.seen_until or 0
    if function == 0x5F:
        assert length == len(du) - 4
        refused = server.write_record(slot, index, du[4:], now)
        return request[:11] if refused is None else f"DF 80 {refused.code:02X} 00"
    data = server.read_record(slot, index, length, now)
    return f"DE 80 {data.code:02X} 00" if isinstance(data, Refused) else data.hex(" ").upper()


def asked(bench: LsBench, request: str) -> str:
    """The response to a request: it is written, then read until the drive is ready."""
    length = len(octets(request))
    assert service(bench, f"5F 01 2F {length:02X} {request}") == f"5F 01 2F {length:02X}"
    while (answer := service(bench, "5E 01 2F F0")) == BUSY:
        bench.pass_time(1)
    return answer


@pytest.fixture
def bench() -> LsBench:
    return drive()


@pytest.fixture
def master() -> Master:
    return Master("ST1", ST1)


def test_l8_965_and_busy_while_it_is_carried_out(bench: LsBench) -> None:
    assert service(bench, "5E 01 2F F0") == BUSY  # nobody asked for anything
    assert service(bench, "5F 01 2F 0A 01 01 01 01 10 00 03 C5 00 00") == "5F 01 2F 0A"
    assert service(bench, "5F 01 2F 0A 02 01 01 01 10 00 03 C5 00 00") == "DF 80 B5 00"
    assert service(bench, "5E 01 2F F0") == BUSY
    bench.pass_time(12)
    assert service(bench, "5E 01 2F F0") == "01 01 01 01 06 01 03 28"
    assert service(bench, "5E 01 2F F0") == BUSY


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("01 01 00 01 10 00 03 96 00 00", "01 01 00 01 06 01 00 07"),  # 918
        ("02 01 01 01 10 01 03 C4 00 01", "02 01 01 01 06 01 00 01"),  # 964[1]
        ("02 01 01 01 10 07 03 C4 00 00", "02 01 01 01 06 07 03 51 00 01 03 00 07 E6 06 01 00 01 0A 6C"),
        ("03 01 01 01 10 00 11 03 00 00", "03 01 01 01 06 01 00 0A"),  # dr-03, by its address
        ("03 01 01 02 10 00 11 03 00 00 10 00 11 14 00 00", "03 01 01 02 06 01 00 0A 06 01 17 70"),
        ("04 02 01 01 10 00 11 03 00 00 06 01 00 32", "04 02 01 01"),
        ("04 02 01 01 10 00 11 03 00 00 42 01 00 32", "04 02 01 01"),  # format Word
        ("05 01 01 01 10 00 03 C5 00 01", "05 81 01 01 44 01 00 04"),
        ("05 01 01 01 10 02 03 C5 00 00", "05 81 01 01 44 01 00 16"),
        ("05 01 01 01 10 01 03 C4 00 07", "05 81 01 01 44 02 00 03 00 07"),
        ("05 01 01 01 10 02 03 C4 00 06", "05 81 01 01 44 02 00 03 00 07"),
        ("05 01 01 01 10 09 03 B3 00 00", "05 81 01 01 44 01 00 16"),  # nine elements
        ("05 01 01 01 20 01 03 C5 00 00", "05 81 01 01 44 01 00 16"),  # a description
        ("05 01 01 01 30 01 03 C5 00 00", "05 81 01 01 44 01 00 16"),
        ("05 01 02 01 10 00 03 C5 00 00", "05 81 02 01 44 01 00 19"),  # object 2
        ("06 01 01 02 10 00 03 C5 00 00 10 00 03 98 00 00", "06 81 01 02 06 01 03 28 44 01 00 00"),
        ("07 02 01 01 10 00 03 C5 00 00 06 01 00 00", "07 82 01 01 44 01 00 01"),
        ("07 02 01 01 10 00 11 03 00 00 06 01 FF FF", "07 82 01 01 44 01 00 02"),
        ("07 02 01 01 10 00 11 03 00 00 07 01 00 00 00 32", "07 82 01 01 44 01 00 05"),
        ("07 02 01 01 10 00 11 03 00 00 7F 01 00 32", "07 82 01 01 44 01 00 17"),
        ("07 02 01 01 10 00 11 03 00 00 06 02 00 32 00 32", "07 82 01 01 44 01 00 18"),
        (
            "08 02 01 02 10 00 11 03 00 00 10 00 00 0A 00 00 06 01 00 32 06 01 00 00",
            "08 82 01 02 40 00 44 01 00 01",
        ),
    ],
)
def test_l8_requests_and_responses(request_: str, answer: str) -> None:
    assert asked(drive(), request_) == answer


def test_l8_a_change_acts(bench: LsBench) -> None:
    asked(bench, "04 02 01 01 10 00 11 03 00 00 06 01 00 32")
    assert bench.device.store.value("dr-03") == 5.0


@pytest.mark.parametrize(
    ("request_", "refused"),
    [
        ("5F 02 2F 0A 01 01 01 01 10 00 03 C5 00 00", "DF 80 B2 00"),  # slot 2
        ("5E 00 2F F0", "DE 80 B2 00"),
        ("5F 01 30 0A 01 01 01 01 10 00 03 C5 00 00", "DF 80 B0 00"),
        ("5F 01 2F 03 01 01 01", "DF 80 B7 00"),
        ("5F 01 2F 0A 00 01 01 01 10 00 03 C5 00 00", "DF 80 B7 00"),  # reference 0
        ("5F 01 2F 0A 01 03 01 01 10 00 03 C5 00 00", "DF 80 B7 00"),
        ("5F 01 2F 04 01 01 01 00", "DF 80 B7 00"),
        ("5F 01 2F 3A 01 01 01 09 " + 9 * "10 00 03 C5 00 00 ", "DF 80 B7 00"),  # nine parameters
    ],
)
def test_l8_what_is_refused(request_: str, refused: str) -> None:
    assert service(drive(), request_) == refused


def test_l8_a_short_read_does_not_lose_the_response(bench: LsBench) -> None:
    service(bench, "5F 01 2F 0A 01 01 01 01 10 00 03 C5 00 00")
    bench.pass_time(12)
    assert service(bench, "5E 01 2F 07") == "DE 80 B7 00"
    assert service(bench, "5E 01 2F 08") == "01 01 01 01 06 01 03 28"


def test_l8_data_exchange_begins_anew_and_the_old_module_has_none(bench: LsBench) -> None:
    service(bench, "5F 01 2F 0A 01 01 01 01 10 00 03 C5 00 00")
    bench.device.enter(b"\x71", bench.now)
    bench.pass_time(12)
    assert service(bench, "5E 01 2F F0") == BUSY
    assert sim("VENDOR 2/3", version="2.01").device.record47 is None


# -- the master's end --------------------------------------------------------------------------------------------------


class Master:
    """The plugin, and a master that hands its services out in octets."""

    def __init__(self, telegram: str, inputs: str) -> None:
        self.queue = RecordQueue()
        self.bench = PluginBench(DRIVE.core("pump", telegram, ALONE, records=self.queue), inputs)

    def asks(self) -> str:
        """The next service that the plugin asks for within a second, in octets."""
        for _ in range(500):
            pending = self.queue.take()
            if pending is not None:
                self.pending = pending
                wanted = pending.request
                if isinstance(wanted, WriteReq):
                    head = bytes((0x5F, wanted.slot, wanted.index, len(wanted.data)))
                    return (head + wanted.data).hex(" ").upper()
                return f"5E {wanted.slot:02X} {wanted.index:02X} {wanted.length:02X}"
            self.bench.run()
        raise AssertionError("it asks for nothing")

    def answers(self, data: str | Refused | ServiceFailure) -> None:
        self.pending.outcome = outcome(data)
        self.bench.run()

    def accepts(self, response: str | Refused | ServiceFailure) -> None:
        """The request was written, and its first read has ``response``."""
        self.answers("")
        assert self.asks() == "5E 01 2F F0"
        self.answers(response)


ST1 = "00 00 00 00"


def read(master: Master, number: object, *, reference: str, address: str, answer: str) -> dict[str, object]:
    token = master.bench.order("read", number=number)
    assert master.asks() == f"5F 01 2F 0A {reference} 01 01 01 10 {address}"
    master.accepts(Refused(0xB5))
    assert master.asks() == "5E 01 2F F0"
    master.answers(f"{reference} {answer}")
    return master.bench.done(token)


def test_l8_the_plugin_reads_965_as_the_manual_prints_it_and_addresses(master: Master) -> None:
    found = read(master, 965, reference="01", address="00 03 C5 00 00", answer="01 01 01 06 01 03 28")
    assert (found["ok"], found["value"], found["number"]) == (True, 0x0328, 965)
    found = read(master, "dr-20", reference="02", address="00 11 14 00 00", answer="01 01 01 06 01 17 70")
    assert (found["value"], found["unit"], found["raw"]) == (60.0, "Hz", 6000)


def test_l8_the_plugin_writes_and_reads_elements(master: Master) -> None:
    token = master.bench.order("write", number="dr-03", value=5.0)
    assert master.asks() == "5F 01 2F 0E 01 02 01 01 10 00 11 03 00 00 06 01 00 32"
    master.accepts("01 02 01 01")
    assert master.bench.value(token) == 5.0
    token = master.bench.order("read", number=964, index=6)
    assert master.asks() == "5F 01 2F 0A 02 01 01 01 10 01 03 C4 00 06"
    master.accepts("02 01 01 01 06 01 0A 6C")
    assert master.bench.value(token) == 0x0A6C


@pytest.mark.parametrize(
    ("answer", "error", "text"),
    [
        ("01 81 01 01 44 01 00 00", "parameter", "PNU 965: error 0, illegal parameter number"),
        ("01 81 01 01 44 02 00 03 00 07", "parameter", "PNU 965: error 3, invalid subindex (subindex 7)"),
        ("01 81 01 01 44 01 00 C8", "parameter", "PNU 965: error 200, the maker's own"),
        ("01 01 01 01 06 00", "parameter", "PNU 965: the drive answered without a value"),
        (ServiceFailure.SILENT, "timeout", "PNU 965: slave 6 silent"),
        (ServiceFailure.CLOSED, "lost", "PNU 965: slave 6 closed"),
        (
            Refused(0xA0),
            "parameter",
            "PNU 965: record 47 of slot 1: the drive refuses the response: error A/0, read error",
        ),
    ],
)
def test_l8_refusals_as_texts(master: Master, answer: str | Refused | ServiceFailure, error: str, text: str) -> None:
    token = master.bench.order("read", number=965)
    assert master.asks() == "5F 01 2F 0A 01 01 01 01 10 00 03 C5 00 00"
    master.accepts(answer)
    result = master.bench.done(token)
    assert (result["ok"], result["error"], result["text"]) == (False, error, text)


def test_orders_queue_and_their_time_ends(master: Master) -> None:
    first = master.bench.order("read", number=965, timeout_s=0.05)
    second = master.bench.order("read", number=922)
    assert master.asks() == "5F 01 2F 0A 01 01 01 01 10 00 03 C5 00 00"
    assert master.asks() == "5F 01 2F 0A 02 01 01 01 10 00 03 9A 00 00"
    assert master.bench.text(first) == "PNU 965: the drive did not answer over record 47 in time"
    master.answers("")
    master.asks()
    master.answers("01 01 01 01 06 01 03 28")  # the late answer to the first
    master.asks()
    master.answers("02 01 01 01 06 01 00 65")
    assert master.bench.value(second) == 101


def test_a_drive_without_the_record_is_asked_by_pkw() -> None:
    master = Master("PPO1", ZERO + "00 40 00 00")
    token = master.bench.order("read", number=965)
    assert master.asks() == "5F 01 2F 0A 01 01 01 01 10 00 03 C5 00 00"
    master.answers(Refused(0xB0))
    assert master.bench.run(2)[:8] == octets("13 C5 00 00 00 00 00 00")
    master.bench.see("13 C5 00 00 00 00 03 28 00 40 00 00")
    assert master.bench.value(token) == 0x0328
    master.bench.see(ZERO + "00 40 00 00")
    master.bench.order("read", number=922)
    assert master.bench.run(2)[:8] == octets("13 9A 00 00 00 00 00 00")
    assert master.queue.take() is None
    master.bench.core.lost(master.bench.now)
    master.bench.run(2)
    master.bench.order("read", number=965)
    assert master.asks()[:2] == "5F"  # it may be another drive now


def test_without_either_the_reason_is_told(master: Master) -> None:
    token = master.bench.order("read", number=965)
    master.asks()
    master.answers(Refused(0, "SAP 51 is closed"))
    result = master.bench.done(token)
    assert result["text"] == (
        "PNU 965: record 47 of slot 1: the drive refuses the request: SAP 51 is closed; "
        "a telegram with a parameter channel needs none"
    )


def test_l8_trips_have_names_in_a_telegram_without_a_channel(master: Master) -> None:
    master.bench.see("00 48 00 00")
    assert master.bench.core.faults() == ("not yet named",)
    assert master.asks() == "5F 01 2F 0A 01 01 01 01 10 01 03 B3 00 00"
    master.accepts("01 01 01 01 06 01 00 22")
    assert master.asks() == "5F 01 2F 0A 02 01 01 01 10 01 03 B3 00 01"
    master.accepts("02 01 01 01 06 01 00 00")
    assert master.bench.core.faults() == ("34 LV",)


def du(device: LsDevice, service: str) -> str:
    """One service of DP-V1 as the slave application hands it on, in octets both ways."""
    request = RecordRequest(parse_request(octets(service)))
    present(device.records).ask(request)
    assert request.response is not None
    return request.response.build().hex(" ").upper()


def test_l8_l10_as_the_slave_application_asks(bench: LsBench) -> None:
    assert du(bench.device, "5F 01 2F 0A 01 01 01 01 10 00 03 C5 00 00") == "5F 01 2F 0A"
    assert du(bench.device, "5E 01 2F F0") == "DE 80 B5 00"
    bench.pass_time(12)
    assert du(bench.device, "5E 01 2F F0") == "5E 01 2F 08 01 01 01 01 06 01 03 28"
    for slot in ("00", "01", "05"):
        assert du(bench.device, f"5F {slot} FF 04 08 00 FD E8") == f"5F {slot} FF 04"
        found = octets(du(bench.device, f"5E {slot} FF 44"))
        assert found[:8] == octets(f"5E {slot} FF 44 08 00 FD E8")
        assert found[18:20] == octets("03 51")
        assert found[20:40].rstrip() == b"CPDP-S100"
        assert len(found) == 72
        assert found[62:] == octets("00 00 3A 00 00 00 01 01 00 01")  # revision counter, profile, type, I&M 1.1, I&M0
    assert du(bench.device, "5F 01 FF 04 08 00 FD E9") == "DF 80 B7 00"  # no I&M1
