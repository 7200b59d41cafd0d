"""Data exchange broadcast as the monitor hears it: publisher, links and their states."""

from __future__ import annotations

import io
from typing import Any

import pytest
from octet_slave import frame
from page_kit import Page
from report_kit import Heard
from rich.console import Console
from support import S

from dpstack.capture.timing import timing_of
from dpstack.capture.transmission import Transmission
from dpstack.cli.listening import monitor_view
from dpstack.monitor.monitor import Monitor

BAUD = 500_000
NOW = 1_800_000_000 * S
PRM = bytes.fromhex("3D 3E 88 01 14 0B 12 34 00")
FILTER = bytes.fromhex("80 00 08 0B 07 00 00 01 07 04 01 03 01 02")
DIAG = bytes.fromhex("3E 3C 08 0C 00 02 12 34 06 83 00 00 07 40")


def heard(*telegrams: bytes) -> Monitor:
    monitor, at = Monitor(timing_of("tap", BAUD, exact=True)), NOW
    for octets in telegrams:
        monitor.add(Transmission(octets, at, BAUD))
        at += 22_000 * len(octets) + 100_000
    return monitor


def station_of(*telegrams: bytes, address: int) -> dict[str, object]:
    stations = heard(*telegrams).summary()["stations"]
    assert isinstance(stations, dict)
    found = stations[str(address)]
    assert isinstance(found, dict)
    return found


def request(address: int, fc: int, body: bytes) -> bytes:
    return frame(bytes((address | 0x80, 0x82, fc)) + body)


def diagnosed(data: bytes) -> tuple[bytes, bytes]:
    """Slave_Diag of slave 9, and its answer."""
    return request(9, 0x5D, bytes.fromhex("3C 3E")), frame(b"\x82\x89\x08" + data)


PRM_9 = request(9, 0x6D, PRM + FILTER)
EXCHANGE, ANSWER = frame(bytes.fromhex("09 02 7D 01")), frame(bytes.fromhex("02 09 08 01"))
#: Set_Prm of publisher 7, and its answer to all
PUBLISHER = (
    request(7, 0x6D, PRM + bytes.fromhex("A0 00 00")),
    b"\xe5",
    frame(bytes.fromhex("07 02 57 01")),
    frame(bytes.fromhex("7F 07 08 AA")),
)


def test_a_subscriber() -> None:
    prm = PRM_9
    link = "octets 1..2 of the 4 of publisher 7 to output octet 1 of slot 3"
    found = station_of(prm, b"\xe5", address=9)
    assert found["links"] == [{"publisher": 7, "text": link, "good": None, "state": None}]
    lost = "the broadcast has another length than the filter"
    found = station_of(prm, b"\xe5", EXCHANGE, ANSWER, *diagnosed(DIAG), address=9)
    assert found["links"] == [{"publisher": 7, "text": link, "good": False, "state": lost}]
    assert found["diagnosis_texts"] == [f"DXB link status: publisher 7: {lost}"]
    # a later diagnosis without that message does not end what it said; a new bring-up does
    found = station_of(prm, b"\xe5", EXCHANGE, ANSWER, *diagnosed(DIAG), *diagnosed(DIAG[:8]), address=9)
    assert found["links"] == [{"publisher": 7, "text": link, "good": False, "state": lost}]
    found = station_of(prm, b"\xe5", EXCHANGE, ANSWER, *diagnosed(DIAG), prm, b"\xe5", address=9)
    assert found["links"] == [{"publisher": 7, "text": link, "good": None, "state": None}]


def test_the_verdict_is_about_links_without_data_only() -> None:
    def reasons(state: int) -> list[str]:
        told = diagnosed(DIAG.replace(b"\x08", b"\x00", 1)[:-1] + bytes((state,)))  # without Ext_Diag
        found = station_of(PRM_9, b"\xe5", *(EXCHANGE, ANSWER) * 100, *told, address=9)["reasons"]
        assert isinstance(found, list)
        return [one for one in found if "publisher" in one or "diagnosis" in one]

    assert reasons(0x81) == []
    (reason,) = reasons(0x00)
    assert "has no valid data from publisher 7 (no data): look at station 7" in reason


def test_nothing_is_good_at_a_station_without_data_exchange() -> None:
    found = station_of(PRM_9, b"\xe5", *diagnosed(DIAG[:-1] + b"\x81"), address=9)["links"]
    assert isinstance(found, list)
    assert (found[0]["good"], found[0]["state"]) == (None, "valid data; it is not in data exchange now")


def test_links_in_the_report_and_on_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    monitor = heard(PRM_9, b"\xe5", EXCHANGE, ANSWER, *diagnosed(DIAG), *PUBLISHER)
    summary: dict[str, Any] = monitor.summary()
    for name in ("</td><script>x", "\x1b[31m\u202e"):
        for address in ("7", "9"):
            summary["stations"][address]["name"] = name
        html = Heard().report(summary=summary).html()
        assert Page.of(html).faults == []
        assert "Links between slaves (data exchange broadcast)" in html
        assert "octets 1..2 of the 4 of publisher 7 to output octet 1 of slot 3" in html
        assert "the broadcast has another length than the filter" in html
        assert name not in html
    assert "data exchange broadcast" not in Heard().report().html()
    monitor_view.show_summary(monitor.heard(), summary)
    shown = capsys.readouterr().out
    assert "another length than the filter" in shown
    assert "\x1b" not in shown
    console = Console(width=200, file=io.StringIO())
    console.print(monitor_view.LiveView(monitor, "port").picture(NOW + S))
    assert isinstance(console.file, io.StringIO)
    assert "link: 9, octets 1..2 of the 4 of publisher 7" in console.file.getvalue()


def test_a_publisher_and_its_answers() -> None:
    found = station_of(*PUBLISHER, address=7)
    assert found["publisher"] is True
    assert "links" not in found
    assert (found["requests"], found["answers"]) == (2, 2)
