"""Which way a parameter goes: over record 47 where the drive has it, over the cyclic channel where not."""

from __future__ import annotations

from dpstack.profile.acyclic.access import AcyclicAccess
from dpstack.profile.channel import ParameterChannel, ParamKey
from dpstack.profile.jobs import CommandError, Steps


class ChosenAccess:
    """A :class:`~dpstack.profile.channel.ParameterChannel` of both; ``cyclic`` None where the telegram has none.

    The way is chosen when an order begins: one that runs stays where it is.
    """

    __slots__ = ("_acyclic", "_cyclic")

    def __init__(self, acyclic: AcyclicAccess, cyclic: ParameterChannel | None) -> None:
        self._acyclic = acyclic
        self._cyclic = cyclic

    @property
    def octets(self) -> bytes:
        """Those of the cyclic channel."""
        return b"" if self._cyclic is None else self._cyclic.octets

    @property
    def busy(self) -> bool:
        """The cyclic channel wants to be stepped."""
        return self._cyclic is not None and self._cyclic.busy

    def step(self, inputs: bytes, now: int) -> None:
        """One cycle of the cyclic channel."""
        if self._cyclic is not None:
            self._cyclic.step(inputs, now)

    def reset(self) -> None:
        """The slave left data exchange."""
        self._acyclic.reset()
        if self._cyclic is not None:
            self._cyclic.reset()

    def read(self, key: ParamKey, deadline: int) -> Steps[dict[str, object]]:
        """Read one parameter."""
        return (yield from self._way().read(key, deadline))

    def write(self, key: ParamKey, value: float, deadline: int) -> Steps[dict[str, object]]:
        """Write one parameter."""
        return (yield from self._way().write(key, value, deadline))

    def _way(self) -> ParameterChannel:
        if self._acyclic.available:
            return self._acyclic
        if self._cyclic is None:
            raise CommandError(
                "parameter",
                "the telegram has no parameter channel and the slave serves no records now: switch DP-V1 on for it, "
                "or take a telegram with a parameter channel",
            )
        return self._cyclic
