"""A line on which a station sends without end, as fast as a pty takes it: the run still hears orders and signals."""

from __future__ import annotations

import contextlib
import os
import random
import select
import signal
import threading
from pathlib import Path

import pytest
from programs import Program, wait_for_socket

from dpstack.api.control.client import connect

CONFIG = """
[bus]
port = "{port}"
baud = 500000

[[slave]]
name = "raw"
address = 9
ident = 0x1234
config = "20 10"
"""


class Flood(threading.Thread):
    """Writes ``octets`` to the descriptor again and again, and reads what comes back; ``end()`` joins it."""

    def __init__(self, fd: int, octets: bytes) -> None:
        super().__init__(daemon=True)
        os.set_blocking(fd, False)
        self._fd, self._octets, self._over = fd, octets * (65_536 // len(octets)), threading.Event()

    def run(self) -> None:
        while not self._over.is_set():
            with contextlib.suppress(BlockingIOError):
                os.read(self._fd, 65_536)
            try:
                os.write(self._fd, self._octets)
            except BlockingIOError:
                select.select((), (self._fd,), (), 0.05)

    def end(self) -> None:
        self._over.set()
        self.join()


@pytest.mark.soak
@pytest.mark.parametrize(
    "octets", [b"\x55", b"\xe5", b"\x10", random.Random(2).randbytes(65_536)], ids=["55", "e5", "10", "random"]
)
def test_a_run_on_a_flooded_line_answers_and_ends(tmp_path: Path, octets: bytes) -> None:
    far, near = os.openpty()
    port = Path(os.ttyname(near))
    config = tmp_path / "plant.toml"
    config.write_text(CONFIG.format(port=port))
    run = Program(tmp_path, "run", str(config), "--driver", "asyncio", "--json")
    flood = Flood(far, octets)
    try:
        run.wait_for('"mode":"operate"')
        wait_for_socket(port)
        flood.start()
        for _ in range(5):
            with connect(str(port)) as client:
                assert client.call("status")
        run.process.send_signal(signal.SIGINT)
        assert run.process.wait(60) == 1
        assert '"event":"summary"' in run.out
    finally:
        run.process.kill()
        run.process.wait()
        flood.end()
        os.close(far)
        os.close(near)
