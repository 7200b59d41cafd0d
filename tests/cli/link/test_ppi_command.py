"""``dpstack ppi``: what is wrong is said before the port is opened."""

from __future__ import annotations

import pytest

from dpstack.cli.link import ppi
from dpstack.cli.main import main
from dpstack.errors import DpError, PortBusyError, SlaveTimeout

PORT = "/nowhere/port"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["read"], "read needs addresses"),
        (["read", "DB1.DBW0"], "no address of an S7-200"),
        (["write", "VW0"], "write needs an address and a value"),
        (["write", "VW0", "x", "--yes"], "VW0: 'x' is no value; a number is wanted"),
        (["write", "VW0", "70000", "--yes"], "0 to 65535"),
        (["write", "M0.0", "2", "--yes"], "0 or 1 is wanted"),
        (["write", "VB0[2]", "0x", "--yes"], "octets in hex"),
        (["write", "VW0", "1"], "add --yes if that is meant"),
        (["stop"], "stop acts on the plant of CPU 2: add --yes"),
        (["clock", "now"], "clock takes no 'now': leave it out"),
        (["set-time", "a", "b", "--yes"], "set-time takes one time"),
    ],
)
def test_wrong_words(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ppi", PORT, "2", *words]) == 2
    assert message in capsys.readouterr().err


def test_a_port_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ppi", PORT, "2", "read", "VW0"]) != 0
    assert PORT in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "words", "message"),
    [
        (
            PortBusyError("held by `dpstack run plant.toml` (pid 1): end it"),
            [],
            f"or let that run ask: `dpstack ctl {PORT} status` shows the values of its plant file, `dpstack ctl {PORT} "
            "set CPU.NAME=VALUE` writes one\n",
        ),
        (PortBusyError("held by `minicom` (pid 1): end it"), [], "dpstack: held by `minicom` (pid 1): end it\n"),
        (SlaveTimeout(2, "no answer: check the rate"), [], "check the rate (asked at 9.6 kbit/s: --baud)\n"),
        (SlaveTimeout(2, "no answer: check the rate"), ["--baud", "187500"], "(asked at 187.5 kbit/s: --baud)\n"),
    ],
)
def test_the_next_step(
    error: DpError, words: list[str], message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def station_for(_: object) -> None:
        raise error

    monkeypatch.setattr(ppi, "station_for", station_for)
    assert main(["ppi", PORT, "2", "read", "VW0", *words]) == 1
    assert capsys.readouterr().err.endswith(message)
