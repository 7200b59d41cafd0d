"""A user of the link layer that asks station 3, and what that answers in literal octets."""

from __future__ import annotations

from typing import Final

from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.telegram import Req, Telegram

BAUD: Final = 500_000
ANSWER: Final = bytes.fromhex("68 0F 0F 68 02 03 08 00 00 00 00 00 00 00 00 00 00 00 00 0D 16")
SHORT: Final = bytes.fromhex("10 02 03 03 08 16")  # RS: the service is not activated


class Asker(LinkUser):
    """Asks station 3 once a token hold."""

    def __init__(self) -> None:
        self.outcomes: list[Telegram | Failure] = []
        self._asks = False

    def token_received(self, now: int) -> None:
        self._asks = True

    def next_request(self, now: int, high_only: bool) -> Request | None:
        asks, self._asks = self._asks, False
        return Request(3, Req.SRD_HIGH, bytes(12), patient=True) if asks else None

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        self.outcomes.append(outcome)
