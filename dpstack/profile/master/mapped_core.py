"""Master side of a drive with process data maps: orders to read and write maps and values."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from types import MappingProxyType
from typing import Final, Generic, Literal, NamedTuple, TypeVar, cast

from dpstack.errors import ConfigError
from dpstack.profile.channel.base import MapCodes, ParamKey
from dpstack.profile.master.core import DriveCore, settled
from dpstack.profile.master.guarded_writes import refuse_while_turning
from dpstack.profile.master.settings import Setting
from dpstack.profile.model import process_data_map
from dpstack.profile.model.drive_type import Options
from dpstack.profile.model.jobs import Args, CommandError, Steps
from dpstack.profile.model.params import POWER_ON, Use
from dpstack.profile.model.process_data_map import FieldMap, FieldTable, MapField
from dpstack.profile.model.states import Goal

M = TypeVar("M", bound=FieldMap)
#: maps read from and written to the drive, all values of the inputs, one value of the outputs
MAP_OPS: Final = ("read_map", "write_map", "inputs", "output")
_TIMEOUT_S: Final = 10.0


class _Maps(NamedTuple, Generic[M]):
    """Both maps, and the values of the outputs by key."""

    inputs: M
    outputs: M
    values: Mapping[int, int]


class MappedCore(DriveCore, Generic[M]):
    """The orders of :data:`MAP_OPS`, as far as ``own_ops`` names them.

    ``read_map``; ``write_map`` (``inputs``, ``outputs``: texts, what is not given stays); ``inputs``; ``output``
    (``number``: name or key of a field of the output map, ``value`` in its unit). A map or a value that cannot be
    raises before anything is sent.

    An output that is a parameter of the drive (a field that is not ``neutral``) is never sent without a value: it has
    one behind its name in the option (``dr-04=2.5``), in ``write_map``, or by ``output``; until then ``start`` is
    refused. It keeps the last one in the safe outputs and when the drive was away, all others fall back to those of
    the option.

    One rule for a change of maps (docs/reference/drives.md#maps), by the codes in ``map_codes`` and the column ``acts``
    of the drive's table: at standstill only; control word and set point go to their safe values first; the drive's
    output map is emptied before the octets become those of the new one; then the new codes are written, read back
    and compared. If the codes act from the drive's power-on, ``start`` and set points are refused from the write on,
    until the drive has the maps of the options.
    """

    #: the orders of :data:`MAP_OPS` that the plugin takes
    own_ops: tuple[str, ...] = MAP_OPS
    #: remedy if the telegram has no parameter channel, for people
    channel_hint: str = ""
    #: the options with the map of the inputs and of the outputs
    map_options: tuple[str, str] = ("map_inputs", "map_outputs")
    #: name of the output map for people
    outputs_name: str = "the output map"
    #: the parameters with the maps of inputs and outputs; None: the drive holds them in another way (see
    #: :meth:`read_map` and :meth:`store_maps`), or they are not written over the bus
    map_codes: tuple[MapCodes, MapCodes] | None = None
    #: the fields that maps of inputs and of outputs may have; None: the plugin reads maps by itself
    map_fields: tuple[FieldTable, FieldTable] | None = None
    #: the process data are held, and set points refused, while the maps of the drive are not those of the plugin: the
    #: control word or the set point stands in the output map, or another map may act since the drive's power-on
    holds_outputs: bool = False

    #: map of the drive's inputs; None until it is known
    inputs_map: M | None
    #: map of the drive's outputs; None until it is known
    outputs_map: M | None
    #: the word at which the map of the inputs begins
    inputs_at: int = 0
    #: the word at which the map of the outputs begins
    outputs_at: int = 0
    #: octet order of a word
    octet_order: Literal["big", "little"] = "big"
    #: values of the outputs by key, as the option has them
    presets: Mapping[int, int] = MappingProxyType({})
    #: present values of the outputs by key
    values: dict[int, int]
    _last_map: M | None = None
    #: maps of the options
    plant: _Maps[M]
    #: maps in the drive that act from its next power-on
    pending: _Maps[M] | None = None
    _changing = False

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
        self.plant = _Maps(inputs, outputs, self.presets)
        self.held = self.holds_outputs
        return inputs, outputs

    def refuse_zeros(self) -> None:
        """For a map that counts from the first cycle on. Raises ConfigError if a parameter has no value."""
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
        return [field.name for field in self._without_value(self.outputs_map, self.values)]

    def lost(self, now: int) -> None:
        """Parameters keep their values; commands and set points fall back to those of the option.

        Maps that waited for the drive's power-on are taken for the present ones: it may have been switched off.
        """
        self._last_map = self.outputs_map or self._last_map
        pending = self.pending
        if pending is not None:
            self._use(pending)
            if pending[:2] == self.plant[:2]:
                self.pending = None
        self.values = {**self.presets, **self._kept(self.outputs_map or self._last_map)}
        self.held = self.holds_outputs
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
        if (why := self.other_maps()) is not None:
            raise CommandError("fault", why)
        if missing := self.missing():
            raise CommandError(
                "fault",
                f"{', '.join(missing)} in {self.outputs_name} would be written with 0: give a value first, "
                f"by order('output', number='{missing[0].partition(' ')[0]}', value=...) or in the option of the map",
            )

    def settings_judged(self) -> None:
        """The maps were compared with those of the drive."""
        if self.holds_outputs and self.goal is not Goal.RUN:
            self.held = self.refuses_setpoint() is not None or bool(self.missing())
            self.dirty = True

    def refuses_setpoint(self) -> str | None:
        if self._changing:
            return "write_map is under way"
        return self.other_maps() or (self.settings_check.differs(Use.MAP) if self.holds_outputs else None)

    def other_maps(self) -> str | None:
        """Why the drive does not have the maps of the options, or will not have them; with what to do."""
        pending = self.pending
        if pending is None:
            return None
        option_in, option_out = self.map_options
        if pending[:2] == self.plant[:2]:
            return "the maps of the options were written and act from the drive's next power-on: switch it off and on"
        needed = [field.name.partition(" ")[0] for field in self._without_value(pending.outputs, {})]
        values = f" (with {', '.join(f'{name}=VALUE' for name in needed)})" if needed else ""
        return (
            f"other maps were written to the drive, which act from its next power-on: end the bus, set {option_in} = "
            f"'{pending.inputs}' and {option_out} = '{pending.outputs}'{values} among the options, and switch the "
            "drive off and on"
        )

    def all_settings(self) -> Sequence[Setting]:
        """With maps that wait for the drive's power-on."""
        settings = self.settings()
        if self.pending is None:
            return settings
        return (Setting(wanted="maps in force", keys=(), differs=lambda _: self.other_maps()), *settings)

    def before_applied(self, name: str, deadline: int) -> Steps[None]:
        """A map that stands in the drive and does not yet act would begin to act without its values."""
        if name != self.map_acts:
            return
        found = yield from self.read_maps(deadline)
        if not self.are_maps(found, self.inputs_map, self.outputs_map):
            raise CommandError(
                "usage",
                f"{name} would make other maps act, which stand in the drive: inputs '{found[0]}' and outputs "
                f"'{found[1]}'; use write_map, which writes maps and values and applies them",
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

    def parse_map(self, text: str, *, outputs: bool) -> M:
        """Read a map from a text of the user's: fields of :attr:`map_fields`. Raises ValueError."""
        assert self.map_fields is not None
        return cast("M", self.map_fields[outputs].parse(text, self.room(outputs=outputs)))

    def option_map(self, text: str, *, outputs: bool) -> M:
        """Read a map from an option; the text may be empty. Raises ValueError."""
        return self.parse_map(text, outputs=outputs)

    def map_of(self, codes: tuple[int, ...], *, outputs: bool) -> M:
        """The map with these codes, as the drive has it."""
        assert self.map_fields is not None
        return cast("M", self.map_fields[outputs].of(codes))

    def codes_of(self, one: M) -> tuple[int, ...]:
        """A map as the parameters of the drive hold it, 0 for an empty word."""
        return one.codes

    def room(self, *, outputs: bool) -> int | None:
        """Words of the telegram that a map fills; None: as many as there are codes."""
        return None

    def present_maps(self) -> tuple[M, M]:
        """The maps that ``write_map`` writes if none is given."""
        assert self.inputs_map is not None
        assert self.outputs_map is not None
        return self.inputs_map, self.outputs_map

    def check_maps(self, inputs: M, outputs: M) -> str | None:
        """Why the drive would refuse the two maps together; None if it accepts them."""
        return None

    def cannot_write(self, inputs: M, outputs: M) -> str | None:
        """Why maps that the drive accepts cannot be written by this plugin; None if they can."""
        return None

    def known(self, deadline: int) -> Steps[None]:
        """Wait until both maps are known."""
        yield from ()

    def has_maps(self, inputs: M, outputs: M, deadline: int) -> Steps[bool]:
        """Whether these maps act in the drive already, so that they need not be written."""
        yield from ()
        return False

    def verify_maps(self, inputs: M, outputs: M, deadline: int) -> Steps[None]:
        """Read the maps that were written. Raises CommandError if they are others."""
        found = yield from self.read_maps(deadline)
        if not self.are_maps(found, inputs, outputs):
            raise CommandError(
                "parameter",
                f"write_map: the drive has inputs '{found[0]}' and outputs '{found[1]}' afterwards, not what was "
                "written",
            )

    def maps_changed(self) -> None:
        """The drive has other maps now."""

    def maps_unknown(self) -> None:
        """A change of maps failed half way."""

    def read_by(self, field: MapField) -> ParamKey | None:
        """The parameter behind an output; None: it cannot be read."""
        return None

    def called(self, name: str | int) -> str | int:
        """Name or key of an output for the name that a user wrote."""
        return name

    def written_by(self, key: int) -> str | None:
        """The orders that write an output, which ``output`` therefore does not; None if none does."""
        return None

    # -- maps in the drive ----------------------------------------------------------------------------------------

    @property
    def map_acts(self) -> str:
        """When the codes of a map act, as the drive's table says (:class:`ParamSpec`)."""
        return "" if self.map_codes is None else self.acts_of(self.map_codes[1].places[0])

    def read_maps(self, deadline: int) -> Steps[tuple[M, M]]:
        """The maps in the drive, by their codes."""
        assert self.map_codes is not None
        inputs, outputs = self.map_codes
        found_out = yield from self._codes(outputs, deadline)
        found_in = yield from self._codes(inputs, deadline)
        return self.map_of(found_in, outputs=False), self.map_of(found_out, outputs=True)

    def read_map(self, deadline: int) -> Steps[dict[str, object]]:
        """The job of ``read_map``."""
        inputs, outputs = yield from self.read_maps(deadline)
        return {"value": {"inputs": str(inputs), "outputs": str(outputs)}}

    def store_maps(self, inputs: M, outputs: M, values: dict[int, int], deadline: int) -> Steps[bool]:
        """Write maps that were checked; the octets are those of the new map when it begins to act. Returns whether it
        acts now."""
        assert self.map_codes is not None
        codes_in, codes_out = self.map_codes
        now = self.map_acts != POWER_ON
        if now:
            yield from self._empty(outputs, deadline)
            had_in, had_out = self.inputs_map, self.outputs_map
            self.outputs_map = outputs
            self.values = values
            self.dirty = True
            yield from settled(self, lambda: False, deadline)
        yield from self._put(codes_in, inputs, had_in if now else None, deadline)
        yield from self._put(codes_out, outputs, had_out if now else None, deadline)
        yield from self._apply(deadline)
        return now

    def _codes(self, codes: MapCodes, deadline: int) -> Steps[tuple[int, ...]]:
        access = self.access
        assert access is not None
        places = codes.places
        if codes.count is not None:
            places = places[: (yield from access.read_raw(codes.count, deadline))]
        found: tuple[int, ...] = ()
        for place in places:
            found += ((yield from access.read_raw(place, deadline)),)
        return found

    def _empty(self, new: M, deadline: int) -> Steps[None]:
        """Empty the words of the drive's output map that will have another meaning, before their octets change."""
        assert self.map_codes is not None
        codes = self.map_codes[1]
        if codes.count is not None:
            if not any(self.codes_of(new)):
                return  # the new map does it
            yield from self._set(codes.places[0], 0, deadline)
            yield from self._set(codes.count, 1, deadline)
        else:
            assert self.outputs_map is not None
            had = self.codes_of(self.outputs_map)
            for place, old, code in zip(codes.places, had, self.codes_of(new), strict=True):
                if old and code and old != code:
                    yield from self._set(place, 0, deadline)
        yield from self._apply(deadline)

    def _put(self, codes: MapCodes, new: M, had: M | None, deadline: int) -> Steps[None]:
        """Write the codes of a map; without a number of words only those that the drive is not known to have."""
        wanted = self.codes_of(new)
        if codes.count is not None:
            wanted = wanted or (0,)  # the number is 1 at least
            for place, code in zip(codes.places, wanted, strict=False):
                yield from self._set(place, code, deadline)
            yield from self._set(codes.count, len(wanted), deadline)
            return
        before = (None,) * len(wanted) if had is None else self.codes_of(had)
        for place, code, old in zip(codes.places, wanted, before, strict=True):
            if code != old:
                yield from self._set(place, code, deadline)

    def _apply(self, deadline: int) -> Steps[None]:
        if self.map_acts not in ("", POWER_ON):
            yield from self._set(ParamKey(self.map_acts), 1, deadline)

    def _set(self, key: ParamKey, value: int, deadline: int) -> Steps[None]:
        assert self.access is not None
        yield from self.access.write(key, value, deadline)

    def are_maps(self, found: tuple[M, M], inputs: M | None, outputs: M | None) -> bool:
        """Whether the drive's maps ``found`` are these, as far as the telegram has words for them."""
        for one, own, way in ((found[0], inputs, False), (found[1], outputs, True)):
            room = self.room(outputs=way)
            mine = () if own is None else self.codes_of(own)
            if process_data_map.used(self.codes_of(one), room) != process_data_map.used(mine, room):
                return False
        return True

    # -- inside ---------------------------------------------------------------------------------------------------

    def _write(self, inputs: str | None, outputs: str | None, deadline: int) -> Steps[dict[str, object]]:
        """The job of ``write_map``; None: the present map stays.

        A parameter needs a value: the user's, its present one, or that of the drive, if it can be read.
        """
        new_inputs, new_outputs = self.present_maps()
        values: dict[int, int] = {}
        try:
            if inputs is not None:
                new_inputs = self.parse_map(inputs, outputs=False)
            if outputs is not None:
                bare, behind = process_data_map.split(outputs)
                new_outputs = self.parse_map(bare, outputs=True)
                values = process_data_map.given(behind, new_outputs.fields)
            wrong = self.check_maps(new_inputs, new_outputs) or self.cannot_write(new_inputs, new_outputs)
            if wrong is not None:
                raise ValueError(wrong)
            for field in self._without_value(new_outputs, {**self.values, **values}):
                if self.read_by(field) is None:
                    name = field.name.partition(" ")[0]
                    raise ValueError(f"{field.name} would be written with 0: give it a value, {name}=VALUE")
        except ValueError as error:
            raise CommandError("usage", f"write_map: {error}") from None
        return self._change(new_inputs, new_outputs, values, deadline)

    def _without_value(self, outputs: M | None, values: Container[int]) -> list[MapField]:
        """The parameters of a map that have no value in ``values``."""
        fields = () if outputs is None else outputs.fields
        return [field for field in fields if field is not None and not field.neutral and field.key not in values]

    def _change(self, inputs: M, outputs: M, values: dict[int, int], deadline: int) -> Steps[dict[str, object]]:
        yield from self.in_data_exchange(deadline)
        refuse_while_turning(self, "write_map", "a map changes only at standstill and outside of operation")
        with self.without_start("write_map"):
            yield from self.known(deadline)
            yield from self.stand_still(deadline)
            return (yield from self.change_maps(inputs, outputs, values, deadline))

    def change_maps(self, inputs: M, outputs: M, values: dict[int, int], deadline: int) -> Steps[dict[str, object]]:
        """Change the maps of a drive at standstill; what is no parameter begins with 0 if no value is given."""
        access = self.access
        assert access is not None
        for field in self._without_value(outputs, {**self.values, **values}):
            if (key := self.read_by(field)) is not None:
                values[field.key] = yield from access.read_raw(key, deadline)
        values = {**self._kept(outputs), **values}
        changed = _Maps(inputs, outputs, values)
        outcome: dict[str, object] = {"value": {"inputs": str(inputs), "outputs": str(outputs)}}
        self._changing = True
        try:
            acts = yield from self.has_maps(inputs, outputs, deadline)
            if not acts:
                acts = yield from self.store_maps(inputs, outputs, values, deadline)
                yield from self.verify_maps(inputs, outputs, deadline)
            if acts:
                self.pending = None
                self._use(changed)
                self.maps_changed()
            else:
                outcome["acts"] = "after power-on"
                self._wait_for_power_on(changed)
        except BaseException:
            self.maps_unknown()
            raise
        finally:
            self._changing = False
            self.settings_check.changed()
        return outcome

    def _wait_for_power_on(self, maps: _Maps[M]) -> None:
        """The maps in the drive act from its next power-on."""
        present = (self.inputs_map, self.outputs_map)
        self.pending = None if maps[:2] == present and self.map_acts == POWER_ON else maps
        if (why := self.other_maps()) is not None:
            self.notice(why)

    def _use(self, maps: _Maps[M]) -> None:
        """The drive has these maps; nothing stands in them but the values given for them."""
        self.inputs_map, self.outputs_map = maps.inputs, maps.outputs
        self.presets, self.values = maps.values, dict(maps.values)
        self.dirty = True

    def _kept(self, outputs: M | None) -> dict[int, int]:
        """Present values of the parameters of a map."""
        parameters = self._without_value(outputs, ())
        return {field.key: self.values[field.key] for field in parameters if field.key in self.values}

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
        key = self.read_by(field)
        relied = key is not None and self.parameter_table is not None and self.use_of(key) is not Use.NONE
        if relied:
            refuse_while_turning(self, f"output: {field.name} is not written", "the plugin relies on its value")
        if raw and (why := self.refuses_setpoint()) is not None:
            raise CommandError("fault", f"output: {why}")
        self.values[field.key] = raw
        self.dirty = True
        if relied:
            yield from settled(self, lambda: False, deadline)
            self.settings_check.changed()
        return {"value": value}
