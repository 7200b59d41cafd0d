"""Search for the baud rate of a bus: listens at one rate after the other, and never sends."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from time import monotonic_ns
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from dpstack.api.config.config import Config
from dpstack.drivers.line.asyncio_runtime import AsyncioRuntime
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.line.port_latency import patience_of
from dpstack.drivers.line.rate import settle_ns_of
from dpstack.drivers.runtime import PortLost, Runtime
from dpstack.errors import BusError, ConfigError, PortError
from dpstack.fdl.baud_search import AutoBaud, BaudFound, BaudNotFound
from dpstack.ports import Port, open_port
from dpstack.ports.base import VIRTUAL
from dpstack.trace import Event
from dpstack.units import BAUD_RATES, NEVER, ns_to_s, s_to_ns

if TYPE_CHECKING:
    from dpstack.capture.transmission import Transmission
    from dpstack.sim.world import World

#: time of silence (s) that ends the search
SILENCE_S: Final = 5.0
#: Longest time (s) to listen at the rate found for evidence of PROFIBUS. At 9600 bit/s a bus has some ten telegrams
#: in each of them (our choice).
NAMING_S: Final = 2.0
#: time of noise (s), octets without a telegram, that ends the search
_NOISE_S: Final = 20.0
#: advice after noise, and after silence
_ADVICE: Final = (
    "or give the rate, for instance baud = 500000",
    "a master that is alone on its bus must give the rate, for instance baud = 500000",
)


class BaudReport(Struct, frozen=True, kw_only=True):
    """Result of a search. ``baud`` in bit/s, None when no telegram was recognised; ``seconds`` of listening.

    ``confidence``: "checked" (telegrams with check sum) or "token" (the same token three times).
    """

    #: baud rate in bit/s; None when no telegram was recognised
    baud: int | None
    #: time of listening in seconds
    seconds: float
    #: telegrams received in a row, without odd octets between them
    telegrams: int = 0
    confidence: str | None = None
    #: why no rate was found: "silence" or "noise"; None when one was
    missing: str | None = None
    #: result for people
    text: str = ""
    #: the telegrams show that it is PROFIBUS (docs/reference/protocol.md#is-it-profibus); None: nobody looked
    profibus: bool | None = None
    #: reason for ``profibus``, for people
    evidence: str = ""

    def as_dict(self) -> dict[str, object]:
        """The JSON of ``dpstack baud``."""
        line: dict[str, object] = {"baud": self.baud, "seconds": round(self.seconds, 3), "telegrams": self.telegrams}
        if self.baud is None:
            return line | {"reason": self.missing, "text": self.text}
        return line | {"confidence": self.confidence, "profibus": self.profibus}


async def find_baud(
    port: str, *, timeout: float | None = SILENCE_S, silence: float | None = None, naming: float = NAMING_S
) -> BaudReport:
    """Listen at ``port``, without sending, for at most ``timeout`` seconds, or until ``silence`` seconds of silence.

    None: no limit. Once the rate is found, listen for at most ``naming`` seconds more until there is evidence that the
    bus is PROFIBUS; 0: do not. Raises ConfigError for a port that has no wire; PortError.
    """
    require_wire(port)
    # every adapter supports the slowest rate: a port that does not open at it does not exist
    line = open_port(port, BAUD_RATES[0], listen=True)
    limit_ns, silence_ns = _limit(timeout), _limit(silence)
    if not naming:
        return _report(await search_baud(line, limit_ns=limit_ns, silence_ns=silence_ns))
    from dpstack.capture.listener import Listener  # here, because a bus with a given rate needs none of them
    from dpstack.monitor.evidence import Naming

    evidence, named = Naming(), asyncio.Event()

    def add(one: Transmission) -> None:
        evidence.add(one)
        if evidence.is_profibus:
            named.set()

    async def wait_for_the_name() -> None:
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(named.wait(), naming)

    listener = Listener(monotonic_ns(), add, limit_ns=limit_ns, silence_ns=silence_ns, **_delays(line))
    make_runtime = partial(AsyncioRuntime, line, listener, echo=Echo.OFF)
    report = _report(await _run_search(line.name, make_runtime, wait_for_the_name))
    if report.baud is None:
        return report
    return replace(report, profibus=evidence.is_profibus, evidence=evidence.text)


def require_wire(port: str) -> None:
    """Raises ConfigError for a port that this process makes itself: no other master can be on it."""
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


async def search_baud(
    port: Port, *, silence_ns: int = NEVER, limit_ns: int = NEVER, rates: Sequence[int] = BAUD_RATES
) -> BaudFound | BaudNotFound:
    """Open ``port``, listen until the search (:class:`AutoBaud`) has a result, and close it.

    It skips rates that the port cannot do. Raises PortError if the port cannot be opened, vanishes, or is of a kind
    whose rate cannot be changed; ConfigError if it can do none of ``rates``.
    """
    search = AutoBaud(monotonic_ns(), rates=rates, silence_ns=silence_ns, limit_ns=limit_ns, **_delays(port))
    return await _run_search(port.name, partial(AsyncioRuntime, port, search, echo=Echo.OFF))


def _delays(port: Port) -> dict[str, int]:
    return {"slack_ns": patience_of(port).known_ns, "settle_ns": settle_ns_of(port)}


async def _run_search(
    where: str, make_runtime: Callable[..., Runtime], then: Callable[[], Awaitable[None]] | None = None
) -> BaudFound | BaudNotFound:
    """Run a search until it has a result, and ``then`` if the rate was found. Raises PortError, and any exception of
    the machine."""
    result: asyncio.Future[BaudFound | BaudNotFound] = asyncio.get_running_loop().create_future()

    def on_events(events: list[Event]) -> None:
        for event in events:
            if result.done():
                return
            match event:
                case BaudFound() | BaudNotFound():
                    result.set_result(event)
                case PortLost(reason=reason):
                    result.set_exception(PortError(f"{where} vanished while listening: {reason}"))

    def on_failure(error: Exception) -> None:
        if not result.done():
            result.set_exception(error)

    runtime = make_runtime(on_events, on_failure=on_failure)
    await runtime.open()
    try:
        found = await result
        if then is not None and isinstance(found, BaudFound):
            await then()
        return found
    finally:
        await runtime.close()


async def rate_of(config: Config, world: World | None = None) -> BaudReport:
    """Search the baud rate for ``config``, on its port or in a simulated ``world``.

    Raises BusError when no rate is recognised; ConfigError, PortError.
    """
    if world is None:
        where = config.port
        report = await find_baud(where, timeout=_NOISE_S, silence=SILENCE_S, naming=0)
    else:
        where = "the simulated bus"
        search = AutoBaud(world.now, limit_ns=s_to_ns(_NOISE_S), silence_ns=s_to_ns(SILENCE_S))
        from dpstack.drivers.virtual.runtime import VirtualRuntime

        report = _report(await _run_search(where, partial(VirtualRuntime, world, search)))
    if report.baud is None:
        raise BusError(f"{where}: the baud rate was not found: {report.text}; {_ADVICE[report.missing == 'silence']}")
    return report
