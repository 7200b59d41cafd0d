"""The parameter channel, each end against literal octets (docs/reference/drives/demag.md#parameter-channel)."""

from __future__ import annotations

import pytest
from acyclic_kit import octets
from drive_bench import Times
from hypothesis import given
from hypothesis import strategies as st

from dpstack.profile import Pkw, PkwChannel, PkwDialect, PkwServer
from dpstack.profile.channel.pkw import Exchange

READ_400 = octets("11 90 00 00 00 00 00 00")
REPLY_400 = octets("11 90 00 00 00 00 00 02")
ZERO = bytes(8)
STRICT = PkwDialect(answers={1: (1, 2), 2: (1,), 6: (4, 5)}, errors={0: "none"})
LOOSE = PkwDialect(answers={1: (1,), 2: (1,)}, errors={}, zero_between=False)


def channel(dialect: PkwDialect = STRICT) -> PkwChannel:
    """The master's end of a drive, at time 0."""
    return PkwChannel(dialect, Times())


def stepped(client: PkwChannel, reply: bytes, now: int) -> bytes:
    """The octets that it sends after this reply."""
    client.step(reply, now)
    return client.octets


def busy(client: PkwChannel) -> bool:
    return client.busy


def answered(exchange: Exchange) -> bool:
    return exchange.reply is not None


def test_octets_of_the_manuals() -> None:
    assert Pkw(1, 400).build() == READ_400
    assert Pkw(8, 480, 3, 0xFFFF8AD0).build() == octets("81 E0 03 00 FF FF 8A D0")
    assert Pkw.parse(octets("51 E0 03 00 FF FF 8A D0")) == (5, 480, 3, 0xFFFF8AD0)
    assert Pkw(2, 0x104, 0x1A, 15).build() == octets("21 04 1A 00 00 00 00 0F")
    # SPM (bit 11) and IND's low octet are not ours to judge
    assert Pkw.parse(octets("19 90 00 FF 00 00 00 02")) == (1, 400, 0, 2)


@pytest.fixture
def client() -> PkwChannel:
    return channel()


def test_d4_the_master_holds_its_order_until_the_reply_then_sends_zero_and_waits_for_zero(client: PkwChannel) -> None:
    assert not busy(client)
    first, second = client.submit(Pkw(1, 400)), client.submit(Pkw(6, 480, 3))
    assert busy(client)
    client.step(ZERO, 0)
    for _ in range(3):
        assert client.octets == READ_400  # held while the reply is 0
        client.step(ZERO, 0)
    client.step(REPLY_400, 0)
    assert first.reply == (1, 400, 0, 2)
    for _ in range(3):
        assert client.octets == ZERO  # withdrawn; the reply is not yet 0
        client.step(REPLY_400, 0)
    assert not answered(second)
    assert stepped(client, ZERO, 0) == octets("61 E0 03 00 00 00 00 00")
    client.step(octets("51 E0 03 00 00 00 01 F4"), 0)
    assert second.reply == (5, 480, 3, 500)
    client.step(ZERO, 0)
    assert not busy(client)
    assert client.octets == ZERO


def test_an_answer_for_another_parameter_is_not_accepted_but_kept(client: PkwChannel) -> None:
    exchange = client.submit(Pkw(1, 400))
    client.step(ZERO, 0)
    client.step(octets("11 91 00 00 00 00 00 07"), 0)
    assert exchange.reply is None
    assert exchange.stray == (1, 401, 0, 7)
    assert client.octets == READ_400
    client.step(REPLY_400, 0)
    assert exchange.reply is not None


def test_a_cancelled_order_is_withdrawn_with_zero(client: PkwChannel) -> None:
    running, queued = client.submit(Pkw(1, 400)), client.submit(Pkw(1, 401))
    client.step(ZERO, 0)
    client.cancel(queued)
    client.cancel(running)
    assert client.octets == ZERO
    client.step(REPLY_400, 0)
    assert running.reply is None
    client.step(ZERO, 0)
    assert not busy(client)


def test_without_the_rule_of_zero_a_stale_reply_is_not_the_answer() -> None:
    client = channel(LOOSE)
    first, second, third = (client.submit(Pkw(1, pnu)) for pnu in (0x10F, 0x104, 0x104))
    client.step(ZERO, 0)
    client.step(octets("11 0F 00 00 00 00 00 03"), 0)
    assert first.reply is not None
    client.step(octets("11 0F 00 00 00 00 00 03"), 0)  # the drive still repeats it
    assert client.octets == octets("11 04 00 00 00 00 00 00")
    client.step(octets("11 0F 00 00 00 00 00 03"), 0)
    assert not answered(second)
    client.step(octets("11 04 00 00 00 00 00 05"), 0)
    assert second.reply == (1, 0x104, 0, 5)
    # an equal order: 0 in between
    assert stepped(client, octets("11 04 00 00 00 00 00 05"), 0) == ZERO
    assert third.reply is None
    assert stepped(client, ZERO, 0) == octets("11 04 00 00 00 00 00 00")


def test_without_the_rule_of_zero_a_write_is_not_answered_by_the_read_before_it() -> None:
    """A drive repeats its last reply: F26 read as 2, then F26 := 15, must not end with that 2."""
    client = channel(LOOSE)
    read, write = client.submit(Pkw(1, 0x104, 0x1A)), client.submit(Pkw(2, 0x104, 0x1A, 15))
    client.step(ZERO, 0)
    for _ in range(3):
        client.step(octets("11 04 1A 00 00 00 00 02"), 0)
    assert read.reply == (1, 0x104, 0x1A, 2)
    assert (client.octets, write.reply) == (ZERO, None)
    assert stepped(client, ZERO, 0) == octets("21 04 1A 00 00 00 00 0F")
    client.step(octets("11 04 1A 00 00 00 00 0F"), 0)
    assert write.reply == (1, 0x104, 0x1A, 15)


@pytest.mark.parametrize("dialect", [STRICT, LOOSE])
def test_an_order_that_timed_out_is_not_answered_into_the_next_one(dialect: PkwDialect) -> None:
    """The drive looks every 32 ms: it may take the withdrawn order up after our 0 and answer it then."""
    times = Times(settle_ns=100)
    client = PkwChannel(dialect, times)
    late, again = client.submit(Pkw(2, 400, 0, 1)), client.submit(Pkw(2, 400, 0, 2))
    client.step(ZERO, 0)
    times.now = 10
    client.cancel(late)
    for now in (12, 50, 109):
        assert stepped(client, ZERO, now) == ZERO
    client.step(octets("11 90 00 00 00 00 00 01"), 60)
    assert (client.octets, again.reply) == (ZERO, None)
    assert stepped(client, ZERO, 70) == octets("21 90 00 00 00 00 00 02")  # the drive has seen both orders
    silent = client.submit(Pkw(1, 400))
    times.now = 200
    client.cancel(again)
    assert stepped(client, ZERO, 299) == ZERO
    assert stepped(client, ZERO, 300) == READ_400
    assert silent.reply is None


def test_the_first_order_waits_until_the_reply_is_zero(client: PkwChannel) -> None:
    """docs/reference/drives/demag.md#handshake-of-the-parameter-channel: both start at 0; after a re-entry a drive may
    show its last reply for one more scan."""
    exchange = client.submit(Pkw(1, 400))
    client.step(REPLY_400, 0)
    client.step(REPLY_400, 0)
    assert (client.octets, exchange.reply) == (ZERO, None)
    assert exchange.stray == (1, 400, 0, 2)
    assert stepped(client, ZERO, 0) == READ_400


def test_reset_starts_at_zero(client: PkwChannel) -> None:
    client.submit(Pkw(1, 400))
    client.step(ZERO, 0)
    client.reset()
    assert client.octets == ZERO
    assert not busy(client)


def test_d4_the_slave_ignores_a_new_order_until_it_answered_zero_with_zero() -> None:
    done: list[Pkw] = []

    def handler(order: Pkw) -> tuple[int, int]:
        done.append(order)
        return 1, len(done)

    server = PkwServer(STRICT, handler)
    assert server.step(ZERO) == ZERO
    assert server.step(READ_400) == octets("11 90 00 00 00 00 00 01")
    assert server.step(READ_400) == octets("11 90 00 00 00 00 00 01")
    assert server.step(octets("11 91 00 00 00 00 00 00")) == octets("11 90 00 00 00 00 00 01")
    assert server.step(ZERO) == ZERO
    assert server.step(octets("11 91 00 00 00 00 00 00")) == octets("11 91 00 00 00 00 00 02")
    assert [order.pnu for order in done] == [400, 401]
    server.reset()
    assert server.step(READ_400)[7] == 3


def test_a_loose_slave_repeats_reads_with_the_momentary_value_and_writes_once() -> None:
    calls: list[int] = []

    def handler(order: Pkw) -> tuple[int, int]:
        calls.append(order.id)
        return 1, len(calls)

    server = PkwServer(LOOSE, handler)
    write = octets("21 04 1A 00 00 00 00 0F")
    read = octets("11 04 1A 00 00 00 00 00")
    assert [server.step(order)[7] for order in (write, write, read, read, write)] == [1, 1, 2, 3, 4]
    assert calls == [2, 1, 1, 2]


@given(st.lists(st.binary(min_size=8, max_size=8), max_size=20), st.booleans())
def test_any_replies_never_raise(replies: list[bytes], strict: bool) -> None:
    client = channel(STRICT if strict else LOOSE)
    for reply in replies:
        if not client.busy:
            client.submit(Pkw(1, 400))
        client.step(reply, 0)
        assert len(client.octets) == 8


@pytest.mark.parametrize("dialect", [STRICT, LOOSE])
def test_error_texts(dialect: PkwDialect) -> None:
    assert dialect.error_text(4711) == "error without a text in the manual"
