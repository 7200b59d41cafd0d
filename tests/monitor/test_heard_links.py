"""Data exchange broadcast as the monitor hears it: publisher, links and their states."""

from __future__ import annotations

from octet_slave import frame
from support import S

from dpstack.capture.timing import timing_of
from dpstack.capture.transmission import Transmission
from dpstack.monitor.monitor import Monitor

BAUD = 500_000
NOW = 1_800_000_000 * S
PRM = bytes.fromhex("3D 3E 88 01 14 0B 12 34 00")
FILTER = bytes.fromhex("80 00 08 0B 07 00 00 01 07 04 01 03 01 02")
DIAG = bytes.fromhex("3E 3C 08 0C 00 02 12 34 06 83 00 00 07 40")


def station_of(*telegrams: bytes, address: int) -> dict[str, object]:
    monitor, at = Monitor(timing_of("tap", BAUD, exact=True)), NOW
    for octets in telegrams:
        monitor.add(Transmission(octets, at, BAUD))
        at += 22_000 * len(octets) + 100_000
    stations = monitor.summary()["stations"]
    assert isinstance(stations, dict)
    found = stations[str(address)]
    assert isinstance(found, dict)
    return found


def request(address: int, fc: int, body: bytes) -> bytes:
    return frame(bytes((address | 0x80, 0x82, fc)) + body)


def test_a_subscriber() -> None:
    prm = request(9, 0x6D, PRM + FILTER)
    link = "octets 1..2 of the 4 of publisher 7 to output octet 1 of slot 3"
    found = station_of(prm, b"\xe5", address=9)
    assert found["links"] == [{"publisher": 7, "text": link, "state": None}]
    diag = frame(b"\x82\x89\x08" + DIAG)
    found = station_of(prm, b"\xe5", request(9, 0x5D, bytes.fromhex("3C 3E")), diag, address=9)
    lost = "the broadcast has another length than the filter"
    assert found["links"] == [{"publisher": 7, "text": link, "state": lost}]
    assert found["diagnosis_texts"] == [f"DXB link status: publisher 7: {lost}"]


def test_a_publisher_and_its_answers() -> None:
    asked = frame(bytes.fromhex("07 02 57 01"))
    found = station_of(
        request(7, 0x6D, PRM + bytes.fromhex("A0 00 00")),
        b"\xe5",
        asked,
        frame(bytes.fromhex("7F 07 08 AA")),
        address=7,
    )
    assert found["publisher"] is True
    assert "links" not in found
    assert (found["requests"], found["answers"]) == (2, 2)
