"""A drive whose process data carry more than control word and set point, as its maps say: the orders about them."""

from __future__ import annotations

from abc import abstractmethod
from typing import Final, Generic, TypeVar

from dpstack.profile import datamap
from dpstack.profile.core import DriveCore
from dpstack.profile.datamap import DataMap
from dpstack.profile.jobs import Args, CommandError, Steps

M = TypeVar("M", bound=DataMap)
#: maps read from and written to the drive, all values of the inputs, one value of the outputs
MAP_OPS: Final = ("read_map", "write_map", "inputs", "output")
_TIMEOUT_S: Final = 10.0


class MappedCore(DriveCore, Generic[M]):
    """The orders of :data:`MAP_OPS`, as far as ``own_ops`` names them.

    ``read_map``; ``write_map`` (``inputs``, ``outputs``: texts, what is not given stays); ``inputs``; ``output``
    (``number``: name or key of a field of the output map, ``value`` in its unit). A map or a value that cannot be
    raises before anything is sent.
    """

    own_ops: tuple[str, ...] = MAP_OPS
    #: what to do where the telegram has no parameter channel, for people
    channel_hint: str = ""
    #: what people call the output map
    outputs_name: str = "the output map"

    #: as the drive has them; None until that is known
    inputs_map: M | None
    outputs_map: M | None
    #: the word at which the inputs' map begins
    inputs_at: int = 0
    #: what the application gave, by key
    values: dict[int, int]

    def order(self, op: str, args: Args) -> Steps[dict[str, object]] | None:
        """See the class."""
        if op not in MAP_OPS or op not in self.own_ops:
            return None
        deadline = self.now + args.timeout_ns(_TIMEOUT_S)
        match op:
            case "inputs":
                return self._inputs_values(deadline)
            case "output":
                return self._output(args.name_or_number("number"), args.number("value"), deadline)
        if self.access is None:
            raise CommandError("usage", f"{op}: {self.telegram.name} has no parameter channel{self.channel_hint}")
        if op == "read_map":
            return self.read_map(deadline)
        return self._write(args.text("inputs"), args.text("outputs"), deadline)

    # -- hooks: what a plugin gives ---------------------------------------------------------------------------------

    @abstractmethod
    def parse_map(self, text: str | None, *, outputs: bool) -> M:
        """What a user wrote; None: the map as it is to be without that. Raises ValueError."""

    def check_maps(self, inputs: M, outputs: M) -> str | None:
        """Why the drive would not take two maps together; None where it would."""
        return None

    def read_map(self, deadline: int) -> Steps[dict[str, object]]:
        """Ask the drive for its maps."""
        raise NotImplementedError

    def write_map(self, inputs: M, outputs: M, deadline: int) -> Steps[dict[str, object]]:
        """Write maps that were checked."""
        raise NotImplementedError

    def known(self, deadline: int) -> Steps[None]:
        """Wait until both maps are known."""
        yield from ()

    def called(self, name: str | int) -> str | int:
        """Name or key of an output as a user wrote it."""
        return name

    def written_by(self, key: int) -> str | None:
        """The orders that write an output, which ``output`` therefore does not; None where none does."""
        return None

    # -- inside ---------------------------------------------------------------------------------------------------

    def _write(self, inputs: str | None, outputs: str | None, deadline: int) -> Steps[dict[str, object]]:
        try:
            maps = self.parse_map(inputs, outputs=False), self.parse_map(outputs, outputs=True)
        except ValueError as error:
            raise CommandError("usage", f"write_map: {error}") from None
        if (wrong := self.check_maps(*maps)) is not None:
            raise CommandError("usage", f"write_map: {wrong}")
        return self.write_map(*maps, deadline)

    def _inputs_values(self, deadline: int) -> Steps[dict[str, object]]:
        yield from self.known(deadline)
        if not self.online or self.inputs_map is None:
            raise CommandError("lost", "the drive is not in data exchange")
        return {"value": datamap.decoded(self.inputs_map.fields, self.words[self.inputs_at :])}

    def _output(self, name: str | int, value: float, deadline: int) -> Steps[dict[str, object]]:
        yield from self.known(deadline)
        outputs = self.outputs_map
        field = None if outputs is None else datamap.find(outputs.fields, self.called(name))
        if field is None:
            raise CommandError("usage", f"output: {name!r} is not in {self.outputs_name} ({str(outputs) or 'empty'})")
        if (orders := self.written_by(field.key)) is not None:
            raise CommandError("usage", f"output: {field.name} is written by {orders}")
        try:
            raw = field.encode(value)
        except ValueError as error:
            raise CommandError("usage", f"output: {error}") from None
        self.values[field.key] = raw
        self._dirty = True
        return {"value": value}
