"""The echo filter on literal octets, and under the driver."""

from __future__ import annotations

import pytest
from far_ends import until
from hypothesis import given
from hypothesis import strategies as st

from dpstack.drivers.line.echo import Echo, EchoFilter
from dpstack.fdl.events import AddressCollision
from dpstack.units import NS_PER_MS
from tests.drivers.driver_rig import Rig

REQUEST = bytes.fromhex("68 05 05 68 82 E3 6D 3C 3E 4C 16")
ANSWER = bytes.fromhex("68 0B 0B 68 E3 82 08 3E 3C 02 05 00 FF 0C DA D3 16")
SAME_LENGTH = bytes.fromhex("68 05 05 68 E3 82 08 3E 3C E7 16")  # an answer as long as REQUEST
TOKEN = bytes.fromhex("DC 02 02")


#: rule: mode, telegrams sent, (octets heard, octets that remain) in order, mode at the end, echoes lost
CASES: dict[str, tuple[Echo, list[bytes], list[tuple[bytes, bytes]], Echo, int]] = {
    "an echo in pieces is held back until it is whole": (
        Echo.AUTO,
        [REQUEST],
        [*((REQUEST[n : n + 1], b"") for n in range(10)), (REQUEST[10:] + ANSWER, ANSWER)],
        Echo.ON,
        0,
    ),
    "an answer that begins like the request is given back whole": (
        Echo.AUTO,
        [REQUEST],
        [(ANSWER[:1], b""), (ANSWER[1:], ANSWER), (b"\xe5", b"\xe5")],
        Echo.AUTO,
        0,
    ),
    "a short acknowledgement proves nothing": (
        Echo.AUTO,
        [b"\xe5"],
        [(b"\xe5" + TOKEN, b"\xe5" + TOKEN)],
        Echo.AUTO,
        0,
    ),
    "an echo may come after the next telegram was sent": (
        Echo.ON,
        [TOKEN, REQUEST],
        [(TOKEN + REQUEST[:4], b""), (REQUEST[4:] + ANSWER, ANSWER)],
        Echo.ON,
        0,
    ),
    "an echo that never came is counted and the next one removed": (
        Echo.ON,
        [TOKEN, REQUEST],
        [(REQUEST + ANSWER, ANSWER)],
        Echo.ON,
        1,
    ),
    # an adapter with a latency timer: the two tokens of a claim come back in one piece
    "two echoes may come in one piece": (
        Echo.AUTO,
        [TOKEN, TOKEN],
        [(TOKEN + TOKEN, b""), (ANSWER, ANSWER)],
        Echo.ON,
        0,
    ),
    "the first whole echo proves it while the next one is under way": (
        Echo.AUTO,
        [TOKEN, REQUEST],
        [(TOKEN, b"")],
        Echo.ON,
        0,
    ),
    # a host that stalls longer than the patience: the repetition has been sent meanwhile
    "two echoes may come in one piece with their answers": (
        Echo.ON,
        [REQUEST, REQUEST],
        [(REQUEST + ANSWER + REQUEST + ANSWER, ANSWER + ANSWER)],
        Echo.ON,
        0,
    ),
    "a late answer may come before the echo of the next telegram, whose end is in the next piece": (
        Echo.ON,
        [REQUEST],
        [(ANSWER + REQUEST[:5], ANSWER), (REQUEST[5:] + ANSWER, ANSWER)],
        Echo.ON,
        0,
    ),
    "an answer that begins like its request is whole when the echo is missing": (
        Echo.ON,
        [REQUEST],
        [(SAME_LENGTH, SAME_LENGTH), (ANSWER, ANSWER)],
        Echo.ON,
        0,
    ),
    "the same in pieces": (
        Echo.ON,
        [REQUEST],
        [*((b"", b"") for _ in range(2)), (SAME_LENGTH[:4], b""), (SAME_LENGTH[4:], SAME_LENGTH)],
        Echo.ON,
        0,
    ),
    "an echo without its end is removed as far as it goes": (
        Echo.ON,
        [REQUEST],
        [(REQUEST[:7], b""), (ANSWER, ANSWER)],
        Echo.ON,
        1,
    ),
    "the echo of a token with one wrong address is no token": (
        Echo.ON,
        [TOKEN, TOKEN],
        [(b"\xdc\x02\x03" + ANSWER, ANSWER), (b"\xdc\x12", b""), (b"\x02" + ANSWER, ANSWER)],
        Echo.ON,
        2,
    ),
    "the same behind a telegram whose echo never came": (
        Echo.ON,
        [REQUEST, TOKEN],
        [(b"\xdc\x02\x03" + ANSWER, ANSWER)],
        Echo.ON,
        2,
    ),
    "a token of two other masters is one": (
        Echo.ON,
        [TOKEN],
        [(b"\xdc\x05\x03", b"\xdc\x05\x03")],
        Echo.ON,
        0,
    ),
    "an echo that has ended is looked for anew": (
        Echo.ON,
        [TOKEN] * 32,
        [(ANSWER, ANSWER)],
        Echo.AUTO,
        31,
    ),
    "after a proof the next echo is removed too": (
        Echo.AUTO,
        [TOKEN, REQUEST],
        [(TOKEN, b""), (REQUEST + ANSWER, ANSWER)],
        Echo.ON,
        0,
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_the_echo_is_removed_and_nothing_else(case: str) -> None:
    mode, sent, heard, at_end, lost = CASES[case]
    echo = EchoFilter(mode)
    for telegram in sent:
        echo.sent(telegram)
    assert [echo.strip(octets) for octets, _ in heard] == [remain for _, remain in heard]
    assert echo.state is at_end
    assert echo.lost == lost
    assert echo.release() == b""


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


@pytest.mark.parametrize("damaged", range(11))
def test_a_damaged_echo_is_counted_and_passed_on(damaged: int) -> None:
    """Its sound begin is left out where it is longer than an answer's may be."""
    echo = EchoFilter(Echo.ON)
    echo.sent(REQUEST)
    heard = REQUEST[:damaged] + b"\xaa" + REQUEST[damaged + 1 :]
    assert echo.strip(heard) == heard[damaged if damaged > 4 else 0 :]
    echo.sent(TOKEN)
    assert echo.strip(TOKEN + ANSWER) == ANSWER
    assert echo.lost == 1


async def exchange(rig: Rig, sent: bytes, received: bytes) -> None:
    """The driver sends ``sent``, then its port receives ``received``."""
    rig.driver.command(sent)
    rig.far.write(received)
    await rig.settle()


@pytest.mark.usefixtures("each_driver")
async def test_an_echo_is_recognised_reported_and_removed() -> None:
    async with Rig(echo=Echo.AUTO) as rig:
        for answer in (b"\xe5", REQUEST):
            await exchange(rig, TOKEN, TOKEN + answer)
        assert rig.machine.received == [b"\xe5", REQUEST]
        assert rig.driver.echo is Echo.ON
        assert ["echo" in event.text for event in rig.events] == [True]


@pytest.mark.usefixtures("each_driver")
async def test_a_line_without_echo_is_recognised_too() -> None:
    async with Rig(echo=Echo.AUTO) as rig:
        for _ in range(5):
            await exchange(rig, TOKEN, REQUEST)
        assert rig.machine.received == [REQUEST] * 5
        assert rig.driver.echo is Echo.OFF


@pytest.mark.usefixtures("each_driver")
async def test_octets_held_back_for_an_echo_reach_the_machine_at_a_deadline() -> None:
    async with Rig(echo=Echo.AUTO) as rig:
        await exchange(rig, REQUEST, REQUEST[:2])
        assert not rig.machine.did("receive")
        rig.driver.command(NS_PER_MS)
        await until(lambda: bool(rig.machine.did("wake")), "the deadline")
        assert rig.machine.received == [REQUEST[:2]]


@pytest.mark.usefixtures("each_driver")
async def test_a_line_that_begins_to_echo_later_is_recognised() -> None:
    """The machine reports another station with its own address; the driver looks for an echo again."""
    async with Rig(echo=Echo.AUTO) as rig:
        for _ in range(3):
            await exchange(rig, TOKEN, REQUEST)
        found: list[Echo] = [rig.driver.echo]
        rig.machine.on_receive = lambda _chunk, now: rig.machine.events.append(AddressCollision(t_ns=now, address=2))
        await exchange(rig, TOKEN, TOKEN)
        rig.machine.on_receive = lambda _chunk, _now: None
        await exchange(rig, TOKEN, TOKEN + b"\xe5")
        assert [*found, rig.driver.echo] == [Echo.OFF, Echo.ON]
        assert rig.machine.received == [REQUEST] * 3 + [TOKEN, b"\xe5"]


@pytest.mark.usefixtures("each_driver")
async def test_a_line_without_echo_by_order_is_never_looked_at_again() -> None:
    async with Rig(echo=Echo.OFF) as rig:
        rig.machine.on_receive = lambda _chunk, now: rig.machine.events.append(AddressCollision(t_ns=now, address=2))
        for _ in range(2):
            await exchange(rig, TOKEN, TOKEN)
        assert rig.machine.received == [TOKEN] * 2


@pytest.mark.usefixtures("each_driver")
async def test_an_echo_that_ends_is_reported_and_answers_pass() -> None:
    async with Rig(echo=Echo.AUTO) as rig:
        await exchange(rig, TOKEN, TOKEN + b"\xe5")
        for _ in range(40):
            await exchange(rig, REQUEST, SAME_LENGTH)
        assert rig.machine.received == [b"\xe5", *[SAME_LENGTH] * 40]
        assert rig.driver.echo is Echo.OFF
        assert [event.text.partition(" ")[2] for event in rig.events] == [
            "the line echoes what is sent: the echo is removed",
            "the line no longer echoes what is sent",
        ]
