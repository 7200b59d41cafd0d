"""Ports in the child of a fork."""

from __future__ import annotations

import asyncio
import os

import pytest
from far_ends import PtyFarEnd, TcpFarEnd

from dpstack.ports import open_port


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
