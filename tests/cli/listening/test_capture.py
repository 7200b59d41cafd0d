"""``dpstack capture``: what is on the line gets into the file, with its damage and its gaps, and nothing is sent."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_kit import Cli
from far_ends import PtyFarEnd

from dpstack.capture.pcapng import PROFIBUS_DL, Packet, Reader

TOKEN = bytes.fromhex("DC 02 02")
REQUEST = bytes.fromhex("68 05 05 68 83 82 6D 3C 3E EC 16")
ANSWER = bytes.fromhex("68 0B 0B 68 82 83 08 3E 3C 02 05 00 FF 12 34 D3 16")
ROUND = TOKEN + REQUEST + ANSWER


class Bus(PtyFarEnd):
    """The other end of the pty: a bus that sends the same round again and again; ``heard``: the octets sent to it."""

    def __init__(self, octets: bytes) -> None:
        super().__init__()
        self.octets = octets
        self.heard = b""
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._send)
        self._thread.start()

    def _send(self) -> None:
        while not self._ended.wait(0.002):
            with contextlib.suppress(BlockingIOError):  # nobody reads yet
                os.write(self.fd, self.octets)
            with contextlib.suppress(OSError):  # nobody has it open
                self.heard += self.take()

    def end(self) -> None:
        self._ended.set()
        self._thread.join()
        self.hang_up()


@pytest.fixture
def bus() -> Iterator[Bus]:
    bus = Bus(ROUND)
    yield bus
    bus.end()


def packets(path: Path) -> list[Packet]:
    with path.open("rb") as file:
        return list(Reader(file, path.name))


def test_a_file(cli: Cli, bus: Bus, tmp_path: Path, alone: None) -> None:
    path = tmp_path / "a.pcapng"
    lines = cli.jsons("capture", "--port", bus.path, "--baud", "500000", "--write", str(path), "--seconds", "0.15")
    found = packets(path)
    whole = {TOKEN, REQUEST, ANSWER}
    assert {one.octets for one in found if not one.damage} == whole
    assert lines[0]["event"] == "start"
    summary = lines[-1]
    assert (summary["event"], summary["baud"], summary["gaps"]) == ("summary", 500_000, 0)
    assert summary["telegrams"] == sum(one.octets in whole for one in found)
    assert summary["kept"] == len(found)
    assert (found[0].interface.name, found[0].interface.bits_per_s) == (bus.path, 500_000)
    assert bus.heard == b""


def test_the_screen_with_a_filter(cli: Cli, bus: Bus, alone: None) -> None:
    out = cli.out(
        "capture", "--port", bus.path, "--baud", "500000", "--seconds", "0.1", "--filter", "service==slave_diag"
    )
    shown = [line for line in out.splitlines() if "Slave_Diag" in line]
    assert shown
    assert "token" not in out
    assert "telegrams in 0." in out.splitlines()[-1]


def test_the_link_type_of_profibus(cli: Cli, bus: Bus, tmp_path: Path, alone: None) -> None:
    path = tmp_path / "a.pcapng"
    args = ("--port", bus.path, "--baud", "500000", "--write", str(path), "--seconds", "0.1", "--linktype", "257")
    assert "show only octets" in cli("capture", *args)[1]
    assert packets(path)[0].interface.linktype == PROFIBUS_DL


def test_an_existing_file_is_kept(cli: Cli, tmp_path: Path, alone: None) -> None:
    path = tmp_path / "a.pcapng"
    path.write_bytes(b"mine")
    assert "there is a file of that name" in cli.err("capture", "--port", "/dev/none", "--write", str(path))
    assert path.read_bytes() == b"mine"


def test_no_file_is_left_where_the_port_cannot_be_opened(cli: Cli, tmp_path: Path, alone: None) -> None:
    path = tmp_path / "a.pcapng"
    assert "no such port" in cli.err("capture", "--port", "/dev/none", "--write", str(path), code=1)
    assert not path.exists()
