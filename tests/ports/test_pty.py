"""A pty made here: openers come and go; ports in the child of a fork."""

from __future__ import annotations

import asyncio
import os
import termios

import pytest
from far_ends import PtyFarEnd, TcpFarEnd, open_slave, set_rate, until

from dpstack.ports import open_port


async def test_openers_come_and_go_without_a_loss() -> None:
    port = open_port("pty", 500_000)
    await port.open()
    got: list[bytes] = []
    lost: list[str] = []
    port.attach(asyncio.get_running_loop(), got.append, lost.append)
    assert not port.write(b"nobody is there")
    assert port.dropped == 1
    for _ in range(3):
        got.clear()
        far = open_slave(port.name)
        far.send(b"hello")
        await until(lambda: b"".join(got) == b"hello", "the opener's octets")
        assert port.write(b"answer")
        assert await far.recv(6) == b"answer"
        assert port.write(b"unread")
        far.hang_up()
        await until(lambda: not port.write(b"x"), "the departure")
    assert not lost
    port.close()


async def test_a_silent_opener_is_noticed_at_the_next_write_and_finds_nothing_old() -> None:
    port = open_port("pty", 500_000)
    await port.open()
    port.attach(asyncio.get_running_loop(), lambda _chunk: None, lambda _reason: None)
    far = open_slave(port.name)
    assert port.write(b"unread")
    far.hang_up()
    await until(lambda: not port.write(b"x"), "the departure")
    fd = os.open(port.name, os.O_RDWR | os.O_NOCTTY)  # sets nothing, flushes nothing
    assert termios.tcgetattr(fd)[3] == 0  # raw from the beginning
    assert port.write(b"fresh")
    assert os.read(fd, 100) == b"fresh"
    os.close(fd)
    port.close()


async def test_the_openers_rate_is_seen() -> None:
    port = open_port("pty", 500_000)
    assert port.line_baud() is None
    await port.open()
    far = open_slave(port.name)
    assert port.line_baud() is None
    set_rate(far.fd, termios.B1500000)
    assert port.line_baud() == 1_500_000
    far.hang_up()
    port.close()
    assert port.line_baud() is None


@pytest.mark.parametrize("kind", ["tty", "pty", "socket"])
async def test_a_forked_child_lets_go_without_touching_loop_or_line(kind: str) -> None:
    """As in the child: its copy of the descriptor is closed, the loop's reader stays (the loop is the parent's)."""
    far = TcpFarEnd() if kind == "socket" else PtyFarEnd()
    port = open_port("pty" if kind == "pty" else far.path, 500_000)
    await port.open()
    loop = asyncio.get_running_loop()
    port.attach(loop, lambda _octets: None, lambda _reason: None)
    fd = port.fd
    assert fd is not None
    port.release_after_fork()
    assert port.fd is None
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(fd)
    assert not port.write(b"\xdc\x02\x02")
    port.close()
    loop.remove_reader(fd)
    if isinstance(far, TcpFarEnd):
        far.shut()
    else:
        far.hang_up()
