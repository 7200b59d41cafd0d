"""Type of a drive on the bus: ident number, telegrams, user parameters; its options."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from msgspec import Struct

from dpstack.errors import ConfigError
from dpstack.profile.model.jobs import LARGEST

#: the options of one drive, checked: true or false, a number, a text
Options = Mapping[str, bool | float | str]
#: octets of a parameter channel in front of the process data, the same for every drive that has one
CHANNEL_LEN: Final = 8
#: the option of every drive that switches the comparison off
CHECK_SETTINGS: Final = "check_settings"


def config_number(what: str, value: object) -> float:
    """``value`` if it is a number up to :data:`LARGEST`. Raises ConfigError, whose text begins with ``what``."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigError(f"{what} must be a number, not {value!r}")
    if abs(value) > LARGEST:
        raise ConfigError(f"{what} must be a number up to {LARGEST:g}")
    return value


class TelegramSpec(Struct, frozen=True, kw_only=True):
    """A telegram of a drive: identifier octets, octets each way, whether a parameter channel leads.

    ``made_up``: the identifiers are in no manual.
    """

    #: name
    name: str
    #: identifier octets
    config: bytes
    #: octets of the outputs behind the parameter channel
    outputs: int
    #: octets of the inputs behind the parameter channel
    inputs: int
    #: a parameter channel of eight octets leads
    channel: bool = False
    made_up: bool = False

    @property
    def output_octets(self) -> int:
        """All octets of the outputs."""
        return self.outputs + (CHANNEL_LEN if self.channel else 0)

    @property
    def input_octets(self) -> int:
        """All octets of the inputs."""
        return self.inputs + (CHANNEL_LEN if self.channel else 0)


class TelegramFamily(NamedTuple):
    """Telegrams too many to list, made on request."""

    #: makes the telegram of a name; raises ConfigError
    named: Callable[[str], TelegramSpec]
    #: makes the telegram of identifier octets; None for octets of another kind
    of_config: Callable[[bytes], TelegramSpec | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveType:
    """``family``: telegrams too many to list; ``fail_safe``: empty frames in Clear are understood."""

    #: name of the drive, that of its entry point
    name: str
    #: ident number, 0..0xFFFF
    ident: int
    #: its telegrams by name
    telegrams: Mapping[str, TelegramSpec]
    #: name of the telegram that a configuration without one gets
    default_telegram: str
    #: frequency in Hz that 100 % speed means at the factory
    reference_hz: float
    #: user parameters for Set_Prm
    user_prm: bytes = b""
    fail_safe: bool = False
    #: speed in rpm that 100 % speed means at the factory; 0: not known
    reference_rpm: float = 0.0
    family: TelegramFamily | None = None

    def telegram(self, name: str | None = None) -> TelegramSpec:
        """A telegram by name (any case), the default one for None. Raises ConfigError naming those there are."""
        wanted = self.default_telegram if name is None else name.strip().upper()
        for spec in self.telegrams.values():
            if spec.name.upper() == wanted.upper():
                return spec
        if self.family is not None:
            return self.family.named(wanted)
        raise ConfigError(f"{self.name} has no telegram {name!r}; it has {', '.join(self.telegrams)}")

    def telegrams_of(self, config: bytes) -> tuple[TelegramSpec, ...]:
        """The telegrams with these identifier octets; none if the drive does not know them."""
        found = tuple(spec for spec in self.telegrams.values() if spec.config == config)
        if not found and self.family is not None and (made := self.family.of_config(config)) is not None:
            return (made,)
        return found
