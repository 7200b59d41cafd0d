"""A pty at whose other end a bus sends the same round of octets again and again, for stations that only listen."""

from __future__ import annotations

import contextlib
import os
import signal
import threading

from far_ends import PtyFarEnd

TOKEN = bytes.fromhex("DC 02 02")
REQUEST = bytes.fromhex("68 05 05 68 83 82 6D 3C 3E EC 16")
ANSWER = bytes.fromhex("68 0B 0B 68 82 83 08 3E 3C 02 05 00 FF 12 34 D3 16")
ROUND = TOKEN + REQUEST + ANSWER


class SpeakingPty(PtyFarEnd):
    """``octets`` are sent every 2 ms to whoever has ``path`` open; ``heard``: the octets sent to this end.

    After ``stop_after`` rounds that could be heard it ends the command with a signal.
    """

    stop_after = 0

    def __init__(self, octets: bytes = ROUND) -> None:
        super().__init__()
        self.octets = octets
        self.heard = b""
        self.rounds = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._send)
        self._thread.start()

    def _send(self) -> None:
        while not self._ended.wait(0.002):
            with contextlib.suppress(BlockingIOError):  # nobody reads yet
                os.write(self.fd, self.octets)
            with contextlib.suppress(OSError):  # nobody has it open
                self.heard += self.take()
                self.rounds += 1
                if self.rounds == self.stop_after:
                    os.kill(os.getpid(), signal.SIGTERM)

    def end(self) -> None:
        self._ended.set()
        self._thread.join()
        self.hang_up()
