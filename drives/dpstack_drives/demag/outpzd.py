"""OUT-PZD3 to OUT-PZD6 of PPO2 and PPO4 as sources 750 to 761 (docs/reference/drives/demag.md#out-pzd).

PZD3 is also the additional reference (docs/reference/drives/demag.md#additional-reference). The manual's list and
example have PZD5 as long at 759: by its table it is 760, which is taken.
"""

from __future__ import annotations

from typing import ClassVar, Final

from msgspec import Struct

from dpstack.profile import Scale, process_data_map

#: PZD3 is the first one
FIRST: Final = 3
COUNT: Final = 4
#: meaning: first source number (of PZD3)
SOURCES: Final = {"bool": 750, "percent": 754, "current": 754, "torque": 754, "frequency": 758}
#: 11.2.4: PZD3 is added to the ramp output
ADDITIONAL: Final = "reference"
EMPTY: Final = "-"
_KINDS: Final = (*SOURCES, ADDITIONAL, EMPTY)
_TRUE: Final = 0xFFFF
_PERCENT: Final = Scale("percent", full=100, span=1.0, unit="%")
_PERCENT_LIMIT: Final = 300
_CURRENTS: Final = ("current", "torque")
#: of the scaling current
_AMPERE: Final = 0x2000


class OutPzd(Struct, frozen=True):
    """A word: PZD ``key`` as ``kind``. ``reference_hz`` and ``scaling_current`` (A, 0: not known) scale it."""

    octets: ClassVar[int] = 2
    neutral: ClassVar[bool] = True
    key: int
    kind: str
    reference_hz: float
    scaling_current: float

    @property
    def name(self) -> str:
        """``pzd3``."""
        return f"pzd{self.key}"

    def encode(self, value: float) -> int:
        """The word. Raises ValueError with the range."""
        what = f"{self.name} ({self.kind})"
        if self.kind == "bool":
            if value not in (0, 1):
                raise ValueError(f"{what} is 0 or 1, not {value:g}")
            return _TRUE if value else 0
        if self.kind == "percent" and not abs(value) <= _PERCENT_LIMIT:
            raise ValueError(f"{what} {value:g} % is outside -{_PERCENT_LIMIT}..{_PERCENT_LIMIT} %")
        if self.kind in _CURRENTS and not self.scaling_current:
            raise ValueError(f"{what} needs the option scaling_current: the drive's scaling current in A")
        return self._scale.encode(value)

    def decode(self, raw: int) -> int | float:
        """The value of a word, in its unit."""
        return int(raw == _TRUE) if self.kind == "bool" else self._scale.decode(raw)

    @property
    def _scale(self) -> Scale:
        what = f"{self.name} ({self.kind})"
        if self.kind in _CURRENTS:
            return Scale(what, _AMPERE, self.scaling_current, "A")
        return _PERCENT if self.kind == "percent" else Scale(what, span=self.reference_hz, unit="Hz")


class OutMap(Struct, frozen=True):
    """The meanings of PZD3 to PZD6; as text their kinds in order, ``-`` for a word that is not used."""

    fields: tuple[OutPzd | None, ...]

    def __str__(self) -> str:
        return " ".join(EMPTY if field is None else field.kind for field in self.fields)


def parse(text: str, reference_hz: float, scaling_current: float) -> OutMap:
    """``reference percent - frequency``; what is not given is not used. Raises ValueError."""
    kinds = process_data_map.split(text)[0].lower().split()
    if len(kinds) > COUNT:
        raise ValueError(f"{len(kinds)} words, there are {COUNT} (PZD3 to PZD6)")
    fields: list[OutPzd | None] = []
    for number, kind in enumerate(kinds, FIRST):
        if kind not in _KINDS:
            raise ValueError(f"{kind!r} is no meaning of PZD{number}; write {', '.join(_KINDS)}")
        if kind == ADDITIONAL and number != FIRST:
            raise ValueError(f"only PZD{FIRST} is the additional reference, not PZD{number}")
        fields.append(None if kind == EMPTY else OutPzd(number, kind, reference_hz, scaling_current))
    return OutMap((*fields, *(None,) * (COUNT - len(fields))))


def source(number: int, words: tuple[int, ...], reference_hz: float) -> bool | float:
    """A source as the drive's functions take it: Boolean, per cent (words), Hz (longs). Raises ValueError.

    Readings: anything but 0 is TRUE; per cent beyond 300 are 300.
    """
    kind, at = divmod(number - SOURCES["bool"], COUNT)
    if not 0 <= kind <= 2:
        raise ValueError(f"source {number} is none of 750 to 761")
    word = words[FIRST - 1 + at]
    if kind == 0:
        return bool(word)
    if kind == 1:
        return min(max(_PERCENT.decode(word), -_PERCENT_LIMIT), _PERCENT_LIMIT)
    return Scale("frequency", span=reference_hz).decode(word)
