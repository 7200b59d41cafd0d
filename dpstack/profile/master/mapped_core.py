"""Master side of a drive with process data maps: orders to read and write maps and values."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, Generic, Literal, TypeVar

from dpstack.errors import ConfigError
from dpstack.profile.channel.base import ParamKey
from dpstack.profile.master.core import DriveCore
from dpstack.profile.model import process_data_map
from dpstack.profile.model.drive_type import Options
from dpstack.profile.model.jobs import Args, CommandError, Steps
from dpstack.profile.model.process_data_map import DataMap, Field

M = TypeVar("M", bound=DataMap)
#: maps read from and written to the drive, all values of the inputs, one value of the outputs
MAP_OPS: Final = ("read_map", "write_map", "inputs", "output")
_TIMEOUT_S: Final = 10.0


class MappedCore(DriveCore, Generic[M]):
    """The orders of :data:`MAP_OPS`, as far as ``own_ops`` names them.

    ``read_map``; ``write_map`` (``inputs``, ``outputs``: texts, what is not given stays); ``inputs``; ``output``
    (``number``: name or key of a field of the output map, ``value`` in its unit). A map or a value that cannot be
    raises before anything is sent.

    An output that is a parameter of the drive (a field that is not ``neutral``) is never sent without a value: it has
    one behind its name in the option (``dr-04=2.5``), in ``write_map``, or by ``output``; until then ``start`` is
    refused. It keeps the last one in the safe outputs and when the drive was away, all others fall back to those of
    the option.
    """

    own_ops: tuple[str, ...] = MAP_OPS
    #: remedy where the telegram has no parameter channel, for people
    channel_hint: str = ""
    #: the options with the map of the inputs and of the outputs
    map_options: tuple[str, str] = ("map_inputs", "map_outputs")
    #: name of the output map for people
    outputs_name: str = "the output map"

    #: the drive's maps; None until they are known
    inputs_map: M | None
    outputs_map: M | None
    #: the word at which the inputs' map begins, and that of the outputs
    inputs_at: int = 0
    outputs_at: int = 0
    #: octet order of a word
    octet_order: Literal["big", "little"] = "big"
    #: values of the outputs by key: those of the option, and the present ones
    presets: Mapping[int, int] = MappingProxyType({})
    values: dict[int, int]
    _last_map: M | None = None
    #: maps that act after the next power-on, as options; and whether a power-on was possible since
    _later: str | None = None
    _doubtful = False

    @property
    def writes_later(self) -> bool:
        """Other maps than the plugin's were written to the drive, which takes them at its next power-on."""
        return self._later is not None

    def maps_of_options(self, options: Options) -> tuple[M, M]:
        """Maps of the inputs and of the outputs in the options; takes the values in the latter. Raises ConfigError."""
        inputs_option, outputs_option = self.map_options
        values = str(options[outputs_option])
        option = inputs_option
        try:
            inputs = self.option_map(str(options.get(inputs_option, "")), outputs=False)
            option = outputs_option
            outputs = self.option_map(process_data_map.split(values)[0], outputs=True)
            self.presets = process_data_map.given(process_data_map.split(values)[1], outputs.fields)
        except ValueError as error:
            raise ConfigError(f"{self.title}: {option}: {error}") from None
        if (wrong := self.check_maps(inputs, outputs)) is not None:
            raise ConfigError(f"{self.title}: {wrong}")
        self.values = dict(self.presets)
        return inputs, outputs

    def refuse_zeros(self) -> None:
        """For a map that counts from the first cycle on. Raises ConfigError where a parameter has no value."""
        if missing := self.missing():
            raise ConfigError(
                f"{self.title}: {self.map_options[1]}: {', '.join(missing)} would be written with 0 from the first "
                f"cycle on: give the value in the map, {missing[0].partition(' ')[0]}=VALUE"
            )

    def encode(self, control: int, setpoint: int) -> bytes:
        """Control word, set point, and the values of the map in the words behind them."""
        assert self.outputs_map is not None
        mapped = process_data_map.pack(self.outputs_map.fields, self.values, len(self.rest))
        return self.pack(control, setpoint, *mapped)

    def missing(self) -> list[str]:
        """Names of the parameters among the outputs that have no value."""
        fields = () if self.outputs_map is None else self.outputs_map.fields
        return [f.name for f in fields if f is not None and not f.neutral and f.key not in self.values]

    def lost(self, now: int) -> None:
        """Parameters keep their values; commands and set points fall back to those of the option."""
        self._last_map = self.outputs_map or self._last_map
        self._doubtful |= self._later is not None
        self.values = {**self.presets, **self._parameters()}
        super().lost(now)

    def safe(self, configured: bytes) -> bytes:
        """The safe outputs with the present values of parameters: a ramp time of 0 is not safe."""
        outputs = self.outputs_map or self._last_map
        if configured != self.safe_outputs or outputs is None:
            return configured
        octets = bytearray(configured)
        begin = len(octets) - self.telegram.outputs + 2 * self.outputs_at
        words = process_data_map.pack(outputs.fields, self.values, (len(octets) - begin) // 2)
        for at, field in process_data_map.places(outputs.fields):
            if not field.neutral:
                for place in range(at, min(at + field.octets // 2, len(words))):
                    octets[begin + 2 * place : begin + 2 * place + 2] = words[place].to_bytes(2, self.octet_order)
        return bytes(octets)

    def prepare(self, deadline: int) -> Steps[None]:
        """Refuse a start with a parameter without a value, or with maps that may not be the drive's."""
        yield from ()
        if self._doubtful:
            raise CommandError(
                "fault",
                "other maps were written to the drive, and it was away since: if it was switched off they act. "
                f"Open the bus anew with {self._later} among the options",
            )
        if missing := self.missing():
            raise CommandError(
                "fault",
                f"{', '.join(missing)} in {self.outputs_name} would be written with 0: give a value first, "
                f"by order('output', number='{missing[0].partition(' ')[0]}', value=...) or in the option of the map",
            )

    def order(self, op: str, args: Args) -> Steps[dict[str, object]] | None:
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

    # -- hooks for a plugin ---------------------------------------------------------------------------------------

    @abstractmethod
    def parse_map(self, text: str, *, outputs: bool) -> M:
        """Read a map from a text of the user's. Raises ValueError."""

    def option_map(self, text: str, *, outputs: bool) -> M:
        """Read a map from an option; the text may be empty. Raises ValueError."""
        return self.parse_map(text, outputs=outputs)

    def present_maps(self) -> tuple[M, M]:
        """The maps that ``write_map`` writes where none is given."""
        assert self.inputs_map is not None
        assert self.outputs_map is not None
        return self.inputs_map, self.outputs_map

    def check_maps(self, inputs: M, outputs: M) -> str | None:
        """Why the drive would refuse the two maps together; None where it accepts them."""
        return None

    def read_map(self, deadline: int) -> Steps[dict[str, object]]:
        raise NotImplementedError

    def write_map(self, inputs: M, outputs: M, deadline: int) -> Steps[dict[str, object]]:
        """Write maps that were checked."""
        raise NotImplementedError

    def known(self, deadline: int) -> Steps[None]:
        """Wait until both maps are known."""
        yield from ()

    def read_by(self, field: Field) -> ParamKey | None:
        """The parameter to read for an output before a map acts at once; None: it is not read."""
        return None

    def called(self, name: str | int) -> str | int:
        """Name or key of an output for the name that a user wrote."""
        return name

    def written_by(self, key: int) -> str | None:
        """The orders that write an output, which ``output`` therefore does not; None where none does."""
        return None

    # -- inside ---------------------------------------------------------------------------------------------------

    def _write(self, inputs: str | None, outputs: str | None, deadline: int) -> Steps[dict[str, object]]:
        """The job of ``write_map``; None: the present map stays."""
        new_inputs, new_outputs = self.present_maps()
        values: dict[int, int] = {}
        try:
            if inputs is not None:
                new_inputs = self.parse_map(inputs, outputs=False)
            if outputs is not None:
                bare, behind = process_data_map.split(outputs)
                new_outputs = self.parse_map(bare, outputs=True)
                values = process_data_map.given(behind, new_outputs.fields)
            if (wrong := self.check_maps(new_inputs, new_outputs)) is not None:
                raise ValueError(wrong)
        except ValueError as error:
            raise CommandError("usage", f"write_map: {error}") from None
        return self._write_maps(new_inputs, new_outputs, values, deadline)

    def _write_maps(self, inputs: M, outputs: M, values: dict[int, int], deadline: int) -> Steps[dict[str, object]]:
        """A parameter without a value gets the drive's present one before the map acts."""
        for field in outputs.fields:
            if field is None or field.neutral or field.key in values or field.key in self.values:
                continue
            if (key := self.read_by(field)) is not None and self.access is not None:
                values[field.key] = yield from self.access.read_raw(key, deadline)
        self.values |= values
        outcome = yield from self.write_map(inputs, outputs, deadline)
        if "acts" in outcome:
            self._write_later(inputs, outputs)
        else:
            self.settings_check.changed()
        return outcome

    def _write_later(self, inputs: M, outputs: M) -> None:
        if (inputs, outputs) == (self.inputs_map, self.outputs_map):
            self._later, self._doubtful = None, False
            return
        self._later = f"map_inputs = '{inputs}' and map_outputs = '{outputs}'"
        needed = [field.name.partition(" ")[0] for field in outputs.fields if field is not None and not field.neutral]
        if needed:
            self._later += f" (with {', '.join(f'{name}=VALUE' for name in needed)})"
        self.notice(
            "end the bus before the drive is switched off and on: this plugin goes on with the maps it was told, "
            f"and needs {self._later} then"
        )

    def _parameters(self) -> dict[int, int]:
        """Present values of the outputs that are not neutral."""
        outputs = self.outputs_map or self._last_map
        fields = () if outputs is None else outputs.fields
        return {f.key: self.values[f.key] for f in fields if f is not None and not f.neutral and f.key in self.values}

    def _inputs_values(self, deadline: int) -> Steps[dict[str, object]]:
        yield from self.known(deadline)
        if not self.online or self.inputs_map is None:
            raise CommandError("lost", "the drive is not in data exchange")
        return {"value": process_data_map.decoded(self.inputs_map.fields, self.words[self.inputs_at :])}

    def _output(self, name: str | int, value: float, deadline: int) -> Steps[dict[str, object]]:
        yield from self.known(deadline)
        outputs = self.outputs_map
        field = None if outputs is None else process_data_map.find(outputs.fields, self.called(name))
        if field is None:
            raise CommandError("usage", f"output: {name!r} is not in {self.outputs_name} ({str(outputs) or 'empty'})")
        if (orders := self.written_by(field.key)) is not None:
            raise CommandError("usage", f"output: {field.name} is written by {orders}")
        try:
            raw = field.encode(value)
        except ValueError as error:
            raise CommandError("usage", f"output: {error}") from None
        self.values[field.key] = raw
        self.dirty = True
        return {"value": value}
