"""Arguments of 5000 digits, which Python itself refuses to read as a number: one line of our own, never a traceback."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from plant_files import plant_file

import dpstack
from dpstack.api.control import arguments
from dpstack.cli.main import main
from dpstack.errors import UsageError
from dpstack.text import decimal, number_or_name

BIG = "9" * 5000
HOIST = {"name": "hoist", "address": 3, "drive": "demag-dedrive", "watchdog_ms": 0}


@pytest.mark.parametrize(
    "argv",
    [
        ["run", "PLANT", "--outputs", f"{BIG}=00"],
        ["run", "PLANT", "--rotations", BIG],
        ["run", "PLANT", "--seconds", BIG],
        ["run", "PLANT", "--baud", BIG],
        ["run", "PLANT", "--port", f"socket://localhost:{BIG}"],
        ["sim", "--gsd", "io-station", "--modules", BIG, "--address", "3", "--port", "pty"],
        ["sim", "--drive", "keb-f5", "--address", BIG, "--port", "pty"],
        ["segment", "--stations", BIG],
        ["segment", "--error-rate", BIG],
        ["segment", "--seed", BIG],
        ["ctl", BIG, "status"],
        ["drive", "PLANT", BIG, "status"],
        ["drive", "PLANT", "hoist", "read", BIG],
        ["drive", "PLANT", "hoist", "read", "412", "--index", BIG],
        ["drive", "PLANT", "hoist", "read", "412", "--data-set", BIG],
        ["drive", "PLANT", "hoist", "write", "412", BIG],
        ["drive", "PLANT", "hoist", "speed", BIG],
        ["drive", "PLANT", "hoist", "speed", "0xBIG"],
        ["drive", "PLANT", "hoist", "frequency", "1e308"],
        ["drive", "PLANT", "hoist", "write", "480", "0xBIG"],
        ["acyclic", "PLANT", BIG, "im"],
        ["acyclic", "PLANT", "3", "read", BIG, "1"],
        ["acyclic", "PLANT", "3", "im", "--address", BIG, "--class", "2"],
        ["scan", "--port", "/nowhere", "--address", BIG],
        ["address", BIG, "5", "--port", "/nowhere"],
        ["address", "126", "5", "--port", "/nowhere", "--ident", BIG],
        ["plan", "PLANT", "--baud", BIG],
        ["plan", "PLANT", "--cycle-ms", BIG],
        ["baud", "--port", "/nowhere", "--timeout", BIG],
        ["demo", "--seconds", BIG],
    ],
    ids=lambda argv: " ".join(argv).replace(BIG, "BIG"),
)
def test_an_argument(argv: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant = plant_file(tmp_path, HOIST)
    try:
        code = main([str(plant) if arg == "PLANT" else arg.replace("BIG", "f" * 5000) for arg in argv])
    except SystemExit as end:
        code = int(str(end.code))
    assert code in (1, 2)
    told = capsys.readouterr().err
    assert "dpstack" in told
    assert "plugin failed" not in told


@pytest.mark.parametrize("number", [10**400, 1e308, -1e16], ids=["int", "1e308", "-1e16"])
def test_a_set_point_of_a_program(number: float) -> None:
    async def program() -> None:
        async with dpstack.open_bus(port="virtual", baud=500_000, slaves=[HOIST]) as bus:
            hoist = bus.drive("hoist")
            with pytest.raises(UsageError, match="drive hoist: speed must be a number up to 1e"):
                hoist.speed = number
            with pytest.raises(UsageError, match="drive hoist: frequency must be a number up to 1e"):
                hoist.frequency = number
            with pytest.raises(UsageError, match="write: value must be a number up to 1e"):
                await hoist.write(480, number)
            with pytest.raises(UsageError, match="timeout must be a number of seconds"):
                await hoist.start(abs(number))
            assert hoist.status.faults == ()

    dpstack.run_virtual(program())


@pytest.mark.parametrize(
    "read",
    [
        arguments.time_ns,
        arguments.whole_number,
        arguments.mask,
        arguments.octet,
        lambda text: arguments.number(text, 0, 1, "0.5"),
        lambda text: arguments.hex_octets(text, "00"),
    ],
)
@pytest.mark.parametrize("text", [BIG, f"{BIG}s", f"0.{BIG}ms", "\u0663", "\u00b2", "", "-1", "x" * 5000])
def test_arguments_of_ctl(read: object, text: str) -> None:
    assert callable(read)
    with contextlib.suppress(UsageError):
        read(text)


def test_a_number_has_nine_digits_at_most() -> None:
    assert [decimal(text) for text in ("0", "007", "999999999")] == [0, 7, 999_999_999]
    assert {decimal(text) for text in ("", "-1", "1.0", "0x1", "\u0663", "\u00b2", "1000000000", BIG, " 1")} == {None}
    assert [number_or_name(text) for text in ("3", "hoist", BIG)] == [3, "hoist", BIG]
