"""The master's end of a KEB COMBIVERT F5."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from dpstack.devices.drive_core import DeclaredMapCore
from dpstack.devices.model import DeviceFile
from dpstack.profile import (
    FAULTED,
    NS_PER_MS,
    CommandError,
    ConfigError,
    ControlTable,
    DriveProfile,
    Goal,
    ListedParam,
    Lookup,
    Options,
    ParamKey,
    ParamRef,
    Scale,
    Setting,
    State,
    StateRow,
    StateTable,
    Steps,
    TelegramSpec,
    Use,
    Word,
    equal,
    listing,
    process_data_map,
    settled,
)
from dpstack_drives.keb import pdmap
from dpstack_drives.keb import table as t
from dpstack_drives.keb.channel import KebChannel, find, target
from dpstack_drives.keb.pdmap import Entry, PdMap

#: names of control bits with a meaning here, and of status bits
_NEEDS: Final = {
    "start": (("run",), ("run",)),
    "stop": (("run",), ("run",)),
    "quick_stop": (("quick_stop",), ("run",)),
    "coast": (("enable",), ("run",)),
    "acknowledge": (("reset",), ("fault",)),
}

#: record and enable of block 1
_FIRST: Final = ((t.MAP_INPUTS, t.ENABLE_INPUTS), (t.MAP_OUTPUTS, t.ENABLE_OUTPUTS))
_NAMES: Final = ("inputs", "outputs")
#: errors of the access itself, not of an enable
_NO_ACCESS: Final = frozenset(
    code.number
    for code in (t.READ_AND_WRITE, t.NO_INVERTER, t.WRITE_PROTECTED, t.PASSWORD, t.BAD_INDEX, t.BAD_SUBINDEX)
)


class KebCore(DeclaredMapCore[PdMap]):
    """Bits of sy.50 and sy.51 and the unit of sy.52 are in no manual of ours: what an order needs is given by options.

    Options: ``control_bits`` (``enable``, ``run``, ``reset``, ``reverse``, ``quick_stop`` mean something here, other
    names do not) and ``status_bits`` (``run``, ``fault``, ``ready``, ``reached``; others are only shown) as
    ``name=bit ...`` or ``simulated``; ``direction``: reverse by its bit with an absolute set speed (oP.01 = 9) or by
    the ``sign`` of sy.52; ``rpm_per_count``; ``reference_rpm`` and ``reference_hz``: what 100 % is; ``map_inputs``,
    ``map_outputs``: the map that the drive has, as in :class:`~dpstack_drives.keb.pdmap.PdMap`; ``block2_inputs``,
    ``block2_outputs``: indexes of record and enable of block 2; ``pd_in_cycle_ms``.

    A value at another place of the map is another parameter. So the process data are 0, as in Clear, from the beginning
    of data exchange until the plugin has read its map (sy.16 to sy.31, sy.58 to sy.73) and its enables and they agree
    with the options, and from ``write_map`` until the new map is in force.

    Jobs of its own: those of a :class:`MappedCore`; values are integers as they stand on the wire. Without
    ``control_bits`` an ``output`` is also the control word, without ``rpm_per_count`` the set speed.
    """

    inputs_map: PdMap
    outputs_map: PdMap
    channel_hint = ": take PCH+..."
    address_parameter = t.name_of(0x2006)  # as its channel calls it
    held_hint = "its outputs are 0 until then"

    def __init__(
        self, file: DeviceFile, profile: DriveProfile, name: str, telegram: TelegramSpec, options: Options
    ) -> None:
        try:
            self._bits = t.bits(str(options["control_bits"]), t.CONTROL_BITS, "control_bits")
            status = t.bits(str(options["status_bits"]), t.STATUS_BITS, "status_bits")
            self._second = [t.record_and_enable(str(options[f"block2_{way}"])) for way in ("inputs", "outputs")]
            self._words = _table(self._bits, status)
        except ValueError as error:
            raise ConfigError(f"drive {name} ({profile.name}): {error}") from None
        super().__init__(file, profile, name, telegram, options)
        self.scan_ns = round(float(options["pd_in_cycle_ms"]) * NS_PER_MS)
        self._by_sign = options["direction"] == "sign"
        self._rpm_per_count = float(options["rpm_per_count"])
        if self._rpm_per_count:
            self.scale = Scale("speed", full=1, span=self._rpm_per_count / float(options["reference_rpm"]))
        self._ours = str(options["status_bits"]).strip() == t.SIMULATED_BITS
        self.holds_outputs = self.access is not None
        self.inputs_map, self.outputs_map = self.maps_of_options(options)
        self.refuse_zeros()
        #: indexes of block 2, given by the options
        self._second_indexes = frozenset(index for both in self._second if both is not None for index in both)
        self._state_number = Lookup(lambda: self.raw_state in FAULTED, self._ask)
        if isinstance(self.access, KebChannel):
            self._channel = self.access
            self.lookups = (self._state_number,)

    def words_and_states(self) -> ControlTable:
        """By the bits that have names."""
        return self._words

    def open_channel(self) -> KebChannel:
        return KebChannel(self)

    # -- process data ---------------------------------------------------------------------------------------------

    def status_of(self, process: bytes) -> int:
        """sy.51 if the map has it."""
        at = self.inputs_map.octet(t.STATUS_WORD)
        return 0 if at is None else int.from_bytes(process[at : at + 2], "big")

    def encode(self, control: int, setpoint: int) -> bytes:
        """sy.50 and sy.52 if the map has them, the user's values for the others."""
        values = dict(self.values)
        if self._bits:
            values[t.CONTROL_WORD] = control
        if self._rpm_per_count:
            values[t.SET_SPEED] = setpoint
        return self.outputs_map.put(values, self.telegram.outputs)

    def encode_held(self) -> bytes:
        """Zeros, as in Clear: the control word may stand in any place."""
        return bytes(self.telegram.outputs)

    def safe(self, configured: bytes) -> bytes:
        """Without the values of parameters while their places are not known."""
        return configured if self.held else super().safe(configured)

    def decode(self, process: bytes) -> tuple[int | None, float | None]:
        """sy.50 and sy.52 if the map has them and their meaning is known."""
        found = {
            index: int.from_bytes(process[at : at + 2], "big")
            for index in (t.CONTROL_WORD, t.SET_SPEED)
            if (at := self.outputs_map.octet(index)) is not None and at + 2 <= len(process)
        }
        control = found.get(t.CONTROL_WORD) if self._bits else None
        raw = found.get(t.SET_SPEED) if self._rpm_per_count else None
        if raw is None:
            return control, None
        reverse = not self._by_sign and control is not None and self.table.control.is_set(control, "reverse")
        return control, -self.scale.decode(raw) if reverse else self.scale.decode(raw)

    def setpoint_word(self, fraction: float) -> int:
        """sy.52."""
        if self.outputs_map.octet(t.SET_SPEED) is None:
            raise ValueError("sy.52 (2034h, set speed) is not in the output map")
        if not self._rpm_per_count:
            raise ValueError("the unit of sy.52 is not in the manual: give the option rpm_per_count")
        if fraction < 0 and not self._by_sign and "reverse" not in self._bits:
            raise ValueError(
                "a negative speed needs the bit 'reverse' in the option control_bits, or direction = 'sign' "
                "(oP.01 = 9 takes the direction from sy.50)"
            )
        return self.scale.encode(fraction if self._by_sign else abs(fraction))

    def control_bits(self) -> int:
        """Direction by its bit."""
        reverse = self.setpoint < 0 and not self._by_sign
        return 1 << self._bits["reverse"] if reverse and self.goal is not Goal.IDLE else 0

    def measured(self) -> tuple[float | None, float | None, float | None]:
        """sy.53 if the map has it and its unit is known."""
        at = self.inputs_map.octet(t.ACTUAL_SPEED)
        if at is None or not self._rpm_per_count:
            return None, None, None
        return self.scale.decode(self.words[at // 2]), None, None

    def parameters(self) -> tuple[ListedParam, ...]:
        """By name, so far as the index of its group is in the manual."""
        return listing(
            t.PARAMETERS,
            data_sets=range(t.SETS),
            known=lambda spec: spec.number not in t.RECORDS,
            why_not=t.why_not_read,
        )

    def fault_texts(self) -> tuple[str, ...] | None:
        """The number in ru.00; its texts are in the application manual."""
        if (state := self._state_number.value) is not None:
            name = {number: text for text, number in t.TRIPS.items()}.get(state) if self._ours else None
            return (f"inverter state ru.00 = {state}" + (f" {name}" if name else ""),)
        if self.access is not None:
            return None
        return ("without a name: only the parameter channel (PCH+...) gives ru.00",)

    def cannot(self, op: str) -> str | None:
        """Orders that the options and the map have no bits for."""
        if self.outputs_map.octet(t.CONTROL_WORD) is None:
            return f"{op}: sy.50 (2032h, control word) is not in the output map"
        if self.inputs_map.octet(t.STATUS_WORD) is None:
            return f"{op}: sy.51 (2033h, status word) is not in the input map"
        control, status = _NEEDS[op]
        for names, known, option in (
            (control, self._bits, "control_bits"),
            (status, self.table.status.bits, "status_bits"),
        ):
            for name in names:
                if name not in known:
                    return (
                        f"{op} needs the bit {name!r}: the bits of sy.50 and sy.51 are not in the manual, name them by "
                        f"the option {option}, e.g. {option} = '{name}=<bit> ...'"
                    )
        return None

    def settings(self) -> Sequence[Setting]:
        """The active map (first: outputs wait for it), the source of the set point, the direction."""
        found: list[Setting] = []
        if self._rpm_per_count:
            why = "5 takes the set point from sy.52, the set speed of the bus"
            found.append(equal("oP.00", 5, "the set point is not sy.52: set oP.00 = 5", why=why, source=t.BASIC))
        if self._bits and self._by_sign:
            found.append(
                Setting(
                    wanted="oP.01 other than 9",
                    keys=(ParamKey("oP.01"),),
                    differs=lambda values: _absolute(values[0]),
                    why="with 9 the direction comes from sy.50, and a negative set speed turns forward",
                    source=t.BASIC,
                )
            )
        elif self._bits:
            remedy = "the direction may not come from sy.50: set oP.01 = 9"
            why = "9 takes the direction from sy.50, with an absolute set speed"
            found.append(equal("oP.01", 9, remedy, refuse=False, why=why, source=t.BASIC))
        if self.pending is not None:
            return found
        return [*self._map_settings(self.inputs_map, self.outputs_map), *found]

    def _map_settings(self, inputs: PdMap, outputs: PdMap) -> list[Setting]:
        """The map as the inverter shows it (sy.16 to sy.31, sy.58 to sy.73), and the enables."""
        return [
            *_active("map_outputs", outputs, t.ACTIVE_OUTPUTS),
            *_active("map_inputs", inputs, t.ACTIVE_INPUTS),
            *_enabled("outputs", outputs, self._enables(1)),
            *_enabled("inputs", inputs, self._enables(0)),
        ]

    def _enables(self, number: int) -> tuple[int | None, int | None]:
        """Indexes of the enables of both blocks, of the inputs (0) or outputs (1)."""
        second = self._second[number]
        return _FIRST[number][1], None if second is None else second[1]

    def _ask(self, deadline: int) -> Steps[int]:
        return self._channel.get(target(t.INVERTER_STATE, 1, "ru.00"), deadline)

    # -- the process data maps (docs/reference/drives/keb-f5.md#process-data-map) --------------------------------------

    def parse_map(self, text: str, *, outputs: bool) -> PdMap:
        return PdMap.parse(text)

    def option_map(self, text: str, *, outputs: bool) -> PdMap:
        """As much of the default map as the telegram takes if the option is empty."""
        octets = self.telegram.outputs if outputs else self.telegram.inputs
        if not text.strip():
            return (pdmap.DEFAULT_OUTPUTS if outputs else pdmap.DEFAULT_INPUTS).cut(octets)
        given = PdMap.parse(text)
        if given.octets > octets:
            raise ValueError(f"{given.octets} octets, the telegram has {octets}")
        return given

    def check_maps(self, inputs: PdMap, outputs: PdMap) -> str | None:
        """The rule of docs/reference/drives/keb-f5.md#process-data-map for which the drive would not confirm the
        maps."""
        return pdmap.check(inputs, outputs)

    def read_by(self, field: process_data_map.MapField) -> ParamKey:
        """The parameter in its sets."""
        return ParamKey(field.key, index=field.sets)

    def place_of(self, key: ParamKey) -> tuple[int, int]:
        return find(key).pnu, 0

    def use_of(self, key: ParamKey) -> Use:
        """With record and enable of block 2, whose indexes the options give."""
        return Use.MAP if self.place_of(key)[0] in self._second_indexes else super().use_of(key)

    def may_turn(self) -> str | None:
        """Without names of status bits: by the control word that the user gives."""
        if "run" in self.table.status.bits:
            return super().may_turn()
        return "the control word is not 0" if self.values.get(t.CONTROL_WORD) and not self.held else None

    def cannot_write(self, inputs: PdMap, outputs: PdMap) -> str | None:
        """Block 2 needs its indexes."""
        for number, one in enumerate((inputs, outputs)):
            if one.block(1) and self._second[number] is None:
                return _no_block2(_NAMES[number])
        return None

    def called(self, name: str | int) -> str | int:
        """``sy.50`` in any writing."""
        found = t.index_of(name) if isinstance(name, str) else name
        return name if found is None else found

    def written_by(self, key: int) -> str | None:
        """The words that start, stop and speed write."""
        ours = {t.CONTROL_WORD: bool(self._bits), t.SET_SPEED: bool(self._rpm_per_count)}
        return "start, stop and speed" if ours.get(key) else None

    def read_map(self, deadline: int) -> Steps[dict[str, object]]:
        """Both maps as the drive's records have them, and their enables."""
        value: dict[str, object] = {}
        for number, name in enumerate(_NAMES):
            record, enable = _FIRST[number]
            length = yield from self._get(record, 1, deadline)
            blocks: list[dict[int, int]] = [{1: length}, {}]
            for block in range((length + pdmap.BLOCK - 1) // pdmap.BLOCK)[:2]:
                index = record if block == 0 else self._block2(number)[0]
                for subindex in range(2, 2 + 2 * min(pdmap.BLOCK, length - block * pdmap.BLOCK)):
                    blocks[block][subindex] = yield from self._get(index, subindex, deadline)
            try:
                value[name] = str(PdMap.from_records(*blocks))
            except ValueError as error:
                raise CommandError("parameter", f"read_map: {name}: the record ({record:04X}h) has {error}") from None
            value[f"{name}_enable"] = yield from self._get(enable, 0, deadline)
        return {"value": value}

    def has_maps(self, inputs: PdMap, outputs: PdMap, deadline: int) -> Steps[bool]:
        """By what the inverter shows. A map that is in force is not written again: that would stop the outputs."""
        if self.pending is not None or (inputs, outputs) != self.present_maps():
            return False
        return (yield from self._in_force(inputs, outputs, deadline))

    def store_maps(self, inputs: PdMap, outputs: PdMap, values: dict[int, int], deadline: int) -> Steps[bool]:
        """Write both records, enable them, and see whether the drive confirms the enable.

        From the first record on the drive takes no outputs; they are zeros from here on. The enable acts at once, or it
        is answered by an error that says it acts after power-on; which one is not in the manual, so any that is not
        about the access itself is taken for it, and the enable read back decides. Without the error the map counts when
        the inverter shows it.
        """
        self.held = True
        self.dirty = True
        yield from settled(self, lambda: False, deadline)
        at_once = yield from self._write_records((inputs, outputs), deadline)
        self._notice_of_lengths(inputs, outputs)
        return at_once and (yield from self._in_force(inputs, outputs, deadline))

    def verify_maps(self, inputs: PdMap, outputs: PdMap, deadline: int) -> Steps[None]:
        """The enables were read back, and the settings are compared."""
        yield from ()

    def _write_records(self, maps: Sequence[PdMap], deadline: int) -> Steps[bool]:
        """Returns whether the drive confirmed the enables without an error."""
        places = [self._record_blocks(number, one) for number, one in enumerate(maps)]
        for one, blocks in zip(maps, places, strict=True):
            for block, (record, _) in enumerate(blocks):
                for subindex, value in one.records(block):
                    yield from self._channel.put(self._target(record, subindex), value, deadline)
        confirmed = True
        for name, blocks in zip(_NAMES, places, strict=True):
            for block, (_, enable) in enumerate(blocks):
                confirmed &= yield from self._enable(f"{name}, block {block + 1}", enable, deadline)
        return confirmed

    def _in_force(self, inputs: PdMap, outputs: PdMap, deadline: int) -> Steps[bool]:
        """Whether the inverter shows these maps."""
        for setting in self._map_settings(inputs, outputs):
            found = yield from self._channel.read_many(setting.keys, deadline)
            values = [value for one in found if isinstance(value := one.get("value"), (int, float))]
            if len(values) < len(found) or setting.differs(values) is not None:
                return False
        return True

    def _enable(self, name: str, index: int, deadline: int) -> Steps[bool]:
        """Returns whether the drive confirmed it without an error."""
        confirmed = True
        try:
            yield from self._channel.put(self._target(index, 0), t.ENABLED, deadline)
        except CommandError as error:
            if error.kind != "parameter" or error.number in _NO_ACCESS:
                raise
            confirmed = False
        got = yield from self._get(index, 0, deadline)
        if got & t.ENABLED != t.ENABLED:
            raise CommandError(
                "parameter",
                f"write_map: the drive does not confirm the enable of {name} ({index:04X}h is {got:02X}h): it does not "
                f"have a parameter of the map, or not with this length, or not as process data",
            )
        return confirmed

    def _notice_of_lengths(self, inputs: PdMap, outputs: PdMap) -> None:
        telegram = self.telegram
        for name, one, octets in (("inputs", inputs, telegram.inputs), ("outputs", outputs, telegram.outputs)):
            if one.octets != octets:
                self.notice(
                    f"the map has {one.octets} octets of {name}, {telegram.name} has {octets}: they must be equal "
                    f"(Fb00 and Fb37, Fb12 and Fb38)"
                )

    def _record_blocks(self, number: int, one: PdMap) -> list[tuple[int, int]]:
        """Record and enable of each block that the map uses, block 1 always."""
        return [_FIRST[number]] + ([self._block2(number)] if one.block(1) else [])

    def _block2(self, number: int) -> tuple[int, int]:
        found = self._second[number]
        if found is None:
            raise CommandError("usage", _no_block2(_NAMES[number]))
        return found

    def _get(self, index: int, subindex: int, deadline: int) -> Steps[int]:
        return self._channel.get(self._target(index, subindex), deadline)

    def _target(self, index: int, subindex: int) -> ParamRef:
        return target(index, subindex, f"{index:04X}h:{subindex}")


def _no_block2(name: str) -> str:
    return (
        f"{name}: more than {pdmap.BLOCK} octets need block 2, whose indexes on the bus are not in the manual: give "
        f"the option block2_{name} (record and enable in hex)"
    )


def _absolute(rotation: float) -> str | None:
    if rotation != 9:
        return None
    return (
        "oP.01 is 9: the direction comes from sy.50 and a negative sy.52 turns forward: set the option direction = "
        "'bit', or oP.01 to a source that takes the sign"
    )


def _active(option: str, own: PdMap, firsts: Sequence[int]) -> list[Setting]:
    """The active map is that of the option, block by block; the drive does not distinguish words from longs.

    A value in another's place would be written into another parameter, or taken for status word or speed: refused.
    """
    found = []
    for block, first in enumerate(firsts):
        entries = own.block(block)
        if block and not entries:
            continue  # the telegram has one block, and so may the drive
        definitions = min(len(entries) + 1, t.BLOCK_VALUES)
        keys = [ParamKey(first + 2 * n) for n in range(definitions)]
        keys += [ParamKey(first + 2 * n + 1) for n in range(len(entries))]
        last = t.name_of(first + 2 * t.BLOCK_VALUES - 1).partition(" ")[0]
        names = f"{t.name_of(first).partition(' ')[0]} to {last}"
        wanted = " ".join(Entry(entry.key, sets=entry.sets).text for entry in entries) or "empty"

        def differs(
            values: Sequence[float], count: int = definitions, wanted: str = wanted, names: str = names
        ) -> str | None:
            indexes = [int(value) & t.OFF for value in values[:count]]
            sets = [int(value) for value in values[count:]]
            places = [
                Entry(t.INVERTER.start + index, sets=sets[n] if n < len(sets) else 1).text
                for n, index in enumerate(indexes)
                if index != t.OFF
            ]
            if places == wanted.split():
                return None
            return (
                f"the active map has {' '.join(places) or 'nothing'} ({names}), the option {option} says {wanted}: set "
                f"{option} to the drive's map (read_map), or write_map and switch the drive off and on"
            )

        found.append(
            Setting(
                wanted=f"{names} = {wanted}",
                keys=tuple(keys),
                differs=differs,
                why=f"the active process data map has to be that of the option {option}: a value in another's place "
                "would be written into another parameter. `write_map` writes it",
                source="Saving of the F5 PB-Operator Configuration",
            )
        )
    return found


def _enabled(name: str, own: PdMap, enables: Sequence[int | None]) -> list[Setting]:
    """The enable of each block covers its octets; without it outputs are not obeyed and inputs stand still."""
    found = []
    for block, index in enumerate(enables):
        octets = sum(entry.octets for entry in own.block(block))
        if not octets or index is None:
            continue
        text = f"the enable of the {name}, block {block + 1} ({index:04X}h)"

        def differs(values: Sequence[float], needed: int = (1 << octets) - 1, text: str = text) -> str | None:
            enable = int(values[0]) & t.ENABLED
            if not needed & ~enable:
                return None
            return (
                f"{text} is {enable:02X}h, {needed:02X}h or FFh is needed: the drive does not pass all {name} on: "
                "write_map, and switch the drive off and on if it does not act at once"
            )

        found.append(
            Setting(
                wanted=f"{index:04X}h = FFh",
                keys=(ParamKey(index),),
                differs=differs,
                why=f"without the enable the drive does not pass all {name} on",
                source="Changing the PD-Assignment via the Parameter Channel",
            )
        )
    return found


def _table(control: Mapping[str, int], status: Mapping[str, int]) -> ControlTable:
    """States and words from the bits that have names. Raises ValueError."""
    enable, run, stop, reset = (1 << control[name] if name in control else 0 for name in _CONTROL)
    runs, fault, ready = (1 << status[name] if name in status else 0 for name in ("run", "fault", "ready"))
    rows = [StateRow(State.FAULT, fault, fault)] if fault else []
    if runs:
        rows += [StateRow(State.RUNNING, runs | fault, runs), StateRow(State.READY, runs | fault | ready, ready)]
    if runs and ready:
        rows.append(StateRow(State.NOT_READY, runs | fault | ready, 0))
    return ControlTable(
        control=Word("sy.50", control),
        status=Word("sy.51", status),
        states=StateTable(rows),
        run={state: enable | run for state in State if state is not State.FAULT},
        steady={
            Goal.IDLE: 0,
            Goal.STOP: enable,
            Goal.QUICK_STOP: enable | stop,
            Goal.COAST: 0,
            Goal.ACK_HIGH: reset,
            Goal.ACK_LOW: 0,
        },
        released_mask=enable | run,
        releasing=frozenset({State.RUNNING}),
    )


_CONTROL: Final = ("enable", "run", "quick_stop", "reset")
