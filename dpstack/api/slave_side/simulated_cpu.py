"""A simulated S7-200 of a plant file: its station, and what commands change in it."""

from __future__ import annotations

from collections.abc import Mapping

from dpstack.api.config.cpu import CpuConfig
from dpstack.errors import UsageError
from dpstack.fdl.passive.station import PassiveStation
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.ppi.addresses import PpiValue
from dpstack.ppi.cpu import CpuStation, SimulatedCpu
from dpstack.units import NEVER


class SimulatedPlantCpu:
    """The CPU of ``config`` as a station at ``params``. It keeps its memory until it is switched off.

    ``at_once``: it has its answer at the first poll, as masters of others give up at RR (docs/development/foreign.md).
    """

    def __init__(
        self, config: CpuConfig, params: BusParams, patience: Patience = EXACT, *, at_once: bool = False
    ) -> None:
        self.config = config
        #: memory, mode and clock behind the requests
        self.responder = CpuStation(answer_ns=0) if at_once else CpuStation()
        self.station = PassiveStation(config.address, self.responder, params, patience=patience)
        self.powered = True

    @property
    def name(self) -> str:
        return self.config.name

    @property
    def address(self) -> int:
        return self.config.address

    @property
    def who(self) -> str:
        return self.config.who

    def set_values(self, values: Mapping[str, object]) -> None:
        """Set named values, also inputs, timers and counters, as its program and its inputs would; all or none. Texts
        are read as people write them. Raises UsageError."""
        self.put(self.plain_values(values))

    def plain_values(self, values: Mapping[str, object]) -> dict[str, PpiValue]:
        """Named values by the addresses of the memory. Raises UsageError."""
        wanted = {}
        for name, value in values.items():
            one = self.config.value(name)
            try:
                wanted[one.address.text] = one.plain(one.field.read(value) if isinstance(value, str) else value)
            except ValueError as error:
                raise UsageError(f"{self.who}: {error}") from None
        return wanted

    def put(self, plain: Mapping[str, PpiValue]) -> None:
        """Set values by their addresses."""
        for text, value in plain.items():
            self.responder.cpu[text] = value

    def silence(self, until_ns: int) -> None:
        """Neither receive nor answer until ``until_ns``."""
        self.responder.silent_until = until_ns

    def power(self, on: bool) -> None:
        """Switch it off, or on with an empty memory."""
        if on is not self.powered:
            self.powered = on
            self.responder.silent_until = 0 if on else NEVER
            if on:
                self.responder.cpu = SimulatedCpu()

    def silent_ns(self, now: int) -> int:
        """The rest of a silence in ns, 0 without one."""
        return max(0, self.responder.silent_until - now) if self.powered else 0

    def as_dict(self) -> dict[str, object]:
        """Its state for people, as simulated slaves have theirs."""
        return {"name": self.name, "kind": "s7-200", "state": "answers" if self.powered else "off"} | {
            "requests": self.responder.requests
        }
