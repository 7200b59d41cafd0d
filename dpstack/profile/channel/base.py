"""A drive's parameters as the rest of the project sees them, by PKW, by a maker's own channel or over record 47."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.profile.model.params import ParamSpec, ParamTable


@dataclass(frozen=True, slots=True)
class ParamKey:
    """A parameter as a user names it. What ``data_set`` and ``index`` mean is the drive's; ``ram``: do not store it."""

    name: str | int
    data_set: int | None = None
    index: int | None = None
    ram: bool = False

    @property
    def place(self) -> int | None:
        """Data set or index, for drives where one octet stands for either."""
        return self.index if self.data_set is None else self.data_set

    def spec_in(self, table: ParamTable) -> ParamSpec | None:
        """What ``table`` has; None for a number that is not in it. Raises CommandError for a name that is not."""
        if not isinstance(self.name, str):
            return table.get(self.name)
        spec = table.named(self.name)
        if spec is None:
            near = " or ".join(table.nearest(self.name))
            hint = f"; did you mean {near}?" if near else ""
            raise CommandError("usage", f"no parameter is called {self.name!r}{hint}")
        return spec


class ParameterChannel(Protocol):
    """The master's end. Orders queue; each is a generator that ends with its outcome or raises CommandError.

    An outcome has ``value`` (in ``unit``), ``raw`` (the integer on the wire), ``number``, ``name``, ``unit`` and
    ``data_set``. Deadlines in ns.
    """

    @property
    def octets(self) -> bytes:
        """What to send now in front of the process data; empty where the channel is not part of them."""

    @property
    def busy(self) -> bool:
        """True while :meth:`step` is wanted in every cycle."""

    def step(self, inputs: bytes, now: int) -> None:
        """Judge the channel's octets in ``inputs`` (the first ones) and go on; never raises."""

    def reset(self) -> None:
        """The slave left data exchange: all orders are given up."""

    def read(self, key: ParamKey, deadline: int) -> Steps[dict[str, object]]: ...

    def write(self, key: ParamKey, value: float, deadline: int) -> Steps[dict[str, object]]:
        """Write one parameter; ``value`` in its unit, or the integer on the wire where its scale is unknown."""


class ChannelServer(Protocol):
    """The drive's end, asked once a scan."""

    def reset(self) -> None: ...

    def step(self, octets: bytes) -> bytes:
        """The reply to the octets of the order area (:data:`CHANNEL_LEN` both)."""
