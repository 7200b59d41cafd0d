"""The requests to one slave. Data_Exchange is made in every rotation: it is the same object while its outputs stay."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.fdl.interface import LONG_NS, Request
from dpstack.fdl.telegram import MAX_DATA, SSAP_MS0, Req

_SRD_HIGH: Final = Req.SRD_HIGH
_NEW: Final = tuple.__new__  # NamedTuple's own constructor costs four times as much


class SlaveRequests:
    """Makes what is asked of the slave at ``address``; ``tag`` goes into every request, ``still`` into
    Data_Exchange (see :class:`~dpstack.fdl.interface.Request`)."""

    __slots__ = ("_address", "_data", "_still", "_tag")

    def __init__(self, address: int, tag: object, still: Callable[[int], bool] | None = None) -> None:
        self._address = address
        self._tag = tag
        self._still = still
        self._data = Request(address, _SRD_HIGH, patient=True, tag=tag, cyclic=True, still=still)

    def data(self, outputs: bytes) -> Request:
        """Data_Exchange with ``outputs``."""
        request = self._data
        if request.data != outputs:
            to, tag = self._address, self._tag
            request = self._data = _NEW(
                Request, (to, _SRD_HIGH, outputs, None, None, True, True, False, tag, 0, MAX_DATA, True, self._still)
            )
        return request

    def service(self, sap: int, data: bytes, *, patient: bool, restart: bool, long: bool) -> Request:
        """A service of MS0. ``long``: a slave that is not there is waited for as if it were."""
        to, tag, extra = self._address, self._tag, LONG_NS if long else 0
        return Request(to, _SRD_HIGH, data, sap, SSAP_MS0, patient=patient, restart=restart, tag=tag, extra_ns=extra)
