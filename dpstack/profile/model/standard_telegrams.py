"""PROFIdrive's telegrams as data: what stands in which word, N2 and N4; and its general parameters (PNU 9xx).

Sources: Siemens MASTERDRIVES, V90, G120, G220 manuals (telegrams 1 to 9, 20, 102, 103, 105; 104 is in none of them),
Mitsubishi FR-E5NP (PPO types), Siemens 611U and ABB RETA-02 (PNUs). Makers use the numbers for words of their own, too:
a drive's telegrams are what its manual says.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

from dpstack.profile.model import process_data_map
from dpstack.profile.model.drive_type import CHANNEL_LEN
from dpstack.profile.model.words import N4, SPEED, Scale


@dataclass(frozen=True, slots=True)
class Signal:
    """One signal of a telegram. ``scale`` None: bits, or an integer without a sign."""

    key: int
    name: str
    octets: int = 2
    scale: Scale | None = None
    neutral: ClassVar[bool] = True

    def encode(self, value: float) -> int:
        """The unsigned integer on the wire. Raises ValueError with the range."""
        if self.scale is not None:
            return self.scale.encode(value)
        bits = 8 * self.octets
        if value != int(value) or not 0 <= value < 1 << bits:
            raise ValueError(f"{self.name} is an integer of {bits} bits, not {value:g}")
        return int(value)

    def decode(self, raw: int) -> int | float:
        """The value of an unsigned integer on the wire; of a scaled signal 1.0 is the reference."""
        return raw if self.scale is None else self.scale.decode(raw)


_WORDS: Final = (
    *("STW1", "STW2", "ZSW1", "ZSW2", "G1_STW", "G2_STW", "G1_ZSW", "G2_ZSW", "MELDW", "MELD_NAMUR"),
    *("SATZANW", "AKTSATZ", "MDI_ACC", "MDI_DEC", "MDI_MOD"),
)
_LONGS: Final = (
    *("G1_XIST1", "G1_XIST2", "G2_XIST1", "G2_XIST2", "XERR", "KPC", "MDI_TARPOS", "MDI_VELOCITY", "XIST_A"),
)
_N2: Final = ("NSOLL_A", "NIST_A", "NIST_A_GLATT", "IAIST_GLATT", "MIST_GLATT", "PIST_GLATT", "MOMRED")
_N4: Final = ("NSOLL_B", "NIST_B")
#: by name
SIGNALS: Final[Mapping[str, Signal]] = {
    name: Signal(key, name, octets, scale)
    for key, (name, octets, scale) in enumerate(
        (
            *((name, 2, None) for name in _WORDS),
            *((name, 4, None) for name in _LONGS),
            *((name, 2, SPEED) for name in _N2),
            *((name, 4, N4) for name in _N4),
        )
    )
}


@dataclass(frozen=True, slots=True)
class Standard:
    """A telegram: the signals each way in their order; ``channel``: PKW leads."""

    number: int
    outputs: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    channel: bool = False

    @property
    def output_octets(self) -> int:
        """All octets of the outputs."""
        return sum(one.octets for one in self.outputs) + (CHANNEL_LEN if self.channel else 0)

    @property
    def input_octets(self) -> int:
        """All octets of the inputs."""
        return sum(one.octets for one in self.inputs) + (CHANNEL_LEN if self.channel else 0)

    def pack(self, values: Mapping[str, float]) -> bytes:
        """The process data of the outputs; a signal that is not given is 0.

        Raises ValueError with the range, KeyError for a signal that the telegram does not have.
        """
        fields = {one.name: one for one in self.outputs}
        raws = {fields[name].key: fields[name].encode(value) for name, value in values.items()}
        words = process_data_map.pack(self.outputs, raws, sum(one.octets for one in self.outputs) // 2)
        return b"".join(word.to_bytes(2, "big") for word in words)

    def unpack(self, process: bytes) -> dict[str, int | float]:
        """The signals of the process data of the inputs, as far as there are octets."""
        words = [int.from_bytes(process[at : at + 2], "big") for at in range(0, len(process) - 1, 2)]
        return process_data_map.decoded(self.inputs, words)


def _signals(text: str) -> tuple[Signal, ...]:
    return tuple(SIGNALS[name] for name in text.split())


_OUT_3, _IN_3 = "STW1 NSOLL_B STW2 G1_STW", "ZSW1 NIST_B ZSW2 G1_ZSW G1_XIST1 G1_XIST2"
_OUT_102, _IN_102 = "STW1 NSOLL_B STW2 MOMRED G1_STW", "ZSW1 NIST_B ZSW2 MELDW G1_ZSW G1_XIST1 G1_XIST2"
_SECOND: Final = " G2_ZSW G2_XIST1 G2_XIST2"
_ROWS: Final[Mapping[int, tuple[str, str]]] = {
    1: ("STW1 NSOLL_A", "ZSW1 NIST_A"),
    2: ("STW1 NSOLL_B STW2", "ZSW1 NIST_B ZSW2"),
    3: (_OUT_3, _IN_3),
    4: (f"{_OUT_3} G2_STW", _IN_3 + _SECOND),
    5: (f"{_OUT_3} XERR KPC", _IN_3),
    7: ("STW1 SATZANW", "ZSW1 AKTSATZ"),
    9: ("STW1 SATZANW STW2 MDI_TARPOS MDI_VELOCITY MDI_ACC MDI_DEC MDI_MOD", "ZSW1 AKTSATZ ZSW2 XIST_A"),
    20: ("STW1 NSOLL_A", "ZSW1 NIST_A_GLATT IAIST_GLATT MIST_GLATT PIST_GLATT MELD_NAMUR"),
    102: (_OUT_102, _IN_102),
    103: (f"{_OUT_102} G2_STW", _IN_102 + _SECOND),
    105: (f"{_OUT_102} XERR KPC", _IN_102),
}
#: by number
TELEGRAMS: Final = {number: Standard(number, _signals(out), _signals(into)) for number, (out, into) in _ROWS.items()}

#: PPO types: octets of process data each way, and whether PKW leads
PPO: Final[Mapping[str, tuple[int, bool]]] = {
    "PPO1": (4, True),
    "PPO2": (12, True),
    "PPO3": (4, False),
    "PPO4": (12, False),
    "PPO5": (20, True),
}

#: general parameters
PNUS: Final[Mapping[int, str]] = {
    915: "assignment of the outputs",
    916: "assignment of the inputs",
    918: "node address",
    919: "device system number",
    922: "telegram",
    923: "list of signals",
    925: "tolerance of the sign of life",
    927: "operator rights",
    928: "control priority",
    930: "operating mode",
    944: "fault message counter",
    945: "fault code",
    947: "fault number",
    950: "scaling of the fault buffer",
    952: "number of fault situations",
    953: "warning word",
    963: "baud rate",
    964: "identity",
    965: "profile and version",
    967: "control word",
    968: "status word",
    970: "load parameters",
    971: "store parameters",
    972: "reset",
    974: "limits of the parameter channel",
    975: "identity of the drive object",
}
