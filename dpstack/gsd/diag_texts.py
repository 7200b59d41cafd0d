"""Look-up of the diagnosis texts of a GSD file by the octets and error types of a received diagnosis."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dpstack.gsd.model import Device, Diagnosis, DiagText, Module


class DiagTexts:
    """The texts of ``device`` with ``modules`` in the order of the configuration (None: an empty slot).

    If the module is known, its texts count before the device's. Bits are counted from 0 at the first
    octet behind the block's header (GE's MM300 manual prints it so, table 4-5); an area's first bit is its lowest.

    ``alarms``, ``warnings``: texts by bit that somebody knows beside the file, and that go before its own: they count
    without Ext_Diag too, and after an alarm no value of the device is good. ``pa_extension``: of a PROFIBUS PA device,
    texts of the bits of DIAGNOSIS_EXTENSION by their numbers from 1; None: it is no such device by its device file.
    """

    def __init__(
        self,
        device: Device,
        modules: Sequence[Module | None] = (),
        alarms: Iterable[DiagText] = (),
        warnings: Iterable[DiagText] = (),
        pa_extension: Mapping[int, str] | None = None,
    ) -> None:
        #: see above
        self.pa_extension = pa_extension
        self.alarms = frozenset(alarms)
        self.warnings = frozenset(warnings)
        self._known_beside = tuple(sorted(self.alarms | self.warnings))
        self.device = device
        self.first_slot = device.first_slot
        self._types = {d.type: d for d in device.diag_types}
        self.modules = tuple(modules)

    def unit_diag_texts(self, octets: bytes, module: int | None = None) -> tuple[DiagText, ...]:
        """Texts of a device related block; ``octets`` behind its header. ``module``: its index in the configuration."""
        return tuple(self._found(octets, module))

    def has_type(self, octets: bytes) -> bool:
        """Whether the file has texts for device related blocks of this type, the first of ``octets``."""
        return bool(octets) and octets[0] in self._types

    def channel_text(self, error_type: int, module: int | None = None) -> DiagText | None:
        """The text of a channel related error, 0..31; None if the file has none."""
        texts = (text for diagnosis in self._sources(module) for text in diagnosis.texts)
        return next((text for text in texts if text.kind == "channel" and text.value == error_type), None)

    def known(self, module: int | None = None) -> tuple[DiagText, ...]:
        """All texts of a module, by its index in the configuration, and of the device."""
        return tuple(text for diagnosis in self._sources(module) for text in diagnosis.texts)

    def all_known(self, module: int | None = None) -> Iterator[tuple[DiagText, int | None]]:
        """As :meth:`known`, each with None, and those of the types of device related blocks, each with its type."""
        for text in self.known(module):
            yield text, None
        for kind, diagnosis in self._types.items():
            for text in diagnosis.texts:
                yield text, kind

    def module_name(self, module: int) -> str:
        """The name of a module by its index in the configuration; empty for an empty slot and if none exists."""
        found = self._module(module)
        return "" if found is None else found.name

    def _sources(self, module: int | None) -> Iterator[Diagnosis]:
        own = self._module(module)
        if own is not None:
            yield own.diagnosis
        yield self.device.diagnosis

    def _module(self, number: int | None) -> Module | None:
        return self.modules[number] if number is not None and 0 <= number < len(self.modules) else None

    def _found(self, octets: bytes, module: int | None) -> Iterator[DiagText]:
        # UnitDiagType names the first octet, the type of a DP-V1 alarm or status: its texts replace the general ones
        typed = self._types.get(octets[0]) if octets else None
        sources = self._sources(module) if typed is None else (typed,)
        value, size = int.from_bytes(octets, "little"), 8 * len(octets)
        found: set[tuple[str, int]] = set()
        for texts in (self._known_beside, *(diagnosis.texts for diagnosis in sources)):
            for text in texts:
                kind, first, last, wanted, _, _ = text
                if first is None or last is None or first < 0 or last >= size or (kind, first) in found:
                    continue
                if value >> first & (1 << last - first + 1) - 1 == wanted:
                    found.add((kind, first))
                    yield text
