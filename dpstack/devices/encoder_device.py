"""The simulated encoder of a device file: it turns, answers presets, and has alarms to order."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dpstack.devices.model import EncoderFile, WordSpec
from dpstack.dp.pdu.diag_blocks import NO_DIAG, UserDiag, device_block
from dpstack.dp.slave.device import Leave
from dpstack.dpv1.slave.device import Device
from dpstack.errors import ConfigError
from dpstack.profile.drive_profile import DeviceProfile
from dpstack.profile.model.drive_type import Options, TelegramSpec
from dpstack.units import NS_PER_S

_S_PER_MIN: Final = 60
#: octets of a diagnosis before the data of its first block
_HEADERS: Final = 7
#: counts per turn if nobody knows them
_COUNTS: Final = 4096


class EncoderDevice(Device):
    """Its position goes on with :attr:`rpm` from exchange to exchange, also while it is not in data exchange."""

    def __init__(
        self,
        file: EncoderFile,
        profile: DeviceProfile,
        telegram: TelegramSpec,
        options: Options,
        presets: Mapping[str, object],
    ) -> None:
        if presets:
            known = ", ".join(profile.device_options)
            raise ConfigError(f"simulated {file.name}: there is no option {next(iter(presets))!r}; known: {known}")
        self.file, self.profile, self.telegram = file, profile, telegram
        self.name, self.ident, self.fail_safe = profile.name, profile.ident, profile.fail_safe
        #: speed in revolutions per minute
        self.rpm = float(options["rpm"])
        self._range = round(float(options["range"]))
        self._turn = float(options["counts_per_turn"]) or _COUNTS
        self._counts = float(options["start"])
        self._at: int | None = None
        self._strobe = False
        self._alarms: set[int] = set()
        self._warnings = 0

    def __repr__(self) -> str:
        return f"<EncoderDevice {self.name}>"

    # -- from outside --------------------------------------------------------------------------------------------------

    def turn(self, rpm: float) -> None:
        """Turn at this speed from the next exchange on."""
        self.rpm = rpm

    def trip(self, code: str) -> None:
        """Raise an alarm, by its text or its ``OCTET.BIT``. Raises ValueError with the known ones."""
        known = {bit: (f"{_HEADERS + 1 + bit // 8}.{bit % 8}", text) for bit, text in self.file.alarms.items()}
        wanted = code.strip().lower()
        found = [bit for bit, names in known.items() if wanted in (names[0], names[1].lower())]
        if not found:
            listed = ", ".join(f"{place} ({text})" for place, text in known.values()) or "none"
            raise ValueError(f"{code!r} is no alarm of this device; known: {listed}")
        self._alarms.update(found)

    def warn(self, mask: int) -> None:
        """Set the warnings: bit n is the n-th one of the file; 0 ends them."""
        self._warnings = mask

    def acknowledge(self) -> None:
        """End the alarms. Raises ValueError if none stands."""
        if not self._alarms:
            raise ValueError("no alarm stands")
        self._alarms.clear()

    def inherit(self, before: EncoderDevice) -> None:
        """Take over shaft and zero point of the same device before it was switched off and on."""
        self.rpm, self._counts, self._at = before.rpm, before._counts, before._at

    @property
    def injected(self) -> tuple[str, ...]:
        """Faults and conditions from outside, written as the commands of ``dpstack ctl``."""
        found = [f"trip {self.file.alarms[bit]}" for bit in sorted(self._alarms)]
        return (*found, f"warn {self._warnings:04X}") if self._warnings else tuple(found)

    # -- Device --------------------------------------------------------------------------------------------------------

    def check_cfg(self, config: bytes) -> str | None:
        return None if self.profile.telegrams_of(config) else super().check_cfg(config)

    def check_prm(self, user_prm: bytes) -> str | None:
        needed = len(self.profile.user_prm)
        return None if len(user_prm) >= needed else f"{len(user_prm)} octets of user parameters, {needed} are needed"

    def enter(self, config: bytes, now: int) -> None:
        if self.telegram.config != config:
            self.telegram = self.profile.telegrams_of(config)[0]
        self._strobe = False

    def exchange(self, outputs: bytes, now: int) -> bytes:
        if self._at is not None:
            self._counts += self.rpm / _S_PER_MIN * self._turn * (now - self._at) / NS_PER_S
        self._at = now
        found = self.file.part(self.telegram.name, "preset", outputs=True)
        if found is not None:
            word, at = found
            number = int.from_bytes(outputs[at : at + word.octets], "big")
            top = 8 * word.octets - 1
            strobe = bool(number >> top)
            if strobe and not self._strobe:
                self._counts = float(number & ((1 << top) - 1))
            self._strobe = strobe
        return self._inputs()

    def clear(self, now: int) -> None:
        self._strobe = False

    def leave(self, reason: Leave, now: int) -> None:
        self._strobe = False

    def user_diag(self) -> UserDiag:
        warned = {bit for number, bit in enumerate(self.file.warnings) if self._warnings >> number & 1}
        if not self._alarms and not warned:
            return NO_DIAG
        bits = sum(1 << bit for bit in self._alarms | warned)
        data = bits.to_bytes(self.file.diagnosis_octets - _HEADERS, "little")
        return UserDiag.of(device_block(data), fault=bool(self._alarms))

    # -- inside --------------------------------------------------------------------------------------------------------

    def _inputs(self) -> bytes:
        octets = b""
        for name in self.file.telegrams[self.telegram.name].inputs:
            word = None if isinstance(name, int) else self.file.words[name]
            if word is None:
                octets += bytes(2)
                continue
            number = self._position(word) if word.part == "position" else 0
            if word.part == "velocity":
                number = self._velocity(word)
            octets += number.to_bytes(word.octets, "big")
        return octets

    def _position(self, word: WordSpec) -> int:
        limit = 1 << (word.width or 8 * word.octets)
        number = int(self._counts // 1) % min(self._range or limit, limit)
        confirms = word.bits.get(self.file.preset_done)
        return number | (1 << confirms if confirms is not None and self._strobe else 0)

    def _velocity(self, word: WordSpec) -> int:
        declared = {} if self.profile.fields is None else self.profile.fields(self.telegram.name)[0]
        field = declared.get("velocity")
        scale, unit = self.file.velocity
        if isinstance(field, Mapping):
            scale, unit = float(field["scale"]), str(field["unit"])
        speed = self.rpm if unit == "rpm" else self.rpm / _S_PER_MIN * self._turn
        bits = 8 * word.octets
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if word.signed else (0, (1 << bits) - 1)
        return min(max(round(speed / abs(scale)), low), high) & ((1 << bits) - 1)
