"""The connector of the table ``[metrics]``: an HTTP server with ``/metrics``, ``/healthz`` and ``/readyz``."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from http import HTTPStatus
from typing import ClassVar, Final

from prometheus_client import generate_latest
from prometheus_client.core import Metric as Family
from prometheus_client.registry import Collector as OneFamily

from dpstack.bridge.connector import Connector, ConnectorState, Tell, product_version
from dpstack.bridge.metrics.collector import Collector
from dpstack.bridge.metrics.health import Health, liveness, readiness
from dpstack.bridge.metrics.http_server import Answer, HttpServer, Pace
from dpstack.plant.tree import Change, PlantTree
from dpstack.tcp_address import Listen, Origins, is_local, join
from dpstack.trace import Severity

#: s for which a text is given out again: the live stream of the connectors brings no news more often
FRESH_S: Final = 0.2
#: texts made a second in the mean, and at once: a flood of requests gets old ones
_MADE_PER_S: Final = 1.0
_MADE_AT_ONCE: Final = 5
#: series that are written at once: about 1 ms
_AT_ONCE: Final = 250


class MetricsConnector(Connector):
    """``listen``: the address of the server. See :class:`Collector` for the others."""

    name: ClassVar[str] = "metrics"

    def __init__(
        self,
        tree: PlantTree,
        tell: Tell,
        listen: Listen,
        *,
        connectors: Callable[[], Sequence[ConnectorState]] = tuple,
        bus_pid: Callable[[], int | None] = lambda: None,
        most_values: int | None = None,
    ) -> None:
        super().__init__(tree, tell)
        self.collector = Collector(
            tree, connectors=connectors, bus_pid=bus_pid, version=product_version(), most_values=most_values
        )
        #: (host, port) on which it listens, once it is open
        self.address: tuple[str, int] | None = None
        self._listen = listen
        self._server: HttpServer | None = None
        self._making: asyncio.Task[None] | None = None
        self._answer = Answer(HTTPStatus.OK, b"")
        self._answer_until = 0.0
        self._pace = Pace(_MADE_PER_S, _MADE_AT_ONCE)

    async def open(self) -> None:
        sockets = self._listen.sockets()
        host, port = sockets[0].getsockname()[:2]
        self.address = host, port
        local = is_local(sockets)
        self._server = HttpServer(
            {
                "/metrics": self._metrics,
                "/healthz": lambda: _health(liveness(self.tree)),
                "/readyz": lambda: _health(readiness(self.tree, self.collector.verdict)),
            },
            sockets,
            origins=Origins((), port, secure=False) if local else None,
            count=self._count,
            refused=self._refuse,
            fault=self._fault,
        )
        await self._server.begin()
        more = "" if local else "; other computers reach it, without TLS and password"
        self.tell(f"http://{join(host, port)}/metrics{more}", Severity.INFO if local else Severity.WARNING)

    def take(self, changes: Sequence[Change]) -> None:
        for line in self.collector.take(changes):
            self.tell(line, Severity.WARNING)

    async def serve(self) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            # behind a fault nobody changes the tree any more: its last values would look fresh
            if self._server is not None and not self.tree.has_ended:
                self._server.end()

    def close(self) -> None:
        if self._making is not None:
            self._making.cancel()
        if self._server is not None:
            self._server.end()

    def _count(self, status: HTTPStatus) -> None:
        self.collector.requests[status.value] += 1

    def _refuse(self) -> None:
        self.collector.refused += 1

    async def _metrics(self) -> Answer:
        """The text for Prometheus. All who ask within :data:`FRESH_S` get the same one, in a flood within a second."""
        now = asyncio.get_running_loop().time()
        if self._making is None and now >= self._answer_until and self._pace.wait_s(now) <= 0:
            self._pace.take(now)
            self._making = asyncio.create_task(self._make(), name="dpstack metrics: text")
        if self._making is not None:
            # it is made for all: a client that goes away ends only its own wait
            await asyncio.shield(self._making)
        return self._answer

    async def _make(self) -> None:
        try:
            self._answer = Answer(HTTPStatus.OK, await rendered(self.collector.families()))
        except Exception as error:
            self._answer = self._fault(error)
        finally:
            self._answer_until = asyncio.get_running_loop().time() + FRESH_S
            self._making = None

    def _fault(self, error: Exception) -> Answer:
        self.tell(f"a defect, please report it: {type(error).__name__}: {error}", Severity.ERROR)
        return Answer(HTTPStatus.INTERNAL_SERVER_ERROR, b"a defect, see the log of the run\n")


async def rendered(families: Sequence[Family]) -> bytes:
    """``families`` in the text format of Prometheus. Behind each one, and behind each :data:`_AT_ONCE` series, the loop
    goes on: it may drive a bus."""
    parts = []
    for family in families:
        samples = family.samples
        for first in range(0, len(samples), _AT_ONCE):
            family.samples = samples[first : first + _AT_ONCE]
            text = generate_latest(_One(family))
            # help and type stand before the first ones
            parts.append(text.split(b"\n", 2)[2] if first else text)
            await asyncio.sleep(0)
    return b"".join(parts)


class _One(OneFamily):
    def __init__(self, family: Family) -> None:
        self._family = family

    def collect(self) -> Iterator[Family]:
        yield self._family


async def _health(health: Health) -> Answer:
    status = HTTPStatus.OK if health.good else HTTPStatus.SERVICE_UNAVAILABLE
    return Answer(status, health.text.encode())
