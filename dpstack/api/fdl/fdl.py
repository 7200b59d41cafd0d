"""``Fdl``: the services of FDL for programs, as ``open_fdl()`` and ``bus.fdl`` give them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from msgspec import Struct

from dpstack.api.fdl.link import FdlLink
from dpstack.api.fdl.sap import OnReceive, Sap, SapQueue
from dpstack.api.slave.services import time_of
from dpstack.argcheck import Sealed, functions, octets, whole_number
from dpstack.errors import FdlError, PduError, UsageError
from dpstack.fdl.services.confirmations import Confirmation, FdlService
from dpstack.fdl.services.identity import Ident, SapStatus
from dpstack.fdl.services.orders import (
    CAPACITY,
    MAX_QUEUE,
    FdlConfirmed,
    FdlRequest,
    OpenSap,
    sap_name,
)
from dpstack.fdl.telegram import StationType
from dpstack.text import brief

_USUAL_S: Final = 5.0
#: services that a SAP may take, by the names that programs give
_SAP_SERVICES: Final = {"sda": FdlService.SDA, "sdn": FdlService.SDN, "srd": FdlService.SRD}


class FdlAnswer(Struct, frozen=True):
    """The answer to SRD or MSRD: its confirmation, and the reply data."""

    #: station address of the answer, 0..126
    address: int
    #: DL or DH with data, NR without
    status: Confirmation
    #: reply data, 0..246 octets; empty with NR
    data: bytes = b""

    @property
    def high(self) -> bool:
        """The reply data have high priority (DH)."""
        return self.status is Confirmation.DH


class Fdl(Sealed):
    """The FDL services of a station. ``address`` 0..126, ``dsap`` and ``ssap`` 0..62 or None for the default SAP.

    ``data``: 246 octets at most, less one for each SAP given. ``high``: high priority, also in a late token hold.
    ``timeout``: how long a request may wait for its turn, in seconds.

    A service raises FdlError with the confirmation if that is not positive, also for impossible parameters (IV);
    UsageError for arguments of another type, for a closed bus, and for a request that is refused beside the DP master
    of the same station: to SAPs 48 to 63 or from them, to the default SAP of its slaves, to all (127); BusError when
    the bus fails meanwhile. The table of confirmations: docs/reference/fdl-services.md.

    32 requests may wait at a time. Beside a DP master one is sent in each token hold, and none that could delay the
    next fixed cycle.
    """

    def __init__(self, link: FdlLink) -> None:
        self._link = link
        self._saps: dict[int | None, Sap] = {}
        self._seal(Fdl)

    def __repr__(self) -> str:
        return f"<Fdl of {self._link.bus.config.port}>"

    # --- requests -----------------------------------------------------------------------------------------------
    async def sda(
        self,
        address: int,
        data: bytes,
        *,
        dsap: int | None = None,
        ssap: int | None = None,
        high: bool = False,
        timeout: float = _USUAL_S,
    ) -> None:
        """Send Data with Acknowledge. Returns once the station has taken ``data`` (OK).

        Raises FdlError: UE, RR, RS, NA of the station, LS, LR, DS, IV of this one.
        """
        await self._confirmed(FdlService.SDA, address, data, dsap, ssap, high, timeout)

    async def sdn(
        self,
        address: int,
        data: bytes,
        *,
        dsap: int | None = None,
        ssap: int | None = None,
        high: bool = False,
        timeout: float = _USUAL_S,
    ) -> None:
        """Send Data with No Acknowledge, to one station or to all (``address`` 127). Returns once it has been sent.

        ``dsap`` 63: to all SAPs of the station. Raises FdlError: LS, LR, DS, IV.
        """
        await self._confirmed(FdlService.SDN, address, data, dsap, ssap, high, timeout)

    async def srd(
        self,
        address: int,
        data: bytes = b"",
        *,
        dsap: int | None = None,
        ssap: int | None = None,
        high: bool = False,
        reply_max: int | None = None,
        timeout: float = _USUAL_S,
    ) -> FdlAnswer:
        """Send and Request Data: the answer with DL, DH or NR. SC counts as NR.

        ``reply_max``: the longest reply data, in octets, if it is known: beside a master with a fixed cycle a shorter
        answer fits into less time (a longer one is taken, too).

        Raises FdlError: RDL and RDH (its ``data`` are the reply data; those of the request were not taken), UE, RR, RS,
        NA of the station, LS, LR, DS, IV of this one.
        """
        return self._answer(await self._confirmed(FdlService.SRD, address, data, dsap, ssap, high, timeout, reply_max))

    async def msrd(
        self,
        address: int,
        data: bytes = b"",
        *,
        dsap: int | None = None,
        ssap: int | None = None,
        reply_max: int | None = None,
        timeout: float = _USUAL_S,
    ) -> FdlAnswer:
        """SRD with multicast reply (DP-V2): the station sends its answer to all (127). Otherwise as :meth:`srd`."""
        return self._answer(
            await self._confirmed(FdlService.MSRD, address, data, dsap, ssap, False, timeout, reply_max)
        )

    async def fdl_status(self, address: int, *, timeout: float = _USUAL_S) -> StationType:
        """Request FDL Status: the type of the station. Raises FdlError: NA if nobody answers, LR, DS, IV."""
        done = await self._confirmed(FdlService.FDL_STATUS, address, b"", None, None, False, timeout)
        return StationType(done.kind or 0)

    async def ident(self, address: int, *, timeout: float = _USUAL_S) -> Ident:
        """Request Ident: vendor, controller type, versions of hardware and software.

        Raises FdlError: NR if the station has no ident (most DP slaves), NA, LR, DS, IV; NA also if the four texts of
        the answer cannot be read.
        """
        done = await self._confirmed(FdlService.IDENT, address, b"", None, None, False, timeout)
        try:
            return Ident.parse(done.data)
        except PduError as error:
            raise _error(done, Confirmation.NA, str(error)) from None

    async def lsap_status(self, address: int, sap: int | None, *, timeout: float = _USUAL_S) -> SapStatus:
        """Request LSAP Status (withdrawn in later editions; few stations have it): the configuration of ``sap``.

        Raises FdlError: RS, NR, NA of the station, LR, DS, IV.
        """
        return SapStatus.parse(
            (await self._confirmed(FdlService.LSAP_STATUS, address, b"", sap, None, False, timeout)).data
        )

    # --- SAPs of one's own --------------------------------------------------------------------------------------
    async def sap(
        self,
        number: int | None,
        *,
        on_receive: OnReceive | None = None,
        services: Iterable[str] = ("sda", "sdn", "srd"),
        access: int | None = None,
        access_sap: int | None = None,
        queue: int = CAPACITY,
        indicate_all: bool = False,
    ) -> Sap:
        """Activate the SAP ``number`` (0..62; None: the default SAP) of this station.

        ``on_receive``: gets each :class:`~dpstack.fdl.FdlIndicated`. ``services``: those that it takes; others get RS.
        ``access``, ``access_sap``: the only station, and the only SAP there, that may use it; others get RS. ``queue``:
        1..256 indications that may wait for the program; beyond them SDA gets RR. ``indicate_all``: an SRD without data
        in request and reply is indicated, too.

        Raises UsageError for a SAP that is open already, that belongs to the DP master of the same station (48 to 62),
        and for impossible arguments.
        """
        if on_receive is not None:
            functions("fdl.sap", on_receive=on_receive)
        order = OpenSap(
            None if number is None else whole_number("number", number),
            _services(services),
            None if access is None else whole_number("access", access),
            None if access_sap is None else whole_number("access_sap", access_sap),
            whole_number("queue", queue),
            bool(indicate_all),
        )
        if not 1 <= queue <= MAX_QUEUE:
            raise UsageError(f"queue = {queue}: 1..{MAX_QUEUE} indications may wait")
        if number in self._link.saps:
            raise UsageError(f"{sap_name(number)} is in use already on this station: close it first, or take another")
        inside = SapQueue(number)
        await self._link.open_sap(order, inside)
        made = self._saps[number] = Sap(self._link, inside, on_receive)
        return made

    @property
    def saps(self) -> tuple[Sap, ...]:
        """The open SAPs of this station."""
        return tuple(sap for sap in self._saps.values() if sap.is_open)

    async def _confirmed(
        self,
        service: FdlService,
        address: int,
        data: bytes,
        dsap: int | None,
        ssap: int | None,
        high: bool,
        timeout: float,
        reply_max: int | None = None,
    ) -> FdlConfirmed:
        """Order a request and wait for its confirmation. Raises FdlError if that is not positive."""
        order = FdlRequest(
            self._link.bus.services.token(),
            service,
            whole_number("address", address),
            octets("data", data),
            None if dsap is None else whole_number("dsap", dsap),
            None if ssap is None else whole_number("ssap", ssap),
            bool(high),
            time_of(timeout),
            None if reply_max is None else whole_number("reply_max", reply_max),
        )
        done = await self._link.confirmation(order)
        if not done.status.is_positive(service):
            raise _error(done, done.status, done.remark)
        return done

    def _answer(self, done: FdlConfirmed) -> FdlAnswer:
        return FdlAnswer(done.address, done.status, done.data)


def _services(names: Iterable[str]) -> tuple[FdlService, ...]:
    """The services of a SAP by the names that a program gives. Raises UsageError."""
    names = (names,) if isinstance(names, str) else tuple(names)
    unknown = [name for name in names if not isinstance(name, str) or name.lower() not in _SAP_SERVICES]
    if unknown or not names:
        raise UsageError(f"services = {brief(unknown or names)}: give some of {', '.join(_SAP_SERVICES)}")
    return tuple(_SAP_SERVICES[name.lower()] for name in names)


def _error(done: FdlConfirmed, status: Confirmation, remark: str) -> FdlError:
    more = f" ({remark})" if remark else ""
    text = f"{done.service.value} to station {done.address}: {status.value}, {status.text}{more}"
    return FdlError(done.address, text, service=done.service.value, status=status.value, data=done.data)
