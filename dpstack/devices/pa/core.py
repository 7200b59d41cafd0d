"""Master side of a PA device: set points go out with a good status only while a value stands.

A set point of PROFIBUS PA is a value and a status, and both are one output: the actuator goes to its fail-safe
position by a bad status. So the octets are zeros, which is bad status, until a program has given a value, and again on
every way out: the safe outputs are zeros.
"""

from __future__ import annotations

import struct
from typing import Final

from dpstack.devices.pa.configurations import layout_of_telegram
from dpstack.devices.pa.layout import Place
from dpstack.devices.pa.model import PaFile
from dpstack.profile.master.device_core import DeviceCore
from dpstack.profile.model.drive_type import DriveType, Options, TelegramSpec
from dpstack.profile.model.jobs import Args, CommandError, Steps

#: status of a set point while its value stands: good, not specific, no limits
GOOD: Final = 0x80
RELEASE: Final = "release"


class PaCore(DeviceCore):
    """The PA device in ``file``. Its order :data:`RELEASE` takes back the value of the output ``name``, without a name
    those of all: their octets are zeros again."""

    def __init__(self, file: PaFile, profile: DriveType, name: str, telegram: TelegramSpec, options: Options) -> None:
        super().__init__(profile.name, name, telegram)
        self.file = file
        self._places = layout_of_telegram(file, telegram.name).outputs
        if self._places:
            self.operations = {RELEASE: 1.0}
        #: octets of the values that stand, by the name of the output
        self.standing: dict[str, bytes] = {}

    def lost(self, now: int) -> None:
        self.standing.clear()
        super().lost(now)

    def set_values(self, args: Args) -> dict[str, object] | None:
        given = [(str(one.name_or_number("name")), one.optional("value")) for one in args.tables("values")]
        octets = {name: None if value is None else self._octets(name, value) for name, value in given}
        for name, own in octets.items():
            if own is None:
                self._place(name)
                self.standing.pop(name, None)
            else:
                self.standing[name] = own
        self._put()
        return {"values": dict(given)}

    def order(self, op: str, args: Args, deadline: int) -> Steps[dict[str, object]]:
        name = args.text("name")
        if name is not None:
            self._place(name)
        return self._release(name)

    # -- inside ------------------------------------------------------------------------------------------------------

    def _release(self, name: str | None) -> Steps[dict[str, object]]:
        yield from ()
        released = list(self.standing) if name is None else [name]
        for one in released:
            self.standing.pop(one, None)
        self._put()
        return {"value": released}

    def _place(self, name: str) -> Place:
        place = self._places.get(name)
        if place is None:
            known = ", ".join(self._places) or "none"
            raise CommandError("usage", f"{name!r} is no output of {self.kind}; it has {known}")
        return place

    def _octets(self, name: str, value: float) -> bytes:
        """``value`` as the octets of its output, with the status. Raises CommandError."""
        part = self._place(name).part
        try:
            own = (
                struct.pack(">f", value) if part.type == "f32" else self._whole(name, value, part.octets - part.status)
            )
        except (OverflowError, struct.error):
            raise CommandError("usage", f"{name} = {value:g} is no number that four octets can hold") from None
        return own + bytes([GOOD] * part.status)

    def _whole(self, name: str, value: float, octets: int) -> bytes:
        signed = self._place(name).part.type.startswith("i")
        if value != int(value):
            raise CommandError("usage", f"{name} = {value:g} is no whole number")
        try:
            return int(value).to_bytes(octets, "big", signed=signed)
        except OverflowError:
            raise CommandError("usage", f"{name} = {value:g} does not fit into {octets} octets") from None

    def _put(self) -> None:
        """Make the outputs of the values that stand; everything else is zero."""
        octets = bytearray(self.safe_outputs)
        for name, own in self.standing.items():
            at = self._places[name].at
            octets[at : at + len(own)] = own
        self.outputs = bytes(octets)
