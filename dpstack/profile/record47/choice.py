"""Which way a parameter goes: over record 47 where the drive has it, over the cyclic channel where not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from dpstack.profile.channel.base import ParameterChannel, ParamKey
from dpstack.profile.channel.read_many import Found, read_many
from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.profile.record47.client import NoRecordError
from dpstack.profile.record47.drive_access import AcyclicAccess

T = TypeVar("T")


class ChosenAccess:
    """A :class:`~dpstack.profile.channel.base.ParameterChannel` of both; ``cyclic`` None where the telegram has none.

    A drive that refuses record 47 as such is asked by the cyclic channel from then on, until it comes back.
    """

    __slots__ = ("_absent", "_acyclic", "_cyclic")

    def __init__(self, acyclic: AcyclicAccess, cyclic: ParameterChannel | None) -> None:
        self._acyclic = acyclic
        self._cyclic = cyclic
        self._absent = False

    @property
    def octets(self) -> bytes:
        """Those of the cyclic channel."""
        return b"" if self._cyclic is None else self._cyclic.octets

    @property
    def per_request(self) -> int:
        """Parameters of one request over record 47; the cyclic channel takes as many orders."""
        return self._acyclic.per_request

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
        self._absent = False
        self._acyclic.reset()
        if self._cyclic is not None:
            self._cyclic.reset()

    def read(self, key: ParamKey, deadline: int) -> Steps[dict[str, object]]:
        """Read one parameter."""
        return self._over(lambda way: way.read(key, deadline))

    def read_many(self, keys: Sequence[ParamKey], deadline: int) -> Steps[Found]:
        """Read several."""
        return self._over(lambda way: read_many(way, keys, deadline))

    def write(self, key: ParamKey, value: float, deadline: int) -> Steps[dict[str, object]]:
        """Write one parameter."""
        return self._over(lambda way: way.write(key, value, deadline))

    def _over(self, ask: Callable[[ParameterChannel], Steps[T]]) -> Steps[T]:
        """Over record 47; where there is none on with the cyclic channel, or the end where there is none either."""
        cyclic = self._cyclic
        if cyclic is None or not self._absent:
            try:
                return (yield from ask(self._acyclic))
            except NoRecordError as error:
                self._absent = True
                if cyclic is None:
                    text = f"{error.text}; a telegram with a parameter channel needs none"
                    raise CommandError(error.kind, text, error.number) from None
        return (yield from ask(cyclic))
