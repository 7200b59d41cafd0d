"""Files that ``decode`` and ``monitor`` read: what is no ordinary file is refused with a line, or read as it comes."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from cli_kit import Cli
from far_ends import HANG_S
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from property_kit import examples

from dpstack.capture.pcapng import Writer
from dpstack.cli.main import main

TOKEN = bytes.fromhex("DC 02 02")


def capture(path: Path, packets: int = 3) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, "a test")
        port = writer.interface("p", 500_000, "")
        for number in range(packets):
            writer.packet(port, 1_790_000_000_000_000_000 + number * 1_000_000, TOKEN)
    return path


@pytest.mark.parametrize("command", ["decode", "monitor"])
def test_a_source_that_is_no_file_is_refused(cli: Cli, tmp_path: Path, command: str) -> None:
    assert f"{tmp_path}: is a directory; name a capture file in it" in cli.err(command, str(tmp_path))
    assert "/dev/null: is a device; to listen to a port: dpstack capture --port /dev/null" in cli.err(
        command, "/dev/null"
    )
    dangling = tmp_path / "gone"
    dangling.symlink_to(tmp_path / "nowhere")
    assert f"{dangling}: cannot be read (No such file or directory)" in cli.err(command, str(dangling))


@pytest.mark.skipif(not hasattr(os, "seteuid"), reason="permissions of POSIX")
@pytest.mark.parametrize("command", ["decode", "monitor"])
def test_a_file_without_permission(cli: Cli, tmp_path: Path, command: str) -> None:
    path = capture(tmp_path / "a.pcapng")
    path.chmod(0)
    cli.err(command, "/dev/null")  # imports, for which nobody else may have the permission
    own = os.geteuid()
    if own == 0:
        os.seteuid(65534)
    try:
        text = cli.err(command, str(path))
    finally:
        os.seteuid(own)
    assert "cannot be read (Permission denied); name a capture file" in text


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="a file of Linux whose octet 0 cannot be read")
@pytest.mark.parametrize("command", ["decode", "monitor"])
def test_a_file_that_fails_while_it_is_read(cli: Cli, command: str) -> None:
    assert "/proc/self/mem: cannot be read to its end (Input/output error)" in cli.err(
        command, "/proc/self/mem", code=1
    )


def test_a_file_goes_before_hex_digits(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    capture(tmp_path / "E5")
    assert [one["kind"] for one in cli.jsons("decode", "E5")] == ["SD4"] * 3
    assert [one["kind"] for one in cli.jsons("decode", "E5", "E5")] == ["SC"] * 2
    Path("DC0202").mkdir()
    assert "DC0202: is a directory" in cli.err("decode", "DC0202")


def test_a_pipe_is_decoded_as_it_comes(tmp_path: Path) -> None:
    """The first telegrams are printed while the writer still has the pipe open."""
    octets = capture(tmp_path / "a.pcapng").read_bytes()
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    program = subprocess.Popen(
        [sys.executable, "-m", "dpstack.cli.main", "decode", str(pipe), "--json"], stdout=subprocess.PIPE, text=True
    )
    assert program.stdout is not None
    hangs = threading.Timer(HANG_S, program.kill)
    hangs.start()
    try:
        with pipe.open("wb", buffering=0) as out:
            out.write(octets[:-40])  # the last packet has 36 octets
            lines = [json.loads(program.stdout.readline()) for _ in range(1)]
            out.write(octets[-40:])
            lines += [json.loads(program.stdout.readline()) for _ in range(2)]
        assert program.wait(HANG_S) == 0
    finally:
        hangs.cancel()
        program.kill()
        program.stdout.close()
    assert [one["number"] for one in lines] == [1, 2, 3]


_TELEGRAMS = ("DC0202", "68050568 83826D3C3E EC16", "680B0B68 8283083E3C 0205 00FF 1234 D316", "E5")


def _octets() -> bytes:
    file = io.BytesIO()
    writer = Writer(file, "a test")
    port = writer.interface("p", 500_000, "a port")
    for number, telegram in enumerate(_TELEGRAMS * 2):
        writer.packet(port, 1_790_000_000_000_000_000 + number * 1_000_000, bytes.fromhex(telegram), number << 24, "c")
    return file.getvalue()


OCTETS = _octets()


@given(
    st.lists(
        st.tuples(st.integers(0, len(OCTETS) // 4 - 1), st.binary(min_size=4, max_size=4) | st.just(b"\xff" * 4)),
        min_size=1,
        max_size=4,
    )
)
@settings(examples(20, soak=2_000), suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_damage_of_a_file_is_a_defect(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: list[tuple[int, bytes]]
) -> None:
    octets = bytearray(OCTETS)
    for word, changed in damage:
        octets[4 * word : 4 * word + 4] = changed
    path = tmp_path / "a.pcapng"
    path.write_bytes(octets)
    for command in ("decode", "monitor"):
        assert main([command, str(path), "--json"]) in (0, 1, 2)
    assert "Traceback" not in capsys.readouterr().err
