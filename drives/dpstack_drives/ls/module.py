"""The CPDP-S100 of the simulated drive: parameters by PKW, fault situations, PNUs
(docs/reference/drives/ls-s100.md#pnus)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.profile import DriveDevice, ParamSpec, Pkw, ReplyId, TaskId
from dpstack_drives.ls import table as t

_READS: Final = frozenset({TaskId.READ, TaskId.READ_ARRAY})
#: requests that the module does not support, with their errors (a reading)
_REFUSED: Final = {3: 0x05, 8: 0x05, 4: 0x09, 5: 0x07, 9: 0x04}
_ILLEGAL_FORMAT: Final = 0x17
#: not while the motor turns (a reading)
_STOPPED_ONLY: Final = frozenset({t.address("dr-20"), t.address("dr-06"), t.address("dr-07")})
_RESETS: Final = frozenset({t.address("COM-13")})
_TRIP_COUNTER_END: Final = 0x10000


class Module:
    """Answers orders. ``live``: the present value of a PNU or an address, None if it is the stored one.

    ``changed`` is called with the address of every parameter written.
    """

    def __init__(
        self, device: DriveDevice, live: Callable[[int, int], int | None], changed: Callable[[int], None]
    ) -> None:
        self.device = device
        self.store = device.store
        self._live = live
        self._changed = changed
        self.counter = 0
        #: 947: eight situations of messages in their order, the present one first
        self.situations: list[list[int]] = [[] for _ in range(t.SITUATIONS)]
        self._reset = 0

    # -- faults (7.2) ---------------------------------------------------------------------------------------------

    def fault(self, number: int) -> None:
        """A message of the present situation; the ninth overwrites the eighth."""
        present = self.situations[0]
        if len(present) == t.MESSAGES:
            present[-1] = number
        else:
            present.append(number)
        self.counter = (self.counter + 1) % _TRIP_COUNTER_END

    def acknowledged(self) -> None:
        """The present situation becomes the second one."""
        self.situations = [[], *self.situations][: t.SITUATIONS]

    def clear(self) -> None:
        """944 and 947 are 0."""
        self.counter = 0
        self.situations = [[] for _ in range(t.SITUATIONS)]

    # -- orders ---------------------------------------------------------------------------------------------------

    def order(self, order: Pkw) -> tuple[int, int]:
        """Reply id and PWE. Requests 1 and 6, 2 and 7 are taken for array and plain parameter alike (a reading)."""
        if order.id not in t.PKW.answers:
            return ReplyId.ERROR, _REFUSED.get(order.id, _ILLEGAL_FORMAT)
        reply = t.PKW.answers[order.id][0]
        spec = t.PARAMETERS.get(order.pnu) if order.pnu > 0xFF else t.spec_at(order.pnu << 8 | order.ind)
        if spec is None:
            return ReplyId.ERROR, 0x00
        if order.pnu > 0xFF and order.ind >= t.ARRAYS.get(order.pnu, 1):
            return ReplyId.ERROR, 0x03
        if order.id in _READS:
            return reply, self.value(spec, order.ind) & 0xFFFF
        error = self.write(spec, order.pwe & 0xFFFF)
        return (reply, order.pwe & 0xFFFF) if error is None else (ReplyId.ERROR, error)

    def value(self, spec: ParamSpec, ind: int = 0) -> int:
        match spec.number:
            case t.PNU_COUNTER:
                return self.counter
            case t.PNU_FAULTS:
                situation = self.situations[ind // t.MESSAGES]
                return situation[ind % t.MESSAGES] if ind % t.MESSAGES < len(situation) else 0
            case t.PNU_DEVICE:
                return t.DEVICE_ID[ind]
            case t.PNU_RESET:
                return self._reset
        live = self._live(spec.number, spec.index)
        return self.store.raw(spec) if live is None else live

    def write(self, spec: ParamSpec, raw: int) -> int | None:
        """Over PKW or record 47: the error number, None if it was written."""
        where = spec.number << 8 | spec.index if spec.index else spec.number
        if (error := spec.write_error(raw)) is not None:
            return error
        if where in _STOPPED_ONLY and self.device.motor.frequency:
            return 0x11
        if spec.number == t.PNU_RESET or where in _RESETS:
            if raw and not self._reset:
                self._changed(t.PNU_RESET)
            self._reset = raw
        else:
            self.store.write(spec, raw)
            self._changed(where)
        return None
