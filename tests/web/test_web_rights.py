"""Rights to look and to give orders: tokens, the secret of a start, TLS, wrong files."""

from __future__ import annotations

import asyncio
import os
import ssl
from collections.abc import Collection, Mapping
from pathlib import Path

import aiohttp
import pytest
from far_ends import HANG_S
from tls_kit import CERT, EXPIRED, KEY, KEY_WITH_PASSWORD, OTHER_KEY

from dpstack.errors import ConfigError, PortError, UsageError
from dpstack.tcp_address import Listen, Origins, is_local
from dpstack.web import rights as rights_module
from dpstack.web.rights import Rights, make_rights, read_tokens, tls_context, who_may
from dpstack.web.source import GivenItems
from dpstack.web.web_server import serve
from tests.web.web_kit import PLANT, connected, page_of, stranger

ANNA, BERT = "anna-0123456789abcdef", "bert-0123456789abcdef"
TOKENS = {ANNA: "anna", BERT: "bert"}


def write(path: Path, text: str, mode: int = 0o600) -> Path:
    path.write_text(text, encoding="utf-8")
    path.chmod(mode)
    return path


@pytest.fixture
def unhurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wrong tokens are slowed down by hundredths of a second."""
    monkeypatch.setattr(rights_module, "_PAUSES_S", (0.0, 0.01))


async def test_a_token_gives_its_name_and_a_wrong_one_nothing(unhurried: None) -> None:
    log: list[str] = []
    async with serve(GivenItems([PLANT]), rights=Rights(control=True, tokens=TOKENS), log=log.append) as server:
        assert "#" not in server.url
        for token in ("x" * 21, ANNA + "x", ANNA[:-1], "", "\ud800"):
            async with page_of(server, token) as page:
                refused = await page.item()
                assert list(refused) == ["refused"]
                assert (await page.ws.receive(timeout=HANG_S)).type is aiohttp.WSMsgType.CLOSE
        async with page_of(server, None) as page:
            assert await page.item() == {"refused": "a token is needed"}
        assert server.pages == 0
        async with page_of(server, BERT) as page:
            welcome = await page.until("welcome")
            assert (welcome["name"], welcome["control"]) == ("bert", True)
    assert sum("a wrong token from 127.0.0.1" in line for line in log) == 4
    assert not any(ANNA[:-1] in line or "x" * 21 in line for line in log)


async def test_tokens_without_control_only_look() -> None:
    async with serve(GivenItems(), rights=Rights(tokens=TOKENS)) as server, page_of(server, ANNA) as page:
        assert (await page.until("welcome"))["control"] is False
        assert (await page.order("operate"))["ok"] is False


async def test_the_secret_of_a_start_gives_orders_and_without_it_one_may_look(unhurried: None) -> None:
    rights = make_rights(local=True, control=True, tokens=None, tls=False)
    again = make_rights(local=True, control=True, tokens=None, tls=False)
    async with serve(GivenItems(), rights=rights) as server:
        secret = server.url.partition("#")[2]
        assert len(secret) >= 32
        assert secret != again.secret
        async with page_of(server, secret) as page:
            welcome = await page.until("welcome")
            assert (welcome["name"], welcome["control"]) == (None, True)
        async with page_of(server, None) as page:
            assert (await page.until("welcome"))["control"] is False
        async with page_of(server, again.secret) as page:
            assert "earlier start" in (await page.item())["refused"]


async def test_the_first_message_is_hello_and_comes_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dpstack.web.web_server._HELLO_S", 0.05)
    async with serve(GivenItems([PLANT])) as server:
        messages: list[object] = [{"ask": {"id": 1, "what": "why"}}, {"hello": {"token": 7}}, [], "hello"]
        for message in messages:
            async with stranger(server) as page:
                await page.send(message)
                assert list(await page.item()) == ["refused"]
        async with stranger(server) as page:
            assert "did not come" in (await page.item())["refused"]


async def test_wrong_tokens_of_one_address_wait_for_one_another(monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []

    async def sleep(seconds: float) -> None:
        slept.append(seconds)

    rights = Rights(control=True, tokens=TOKENS)
    monkeypatch.setattr("dpstack.web.rights.asyncio.sleep", sleep)
    for _ in range(8):
        await rights.pauses.wait("192.0.2.1")
        rights.pauses.judge("192.0.2.1", False)
    assert slept == [0.5, 1.0, 2.0, 4.0, 8.0, 8.0, 8.0]
    await rights.pauses.wait("192.0.2.2")
    assert len(slept) == 7
    rights.pauses.judge("192.0.2.1", True)
    await rights.pauses.wait("192.0.2.1")
    assert len(slept) == 7


def test_addresses_of_wrong_tokens_are_bounded() -> None:
    pauses = rights_module.Pauses()
    for number in range(5_000):
        pauses.judge(str(number), False)
    assert len(pauses._wrong) == 1_024


@pytest.mark.parametrize(
    ("local", "control", "tokens", "tls", "missing"),
    [
        (False, False, None, True, "--token"),
        (False, True, None, True, "--token"),
        (False, True, TOKENS, False, "--tls"),
        (False, False, TOKENS, False, None),
        (False, True, TOKENS, True, None),
        (True, True, TOKENS, False, None),
        (True, False, None, False, None),
    ],
)
def test_an_address_of_others_needs_tokens_and_with_control_tls(
    local: bool, control: bool, tokens: Mapping[str, str] | None, tls: bool, missing: str | None
) -> None:
    if missing is None:
        made = make_rights(local=local, control=control, tokens=tokens, tls=tls)
        assert (made.secret is None) is (tokens is not None or not control)
        return
    with pytest.raises(UsageError, match=missing):
        make_rights(local=local, control=control, tokens=tokens, tls=tls)


def test_rights_are_told_in_a_sentence() -> None:
    looking, secret = Rights(), Rights(True, secret="x" * 32)
    assert who_may(looking, tls=False, local=True).endswith("nobody may give orders")
    assert "whole address may give orders" in who_may(secret, tls=False, local=True)
    assert who_may(Rights(tokens=TOKENS), tls=True, local=False) == "these may look there: anna, bert"
    assert "and give orders: anna, bert" in who_may(Rights(True, TOKENS), tls=False, local=True)
    assert "without --tls everybody" in who_may(Rights(tokens=TOKENS), tls=False, local=False)


def test_the_file_of_tokens(tmp_path: Path) -> None:
    path = write(tmp_path / "tokens", f"# people\n\nanna {ANNA}\n  bert\t{BERT}  \n")
    assert read_tokens(path) == TOKENS


@pytest.mark.parametrize(
    ("text", "mode", "why"),
    [
        (f"anna {ANNA}\n", 0o640, "0640"),
        (f"anna {ANNA}\n", 0o604, "chmod 600"),
        ("anna short-token-123\nbert 0123456789abcde\n", 0o600, "15 characters"),
        ("# nobody\n", 0o600, "has no token"),
        (f"anna\n{ANNA}\n", 0o600, "tokens:1: is not NAME TOKEN"),
        (f"anna {ANNA} x\n", 0o600, "is not NAME TOKEN"),
        (f"anna {ANNA}\nanna {BERT}\n", 0o600, "anna has a token already"),
        (f"anna {ANNA}\nbert {ANNA}\n", 0o600, "same token as anna"),
        (f"an\x1b[31mna {ANNA}\n", 0o600, "cannot be shown"),
    ],
)
def test_a_wrong_file_of_tokens_is_one_line_without_a_token(tmp_path: Path, text: str, mode: int, why: str) -> None:
    path = write(tmp_path / "tokens", text, mode)
    with pytest.raises(ConfigError) as error:
        read_tokens(path)
    assert why in str(error.value)
    assert ANNA not in str(error.value)
    assert BERT not in str(error.value)


def test_a_file_of_tokens_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        read_tokens(tmp_path / "missing")
    os.mkfifo(tmp_path / "fifo", 0o600)
    with pytest.raises(ConfigError, match="is no file"):
        read_tokens(tmp_path / "fifo")
    (tmp_path / "octets").write_bytes(b"\xff\xfe")
    (tmp_path / "octets").chmod(0o600)
    with pytest.raises(ConfigError, match="UTF-8"):
        read_tokens(tmp_path / "octets")


async def test_the_addresses_of_one_computer_wait_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """A computer takes any address of its IPv6 network, so a pause for each of them would be none."""
    slept: list[float] = []

    async def sleep(seconds: float) -> None:
        slept.append(seconds)

    monkeypatch.setattr("dpstack.web.rights.asyncio.sleep", sleep)
    pauses = rights_module.Pauses()
    for number in range(1, 6):
        assert await pauses.wait(f"2001:db8::{number:x}%eth0")
        pauses.judge(f"2001:db8::{number:x}%eth0", False)
    assert slept == [0.5, 1.0, 2.0, 4.0]
    assert await pauses.wait("2001:db8:0:1::1")
    assert len(slept) == 4


async def test_tokens_of_one_network_do_not_pile_up() -> None:
    pauses = rights_module.Pauses()
    pauses.judge("192.0.2.1", False)
    waiting = [asyncio.ensure_future(pauses.wait("192.0.2.1")) for _ in range(4)]
    await asyncio.sleep(0)
    assert await pauses.wait("192.0.2.1") is False
    assert await pauses.wait("192.0.2.2")
    waiting.pop().cancel()
    await asyncio.sleep(0)
    waiting.append(asyncio.ensure_future(pauses.wait("192.0.2.1")))
    await asyncio.sleep(0)
    assert not any(one.done() for one in waiting)
    for one in waiting:
        one.cancel()


async def test_one_network_does_not_take_all_places_before_hello(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dpstack.web.web_server._MOST_OF_A_NETWORK", 1)
    async with serve(GivenItems([PLANT])) as server, stranger(server) as silent:
        with pytest.raises(aiohttp.WSServerHandshakeError, match="503"):
            async with stranger(server):
                pass
        await silent.send({"hello": {"token": None}})
        await silent.until("welcome")
        async with page_of(server) as page:
            await page.until("welcome")


# --- TLS ----------------------------------------------------------------------------------------------------------


def tls(folder: Path) -> tuple[ssl.SSLContext, Collection[str], ssl.SSLContext]:
    """The context of a server, the names in its certificate, and a client's context that trusts it."""
    cert, key = write(folder / "cert.pem", CERT), write(folder / "key.pem", KEY)
    trusting = ssl.create_default_context(cafile=str(cert))
    trusting.verify_flags &= ~ssl.VERIFY_X509_STRICT
    return *tls_context(cert, key), trusting


async def test_a_page_over_tls(tmp_path: Path) -> None:
    context, names, trusting = tls(tmp_path)
    assert names == {"plant.example", "127.0.0.1"}
    async with serve(GivenItems([PLANT]), rights=Rights(True, TOKENS), tls=context, names=names) as server:
        assert server.url.startswith("https://127.0.0.1:")
        async with page_of(server, ANNA, ssl=trusting) as page:
            assert (await page.until("welcome"))["name"] == "anna"
        with pytest.raises(aiohttp.WSServerHandshakeError):
            async with stranger(server, ssl=trusting, origin=server.url.replace("https", "http").rstrip("/")):
                pass
        plain = server.url.replace("https", "http")
        async with aiohttp.ClientSession() as session:
            with pytest.raises(aiohttp.ClientError):
                await session.get(plain)


async def test_connections_without_a_handshake_are_closed_and_their_number_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dpstack.web.web_server._HELLO_S", 0.2)
    monkeypatch.setattr("dpstack.web.web_server._MOST_CONNECTIONS", 3)
    context, names, trusting = tls(tmp_path)
    async with serve(GivenItems([PLANT]), rights=Rights(True, TOKENS), tls=context, names=names) as server:
        opened = [await connected(server) for _ in range(4)]
        refused = await asyncio.wait_for(opened[3][0].read(), 5)
        assert refused == b""
        assert not opened[0][0].at_eof()
        for reader, writer in opened:
            assert await asyncio.wait_for(reader.read(), 5) == b""
            writer.close()
        async with page_of(server, ANNA, ssl=trusting) as page:
            assert (await page.until("welcome"))["name"] == "anna"


@pytest.mark.parametrize(
    ("cert", "key", "why"),
    [
        (EXPIRED, KEY, "has expired"),
        (CERT, OTHER_KEY, "does not belong to the certificate"),
        (CERT, KEY_WITH_PASSWORD, "has a password"),
        (KEY, CERT, "has no certificate in PEM"),
        (CERT, CERT, "has no key in PEM"),
        ("", KEY, "has no certificate in PEM"),
        (CERT[:200], KEY, "cannot be read as PEM"),
    ],
)
def test_a_wrong_certificate_or_key_is_one_line(tmp_path: Path, cert: str, key: str, why: str) -> None:
    with pytest.raises(ConfigError, match=f"^--tls: .*{why}"):
        tls_context(write(tmp_path / "cert.pem", cert), write(tmp_path / "key.pem", key))


def test_a_key_that_everybody_can_read_or_that_is_missing(tmp_path: Path) -> None:
    cert = write(tmp_path / "cert.pem", CERT)
    with pytest.raises(ConfigError, match="can be read by every user"):
        tls_context(cert, write(tmp_path / "key.pem", KEY, 0o644))
    with pytest.raises(ConfigError, match=r"key .* cannot be read: No such file"):
        tls_context(cert, tmp_path / "nothing.pem")


# --- addresses ------------------------------------------------------------------------------------------------------


def test_listen() -> None:
    assert Listen.parse("8470") == Listen("127.0.0.1", 8470)
    assert Listen.parse("[::1]:0") == Listen("::1", 0)
    assert Listen.parse("plant.example:80") == Listen("plant.example", 80)
    for wrong in ("", "x", ":", "a:b", "1.2.3.4:70000", "http://x:80", "::1:80", "a/b:80", "[x]:80", "127.0.0.1"):
        with pytest.raises(UsageError, match="HOST:PORT"):
            Listen.parse(wrong)


async def test_only_loopback_is_local_and_a_port_in_use_is_one_line() -> None:
    one = Listen.parse("0").sockets()[0]
    everywhere = Listen.parse("0.0.0.0:0").sockets()[0]
    with one, everywhere:
        assert is_local([one])
        assert not is_local([one, everywhere])
        one.listen()
        with pytest.raises(PortError, match=r"^--listen 127.0.0.1:\d+: Address already in use; give another"):
            Listen("127.0.0.1", one.getsockname()[1]).sockets()
    with pytest.raises(PortError, match="there is no such address"):
        await asyncio.to_thread(Listen("no such name.invalid", 80).sockets)


def test_hosts_and_origins() -> None:
    origins = Origins(["plant.example"], 443, secure=True)
    for host in ("plant.example", "PLANT.example:443", "192.0.2.1", "[2001:db8::1]:443", "localhost"):
        assert origins.is_own_host(host), host
        assert origins.is_own_origin(f"https://{host}", host)
        assert not origins.is_own_origin(f"http://{host}", host)
        assert not origins.is_own_origin("https://evil.example", host)
    for wrong in (None, "", "evil.example", "plant.example.evil.example", "plant.example:8443", "user@plant.example"):
        assert not origins.is_own_host(wrong), wrong
        assert not origins.is_own_origin(f"https://{wrong}", wrong)
