"""Faults of the fault matrix on the wire: bit errors, bursts, lost, late, doubled and truncated telegrams."""

from __future__ import annotations

from fault_matrix import Begin, End, Fault
from fault_matrix_plant import Plant

RING_RATES = (19_200, 500_000, 12_000_000)


def bit_errors(per_bit: float) -> Begin:
    """Each bit on the wire is inverted with the probability ``per_bit``."""

    def begin(plant: Plant) -> End:
        plant.world.faults.noise(per_bit)
        return plant.world.faults.clear

    return begin


def _bit_errors() -> list[Fault]:
    return [
        Fault(
            name=f"bit errors {per_bit:g}",
            begin=bit_errors(per_bit),
            quick=((500_000, 8), (12_000_000, 1)),
        )
        for per_bit in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
    ]


WIRE_FAULTS = [*_bit_errors()]
