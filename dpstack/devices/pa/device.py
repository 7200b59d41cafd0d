"""The simulated PA device of a device file: the blocks in its slots, what they measure or move, its cyclic values."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Final

from dpstack.devices.pa.configurations import layout_of_telegram
from dpstack.devices.pa.layout import Layout, Part, Place
from dpstack.devices.pa.model import PaFile
from dpstack.errors import ConfigError, UsageError
from dpstack.pa.datatypes import datatype
from dpstack.pa.simulated import KIND, MANY
from dpstack.pa.simulated.block import Block
from dpstack.pa.simulated.device import ProcessDevice
from dpstack.pa.simulated.directory_records import Layout as BlockLayout
from dpstack.pa.simulated.inputs import Totaliser
from dpstack.pa.simulated.kinds import Row, process_device
from dpstack.pa.simulated.slave import Cyclic, CyclicPart, ProcessSlave
from dpstack.pa.units import find_unit
from dpstack.profile.drive_profile import DeviceProfile
from dpstack.profile.model.drive_type import Options, TelegramSpec

#: status of a value: good
GOOD: Final = 0x80
_FORMATS: Final = {"f32": ">f", "u8": ">B", "u16": ">H", "i16": ">h", "u32": ">I", "i32": ">i"}
#: parameters by the parts of modules whose names differ
_PARAMETERS: Final = {"CHECKBACK": "check_back", "CHECKBACK_D": "check_back"}
_FUNCTION_BLOCKS: Final = ("AI", "AO", "DI", "DO", "TOT")
#: a kind of device by a word in the name of a value
_BY_WORD: Final = ("pressure", "temperature", "level", "flow")


class PaDevice(ProcessSlave):
    """Values follow the process (:meth:`set_process`), set points move a valve; :meth:`put` holds a value instead.

    Its blocks stand in the slots of its file, or in those of the modules that a master plugs if the file has none.
    """

    def __init__(
        self,
        file: PaFile,
        profile: DeviceProfile,
        telegram: TelegramSpec,
        options: Options,
        presets: Mapping[str, object],
    ) -> None:
        self.file, self.profile, self.telegram = file, profile, telegram
        self._options = options
        self._layout = layout_of_telegram(file, telegram.name)
        model = self._model()
        super().__init__(model, {telegram.config: self._cyclic(model)}, ident=profile.ident, name=profile.name)
        self.fail_safe = profile.fail_safe
        self.delay = float(options["answer_s"])
        #: octets of held inputs that no block has, by name
        self._held: dict[str, bytes] = {}
        for name, value in presets.items():
            self._preset(name, value)

    # -- from outside --------------------------------------------------------------------------------------------------

    @property
    def layout(self) -> Layout:
        """The places of its values."""
        return self._layout

    def put(self, name: str, value: float, status: int | None = None) -> None:
        """Hold a value of the inputs, with its status octet (None: as it is now); :meth:`release` ends it. Raises
        ValueError."""
        place = self._layout.inputs.get(name)
        if place is None:
            raise ValueError(f"{name!r} is no value of this device; it has {', '.join(self._layout.inputs)}")
        octets = _packed(place.part, value)
        if place.part.status:
            known = self.inputs()[place.status_at]
            octets += bytes((known if status is None else status,))
        self._hold(place, octets)
        self._changed()

    def set_inputs(self, octets: bytes) -> None:
        """Hold all values, with their status."""
        for place in self._layout.inputs.values():
            self._hold(place, octets[place.at : place.at + place.part.octets])
        self._changed()

    def release(self) -> None:
        """Hold no value any more."""
        self._held.clear()
        for block in self.model.blocks:
            block.held.clear()
        self._changed()

    def inputs(self) -> bytes:
        """The octets of its inputs now."""
        return self._give()

    # -- ProcessSlave --------------------------------------------------------------------------------------------------

    def check_cfg(self, config: bytes) -> str | None:
        return None if self.profile.telegrams_of(config) else super().check_cfg(config)

    def cyclic_of(self, config: bytes) -> Cyclic:
        if self.telegram.config != config:
            before = self._rows()
            self.telegram = self.profile.telegrams_of(config)[0]
            self._layout = layout_of_telegram(self.file, self.telegram.name)
            if self._rows() != before:
                now, self.model = self.model.now, self._model()
                self.model.now = now
        return self._cyclic(self.model)

    def foreign_input(self, place: int, part: CyclicPart) -> bytes:
        name = [*self._layout.inputs][place]
        filler = (
            bytes(part.octets - 1) + bytes((GOOD,)) if self._layout.inputs[name].part.status else bytes(part.octets)
        )
        return self._held.get(name, filler)

    # -- inside ------------------------------------------------------------------------------------------------------

    def _rows(self) -> list[Row]:
        """Its function blocks: those of the file's slots, else those of the modules."""
        slots = self.file.slots or [*{one.slot.number: one.slot for one in self._places()}.values()]
        return [
            Row(slot.block, slot.name, slot.block_slot, find_unit(slot.unit) or 0, slot.block_index)
            for slot in slots
            if slot.block in _FUNCTION_BLOCKS
        ]

    def _places(self) -> Sequence[Place]:
        places = (*self._layout.inputs.values(), *self._layout.outputs.values())
        return sorted(places, key=lambda one: one.slot.number)

    def _model(self) -> ProcessDevice:
        given, rows = self._options, self._rows()
        kind = str(given[KIND]) or _kind_of(rows)
        try:
            model = process_device(
                kind,
                () if kind == MANY else rows,
                layout=BlockLayout(
                    profile=round(float(given["profile"])),
                    numbering=str(given["numbering"]),
                    directory_slot=round(float(given["directory_slot"])),
                    is_shifted=bool(given["shifted"]),
                    records=str(given["records"]),
                ),
                condensed=given["coding"] == "condensed",
                lie=str(given["lie"]),
                identity={
                    "device_id": self.file.name[:16].upper(),
                    "tag_desc": str(given["tag"])[:32] or self.file.name[:32],
                },
            )
        except UsageError as error:
            raise ConfigError(f"simulated {self.file.name}: {error}") from None
        for block in model.transducers:
            for name in ("act_stroke_time_inc", "act_stroke_time_dec"):
                if name in block.parameters:
                    block.put(name, float(given["stroke_s"]))
        return model

    def _cyclic(self, model: ProcessDevice) -> Cyclic:
        blocks = {name: model.block(block) for block, name in model.names.items()}
        ways = (self._layout.inputs.values(), self._layout.outputs.values())
        return Cyclic(*([_part(place, blocks.get(place.slot.name)) for place in way] for way in ways))

    def _hold(self, place: Place, octets: bytes) -> None:
        part = _part(
            place, next((self.model.block(b) for b, n in self.model.names.items() if n == place.slot.name), None)
        )
        if part.block:
            self.model.block(part.block).held[part.parameter] = octets
        else:
            self._held[place.name] = octets

    def _preset(self, name: str, value: object) -> None:
        """A value as it is at the beginning: of the process, a total, or held."""
        known = {*self._layout.inputs, *self.model.process}
        where = f"simulated {self.file.name}"
        if name not in known:
            listed = ", ".join((*self.profile.device_options, *sorted(known)))
            raise ConfigError(f"{where}: there is no option or value {name!r}; known: {listed}")
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise ConfigError(f"{where}: {name} = {value!r} is no number; give for instance 1.5")
        block = next((self.model.block(b) for b, n in self.model.names.items() if n == name), None)
        try:
            if name in self.model.process:
                self.set_process(value, name)
            elif isinstance(block, Totaliser):
                block.preset(value)
            else:
                self.put(name, value)
        except ValueError as error:
            raise ConfigError(f"{where}: {error}") from None


def _kind_of(rows: Sequence[Row]) -> str:
    """The kind of device with these function blocks."""
    kinds = {row.block for row in rows}
    if "AO" in kinds:
        return "positioner"
    if "DO" in kinds:
        return "valve"
    if "TOT" in kinds:
        return "flow"
    named = (word for row in rows for word in _BY_WORD if word in row.name)
    return next(named, "values")


def _part(place: Place, block: Block | None) -> CyclicPart:
    """The parameter of a block that a value is; none if the block has no such parameter of this length."""
    name = _PARAMETERS.get(place.part.name, place.part.name.lower())
    if block is None or name not in block.parameters:
        return CyclicPart("", "", place.part.octets)
    if datatype(block.parameters[name].kind).length != place.part.octets:
        return CyclicPart("", "", place.part.octets)
    return CyclicPart(block.name, name, place.part.octets)


def _packed(part: Part, value: float) -> bytes:
    """Raises ValueError for a value that the octets cannot have."""
    try:
        if part.type == "f32":
            return struct.pack(">f", value)
        whole = int(value)
        if part.type in _FORMATS:
            return struct.pack(_FORMATS[part.type], whole)
        return whole.to_bytes(3, "little" if part.name.startswith("CHECKBACK") else "big")
    except (OverflowError, struct.error, ValueError):
        raise ValueError(f"{value!r} does not fit into {part.type}") from None
