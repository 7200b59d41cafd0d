"""The vendor's own telegrams of the CPDP-S100 (docs/reference/drives/ls-s100.md#telegrams); all others are in its file.

``VENDOR OUTPUTS/INPUTS`` has 1..8 words each way, which Para Control (COM-51..) and Para Status (COM-31..) fill. ST1,
PPO3 and VENDOR 2/2 are alike by length: their identifier octets distinguish them. All identifier octets are made up,
as the manual prints no GSD file.
"""

from __future__ import annotations

import re
from typing import Final

from dpstack.profile import ConfigError, TelegramFamily, TelegramSpec
from dpstack_drives.ls import table as t

_OUT, _IN = 0x60, 0x50
#: COM-30 and COM-50; the manual has 0..8 and 1..8: 1..8 is taken
MOST: Final = 8
VENDOR: Final = 100
_HOW: Final = "VENDOR OUTPUTS/INPUTS, 1..8 words each, e.g. VENDOR 2/3"
_NAME: Final = re.compile(r"VENDOR\s+(\d+)\s*/\s*(\d+)", re.IGNORECASE)


TELEGRAMS: Final = t.FILE.telegrams


def number_of(spec: TelegramSpec) -> int:
    """The number of a telegram in PNU 922 and COM-10."""
    found = TELEGRAMS.get(spec.name)
    return VENDOR if found is None or found.number is None else found.number


def vendor(outputs: int, inputs: int) -> TelegramSpec:
    """The vendor telegram of so many words, 1..8 each."""
    return TelegramSpec(
        name=f"VENDOR {outputs}/{inputs}",
        config=bytes((_OUT + outputs - 1, _IN + inputs - 1)),
        outputs=2 * outputs,
        inputs=2 * inputs,
        made_up=True,
    )


def named(name: str) -> TelegramSpec:
    """The vendor telegram called ``name`` (any case). Raises ConfigError that says how names are written."""
    match = _NAME.fullmatch(name.strip())
    if match is None:
        raise ConfigError(f"ls-s100 has no telegram {name!r}; it has {', '.join(TELEGRAMS)} and {_HOW}")
    outputs, inputs = int(match[1]), int(match[2])
    if not (1 <= outputs <= MOST and 1 <= inputs <= MOST):
        raise ConfigError(f"telegram {name!r}: COM-50 (outputs) and COM-30 (inputs) are 1..{MOST}; write {_HOW}")
    return vendor(outputs, inputs)


def of_config(config: bytes) -> TelegramSpec | None:
    """The vendor telegram with these identifier octets; None for octets of another kind."""
    if len(config) != 2 or not (0 <= config[0] - _OUT < MOST and 0 <= config[1] - _IN < MOST):
        return None
    return vendor(config[0] - _OUT + 1, config[1] - _IN + 1)


FAMILY: Final = TelegramFamily(named, of_config)
