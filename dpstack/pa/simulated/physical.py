"""The physical block: identity, write protection, reset, DIAGNOSIS, classic or condensed.

Sources: docs/reference/decisions/pa.md#simulated-devices.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, cast

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.errors import RecordRefused
from dpstack.pa.blocks import PHYSICAL
from dpstack.pa.datatypes import ParameterValue
from dpstack.pa.simulated.block import AUTO, OUT_OF_SERVICE, Block
from dpstack.pa.simulated.faults import SWITCHES, diagnosis_of
from dpstack.units import NS_PER_S

#: WRITE_LOCKING: all parameters may be written
UNLOCKED: Final = 2457
#: FEATURE, octet 1: condensed status and diagnosis, classic ones, MS1
CONDENSED, CLASSIC, MS1 = 0x01, 0x02, 0x08
#: DIAGNOSIS, octet 2: after FACTORY_RESET, for ten seconds
WARM_START, COLD_START = 0x08, 0x10
_START_S: Final = 10
_IDENT_VIOLATION: Final = 0x80
#: FACTORY_RESET
RESET, WARM, ADDRESS = 1, 2506, 2712
#: bits of DIAGNOSIS and of its extension that the device knows
_MASK: Final = bytes((0x21, 0xB8, 0x0F, 0x80))
_MASK_EXTENSION: Final = bytes((0x3F, 0, 0, 0, 0, 0))


class PhysicalBlock(Block):
    """PB: what is common to the device."""

    permitted = AUTO | OUT_OF_SERVICE
    view = ("diagnosis",)

    def __init__(self, parent: int, of_class: int, values: Mapping[str, ParameterValue]) -> None:
        self._started_until: dict[int, int] = {}
        #: the condensed coding is ordered by Set_Prm; None: the parameters decide
        self.ordered: bool | None = None
        #: DIAGNOSIS has to show that the ident number in use is another than IDENT_NUMBER_SELECTOR says
        self.has_other_ident = False
        super().__init__("PB", PHYSICAL, parent, of_class, values)

    def reset(self) -> None:
        super().reset()
        self.put("write_locking", UNLOCKED)
        self.put("local_op_ena", 1)
        if "ident_number_selector" not in self._delivered:
            self.put("ident_number_selector", 127)
        self.put("diagnosis_mask", _MASK)
        self.put("diagnosis_mask_extension", _MASK_EXTENSION)
        self.put("diag_event_switch", SWITCHES)
        self.enable(bool(self.whole("cond_status_diag")))

    def enable(self, condensed: bool) -> None:
        """Bring the condensed coding of status and diagnosis into force, or the classic one."""
        supported = bytes((CONDENSED | CLASSIC | MS1, 0, 0, 0))
        enabled = bytes(((CONDENSED if condensed else CLASSIC) | MS1, 0, 0, 0))
        self.put("feature", {"supported": supported, "enabled": enabled})

    @property
    def condensed(self) -> bool:
        """Whether FEATURE has the condensed coding enabled."""
        enabled = cast("Mapping[str, bytes]", self.get("feature"))["enabled"]
        return bool(enabled[0] & CONDENSED)

    def allows(self, name: str) -> bool:
        """Whether the write protections let a master write the parameter ``name`` of any block."""
        if name == "tab_entry":
            return True
        if protection := self.whole("hw_write_protection"):
            return protection == 1 and name == "target_mode"
        return name == "write_locking" or self.whole("write_locking") == UNLOCKED

    def check(self, name: str, value: ParameterValue) -> None:
        super().check(name, value)
        if name == "diag_event_switch" and isinstance(value, bytes) and not _is_switch(value):
            raise RecordRefused(Code.INVALID_RANGE)

    def written(self, name: str, before: ParameterValue) -> None:
        super().written(name, before)
        if name == "cond_status_diag":
            self.ordered = None
            self.enable(bool(self.whole(name)))
        elif name == "factory_reset":
            self._restart(self.whole(name))

    def _restart(self, order: int) -> None:
        revision = self.whole("st_rev")
        self.put("factory_reset", 0)
        if order == RESET:
            self.device.reset()
            self.put("st_rev", revision)
            self.show_start(COLD_START)
        elif order == WARM:
            self.show_start(WARM_START)
        else:
            self.device.address_reset = True

    def show_start(self, bit: int) -> None:
        """Show a start in DIAGNOSIS for ten seconds."""
        self._started_until[bit] = self.device.now + _START_S * NS_PER_S

    def step(self, seconds: float) -> None:
        device = self.device
        switches = self._octets["diag_event_switch"]
        found, extension = diagnosis_of(device.events, device.condensed, switches)
        octets = bytearray(found)
        for bit, until in self._started_until.items():
            octets[1] |= bit if device.now < until else 0
        octets[1] |= _IDENT_VIOLATION if self.has_other_ident else 0
        if device.condensed and device.is_checked:
            octets[2] |= 0x04
        self.put_octets("diagnosis", bytes(octets))
        self.put_octets("diagnosis_extension", extension)

    @property
    def diagnosis(self) -> bytes:
        """DIAGNOSIS, and its extension if there is something in it; empty while all is well."""
        found, extension = self._octets["diagnosis"], self._octets["diagnosis_extension"]
        if self.mode == OUT_OF_SERVICE or not any(found):
            return b""
        return found + extension if any(extension) else found


def _is_switch(octets: bytes) -> bool:
    """Whether the event switches have known codes, and nothing follows behind them."""
    return all(one & 15 <= 8 and one >> 4 <= 5 for one in octets[:-2]) and not any(octets[-2:])
