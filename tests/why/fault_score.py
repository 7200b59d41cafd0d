"""The score of a diagnosis on the table of faults: each plant is run, proved and asked about.

``python tests/why score [FAULT,...] [SEEDS]`` prints it.
"""

from __future__ import annotations

import collections
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import dpstack
from tests.why.fault_plants import bring
from tests.why.fault_proofs import PROOFS
from tests.why.fault_table import ALL, SEEDS

#: a cause with this confidence must be right
SURE: Final = 0.9


@dataclass(frozen=True)
class Outcome:
    """A plant and what was said about it: ``causes`` with their confidence, the likeliest first."""

    fault: str
    seed: int
    wanted: frozenset[str]
    every: bool
    causes: tuple[tuple[str, float], ...]

    @property
    def first_is_right(self) -> bool:
        return self.causes[0][0] in self.wanted

    @property
    def is_right(self) -> bool:
        """The first cause is right; of a pair of faults both are named."""
        return self.first_is_right and (not self.every or self.wanted <= {cause for cause, _ in self.causes})

    @property
    def sure_and_wrong(self) -> list[str]:
        """The causes that are said with great confidence and are wrong."""
        return [cause for cause, confidence in self.causes if confidence >= SURE and cause not in self.wanted]


def outcome_of(fault: str, seed: int) -> Outcome:
    """Run the plant ``fault`` with ``seed``, prove its trouble, ask why."""
    plant = ALL[fault](seed)

    async def program() -> tuple[tuple[str, float], ...]:
        async with bring(plant) as bus:
            PROOFS[fault](plant)
            story = await bus.why(plant.name)
        return tuple((likely.cause, likely.confidence) for likely in story.causes)

    return Outcome(fault, seed, plant.causes, plant.every, dpstack.run_virtual(program()))


def share_right(outcomes: Iterable[Outcome]) -> dict[str, float]:
    """For each fault the part of its seeds that are right."""
    found: dict[str, list[bool]] = collections.defaultdict(list)
    for one in outcomes:
        found[one.fault].append(one.is_right)
    return {fault: sum(right) / len(right) for fault, right in found.items()}


def main(argv: Sequence[str]) -> None:
    faults = argv[0].split(",") if argv and argv[0] != "all" else list(ALL)
    seeds = range(int(argv[1])) if len(argv) > 1 else SEEDS
    for fault in faults:
        outcomes = [outcome_of(fault, seed) for seed in seeds]
        wrong = [(one.seed, one.causes[:3]) for one in outcomes if not one.is_right]
        sure = [(one.seed, one.sure_and_wrong) for one in outcomes if one.sure_and_wrong]
        print(f"{fault:28}{len(outcomes) - len(wrong)}/{len(outcomes)}", *wrong[:3], *(["SURE", *sure] if sure else []))
