"""``PlantCpu``: an S7-200 of the plant file for programs: its named values with quality, as ``bus.cpu()`` gives it."""

from __future__ import annotations

from collections.abc import Callable

from dpstack.api.ppi.cpu import Cpu
from dpstack.api.ppi.polling import CpuPolling
from dpstack.api.slave.quality import QualifiedValue
from dpstack.argcheck import Sealed
from dpstack.dp.process_image import Value


class PlantCpu(Sealed):
    """An S7-200 of the plant file: ``bus.cpu("press")``. The bus polls its values while it is open.

    In the live stream, in recordings and in connectors it is a station as the slaves are, in data exchange while it
    answers.
    """

    def __init__(self, polling: CpuPolling, now: Callable[[], int]) -> None:
        self._polling = polling
        self._now = now
        self._seal(PlantCpu)

    def __repr__(self) -> str:
        return f"<PlantCpu {self.name} ({self.address}) {self._polling.state.value}>"

    def __getitem__(self, name: str) -> Value | None:
        """The value of the last poll, whatever its quality; None for one that the CPU refuses, and before the first
        poll. Raises UsageError for an unknown name."""
        self._polling.config.value(name)
        return self._polling.value(name)

    @property
    def name(self) -> str:
        """Name in the configuration."""
        return self._polling.config.name

    @property
    def address(self) -> int:
        """Station address, 0..125."""
        return self._polling.config.address

    @property
    def who(self) -> str:
        """The CPU for messages: ``CPU 2 (press)``."""
        return self._polling.config.who

    @property
    def ready_now(self) -> bool:
        """Whether it answers."""
        return self._polling.ready_now

    @property
    def fault(self) -> str | None:
        """Why it does not answer, and what to do; None while it does, and before the first poll."""
        return self._polling.fault

    @property
    def polls(self) -> int:
        """Number of times that all values were read."""
        return self._polling.polls

    @property
    def values(self) -> dict[str, Value | None]:
        """All values as ``cpu[name]`` gives them."""
        return {name: self._polling.value(name) for name in self._polling.config.values}

    @property
    def cpu(self) -> Cpu:
        """The CPU for everything else: other addresses, mode and clock. Raises UsageError when the bus is not open."""
        return self._polling.cpu

    def value(self, name: str) -> QualifiedValue:
        """A value with its quality; the value of a bad one means nothing. Raises UsageError for an unknown name."""
        polling = self._polling
        value = polling.config.value(name).field.get(polling.image)
        judged = polling.judge(name, polling.judge_all(polling.described(self._now())))
        since = polling.read_ns if judged.since is None else round(judged.since)
        return QualifiedValue(value, judged.quality, judged.reason.with_note(judged.note), judged.reason, since)

    async def write(self, name: str, value: object) -> None:
        """Write a named value, scaled as it is read; a poll follows at once. ``allow_commands`` is about orders from
        outside: a program may write each value that the CPU lets it.

        Raises UsageError for an unknown name and for a value that does not fit, CpuRefused, SlaveTimeout, BusError.
        """
        await self._polling.write(name, value)
