"""A user of the link layer that asks station 3, and what that answers in literal octets."""

from __future__ import annotations

from typing import Final

from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.telegram import Req, Telegram

BAUD: Final = 500_000
ANSWER: Final = bytes.fromhex("68 0F 0F 68 02 03 08 00 00 00 00 00 00 00 00 00 00 00 00 0D 16")
SHORT: Final = bytes.fromhex("10 02 03 03 08 16")  # RS: the service is not activated


class Asker(LinkUser):
    """Asks station 3 ``often`` a token hold."""

    def __init__(self, often: int = 1) -> None:
        self.outcomes: list[Telegram | Failure] = []
        self._often = often
        self._left = 0

    def token_received(self, now: int) -> None:
        self._left = self._often

    def next_request(self, now: int, high_only: bool) -> Request | None:
        if not self._left:
            return None
        self._left -= 1
        return Request(3, Req.SRD_HIGH, bytes(12), patient=True)

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        self.outcomes.append(outcome)
