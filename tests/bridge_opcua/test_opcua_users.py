"""Users, certificates and history of OPC UA without a server."""

from __future__ import annotations

import asyncio
import itertools
import re
import subprocess
import sys
from collections import deque
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from api_kit import in_virtual_time
from asyncua import ua
from opcua_rig import make_certificate

from dpstack.bridge.opcua.certificate import (
    application_uri,
    client_fault,
    own_certificate,
    own_remarks,
    read_certificate,
    read_trusted,
)
from dpstack.bridge.opcua.history import BoundedHistory
from dpstack.bridge.opcua.lateness import Lateness
from dpstack.bridge.opcua.users import Account, Users, hash_password, is_right, main, read_users
from dpstack.errors import ConfigError

NOW = datetime(2026, 11, 23, 12, tzinfo=UTC)
LAST = NOW + timedelta(days=3650)
#: rsaEncryption in DER
_RSA = bytes.fromhex("06092a864886f70d010101")


def test_the_command_makes_a_line_that_the_server_reads(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "dpstack.bridge.opcua.users", "anna", "control"]
    made = subprocess.run(command, input="correct horse\n", capture_output=True, text=True, check=True).stdout
    path = tmp_path / "users"
    path.write_text(f"# plant 1\n\n{made}")
    path.chmod(0o600)
    (found,) = read_users(path).values()
    assert (found.name, found.control) == ("anna", True)
    assert is_right("correct horse", found.hash)
    assert not is_right("correct horse ", found.hash)
    assert "correct" not in made


@pytest.mark.parametrize("end", [KeyboardInterrupt, EOFError])
def test_ctrl_c_and_the_end_of_the_terminal_at_the_password_end_the_command_in_one_line(
    end: type[BaseException], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(prompt: str) -> str:
        raise end

    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr("getpass.getpass", interrupted)
    assert main(["anna", "control"]) == 130
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.strip() == "no password was typed: there is no line for this user"


def test_a_file_that_others_can_read_or_that_has_no_user_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "users"
    hashed = hash_password("a password")
    for mode, text, why in (
        (0o644, f"anna read {hashed}\n", "others can read or change it"),
        (0o600, "# nobody\n", "has no user"),
        (0o600, f"anna {hashed}\n", "is not NAME read|control HASH"),
        (0o600, f"anna read {hashed}\nanna read {hashed}\n", ":2: anna stands there already"),
        (0o600, "anna read scrypt$1$1$1$AA==$AA==\n", "parameters out of range"),
        (0o600, "anna read password\n", "no hash by scrypt"),
    ):
        path.write_text(text)
        path.chmod(mode)
        with pytest.raises(ConfigError) as error:
            read_users(path)
        assert why in str(error.value)
        assert hashed not in str(error.value)
    with pytest.raises(
        ConfigError, match=r"none: there is no such file; write one line for each user, made by `python -m"
    ):
        read_users(tmp_path / "none")


@in_virtual_time
async def test_wrong_passwords_wait_longer_and_longer() -> None:
    loop = asyncio.get_running_loop()
    users = Users({"anna": Account("anna", True, hash_password("right one"))})
    begin = loop.time()
    for name in ("anna", "nobody", "anna"):
        assert await users.verify(name, "wrong one", "10.0.0.1") is None
    assert await users.verify("anna", "right one", "10.0.0.1") is not None
    assert loop.time() - begin >= 0.5 + 1.0 + 2.0
    many = await asyncio.gather(*(users.verify("anna", "wrong one", "10.0.0.2") for _ in range(10)))
    assert many == [None] * 10


@in_virtual_time
async def test_wrong_passwords_of_one_address_hold_up_no_other() -> None:
    loop = asyncio.get_running_loop()
    users = Users({"anna": Account("anna", True, hash_password("right one"))})
    wrong = [asyncio.ensure_future(users.verify("anna", "wrong one", "10.0.0.2")) for _ in range(8)]
    await asyncio.sleep(0)
    begin = loop.time()
    assert await users.verify("anna", "right one", "10.0.0.1") is not None
    assert loop.time() - begin < 3.5  # those of the other address wait so long
    assert await asyncio.gather(*wrong) == [None] * 8


def test_the_certificate_is_made_once_and_judged_by_its_dates(tmp_path: Path) -> None:
    cert, key = tmp_path / "own" / "c.der", tmp_path / "own" / "k.pem"
    first, _ = own_certificate(cert, key, uri="urn:x", hosts=["here", "127.0.0.1"], now=NOW)
    again, _ = own_certificate(cert, key, uri="urn:x", hosts=["other"], now=NOW)
    assert first == again
    assert key.stat().st_mode & 0o777 == 0o600
    for uri, when, why in (
        ("urn:y", NOW, r"c\.der: is for urn:x, not for urn:y, the name of this server; remove it and .*k\.pem"),
        ("urn:x", NOW + timedelta(days=4000), rf"c\.der: has expired on {LAST:%Y-%m-%d}.*; remove it and .*k\.pem"),
        ("urn:x", NOW - timedelta(days=2), rf"c\.der: is not valid before {NOW:%Y-%m-}.*: set its clock, or remove"),
    ):
        with pytest.raises(ConfigError, match=why):
            own_certificate(cert, key, uri=uri, hosts=[], now=when)
    assert own_remarks(first, cert, key, "127.0.0.1", NOW) == own_remarks(first, cert, key, "Here", NOW) == []
    soon, elsewhere = own_remarks(first, cert, key, "10.0.0.1", LAST - timedelta(days=30))
    assert re.fullmatch(rf".*c\.der: expires on {LAST:%Y-%m-%d}.*, in 30 days: .* remove it and .*k\.pem .*", soon)
    assert "c.der: is for here, 127.0.0.1, not for 10.0.0.1: clients may refuse it" in elsewhere
    key.chmod(0o640)
    with pytest.raises(ConfigError, match=r"k\.pem: others can read or change it: `chmod 600 .*k\.pem`"):
        own_certificate(cert, key, uri="urn:x", hosts=[], now=NOW)
    key.unlink()
    with pytest.raises(ConfigError, match="is missing beside"):
        own_certificate(cert, key, uri="urn:x", hosts=[], now=NOW)


def test_a_name_that_is_not_ascii_is_escaped_in_the_certificate(tmp_path: Path) -> None:
    uri = application_uri("h\u00f6he", "Pr\u00fcfstand 1")
    assert uri == "urn:h%C3%B6he:dpstack:Pr%C3%BCfstand%201"
    found, _ = own_certificate(tmp_path / "c", tmp_path / "k", uri=uri, hosts=["h\u00f6he", "x"], now=NOW)
    assert own_remarks(found, tmp_path / "c", tmp_path / "k", "x", NOW) == []


def test_a_client_is_judged_by_dates_and_the_trusted_directory(tmp_path: Path) -> None:
    path, _ = make_certificate(tmp_path, 30)
    der = path.read_bytes()
    now = read_certificate(path).not_valid_after_utc - timedelta(days=1)
    (tmp_path / "trusted").mkdir()
    assert client_fault(der, None, now) is None
    assert client_fault(der, None, now + timedelta(days=2)) == 0x80140000  # BadCertificateTimeInvalid
    assert client_fault(der, read_trusted(tmp_path / "trusted"), now) == 0x801A0000  # BadCertificateUntrusted
    (tmp_path / "trusted" / "one.der").write_bytes(der)
    assert client_fault(der, read_trusted(tmp_path / "trusted"), now) is None
    assert client_fault(b"\x30\x00", None, now) == 0x80120000  # BadCertificateInvalid
    # version 8 of X.509, and an RSA key whose algorithm nobody knows
    for before, behind in ((b"\xa0\x03\x02\x01\x02", b"\xa0\x03\x02\x01\x07"), (_RSA, _RSA[:-1] + b"\x7f")):
        assert before in der
        assert client_fault(der.replace(before, behind), None, now) == 0x80120000


def at(seconds: float) -> datetime:
    return NOW + timedelta(seconds=seconds)


def numbers(found: list[ua.DataValue]) -> list[object]:
    return [None if one.Value is None else one.Value.Value for one in found]


def test_the_history_has_one_bound_over_all_values_and_an_hour() -> None:
    history = BoundedHistory(3600.0, 100)
    nodes = [ua.NodeId(f"slave/{number}/x", 2) for number in range(10)]
    for number in range(300):
        history.keep(nodes[number % 10], ua.DataValue(ua.Variant(number), SourceTimestamp=at(number)), at(number))
    assert (len(history), history.dropped) == (100, 200)
    found, more = history.read(nodes[3], NOW, None)
    assert (numbers(found), more) == (list(range(203, 300, 10)), None)
    for start, end, courses in (
        (None, at(299), [[293, 283, 273, 263], [253, 243, 233, 223], [213, 203]]),
        (NOW, at(299), [[203, 213, 223, 233], [243, 253, 263, 273], [283, 293]]),
        (at(260), NOW, [[253, 243, 233, 223], [213, 203]]),
    ):
        read, point = [], None
        for _ in courses:
            found, point = history.read(nodes[3], start, end, 4, point=point)
            read.append(numbers(found))
        assert (read, point) == (courses, None)
    # the values right before and behind; where there is none, a status code says so
    found, _ = history.read(nodes[3], at(220), at(240), bounds=True)
    assert numbers(found) == [213, 223, 233, 243]
    found, _ = history.read(nodes[3], at(290), at(400), bounds=True)
    assert numbers(found) == [283, 293, None]
    assert found[-1].StatusCode is not None
    assert found[-1].StatusCode.value == 0x80D70000  # BadBoundNotFound
    history.keep(nodes[0], ua.DataValue(ua.Variant(1), SourceTimestamp=at(3850)), at(3850))
    assert len(history) == 51


def test_parts_of_a_history_are_the_whole_one() -> None:
    """Values at 0, 10, 10, 20 ... s, read from and to each time, forwards and backwards, with bounds and without."""
    history, node = BoundedHistory(3600.0, 100), ua.NodeId("x", 2)
    kept = [(10 * (number // 2 + number % 2), number) for number in range(9)]
    for seconds, number in kept:
        history.keep(node, ua.DataValue(ua.Variant(number), SourceTimestamp=at(seconds)), at(seconds))
    times = range(-5, 60, 5)
    for start, end, bounds in itertools.product(times, times, (False, True)):
        low, high = min(start, end), max(start, end)
        wanted: list[object] = [number for seconds, number in kept if low <= seconds <= high]
        inside = {seconds for seconds, _ in kept if low <= seconds <= high}
        if bounds and low not in inside:
            wanted.insert(0, max((number for seconds, number in kept if seconds < low), default=None))
        if bounds and high not in inside:
            wanted.append(min((number for seconds, number in kept if seconds > high), default=None))
        if start > end:
            wanted.reverse()
        for most in (1, 2, 3, 0):
            read, point = history.read(node, at(start), at(end), most, bounds=bounds)
            while point is not None:
                more, point = history.read(node, at(start), at(end), most, bounds=bounds, point=point)
                read += more
            assert numbers(read) == wanted, (start, end, bounds, most)


def test_a_long_history_is_not_walked_through_for_each_answer() -> None:
    history, node = BoundedHistory(1e6, 20_000), ua.NodeId("x", 2)
    for number in range(20_000):
        history.keep(node, ua.DataValue(ua.Variant(number), SourceTimestamp=at(number)), at(number))
    looked: list[object] = []

    class Counted(deque[object]):
        def __iter__(self) -> Iterator[object]:
            raise AssertionError("a walk through all values")

        def __getitem__(self, place: Any) -> Any:
            looked.append(place)
            return super().__getitem__(place)

    history._of[node] = Counted(list(history._of[node]))  # type: ignore[assignment]
    assert numbers(history.read(node, at(9000), at(12_000), 10)[0]) == list(range(9000, 9010))
    assert len(looked) < 100


def test_the_history_tells_since_when_a_value_was_not_good_and_keeps_values_of_one_time() -> None:
    history, node = BoundedHistory(3600.0, 100), ua.NodeId("x", 2)
    stale = ua.StatusCode(0x408F0000)
    for seconds, status in ((5, ua.StatusCode()), (5, ua.StatusCode()), (8, stale), (9, stale), (5, ua.StatusCode())):
        history.keep(node, ua.DataValue(ua.Variant(7), status, at(5)), at(seconds), is_old=status is stale)
    found, more = history.read(node, at(5), None, 1)
    rest, _ = history.read(node, at(5), None, point=more)
    assert [(one.SourceTimestamp, one.StatusCode.value if one.StatusCode else 0) for one in found + rest] == [
        (at(5), 0), (at(8), 0x408F0000), (at(8), 0)
    ]  # fmt: skip
    # a bad value is of its moment, and keeps its number
    bad = ua.DataValue(ua.Variant(3276), ua.StatusCode(0x808C0000), at(11))
    for seconds in (12, 13):
        history.keep(node, bad, at(seconds))
    [*_, last] = history.read(node, at(5), None)[0]
    assert (last.SourceTimestamp, last.Value.Value, last.StatusCode.value) == (at(11), 3276, 0x808C0000)
    assert len(history) == 4


def test_a_connection_that_was_cut_delivers_late_whatever_the_clocks() -> None:
    lateness = Lateness()
    late = [lateness.of(at(sent), came) for sent, came in ((0, 1000.5), (1, 1001.2), (2, 1002.3), (3, 1063.2))]
    assert late == pytest.approx([0, 0, 0.1, 60 - 2e-3 - 0.06], abs=0.05)
    assert lateness.of(None, 1064.0) == lateness.of(datetime(1601, 1, 1, tzinfo=UTC), 1064.0) == 0.0
