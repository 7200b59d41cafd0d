"""Listening on a port of its own: marked octets reach the transmissions with their place."""

from __future__ import annotations

import pytest
from fake_adapter import FakeDriver
from far_ends import PtyFarEnd, until

from dpstack.api.listen.listening import Listening
from dpstack.capture.transmission import Damage, Transmission
from dpstack.ports import termios2, tty

TOKEN = bytes.fromhex("DC 02 02")


@pytest.fixture
def adapter(monkeypatch: pytest.MonkeyPatch) -> PtyFarEnd:
    """The other end of a pty that looks like an adapter; it writes the marks of damaged octets itself, FF 00 x."""
    really = termios2.set_raw

    def marking(fd: int, baud: int | None, *, marks: bool) -> termios2.Applied:
        return really(fd, baud)._replace(parity=True, marks=marks)

    far = PtyFarEnd()
    FakeDriver(monkeypatch)
    monkeypatch.setattr(termios2, "set_raw", marking)
    monkeypatch.setattr(tty, "is_pty_path", lambda _name: False)
    return far


async def test_a_damaged_octet_is_where_it_was(adapter: PtyFarEnd) -> None:
    heard: list[Transmission] = []
    async with Listening(adapter.path, 500_000, heard.append) as listening:
        adapter.send(TOKEN + bytes.fromhex("10 05 02 FF 00 48 50 16") + TOKEN)
        await until(lambda: len(heard) == 3, "three transmissions")
        assert listening.line.source == "adapter"
        assert listening.line.damaged == "octets with a parity or framing error are marked at their place"
        assert listening.damage() == {"marked": 1}
    adapter.hang_up()
    first, damaged, last = heard
    assert (first.octets, last.octets) == (TOKEN, TOKEN)
    assert damaged.octets.hex() == "100502485016"
    assert damaged.damage == Damage.FCS | Damage.PARITY_OR_FRAMING
    assert damaged.note == "damaged by mark of the port: octet 4"
