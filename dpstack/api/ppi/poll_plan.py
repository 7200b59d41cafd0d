"""The time on the bus that the polls of an S7-200 take: requests, their lengths, and whether they fit a fixed cycle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from msgspec import Struct

from dpstack.api.config.cpu import CpuConfig
from dpstack.api.ppi.cpu import LEAST_PDU
from dpstack.dp.plan.plan import Plan
from dpstack.dp.plan.rotation_time import Case
from dpstack.ppi.addresses import PpiAddress
from dpstack.ppi.pdu import PDU_LENGTH, answer_length, fit, read_request
from dpstack.units import BITS_PER_CHAR

#: octets around a PDU on the wire: SD, LE, LEr, SD, DA, SA, FC, FCS, ED; a poll without data; a short acknowledgement
_FRAME, _SD1, _SC = 9, 6, 1
#: octets of time around a PDU: the rest of its telegram, the other one of the exchange, and the idle times
_AROUND: Final = 30


def pdu_length_of(plan: Plan) -> int:
    """The longest PDU in octets that finds its time between two fixed cycles of ``plan``, its repetitions counted, but
    never less than one value needs; without a fixed cycle the longest of all."""
    return PDU_LENGTH if not plan.figures.cycle_ns else max(LEAST_PDU, min(PDU_LENGTH, _room(plan)))


def _room(plan: Plan) -> int:
    params = plan.params
    of_one = (plan.figures.cycle_ns - plan.figures.work_ns(Case.TYPICAL)) // (params.max_retry + 1)
    return (of_one - params.ns(params.t_sl)) // params.ns(BITS_PER_CHAR) - _AROUND


class PollPlan(Struct, frozen=True):
    """The polls of one CPU. ``requests``: of one poll; ``longest_bits``: the longest of its exchanges on the wire, with
    T_SDR and idle time; ``fits``: it finds its time between two fixed cycles."""

    cpu: CpuConfig
    requests: int
    longest_bits: int
    fits: bool

    def as_dict(self, plan: Plan) -> dict[str, object]:
        """As in ``plan --json``."""
        return {
            "address": self.cpu.address,
            "name": self.cpu.name,
            "values": len(self.cpu.values),
            "requests": self.requests,
            "poll_ms": self.cpu.poll_ms,
            "longest_us": round(plan.params.ns(self.longest_bits) / 1000, 1),
            "fits": self.fits,
        }


def poll_plan(cpu: CpuConfig, plan: Plan) -> PollPlan:
    """The polls of ``cpu`` on the bus of ``plan``."""
    parts = list(_requests(cpu, pdu_length_of(plan)))
    params = plan.params
    octets = max(
        max(len(read_request(0, part).octets) + _FRAME + _SC, _SD1 + answer_length(part) + _FRAME) for part in parts
    )
    bits = octets * BITS_PER_CHAR + params.max_tsdr + params.t_id1
    return PollPlan(cpu, len(parts), bits, not plan.figures.cycle_ns or _room(plan) >= LEAST_PDU)


def _requests(cpu: CpuConfig, pdu_length: int) -> Iterator[Sequence[PpiAddress]]:
    """The addresses of each read request of one poll."""
    wanted = [one.address for one in cpu.values.values()]
    while wanted:
        count = fit(wanted, pdu_length)
        yield wanted[:count]
        wanted = wanted[count:]
