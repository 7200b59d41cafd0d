"""``dpstack address`` as users start it, on a segment of ptys, against slaves that know octets only."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_kit import Cli
from far_ends import HANG_S
from forked_programs import ForkServer
from programs import Starter
from support_responder import Responder

from dpstack.cli.main import main

NOBODY = "33"
#: a busy computer kept the slaves' program from answering three requests in time: it was asked once more, with patience
LATE = "answered a request with FCV = 1 after three silent ones with FCV = 0"
SLAVES = ("126:1234:2111:2:2", "20:1234:2111:2:2", "5:0696:f3f1:12:12,owner=1")


@pytest.fixture(scope="module")
def bus(tmp_path_factory: pytest.TempPathFactory, fork_server: ForkServer | None) -> Iterator[Path]:
    """A segment of two: the slaves on port 0, port 1 is free."""
    folder = tmp_path_factory.mktemp("address")
    starter = Starter(folder, fork_server)
    try:
        starter.segment(folder / "bus")
        with Responder(str(folder / "bus" / "0"), SLAVES):
            yield folder / "bus"
    finally:
        starter.close()


def address(capsys: pytest.CaptureFixture[str], bus: Path, *args: str) -> tuple[int, str, str]:
    """Exit code and output. Asks again where a busy computer kept the slave from answering: nothing was changed yet."""
    end = time.monotonic() + HANG_S
    while True:
        code = main(["address", *args, "--port", str(bus / "1"), "--baud", "500000"])
        printed = capsys.readouterr()
        if args[0] == NOBODY or f"slave {args[0]} does not answer Slave_Diag" not in printed.err:
            break
        assert time.monotonic() < end, printed.err
    told = [line for line in printed.err.splitlines(keepends=True) if LATE not in line]
    return code, printed.out, "".join(told)


def test_there_and_back(bus: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = address(capsys, bus, "20", "9", "--ident", "0x1234")
    assert done == (0, "slave 20 has address 9 now: ident 0x1234, verified there\n", "")
    code, out, err = address(capsys, bus, "9", "11", "--no-change", "--json")
    assert (code, err) == (0, "")
    assert json.loads(out) == {"old": 9, "new": 11, "ident": "0x1234", "no_change": True}
    code, out, err = address(capsys, bus, "11", "12")
    assert (code, out) == (1, "")
    assert err.splitlines()[-1].startswith(
        "dpstack: slave 11 acknowledged Set_Slave_Add and kept its address; its address was locked"
    )


@pytest.mark.parametrize(
    ("args", "code", "line"),
    [
        (("126", "8", "--ident", "0696"), 1, "slave 126 is another device: ident 0x1234 instead of 0x0696; "),
        (("5", "8"), 1, "slave 5 is still locked by master 1, which is not in the token ring (any more) and takes no "),
        (("126", "5"), 1, "address 5 is in use: a station answers there; nothing was changed: "),
        ((NOBODY, "34"), 1, "slave 33 does not answer Slave_Diag; "),
        (("7", "7"), 2, "the slave has address 7 already: nothing to do"),
    ],
)
def test_findings(bus: Path, capsys: pytest.CaptureFixture[str], args: tuple[str, str], code: int, line: str) -> None:
    ended, out, err = address(capsys, bus, *args, "--json")
    assert (ended, out) == (code, "")
    assert err.splitlines()[-1].startswith(f"dpstack: {line}")


@pytest.mark.parametrize(
    ("args", "line"),
    [
        (("127", "5"), "'127' is no address of a slave, 0..126"),
        (("126", "126"), "'126' is no station address, 0..125"),
        (("126", "5", "--ident", "zz"), "'zz' is no ident number, for instance 0x0696"),
    ],
)
def test_wrong_use(capsys: pytest.CaptureFixture[str], args: tuple[str, ...], line: str) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["address", *args, "--port", "/dev/null"])
    assert caught.value.code == 2
    assert line in capsys.readouterr().err


def test_a_port_where_nobody_is(cli: Cli) -> None:
    assert (
        cli.err("address", "126", "5", "--port", "virtual")
        == 'dpstack: address: nobody is on port "virtual"; name the port of a bus\n'
    )
