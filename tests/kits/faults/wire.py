"""Faults of the fault matrix on the wire: bit errors, bursts, octets and telegrams lost, doubled, late or cut short."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from faults.matrix import RATES, Begin, End, Fault
from faults.plant import Plant
from support import S

from dpstack.sim.faults import Which
from dpstack.sim.transmission import Transmission
from dpstack.units import BAUD_RATES

NO_FAULT = "no fault"
#: bit times between the first and the second of two doubled telegrams: without a pause, after T_SYN, after the answer
GAPS = (0, 40, 400)
FEWER_RATES = (9_600, 500_000, 12_000_000)
#: for faults whose times are seconds: at 12 Mbit/s one second is 10 000 rotations, which tell no more
LOW_RATES = (9_600, 45_450, 500_000)
OTHER_RATES = tuple(rate for rate in BAUD_RATES if rate not in RATES)


def no_fault(plant: Plant) -> End:
    """Nothing: the figures that the others are to be compared with."""
    return plant.world.faults.clear


def bit_errors(per_bit: float) -> Begin:
    """Each bit on the wire is inverted with the probability ``per_bit``."""

    def begin(plant: Plant) -> End:
        plant.world.faults.noise(per_bit)
        return plant.world.faults.clear

    return begin


def lost_octets(per_octet: float) -> Begin:
    """Each octet on the wire is lost with the probability ``per_octet``."""

    def begin(plant: Plant) -> End:
        plant.world.faults.lose_octets(per_octet)
        return plant.world.faults.clear

    return begin


def bursts(per_bit: float, bits: int) -> Begin:
    """With each bit a burst of ``bits`` bits begins with the probability ``per_bit``; half of its bits are wrong."""

    def begin(plant: Plant) -> End:
        plant.world.faults.bursts(per_bit, bits)
        return plant.world.faults.clear

    return begin


def of_station(plant: Plant, share: float, *, answers: bool = False, address: int | None = None) -> Which:
    """Chooses a ``share`` of the telegrams of all stations, of all slaves (``answers``), or of one slave."""
    masters = {end.station.params.address for end in plant.masters}

    def which(tx: Transmission) -> bool:
        if tx.node is None or (address is not None and tx.node.station.address != address):
            return False
        return not (answers and tx.node.station.address in masters) and plant.rng.random() < share

    return which


def doubled(*, answers: bool) -> Begin:
    """One telegram in ten is on the wire twice, after one of :data:`GAPS`."""

    def begin(plant: Plant) -> End:
        for gap in GAPS:
            which = of_station(plant, 1 / 30, answers=answers)
            plant.world.faults.repeat(which, plant.params.ns(gap), times=None)
        return plant.world.faults.clear

    return begin


def truncated(plant: Plant) -> End:
    """One telegram in twenty ends early, after any octet but its last."""
    chosen = of_station(plant, 1 / 20)

    def which(tx: Transmission) -> bool:
        if not chosen(tx):
            return False
        plant.truth.meant[tx.start_ns] = tx.octets
        return True

    plant.world.faults.truncate(which, times=None)
    return plant.world.faults.clear


def late(by_ns: Callable[[Plant], int], share: float, *, victim: bool = False) -> Begin:
    """A ``share`` of the answers of all slaves, or of one, begins later; until then the slave hears nothing."""

    def begin(plant: Plant) -> End:
        chosen = of_station(plant, share, answers=True, address=plant.victim if victim else None)
        by = by_ns(plant)

        def which(tx: Transmission) -> bool:
            if not chosen(tx):
                return False
            assert tx.node is not None
            plant.truth.away.setdefault(tx.node.station.address, []).append((tx.start_ns, tx.end_ns + by))
            return True

        plant.world.faults.delay(which, by, times=None)
        return plant.world.faults.clear

    return begin


def _bit_errors() -> list[Fault]:
    found = [Fault(name=NO_FAULT, begin=no_fault, quick=((45_450, 1), (1_500_000, 8), (12_000_000, 32)))]
    quick = {
        1e-6: ((9_600, 8),),
        1e-5: ((500_000, 8),),
        1e-4: ((9_600, 1), (500_000, 8), (12_000_000, 1)),
        1e-3: ((45_450, 8), (500_000, 1), (12_000_000, 1)),
        1e-2: ((9_600, 1), (12_000_000, 1)),
    }
    for per_bit, chosen in quick.items():
        name, begin = f"bit errors {per_bit:g}", bit_errors(per_bit)
        found.append(Fault(name=name, begin=begin, quick=chosen))
        if 1e-6 < per_bit < 1e-2:
            found.append(Fault(name=name, begin=begin, rates=OTHER_RATES, stations=(1, 8)))
    return found


def _rings() -> list[Fault]:
    """Three masters with a slave each, at every rate."""
    options: dict[str, Any] = {
        "masters": 3,
        "rates": BAUD_RATES,
        "stations": (3,),
        "quick": ((500_000, 3),),
    }
    return [
        Fault(name=NO_FAULT, begin=no_fault, **options),
        *(Fault(name=f"bit errors {p:g}", begin=bit_errors(p), **options) for p in (1e-5, 1e-4, 1e-3)),
    ]


WIRE_FAULTS = [
    *_bit_errors(),
    *_rings(),
    Fault(name="lost octets 1e-3", begin=lost_octets(1e-3), rates=FEWER_RATES, quick=((500_000, 8),)),
    Fault(name="lost octets 1e-2", begin=lost_octets(1e-2), quick=((45_450, 1), (12_000_000, 1))),
    Fault(name="bursts of 20 bits", begin=bursts(2e-4, 20), quick=((9_600, 8), (500_000, 1))),
    Fault(name="bursts of 1000 bits", begin=bursts(1e-4, 1_000), rates=FEWER_RATES, quick=((500_000, 1),)),
    Fault(name="doubled telegrams", begin=doubled(answers=False), quick=((9_600, 1), (500_000, 8))),
    Fault(name="doubled answers", begin=doubled(answers=True), rates=FEWER_RATES, quick=((500_000, 1),)),
    Fault(
        name="one answer in ten late by T_SL",
        begin=late(lambda plant: plant.params.ns(plant.params.t_sl), 1 / 10),
        quick=((9_600, 1), (45_450, 8), (500_000, 1)),
    ),
    Fault(
        name="answers of a slave late by 1 s",
        begin=late(lambda _: S, 1 / 5, victim=True),
        rates=LOW_RATES,
        least_ns=3 * S,
        quick=((9_600, 8),),
    ),
    *(
        Fault(name=name, begin=begin, masters=3, stations=(3,), rates=FEWER_RATES)
        for name, begin in (
            ("lost octets 1e-2", lost_octets(1e-2)),
            ("bursts of 1000 bits", bursts(1e-4, 1_000)),
            ("doubled telegrams", doubled(answers=False)),
            ("truncated telegrams", truncated),
        )
    ),
    Fault(name="truncated telegrams", begin=truncated, quick=((45_450, 8), (12_000_000, 1))),
]
