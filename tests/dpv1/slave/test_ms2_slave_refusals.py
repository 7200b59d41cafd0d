"""Connections of class 2 that a slave refuses: by its device, by the length; Aborts of its application."""

from __future__ import annotations

import pytest
from octet_class2 import ABORT_REQUEST, INITIATE, OPENED, RS, SC
from octet_wire import MS
from slave_kit import Recorder

from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.resource_manager import ms2_of
from dpstack.errors import ConfigError, RecordRefused, UsageError
from tests.dpv1.ms2_slave_kit import READ, Slave


class Picky(Recorder):
    """A device that opens connections for the profile 0x1234 only, and fails over 0x9999; its records never answer."""

    def __init__(self, longest: int = 244) -> None:
        super().__init__()
        self.ms2_max_initiate = longest
        self.dropped = 0

    def initiate(self, master: int, wanted: InitiateReq) -> None:
        if wanted.profile_ident == 0x9999:
            raise ZeroDivisionError("no such profile")
        if wanted.profile_ident != 0x1234:
            raise RecordRefused(0xB6, master)

    def ask(self, request: RecordRequest) -> None:
        request.abandoned = self.drop

    def drop(self) -> None:
        self.dropped += 1


class PickySlave(Slave):
    """Slave 8 with a picky device, and a master of class 2."""

    def __init__(self, longest: int = 244) -> None:
        self.picky = Picky(longest)
        super().__init__(self.picky, count=1, device=self.picky)

    def connect(self) -> int:
        """The server SAP of a connection for the profile 0x1234."""
        sap = self.master.initiate(initiate(0x1234))
        assert self.master.ask(sap) == OPENED
        return sap


def initiate(profile: int, extra: str = "") -> str:
    """For ``profile``; ``extra``: network address and MAC of the source."""
    kind = f"01 {2 + len(bytes.fromhex(extra)):02X}" if extra else "00 02"
    return f"57 00 00 00 00 64 01 00 00 00 {profile:04X} {kind} 00 02 00 00 {extra} 00 00"


@pytest.mark.parametrize(
    ("profile", "answer", "told"),
    [
        (0, "D7 80 B6 01", "Initiate of master 1 refused: its function: "),
        (
            0x9999,
            "D7 80 C3 00",
            "Initiate of master 1 refused: its function failed (ZeroDivisionError: no such profile)",
        ),
    ],
)
def test_a_device_refuses_initiate_by_a_negative_response(profile: int, answer: str, told: str) -> None:
    slave = PickySlave()
    sap = slave.master.initiate(initiate(profile))
    assert ms2_of(slave.app).connections == ()
    assert slave.master.ask(sap) == answer
    assert slave.master.ask(sap) == RS
    (text,) = slave.texts()
    assert text.startswith(told)
    assert slave.app.stats.connections == 0
    slave.connect()
    assert slave.picky.calls == []


def test_an_initiate_that_is_too_long() -> None:
    slave = PickySlave(longest=27)
    longer = initiate(0x1234, "00 01 02 03 04 05 06 07")
    assert len(bytes.fromhex(longer)) == 28
    sap = slave.master.initiate(longer)
    assert slave.master.ask(sap) == ABORT_REQUEST
    (text,) = slave.texts()
    assert "Initiate of 28 octets, 27 are possible (Max_Initiate_PDU_Length)" in text
    slave.picky.ms2_max_initiate = 28
    sap = slave.master.initiate(longer)
    assert slave.master.ask(sap)[:2] == "57"


@pytest.mark.parametrize("longest", [19, 245])
def test_impossible_lengths_of_initiate(longest: int) -> None:
    with pytest.raises(ConfigError, match="ms2_max_initiate"):
        PickySlave(longest)


@pytest.mark.parametrize("step", ["opened", "working"])
@pytest.mark.parametrize("reason", [0, 15])
def test_the_application_aborts(step: str, reason: int) -> None:
    """Its master fetches the Abort; who works at a service is told; then there is room again."""
    slave = PickySlave()
    sap = slave.connect()
    if step == "working":
        assert slave.master.ask(sap, READ) == SC
    ms2_of(slave.app).abort(sap, reason, slave.wire.now)
    assert ms2_of(slave.app).connections == ()
    assert slave.picky.dropped == (step == "working")
    assert slave.master.ask(sap) == f"58 00 2{reason:X}"
    assert slave.master.ask(sap) == RS
    assert slave.texts()[-1].endswith(f"services: it was aborted here (reason {reason})")
    assert ms2_of(slave.app).free == 1
    with pytest.raises(UsageError, match=f"no open class 2 connection at server SAP {sap}; see connections"):
        ms2_of(slave.app).abort(sap, 0, slave.wire.now)


def test_an_abort_that_is_not_fetched_frees_the_connection() -> None:
    slave = PickySlave()
    sap = slave.connect()
    with pytest.raises(UsageError, match=r"an Abort has no reason 16: 0\.\.15"):
        ms2_of(slave.app).abort(sap, 16, slave.wire.now)
    ms2_of(slave.app).abort(sap, 0, slave.wire.now)
    with pytest.raises(UsageError, match="no open class 2 connection"):
        ms2_of(slave.app).abort(sap, 0, slave.wire.now)
    slave.wire.pass_time(2_001 * MS)
    assert slave.master.ask(sap) == RS
    assert slave.master.initiate(INITIATE) == sap
