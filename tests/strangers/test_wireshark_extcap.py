"""tshark runs our extcap program, installed by ``dpstack wireshark``, on a live segment with a run and a sim on it; and
the table, the frames that belong together, and the expert infos of the dissector.
"""

from __future__ import annotations

import os
import subprocess
import unicodedata
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest
from programs import Starter, plant_of

from dpstack.capture.transmission import Damage, Transmission
from dpstack.cli.main import main
from tests.strangers.stranger_kit import HANGS_S, program
from tests.strangers.wireshark_kit import differences, dissected, environment, explained, tshark, write_capture

pytestmark = pytest.mark.strangers

POLL: Final = bytes.fromhex("68 04 04 68 03 02 5D 07 69 16")  # Data_Exchange 2 -> 3, FCV=1 FCB=0
ANSWER: Final = bytes.fromhex("68 04 04 68 02 03 08 AA B7 16")
TOKEN: Final = bytes.fromhex("DC 02 02")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Path:
    """A home folder in which ``dpstack wireshark install`` has been."""
    folder = tmp_path / "home"
    folder.mkdir()
    for name, value in environment(folder).items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    assert main(["wireshark", "install"]) == 0
    assert "installed" in capsys.readouterr().out
    return folder


@pytest.fixture
def segment(tmp_path: Path) -> Iterator[Path]:
    """The folder of a live segment, on which a run has its three slaves, simulated by a sim, in data exchange."""
    folder = tmp_path / "bus"
    plant = plant_of(tmp_path, folder / "1")
    logs = tmp_path / "logs"
    logs.mkdir()
    start = Starter(logs)
    try:
        start.segment(folder)
        start("sim", str(plant), "--port", str(folder / "0")).wait_for(str(folder / "0"))
        start("run", str(plant), "--json").wait_for_slaves(3)
        yield folder
    finally:
        start.close()


def test_tshark_captures_from_a_live_segment_and_from_the_run_on_it(home: Path, segment: Path, tmp_path: Path) -> None:
    listed = tshark("-D", home=home)
    assert f"dpstack:{segment} (PROFIBUS: segment on {segment})" in listed
    assert f"dpstack:{segment / '1'} (PROFIBUS: run on {segment / '1'})" in listed
    for number, port in enumerate((segment, segment / "1")):
        file = tmp_path / f"{number}.pcapng"
        tshark("-i", f"dpstack:{port}", "-a", "packets:400", "-w", file, home=home)
        ours = explained(file)
        assert len(ours) >= 400
        assert {"Data_Exchange", "token"} <= {one.service for one in ours}
        assert {one.telegram.da for one in ours if one.telegram and one.telegram.is_request} >= {3, 4, 9}
        assert differences(dissected(file), ours) == []
    lines = tshark("-i", f"dpstack:{segment}", "-a", "packets:50", home=home).splitlines()
    assert any("Data_Exchange request 2 -> 3" in line for line in lines)


def test_a_port_that_is_not_there_ends_with_a_line(home: Path) -> None:
    done = subprocess.run(
        [program("tshark"), "-i", "dpstack:/nowhere", "-a", "packets:1"],
        capture_output=True,
        text=True,
        timeout=HANGS_S,
        check=False,
        env=dict(os.environ),
    )
    assert done.returncode != 0
    assert "/nowhere" in done.stderr


def test_it_is_gone_when_it_is_removed(home: Path) -> None:
    assert "dpstack-profibus" in tshark("-G", "plugins", home=home)
    assert main(["wireshark", "remove"]) == 0
    assert "dpstack-profibus" not in tshark("-G", "plugins", home=home)


def _course(path: Path) -> Path:
    """A poll with its answer, one that is repeated and answered, one in vain, a late answer, a damaged telegram, a poll
    of the GAP."""
    gap = bytes.fromhex("10 05 02 49 50 16")  # FDL_Status 2 -> 5
    octets = [TOKEN, POLL, ANSWER, POLL, POLL, ANSWER, POLL, TOKEN, ANSWER, POLL[:-1] + b"\x17", gap, TOKEN]
    sent, at = [], 1_790_000_000_000_000_123
    for one in octets:
        damage = Damage.FCS if one[-1] == 0x17 else 0
        sent.append(Transmission(one, at, 500_000, "", damage))
        at += len(one) * 22_000 + 30_500
    return write_capture(path, sent)


def _column(path: Path, name: str, *more: str) -> list[str]:
    return tshark("-2", "-r", path, "-T", "fields", "-e", name, *more).split("\n")[:-1]


def test_requests_answers_and_their_times(tmp_path: Path) -> None:
    path = _course(tmp_path / "course.pcapng")
    assert _column(path, "profibus.response_in") == ["", "3", "", "", "6", "", "9", *[""] * 5]
    assert _column(path, "profibus.response_to") == ["", "", "2", "", "", "5", "", "", "7", "", "", ""]
    assert _column(path, "profibus.retry_of") == ["", "", "", "", "4", *[""] * 7]
    assert _column(path, "profibus.response_time")[2] == "0.000030500"
    assert _column(path, "profibus.pair") == ["", *["2-3"] * 6, "", "2-3", "", "2-5", ""]
    assert _column(path, "frame.number", "-Y", "profibus.late") == ["9"]
    assert _column(path, "frame.number", "-Y", "profibus.sa == 2 && profibus.service == \"Data_Exchange\"") == [
        "2", "4", "5", "7",
    ]  # fmt: skip


def test_expert_infos(tmp_path: Path) -> None:
    path = _course(tmp_path / "course.pcapng")

    def frames(name: str) -> list[str]:
        return _column(path, "frame.number", "-Y", f"profibus.expert.{name}")

    assert frames("retry") == ["5"]
    assert frames("lost") == ["4", "8"]
    assert frames("late") == ["9"]
    assert frames("damaged") == ["10"]
    assert frames("refused") == []
    shown = tshark("-r", path, "-q", "-z", "expert")
    assert "Retry of telegram 4" in shown
    assert "no telegram: the end octet is not 16" in shown
    assert _column(path, "profibus.damage")[9] == "check sequence"


def test_the_table_by_master_and_slave(tmp_path: Path) -> None:
    path = _course(tmp_path / "course.pcapng")
    title, head, row, sums, polls = tshark("-q", "-o", "profibus.table:TRUE", "-r", path).strip().splitlines()
    assert title == "PROFIBUS by master and slave"
    assert head.split() == [
        "master", "slave", "requests", "answers", "retries", "no", "answer", "late", "min", "us", "mean", "us", "max",
        "us",
    ]  # fmt: skip
    assert row.split() == ["2", "3", "4", "2", "1", "2", "1", "30.5", "30.5", "30.5"]
    assert sums == "12 telegrams, 3 of them tokens, 1 damaged, 0 answers without a request"
    assert polls == "1 requests FDL_Status (GAP), 0 of them answered"


def test_comments_in_a_file_never_reach_a_terminal_raw(tmp_path: Path) -> None:
    evil = "\x1b]0;owned\x07\x9b31m\x7f\x85\u202eevil\u2066\u200b\ufeff\u2028\u061c\U000e0001 lost\nx"
    path = write_capture(tmp_path / "a.pcapng", [Transmission(b"\xe5", 1_000, 500_000, evil)])
    for shown in (tshark("-r", path), tshark("-r", path, "-T", "fields", "-e", "profibus.text")):
        assert "lost?x" in shown
        assert not [sign for sign in shown.rstrip("\n") if unicodedata.category(sign) in ("Cc", "Cf", "Zl")]


def test_the_rate_may_come_from_the_user(tmp_path: Path) -> None:
    sent = [Transmission(POLL, 1_000_000, 0), Transmission(ANSWER, 1_000_000 + 220_000 + 30_000, 0)]
    path = write_capture(tmp_path / "a.pcapng", sent)
    assert _column(path, "profibus.response_time") == ["", ""]
    assert _column(path, "profibus.response_time", "-o", "profibus.baud:500000") == ["", "0.000030000"]
