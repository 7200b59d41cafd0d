"""Undisturbed rounds of a planned bus in virtual time: their durations, read from the octets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

from bus_kit import SimBus, setup
from support import S, WorldFactory

from dpstack.dp.plan.rotation_time import Case, rotation
from dpstack.dp.slave_params import SlaveParams
from dpstack.params import BusParams
from dpstack.trace import WireEntry

MASTER = 2
FIRST = 3


def identifiers(inputs: int, outputs: int) -> bytes:
    """Identifier octets for so many octets each way, in modules of 16 at most; an empty slot for none."""
    octets = bytearray()
    for left, kind in ((inputs, 0x10), (outputs, 0x20)):
        while left:
            octets.append(kind | (min(left, 16) - 1))
            left -= min(left, 16)
    return bytes(octets or b"\x00")


def setups(configs: Sequence[bytes], min_tsdr: int = 11) -> list[SlaveParams]:
    """Slaves from address 3 on."""
    return [setup(FIRST + n, name=f"s{n}", config=config, min_tsdr=min_tsdr) for n, config in enumerate(configs)]


def kind(entry: WireEntry) -> str:
    """The kind of a transmission on the wire."""
    octets = entry.octets
    if octets[0] == 0xDC:
        return "token"
    if octets[0] == 0x10 and octets[3] == 0x49:
        return "gap poll"
    mine = entry.sender == str(MASTER)
    if octets[0] == 0x68 and octets[4] & 0x7F == 127:
        return "global control"
    if octets[0] == 0x68 and octets[4] & 0x80:
        return "service"
    return "request" if mine else "answer"


def first_request(entry: WireEntry) -> bool:
    """Data_Exchange with the first slave, SD1 or SD2."""
    at = 1 if entry.octets[0] == 0x10 else 4
    return kind(entry) == "request" and entry.octets[at] == FIRST


def undisturbed(
    world: WorldFactory,
    params: BusParams,
    slaves: Sequence[SlaveParams],
    *,
    t_sdr: int | None = None,
    gap_polls: int = 0,
    rounds: int = 12,
) -> list[int]:
    """Durations in ns of those of ``rounds`` rounds that hold only data, the token and ``gap_polls`` unanswered polls.

    Slow rounds all have a Global_Control: 13 characters and T_ID2, which are taken off.
    """
    w = world()
    bus = SimBus(w, params, slaves, t_sdr=t_sdr, watchdog_ms=650_000)
    turn = params.ns(rotation(params, slaves, Case.TYPICAL).bits)
    while not bus.exchanging:
        assert w.now < 3000 * S, "not all slaves in data exchange"
        w.run_for(5 * turn)
    entries: list[WireEntry] = []
    w.log.listener = entries.append
    w.run_for((rounds + 1) * turn)
    starts = [n for n, entry in enumerate(entries) if first_request(entry)]
    wanted = +Counter({"request": len(slaves), "answer": len(slaves), "token": 1, "gap poll": gap_polls})
    found = []
    for before, after in pairwise(starts):
        kinds = Counter(kind(entry) for entry in entries[before:after])
        controls = kinds.pop("global control", 0)
        if kinds == wanted:
            took = entries[after].start_ns - entries[before].start_ns
            found.append(took - params.ns(controls * (13 * 11 + params.t_id2)))
    return found
