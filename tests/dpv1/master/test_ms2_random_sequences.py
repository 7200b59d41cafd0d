"""Random answers of slaves in random order: every service over a class 2 connection has exactly one end, every
connection that was open, too, and none is kept.
"""

from __future__ import annotations

from collections import Counter

from hypothesis import given, note
from hypothesis import strategies as st
from ms2_kit import DL, MS, SC, Ms2Bus, connections_of, sd1, sd2
from octet_slave import NR, RR, RS, UE
from property_kit import examples

from dpstack.dp.acyclic.job import ServiceFailure
from dpstack.dp.acyclic.queue import CancelService
from dpstack.dpv1.master.orders import (
    CloseConnection,
    ConnectionOver,
    InitiateDone,
    OpenConnection,
    RecordDone,
    RecordOrder,
)
from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.pdu.read_write import Function
from dpstack.errors import UsageError
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.machine import LineDown, LineUp

LIMIT = 60 * MS


def pdu(text: str, fc: int = DL) -> bytes:
    """From the SAP that is asked: 99 stands for it."""
    return sd2(2, 4, fc, 50, 99, bytes.fromhex(text))


#: telegrams, or parts of one: lengths that lie, functions that do not exist, answers to others, ends of all kinds
_ODD = st.sampled_from(
    [
        None,
        None,
        SC,
        *(sd1(2, 4, code) for code in (0x00, NR, RR, UE, RS, 0x0C, 0x07)),
        *(
            pdu(text)
            for text in (
                "5E 01 02 02 01 02",
                "5E 01 03 01 55",
                "5F 01 02 02",
                "51 01 02 00",
                "5E 01 02 F0 55",
                "DE 80 B5 00",
                "DF 80 C2 00",
                "D1 80 B5 00",
                "D7 80 C3 00",
                "57 00",
                "57 F0 01 00 00 00 00 00 00 02 00 02 00 00 00 00",
                "56 2F 00 0A",
                "56 30 00 0A",
                "56 63 00 0A",
                "48 01",
                "48",
                "58 00 13",
                "58",
                "00",
                "5E 01 02 F1" + " 55" * 240,
            )
        ),
        pdu("5E 01 02 01 66", 0x0C),
        pdu("48 01", 0x0A),
        b"\x68\x00\xff",
    ]
)
_ORDERS = st.sampled_from("ooorrrwtxcmud.....l")


@examples(60)
@given(st.lists(_ODD, max_size=40), st.lists(_ORDERS, max_size=20), st.integers(0, 8))
def test_slaves_that_answer_anything(answers: list[bytes | None], steps: list[str], good: int) -> None:
    kit = Ms2Bus((4, 5))
    queue = list(answers)
    slave = kit.slaves[4]

    def says(octets: bytes) -> bytes | None:
        """``good`` requests as they should be, then anything, then as they should be."""
        if len(slave.requests) <= good or not queue:
            return slave.usual(octets)
        answer = queue.pop(0)
        if answer is None or len(answer) < 9:
            return answer
        sap = octets[7]
        return answer[:8] + bytes((sap,)) + answer[9:-2] + bytes(((answer[-2] + sap - 99) & 0xFF, 0x16))

    slave.says = dict.fromkeys(range(50), says)
    opened: list[int] = []
    ordered: Counter[int] = Counter()

    def order(command: object, token: int) -> None:
        try:
            kit.send(command)
        except UsageError:  # the connection is over, or 32 wait
            return
        ordered[token] += 1

    for step in steps:
        token = kit.next_token()
        ref = opened[token % len(opened)] if opened else 0
        match step:
            case "o":
                opened.append(token)
                order(OpenConnection(token, 4, InitiateReq(200 * MS), LIMIT, timeout_ns=1_000 * MS), token)
            case "r":
                order(RecordOrder(token, Function.READ, 1, 2, 8, connection=ref, timeout_ns=1_000 * MS), token)
            case "w":
                order(
                    RecordOrder(token, Function.WRITE, 1, 2, data=b"\1\2", connection=ref, timeout_ns=1_000 * MS), token
                )
            case "t":
                order(
                    RecordOrder(token, Function.DATA_TRANSPORT, 1, 2, data=b"\1", connection=ref, timeout_ns=100 * MS),
                    token,
                )
            case "x":
                kit.send(CloseConnection(ref))
            case "c":
                kit.send(CancelService(token - 1))
            case "m" | "u":
                slave.mute = step == "m"
            case "d":
                kit.send(LineDown("out"))
                kit.run(3)
                kit.send(LineUp())
            case "l":
                kit.send(GoOffline())
                kit.run(5)
                kit.send(GoOnline())
            case _:
                kit.run(7)
    for ref in opened:
        kit.send(CloseConnection(ref))
    end = kit.bus.now + 1_500 * MS
    while (kit.acyclic.waiting or connections_of(kit.acyclic)) and kit.bus.now < end:
        kit.run(10)
    note("\n".join(kit.bus.octets()[-60:]))
    assert kit.acyclic.waiting == connections_of(kit.acyclic) == 0
    done = [event for event in kit.bus.events if isinstance(event, (InitiateDone, RecordDone))]
    assert Counter(event.token for event in done) == ordered
    were_open = [e.token for e in done if isinstance(e, InitiateDone) and e.outcome.failure is None]
    assert Counter(event.connection for event in kit.events_of(ConnectionOver)) == Counter(were_open)
    for event in done:
        outcome = event.outcome
        assert (outcome.failure is None) or "slave 4" in outcome.text
        if isinstance(event, RecordDone) and outcome.failure is None and event.function is Function.READ:
            assert outcome.data in (b"\1\2", b"\x66")
        if outcome.failure is ServiceFailure.NEGATIVE:
            assert outcome.codes is not None
    # the other slave noticed nothing, and the bus goes on
    slave.mute = False
    token = kit.open(5).token
    assert kit.read(token).outcome.data == b"\1\2"
