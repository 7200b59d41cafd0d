"""The master's end of a Fuji FRENIC-Multi."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dpstack.profile import (
    CHANNEL_LEN,
    FAULTED,
    NS_PER_MS,
    NS_PER_S,
    CommandError,
    DriveCore,
    DriveProfile,
    ListedParam,
    ParamKey,
    ParamRef,
    PkwAccess,
    State,
    Steps,
    TelegramSpec,
    listing,
    settled,
)
from dpstack_drives.fuji import table as t

_REMOTE: Final = t.STATUS.mask("remote")
_REVERSE: Final = t.CONTROL.mask("reverse")
#: OFF1 (ramp down) with bit 10 set: zeros would be ignored and leave the drive running
_SAFE: Final = bytes.fromhex("047E")
#: how long the drive may take to react is not in the manual; waits reckon with this
_SCAN_NS: Final = 20 * NS_PER_MS


class FujiCore(DriveCore):
    """MRV and MAV in parts of F03.

    Options: ``reference_hz`` (F03) and ``reverse``: a negative speed goes out as a negative MRV (``sign``) or by bit
    11 of CTW (``bit``).
    """

    def __init__(
        self, profile: DriveProfile, name: str, telegram: TelegramSpec, options: Mapping[str, bool | float | str]
    ) -> None:
        self._by_bit = options["reverse"] == "bit"
        self._alarm: int | None = None
        self._asked = False
        super().__init__(
            name,
            profile.name,
            telegram,
            t.TABLE,
            scan_ns=_SCAN_NS,
            reference_hz=float(options["reference_hz"]),
            safe_outputs=(bytes(CHANNEL_LEN) if telegram.channel else b"")
            + _SAFE
            + bytes(telegram.outputs - len(_SAFE)),
        )
        if telegram.channel:
            self.access = PkwAccess(t.PKW, self._resolve, lambda: self.now, self.settle_ns)

    def received(self) -> None:
        """With a parameter channel a trip is looked up in the malfunction history."""
        if self.raw_state not in FAULTED:
            self._alarm = None
            self._asked = False
        elif not self._asked and self.access is not None:
            self._asked = True
            self.spawn("alarm", self._ask())

    def setpoint_word(self, fraction: float) -> int:
        """MRV."""
        return self.scale.encode(abs(fraction) if self._by_bit else fraction)

    def control_bits(self) -> int:
        """Bit 11 reverses."""
        return _REVERSE if self._by_bit and self.setpoint < 0 else 0

    def faults(self) -> tuple[str, ...]:
        """By name where there is a parameter channel; STW alone does not tell."""
        if self.raw_state not in FAULTED:
            return ()
        if self._alarm is not None:
            return (t.alarm_text(self._alarm),)
        if self.access is not None:
            return ("not yet named",)
        return ("without a name: PPO3 and PPO4 do not carry it, the keypad shows it",)

    def fault_named(self) -> bool:
        """Nothing more is to be learned."""
        return self._alarm is not None or self.access is None

    def parameters(self) -> tuple[ListedParam, ...]:
        """Of the malfunction history the elements that hold an alarm."""
        return listing(t.PARAMETERS, elements={t.PNU_ALARMS: t.ALARM_INDEXES})

    def obstacle(self) -> str | None:
        """STW bit 9, then the state that a CTW which is not obeyed leaves behind."""
        if not self.status_word & _REMOTE:
            return "STW bit 9 is 0: neither run nor frequency command comes from the bus; set y98 to 3"
        if self.raw_state is State.SWITCH_ON_INHIBITED:
            return (
                "the drive stays in S1 and does not obey CTW: set y98 to 3 "
                "(with 1 only the frequency comes from the bus), and see to terminals LE and LOC and to y99, "
                "which go before the bus"
            )
        return None

    def prepare(self, deadline: int) -> Steps[None]:
        """Without STW bit 9 CTW does nothing."""
        yield from settled(self, self._remote, deadline)
        if self._remote():
            return
        why = self.obstacle() or ""
        if self.access is not None:
            outcome = yield from self.access.read(ParamKey("y98"), deadline)
            why = f"y98 is {outcome['value']}: {why}"
        raise CommandError("fault", why)

    def _remote(self) -> bool:
        return bool(self.status_word & _REMOTE)

    def _ask(self) -> Steps[dict[str, object]]:
        assert self.access is not None
        outcome = yield from self.access.read(ParamKey(t.PNU_ALARMS, index=1), self.now + NS_PER_S)
        raw = outcome["raw"]
        assert isinstance(raw, int)
        self._alarm = raw
        self.update()
        return outcome

    def _resolve(self, key: ParamKey) -> ParamRef:
        name, index = key.name, key.place
        if key.ram:
            raise CommandError("usage", f"{self.drive} has no writes to RAM only")
        if isinstance(name, str) and (found := t.address(name)) is not None:
            if index is not None:
                raise CommandError("usage", f"function code {name} has no index")
            spec = t.PARAMETERS.get(*found)
            return ParamRef(*found, False, spec, spec.label if spec else name)
        spec = t.PARAMETERS.named(name) if isinstance(name, str) else t.PARAMETERS.get(name)
        if spec is None and isinstance(name, str):
            raise CommandError("usage", f"{name!r} is neither a function code such as F26 nor a known parameter")
        number = spec.number if spec is not None else int(name)
        if not 1 <= number <= 0x7FF:
            raise CommandError("usage", f"parameter {number}: PNUs are 1..2047")
        if index is not None and index > 0xFF:
            raise CommandError("usage", f"parameter {number}: indexes are 0..255")
        array = number in t.ARRAYS or (spec is None and index is not None)
        label = f"PNU {number}" + (f"[{index}]" if index is not None else "")
        return ParamRef(number, (1 if array else 0) if index is None else index, array, spec, label)
