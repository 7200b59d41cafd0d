"""The devices of a bus as far as configuration and GSD files describe them: names, models, diagnosis texts, T_SDR."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from dpstack.gsd.diag_texts import DiagTexts


@dataclass(frozen=True, slots=True)
class KnownDevice:
    """``name``: the user's; ``model``: the vendor's, both "" if unknown. ``max_tsdr``: MaxTsdr in bit times by baud
    rate. ``texts``: of its GSD file. ``dpv1``: whether it knows DP-V1, None if nobody says."""

    name: str = ""
    model: str = ""
    max_tsdr: Mapping[int, int] = field(default_factory=dict)
    texts: DiagTexts | None = None
    dpv1: bool | None = None


_UNKNOWN: Final = KnownDevice()


@dataclass(slots=True)
class Devices:
    """Known devices: ``by_address`` from the user's configuration, ``by_ident`` from a folder of GSD files. ``t_sl`` in
    bit times by baud rate, from the configuration; empty without one."""

    by_address: dict[int, KnownDevice] = field(default_factory=dict)
    by_ident: dict[int, KnownDevice] = field(default_factory=dict)
    t_sl: Mapping[int, int] = field(default_factory=dict)

    def find(self, address: int, ident: int | None) -> KnownDevice:
        """The device at ``address``; the configuration goes before GSD files found by ``ident``."""
        own = self.by_address.get(address, _UNKNOWN)
        other = _UNKNOWN if ident is None else self.by_ident.get(ident, _UNKNOWN)
        return KnownDevice(
            own.name,
            own.model or other.model,
            own.max_tsdr or other.max_tsdr,
            own.texts or other.texts,
            other.dpv1 if own.dpv1 is None else own.dpv1,
        )
