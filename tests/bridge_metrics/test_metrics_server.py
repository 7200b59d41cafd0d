"""The HTTP server of the metrics over real sockets: right requests, hostile ones, a port that is taken."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import http.client
import random
import socket
import struct
from asyncio.selector_events import _SelectorSocketTransport  # type: ignore[attr-defined]
from collections.abc import AsyncIterator, Awaitable, Callable
from http import HTTPStatus

import pytest
from far_ends import beside, until
from metrics_kit import FINE, Bench, ask, plant, read, request, snapshot

from dpstack.bridge.metrics import connector as metrics_connector
from dpstack.bridge.metrics import http_server
from dpstack.bridge.metrics.connector import MetricsConnector
from dpstack.bridge.metrics.http_server import MOST_CONNECTIONS, MOST_OCTETS, MOST_OF_ONE, Answer, Pace
from dpstack.errors import PortError
from dpstack.tcp_address import Listen


@contextlib.asynccontextmanager
async def serving() -> AsyncIterator[tuple[MetricsConnector, int]]:
    connector = Bench(plant("valves"), snapshot(1.0, FINE)).connector
    await connector.open()
    try:
        assert connector.address is not None
        yield connector, connector.address[1]
    finally:
        connector.close()


def served(test: Callable[[MetricsConnector, int], Awaitable[None]]) -> None:
    async def run() -> None:
        async with serving() as (connector, port):
            await test(connector, port)

    asyncio.run(run())


def count_pages(connector: MetricsConnector) -> list[int]:
    """A list that grows with each page that is made."""
    made: list[int] = []
    families = connector.collector.families

    def counted() -> object:
        made.append(1)
        return families()

    connector.collector.families = counted  # type: ignore[method-assign,assignment]
    return made


def status_of(answer: bytes) -> int:
    assert answer.startswith(b"HTTP/1.1 "), answer[:100]
    return int(answer[9:12])


def test_a_server_whose_tree_nobody_changes_any_more_gives_no_values() -> None:
    """Behind the end of the bus it says so; behind a fault of the connectors it is gone."""

    async def end(connector: MetricsConnector, port: int) -> bytes:
        async with beside(connector.serve()):
            await asyncio.sleep(0)
        return await ask(port, request("/healthz"))

    async def test_a_fault(connector: MetricsConnector, port: int) -> None:
        with pytest.raises(ConnectionRefusedError):
            await end(connector, port)

    async def test_an_end(connector: MetricsConnector, port: int) -> None:
        connector.tree.apply({"end": {"text": "the bus has ended", "failed": False}}, 2.0)
        assert status_of(await end(connector, port)) == 503

    served(test_a_fault)
    served(test_an_end)


def test_the_pages_by_the_client_of_the_standard_library() -> None:
    async def test(connector: MetricsConnector, port: int) -> None:
        def get(path: str, method: str = "GET") -> tuple[int, str | None, bytes]:
            link = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
            link.request(method, path)
            answer = link.getresponse()
            found = answer.status, answer.getheader("Content-Type"), answer.read()
            link.close()
            return found

        status, kind, body = await asyncio.to_thread(get, "/metrics")
        assert (status, kind) == (200, "text/plain; version=0.0.4; charset=utf-8")
        assert read(body)("dpstack_bus_up") == 1
        assert (await asyncio.to_thread(get, "/metrics?collect[]=x"))[2] == body
        assert (await asyncio.to_thread(get, "/metrics", "HEAD"))[::2] == (200, b"")
        assert await asyncio.to_thread(get, "/healthz") == (200, kind, b"the live stream of the bus comes\n")
        assert (await asyncio.to_thread(get, "/readyz"))[0] == 200
        connector.tree.tick(100.0)
        assert (await asyncio.to_thread(get, "/healthz"))[0] == 503
        assert (await asyncio.to_thread(get, "/readyz"))[0] == 503
        assert connector.collector.requests == {200: 5, 503: 2}

    served(test)


OWN = request("/healthz")


@pytest.mark.parametrize(
    ("octets", "status"),
    [
        (request("/healthz", "POST"), 405),
        (request("/healthz", "BREW"), 405),
        (request("/nothing"), 404),
        (request("/../etc/passwd"), 404),
        (b"GET /healthz\r\n\r\n", 400),
        (b"GET http://127.0.0.1/healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", 400),
        (b"GET /healthz HTTP/2.0\r\nHost: 127.0.0.1\r\n\r\n", 400),
        (b"GET /healthz HTTP/1.1\r\n\r\n", 400),
        (b"GET /health\x00z HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", 400),
        (b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nbad line\r\n\r\n", 400),
        (b"GET /healthz HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n", 400),
        (b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nX: a\nb\r\n\r\n", 400),
        (b"\r\n\r\n", 400),
        (bytes(range(256)) + b"\r\n\r\n", 400),
        (b"GET /" + b"x" * 3000 + b" HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", 400),
        (b"x" * (MOST_OCTETS + 1), 431),
        (b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 5000, 431),
        (request("/healthz", headers={"Host": "evil.example:80"}), 421),
        (request("/healthz", headers={"Host": "evil.example"}), 421),
    ],
)
def test_a_request_that_is_none_is_refused_and_the_next_is_served(octets: bytes, status: int) -> None:
    async def test(_: MetricsConnector, port: int) -> None:
        assert status_of(await ask(port, octets, whole=False)) == status
        assert status_of(await ask(port, OWN)) == 200

    served(test)


def test_pipelined_requests_and_a_body_get_one_answer() -> None:
    async def test(connector: MetricsConnector, port: int) -> None:
        own = request("/healthz")
        answer = await ask(port, own * 5)
        assert answer.count(b"HTTP/1.1") == 1
        assert b"Connection: close\r\n" in answer
        answer = await ask(port, request("/metrics") + b"x" * 1_000_000)
        assert status_of(answer) == 200
        assert read(answer.partition(b"\r\n\r\n")[2])("dpstack_bus_up") == 1
        assert connector.collector.requests == {200: 2}

    served(test)


def test_silent_clients_lose_their_place_and_a_thousand_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_server, "LONGEST_S", 1.5)

    async def test(connector: MetricsConnector, port: int) -> None:
        server = connector._server
        assert server is not None
        own = request("/healthz")
        links = []
        for number in range(1000):
            link = socket.socket()
            link.setblocking(False)
            with contextlib.suppress(OSError):
                await asyncio.get_running_loop().sock_connect(link, ("127.0.0.1", port))
            links.append(link)
            assert len(server.open) <= MOST_OF_ONE <= MOST_CONNECTIONS, number
        await until(lambda: connector.collector.refused >= 1000 - MOST_OF_ONE)
        assert len(server.open) == MOST_OF_ONE
        # the first ones said nothing, and are gone when their time is over
        await until(lambda: not server.open)
        assert not server._of
        assert status_of(await ask(port, own)) == 200
        for link in links:
            link.close()

    served(test)


def test_clients_that_never_read_lose_their_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_server, "LONGEST_S", 0.5)

    async def test(connector: MetricsConnector, port: int) -> None:
        server = connector._server
        assert server is not None

        async def much() -> Answer:
            return Answer(HTTPStatus.OK, b"x" * 10_000_000)

        server.pages = {**server.pages, "/metrics": much}
        with contextlib.ExitStack() as links:
            for _ in range(4):
                link = links.enter_context(socket.create_connection(("127.0.0.1", port)))
                link.sendall(request().replace(b"PORT", str(port).encode()))
            await until(lambda: len(server.open) == 4)
            assert status_of(await ask(port, OWN)) == 200
            await until(lambda: not server.open)

    served(test)


def test_those_who_ask_together_get_one_text() -> None:
    async def test(connector: MetricsConnector, port: int) -> None:
        own = request()
        made = count_pages(connector)
        answers = await asyncio.gather(*(ask(port, own) for _ in range(10)))
        assert [status_of(one) for one in answers] == [200] * 10
        assert len(made) < 5  # one for each 0.2 s

    served(test)


def test_a_pace_lets_a_few_pass_at_once_and_then_one_by_one() -> None:
    pace = Pace(10.0, 3)

    def waits(now: float, times: int) -> list[float]:
        found = []
        for _ in range(times):
            found.append(pace.wait_s(now))
            pace.take(now)
        return found

    assert max(waits(100.0, 3)) <= 0
    assert waits(100.0, 3) == pytest.approx([0.1, 0.2, 0.3])
    assert pace.wait_s(100.0) == pytest.approx(0.4)
    assert [wait_s <= 0 for wait_s in waits(200.0, 4)] == [True, True, True, False]


def test_a_flood_waits_and_gets_old_texts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_server, "MOST_ANSWERS", 10)
    monkeypatch.setattr(metrics_connector, "FRESH_S", 0.0)
    monkeypatch.setattr(metrics_connector, "_MADE_AT_ONCE", 1)

    async def test(connector: MetricsConnector, port: int) -> None:
        made = count_pages(connector)
        loop = asyncio.get_running_loop()
        began = loop.time()
        asked = [request("/metrics")] * 7 + [request("/nothing")] * 4 + [b"GET /metrics\r\n\r\n"] * 3
        answers = await asyncio.gather(*(ask(port, octets) for octets in asked))
        took_s = loop.time() - began
        assert sorted(map(status_of, answers)) == [200] * 7 + [400] * 3 + [404] * 4
        assert connector.collector.requests == {200: 7, 400: 3, 404: 4}
        assert took_s > (14 - 10) / 10 - 0.01
        assert len(made) <= 1 + took_s

    served(test)


def test_clients_that_go_away_while_they_wait_take_no_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_server, "MOST_ANSWERS", 2)

    async def test(connector: MetricsConnector, port: int) -> None:
        server = connector._server
        assert server is not None
        for _ in range(2):
            assert status_of(await ask(port, OWN)) == 200
        await until(lambda: not server.open)
        asked: list[int] = []
        turn = server.turn

        async def counted() -> None:
            asked.append(1)
            await turn()

        monkeypatch.setattr(server, "turn", counted)
        for _ in range(10):
            asked.clear()
            links = [socket.create_connection(("127.0.0.1", port)) for _ in range(8)]
            for link in links:
                link.sendall(OWN.replace(b"PORT", str(port).encode()))
                # to be closed with a reset: behind a mere end of sending the client may still read
                link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            await until(lambda: len(asked) == 8)
            for link in links:
                link.close()
            await until(lambda: not server.open)
        # their 80 turns would be 40 s, more than a connection may take
        assert status_of(await ask(port, OWN)) == 200

    served(test)


def test_a_client_that_resets_its_connection_is_no_fault_of_the_program(monkeypatch: pytest.MonkeyPatch) -> None:
    troubles: list[object] = []

    def shut_down(_: object) -> None:
        raise OSError(errno.ENOTCONN, "the connection was reset")

    async def test(connector: MetricsConnector, port: int) -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, context: troubles.append(context))
        # without an end of its own, for which this client would call the same method
        assert status_of(await ask(port, OWN, whole=False)) == 200
        server = connector._server
        assert server is not None
        await until(lambda: not server.open)

    monkeypatch.setattr(http_server, "_GOODBYE_S", 0.01)
    monkeypatch.setattr(_SelectorSocketTransport, "write_eof", shut_down)
    served(test)
    assert troubles == []


def test_a_defect_is_told_and_the_next_page_is_served(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metrics_connector, "FRESH_S", 0.0)
    monkeypatch.setattr(metrics_connector, "_MADE_AT_ONCE", 2)

    async def test(connector: MetricsConnector, port: int) -> None:
        assert status_of(await ask(port, request())) == 200
        connector.collector.families = lambda: [][0]  # type: ignore[method-assign]
        # neither the pace nor a text of before hides it
        assert [status_of(await ask(port, request())) for _ in range(4)] == [500] * 4
        assert status_of(await ask(port, request("/healthz"))) == 200

    served(test)


@pytest.mark.parametrize("path", ["/readyz", "/healthz"])
def test_a_defect_of_health_is_answered_counted_and_told(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def judge(*_: object) -> object:
        raise KeyError("slave")

    for name in ("readiness", "liveness"):
        monkeypatch.setattr(metrics_connector, name, judge)

    async def test(connector: MetricsConnector, port: int) -> None:
        assert status_of(await ask(port, request(path))) == 500
        assert connector.collector.requests[500] == 1

    served(test)


def test_clients_that_go_away_while_the_text_is_made_leave_no_old_text(monkeypatch: pytest.MonkeyPatch) -> None:
    """They have used up the pace: the next one must get the text that was made for them."""

    async def test(connector: MetricsConnector, port: int) -> None:
        made, go_on = count_pages(connector), asyncio.Event()
        render = metrics_connector.rendered

        async def slowly(families: object) -> bytes:
            await go_on.wait()
            return await render(families)  # type: ignore[arg-type]

        monkeypatch.setattr(metrics_connector, "rendered", slowly)
        for _ in range(metrics_connector._MADE_AT_ONCE + 3):
            _, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(request().replace(b"PORT", str(port).encode()))
            await until(lambda: made)
            await asyncio.sleep(0.01)
            writer.transport.abort()
        await asyncio.sleep(0.05)
        honest = asyncio.create_task(ask(port, request()))
        await asyncio.sleep(0.05)
        go_on.set()
        answer = await honest
        assert status_of(answer) == 200
        assert b"dpstack_bus_up" in answer
        assert len(made) == 1

    served(test)


def test_random_octets_never_reach_the_handler_of_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_server, "MOST_ANSWERS", 1000)
    chance = random.Random(21)
    troubles: list[object] = []

    async def test(connector: MetricsConnector, port: int) -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, context: troubles.append(context))
        for _ in range(100):
            octets = bytearray(request().replace(b"PORT", str(port).encode()))
            for _ in range(chance.randrange(4)):
                octets[chance.randrange(len(octets))] = chance.randrange(256)
            answer = await ask(port, bytes(octets[: chance.randrange(len(octets) + 40)]))
            assert not answer or status_of(answer) in (200, 400, 404, 405, 421, 431)
        server = connector._server
        assert server is not None
        await until(lambda: not server.open)

    served(test)
    assert troubles == []


def test_a_port_that_is_taken_is_one_clear_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        connector = Bench().connector
        connector._listen = Listen("127.0.0.1", port, "[metrics] listen")
        with pytest.raises(PortError, match=rf"\[metrics\] listen 127.0.0.1:{port}: .*in use; give another address"):
            asyncio.run(connector.open())
        connector.close()


def test_an_address_that_others_reach_is_told_and_takes_every_host() -> None:
    async def run() -> None:
        bench = Bench(plant("valves"), snapshot(1.0, FINE))
        bench.connector._listen = Listen("0.0.0.0", 0, "listen")
        await bench.connector.open()
        try:
            assert bench.connector.address is not None
            assert [line for line in bench.told if "other computers reach it, without TLS and password" in line]
            answer = await ask(bench.connector.address[1], request("/healthz", headers={"Host": "plant-7.example"}))
            assert status_of(answer) == 200
        finally:
            bench.connector.close()

    asyncio.run(run())
