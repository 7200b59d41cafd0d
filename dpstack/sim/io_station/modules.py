"""The module types of the I/O station as in its GSD file, and a slot with the module plugged into it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from dpstack.dp.pdu.alarm_blocks import ModuleState

if TYPE_CHECKING:
    from dpstack.hart.module import HartModule

#: the value of an analogue channel with a broken wire (overflow, as real modules show it)
BROKEN: Final = 0x7FFF
_BIT, _WORD = 1, 5
#: an analogue input of 4 to 20 mA: 0 to 100 % of the range
_FULL_SCALE: Final = 27648
#: what the transmitters of a HART module measure at first: half and a quarter of their range
_MEASURED: Final = bytes.fromhex("36001B00")


class IoModule(NamedTuple):
    """A type of module. ``config``: its identifier octet; ``inputs``, ``outputs`` in octets; ``channels``.

    ``prm``: its parameter octet as delivered, None if it has none; ``mask``: the bits that have a meaning.
    ``size``: of a channel, as in channel related diagnosis. ``hart``: a HART transmitter at each channel.
    """

    name: str
    config: int
    inputs: int
    outputs: int
    channels: int
    size: int
    prm: int | None = None
    mask: int = 0
    hart: bool = False

    @property
    def analogue_inputs(self) -> bool:
        """Whether its channels are wires that can break."""
        return bool(self.inputs) and self.size == _WORD


#: bits of the parameter octet of a digital input module
RISING: Final = 0x01
FALLING: Final = 0x02
#: of an analogue one
WIRE_BREAK: Final = 0x01

#: by identifier octet
MODULES: Final = {
    module.config: module
    for module in (
        IoModule("8 DI", 0x10, 1, 0, 8, _BIT, RISING, RISING | FALLING),
        IoModule("16 DI", 0x11, 2, 0, 16, _BIT, RISING, RISING | FALLING),
        IoModule("8 DO", 0x20, 0, 1, 8, _BIT),
        IoModule("16 DO", 0x21, 0, 2, 16, _BIT),
        IoModule("2 AI", 0x51, 4, 0, 2, _WORD, WIRE_BREAK, WIRE_BREAK),
        IoModule("2 AO", 0x61, 0, 4, 2, _WORD),
        IoModule("2 AI HART", 0xD1, 4, 0, 2, _WORD, WIRE_BREAK, WIRE_BREAK, hart=True),
    )
}
#: the identifier octet of an empty slot
EMPTY: Final = 0x00


def module_named(name: str) -> IoModule:
    """The module of this name, without regard to blanks and case. Raises ValueError with the known names."""
    for module in MODULES.values() if isinstance(name, str) else ():
        if module.name.replace(" ", "").lower() == name.replace(" ", "").lower():
            return module
    raise ValueError(f"there is no module {name!r}; there are: {', '.join(m.name for m in MODULES.values())}")


class Slot:
    """One slot: the module it is configured for, and the one that is plugged (None: none)."""

    def __init__(self, number: int, module: IoModule) -> None:
        self.number = number
        self.module = module
        self.plugged: IoModule | None = module
        #: inputs of the process, also while the module is missing
        self.process = _MEASURED if module.hart else bytes(module.inputs)
        self.outputs = bytes(module.outputs)
        self.prm = module.prm or 0
        #: channels whose wire is broken, also while the module is missing
        self.broken: frozenset[int] = frozenset()
        self._hart = _transmitters() if module.hart else None

    @property
    def hart(self) -> HartModule | None:
        """The HART records of the module as wires and process are now; None: it has none."""
        module = self._hart
        if module is not None:
            module.broken = self.broken
            for channel, transmitter in enumerate(module.transmitters):
                raw = int.from_bytes(self.process[2 * channel : 2 * channel + 2], "big", signed=True)
                transmitter.percent = 100 * raw / _FULL_SCALE
        return module

    def inherit(self, before: Slot) -> None:
        """Take over module, process, wires and transmitters of ``before``, before the station was switched off."""
        self.plugged, self.process, self.broken = before.plugged, before.process, before.broken
        self._hart = before._hart
        if self._hart is not None:
            self._hart.restart()

    @property
    def present(self) -> bool:
        return self.plugged is self.module

    @property
    def faults(self) -> frozenset[int]:
        """Broken channels that the module diagnoses."""
        return self.broken if self.present and self.prm & WIRE_BREAK else frozenset()

    @property
    def state(self) -> ModuleState:
        if self.plugged is None:
            return ModuleState.MISSING
        if not self.present:
            return ModuleState.WRONG
        return ModuleState.INVALID if self.faults else ModuleState.OK

    @property
    def inputs(self) -> bytes:
        """The inputs that the master reads: zeros without the right module, BROKEN for a broken wire."""
        if not self.present:
            return bytes(len(self.process))
        if not self.broken:
            return self.process
        octets = bytearray(self.process)
        for channel in self.broken:
            octets[2 * channel : 2 * channel + 2] = BROKEN.to_bytes(2, "big")
        return bytes(octets)

    @property
    def text(self) -> str:
        return f"slot {self.number} ({self.module.name})"

    def as_dict(self) -> dict[str, object]:
        """The slot for JSON; ``plugged`` null: no module. ``inputs`` as the master reads them, ``outputs`` as set."""
        shown: dict[str, object] = {
            "module": self.module.name,
            "plugged": None if self.plugged is None else self.plugged.name,
            "state": self.state.text,
        }
        if self.module.inputs:
            shown["inputs"] = self.inputs.hex()
        if self.module.outputs:
            shown["outputs"] = self.outputs.hex()
        if self.module.prm is not None:
            shown["parameter"] = f"{self.prm:02x}"
        if self.broken:
            shown["wire_breaks"] = sorted(self.broken)
        return shown


def _transmitters() -> HartModule:
    from dpstack.hart.module import HartModule  # here, as few stations have HART modules
    from dpstack.hart.transmitter import pressure, temperature

    return HartModule((pressure(), temperature()))


def edges(before: bytes, after: bytes, prm: int) -> bytes:
    """The bits of digital inputs that changed in a way that raises a process alarm; all zeros for none."""
    was, now = int.from_bytes(before, "big"), int.from_bytes(after, "big")
    rising = now & ~was if prm & RISING else 0
    falling = was & ~now if prm & FALLING else 0
    return (rising | falling).to_bytes(len(after), "big")
