"""Baud rate search by listening only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.api.config.config import VIRTUAL, Config
from dpstack.drivers.line.baud_search import search_baud, search_in
from dpstack.errors import BusError, ConfigError
from dpstack.fdl.baud_search import BaudFound, BaudNotFound
from dpstack.ports import open_port
from dpstack.sim.world import World
from dpstack.units import BAUD_RATES, NEVER, ns_to_s, s_to_ns

#: time of silence (s) that ends the search
SILENCE_S: Final = 5.0
#: time of noise (s), octets without a telegram, that ends the search
_NOISE_S: Final = 20.0
#: advice after noise, after silence
_GIVE: Final = (
    "or give the rate, for instance baud = 500000",
    "a master that is alone on its bus must give the rate, for instance baud = 500000",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class BaudReport:
    """Result of a search. ``baud`` in bit/s, None when no telegram was recognised; ``seconds`` of listening.

    ``telegrams``: heard in a row, with no octet left over between. ``confidence``: "checked" (telegrams with check
    sum) or "token" (the same token three times). ``missing``: "silence" or "noise". ``text``: the same for people.
    """

    baud: int | None
    seconds: float
    telegrams: int = 0
    confidence: str | None = None
    missing: str | None = None
    text: str = ""

    def as_dict(self) -> dict[str, object]:
        """The JSON of ``dpstack baud``."""
        line: dict[str, object] = {"baud": self.baud, "seconds": round(self.seconds, 3), "telegrams": self.telegrams}
        if self.baud is None:
            return line | {"reason": self.missing, "text": self.text}
        return line | {"confidence": self.confidence}


async def find_baud(port: str, *, timeout: float | None = SILENCE_S, silence: float | None = None) -> BaudReport:
    """Listen at ``port`` (nothing is sent) for at most ``timeout`` seconds, or ``silence`` seconds of silence.

    None is no limit. Raises ConfigError for a port that has no wire; PortError.
    """
    need_wire(port)
    # every adapter supports the slowest rate: a port that does not open at it does not exist
    line = open_port(port, BAUD_RATES[0])
    return _report(await search_baud(line, limit_ns=_limit(timeout), silence_ns=_limit(silence)))


def need_wire(port: str) -> None:
    """Raises ConfigError for a port that this process makes: no master can be on it."""
    if port in (VIRTUAL, "pty"):
        raise ConfigError(f'port "{port}": nobody else is on it who could be listened to; give the rate')


def _report(result: BaudFound | BaudNotFound) -> BaudReport:
    seconds = ns_to_s(result.listened_ns)
    if isinstance(result, BaudFound):
        return BaudReport(
            baud=result.baud,
            seconds=seconds,
            telegrams=result.telegrams,
            confidence=result.confidence.value,
            text=result.text,
        )
    return BaudReport(baud=None, seconds=seconds, missing=result.why.value, text=result.text)


def _limit(seconds: float | None) -> int:
    return NEVER if seconds is None else s_to_ns(seconds)


async def rate_of(config: Config, world: World | None = None) -> BaudReport:
    """The rate of the bus that ``config`` leaves to be found ("auto"), on its port or in a simulated ``world``.

    Raises BusError when none is recognised; ConfigError, PortError.
    """
    if world is None:
        where = config.port
        report = await find_baud(where, timeout=_NOISE_S, silence=SILENCE_S)
    else:
        where = "the simulated bus"
        report = _report(await search_in(world, limit_ns=s_to_ns(_NOISE_S), silence_ns=s_to_ns(SILENCE_S)))
    if report.baud is None:
        raise BusError(f"{where}: the baud rate was not found: {report.text}; {_GIVE[report.missing == 'silence']}")
    return report
