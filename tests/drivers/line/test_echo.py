"""The echo filter on literal octets, and under the driver."""

from __future__ import annotations

import pytest
from driver_rig import Rig
from far_ends import until
from hypothesis import given
from hypothesis import strategies as st

from dpstack.drivers.line.echo import Echo, EchoFilter
from dpstack.units import NS_PER_MS

REQUEST = bytes.fromhex("68 05 05 68 82 E3 6D 3C 3E 4C 16")
ANSWER = bytes.fromhex("68 0B 0B 68 E3 82 08 3E 3C 02 05 00 FF 0C DA D3 16")
TOKEN = bytes.fromhex("DC 02 02")


def test_an_echo_in_pieces_is_held_back_until_it_is_whole() -> None:
    echo = EchoFilter(Echo.AUTO)
    echo.sent(REQUEST)
    assert [echo.strip(REQUEST[n : n + 1]) for n in range(10)] == [b""] * 10
    assert echo.strip(REQUEST[10:] + ANSWER) == ANSWER
    assert echo.state is Echo.ON


def test_an_answer_that_begins_like_the_request_is_given_back_whole() -> None:
    echo = EchoFilter(Echo.AUTO)
    echo.sent(REQUEST)
    assert echo.strip(ANSWER[:1]) == b""
    assert echo.strip(ANSWER[1:]) == ANSWER
    assert echo.strip(b"\xe5") == b"\xe5"
    assert echo.release() == b""


def test_a_short_acknowledgement_proves_nothing() -> None:
    echo = EchoFilter(Echo.AUTO)
    echo.sent(b"\xe5")
    assert echo.strip(b"\xe5" + TOKEN) == b"\xe5" + TOKEN
    assert echo.state is Echo.AUTO


def test_three_other_answers_say_that_there_is_none() -> None:
    echo = EchoFilter(Echo.AUTO)
    for _ in range(3):
        assert echo.state is Echo.AUTO
        echo.sent(REQUEST)
        assert echo.strip(ANSWER) == ANSWER
    assert echo.state is Echo.OFF
    echo.sent(REQUEST)
    assert echo.strip(ANSWER) == ANSWER  # and nothing is taken away any more, not even the octet they share


def test_silence_says_nothing() -> None:
    echo = EchoFilter(Echo.AUTO)
    for _ in range(10):
        echo.sent(REQUEST)
        assert echo.strip(b"") == b""
    assert echo.state is Echo.AUTO


@given(st.lists(st.tuples(st.binary(min_size=3, max_size=20), st.binary(max_size=20)), max_size=10), st.data())
def test_with_echo_only_the_answers_remain_however_they_are_cut(
    exchanges: list[tuple[bytes, bytes]], data: st.DataObject
) -> None:
    echo = EchoFilter(Echo.ON)
    for request, answer in exchanges:
        echo.sent(request)
        line, out = request + answer, b""
        cuts = sorted(data.draw(st.lists(st.integers(0, len(line)), max_size=5)))
        for first, last in zip([0, *cuts], [*cuts, len(line)], strict=True):
            out += echo.strip(line[first:last])
        assert out == answer
    assert echo.lost == 0


def test_an_echo_that_comes_after_the_next_telegram_was_sent() -> None:
    echo = EchoFilter(Echo.ON)
    echo.sent(TOKEN)
    echo.sent(REQUEST)
    assert echo.strip(TOKEN + REQUEST[:4]) == b""
    assert echo.strip(REQUEST[4:] + ANSWER) == ANSWER
    assert echo.lost == 0


def test_an_echo_that_never_came_is_counted_and_the_next_one_removed() -> None:
    echo = EchoFilter(Echo.ON)
    echo.sent(TOKEN)
    echo.sent(REQUEST)
    assert echo.strip(REQUEST + ANSWER) == ANSWER
    assert echo.lost == 1


@pytest.mark.parametrize("damaged", [0, 3, 10])
def test_a_damaged_echo_is_counted_and_passed_on(damaged: int) -> None:
    echo = EchoFilter(Echo.ON)
    echo.sent(REQUEST)
    heard = REQUEST[:damaged] + b"\xaa" + REQUEST[damaged + 1 :]
    assert echo.strip(heard) == heard[damaged:]
    assert echo.lost == 1
    echo.sent(TOKEN)
    assert echo.strip(TOKEN + ANSWER) == ANSWER


@pytest.mark.usefixtures("each_driver")
async def test_an_echo_is_recognised_told_and_removed() -> None:
    async with Rig(echo=Echo.AUTO) as rig:
        for answer in (b"\xe5", REQUEST):
            rig.driver.command(TOKEN)
            rig.far.write(TOKEN + answer)
            await rig.settle()
        assert [entry[1] for entry in rig.machine.did("receive")] == [b"\xe5", REQUEST]
        assert rig.driver.echo is Echo.ON
        assert ["echo" in event.text for event in rig.events] == [True]


@pytest.mark.usefixtures("each_driver")
async def test_a_line_without_echo_is_recognised_too() -> None:
    async with Rig(echo=Echo.AUTO) as rig:
        for _ in range(5):
            rig.driver.command(TOKEN)
            rig.far.write(REQUEST)
            await rig.settle()
        assert [entry[1] for entry in rig.machine.did("receive")] == [REQUEST] * 5
        assert rig.driver.echo is Echo.OFF


@pytest.mark.usefixtures("each_driver")
async def test_octets_held_for_an_echo_are_given_back_when_a_deadline_is_due() -> None:
    async with Rig(echo=Echo.AUTO) as rig:
        rig.driver.command(REQUEST)
        rig.far.write(REQUEST[:2])
        await rig.settle()
        assert not rig.machine.did("receive")
        rig.driver.command(NS_PER_MS)
        await until(lambda: bool(rig.machine.did("wake")), "the deadline")
        assert [entry[1] for entry in rig.machine.did("receive")] == [REQUEST[:2]]


def test_two_telegrams_are_sent_before_the_first_echo_comes() -> None:
    """An adapter with a latency timer: the two tokens of a claim come back in one piece."""
    echo = EchoFilter(Echo.AUTO)
    echo.sent(TOKEN)
    echo.sent(TOKEN)
    assert echo.strip(TOKEN + TOKEN) == b""
    assert echo.state is Echo.ON
    assert echo.strip(ANSWER) == ANSWER


def test_the_first_whole_echo_proves_it_while_the_next_one_is_under_way() -> None:
    echo = EchoFilter(Echo.AUTO)
    echo.sent(TOKEN)
    echo.sent(REQUEST)
    assert echo.strip(TOKEN) == b""
    assert echo.state is Echo.ON
    assert echo.release() == b""
    assert echo.strip(REQUEST + ANSWER) == ANSWER
