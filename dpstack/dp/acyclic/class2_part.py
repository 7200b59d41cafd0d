"""The services of a class 2 master, beside any class 1 master: Slave_Diag, Get_Cfg, RD_Inp, RD_Outp, Set_Slave_Add.

The orders, and what is refused of them at once. Queue and token are :mod:`dpstack.dp.acyclic.queue`, the requests
:mod:`dpstack.dp.acyclic.class2_services`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.dp.acyclic.class2 import AddressChange
from dpstack.dp.acyclic.class2_services import Reading, Service
from dpstack.dp.acyclic.job import Job
from dpstack.dp.master.master import Master
from dpstack.dp.pdu.requests import SetSlaveAdd
from dpstack.errors import PduError, UsageError
from dpstack.params import MAX_STATION, UNADDRESSED
from dpstack.units import NS_PER_S

READ_TIMEOUT: Final = 5 * NS_PER_S
#: a slave that restarts with its new address takes seconds
CHANGE_TIMEOUT: Final = 15 * NS_PER_S


@dataclass(frozen=True, slots=True)
class ReadService:
    """Ask ``address`` (0..126) for ``service``; ``expected`` as in
    :class:`~dpstack.dp.acyclic.class2_services.Reading`.

    The result is the :class:`~dpstack.dp.acyclic.class2_services.ServiceDone` with ``token``.
    """

    token: int
    address: int
    service: Service
    expected: int | None = None
    timeout_ns: int = READ_TIMEOUT


@dataclass(frozen=True, slots=True)
class ChangeAddress:
    """Give the slave at ``old`` (0..126) the address ``new`` (0..125); see :mod:`dpstack.dp.acyclic.class2`."""

    token: int
    old: int
    new: int
    ident: int | None = None
    no_add_chg: bool = False
    rem_slave_data: bytes = b""
    timeout_ns: int = CHANGE_TIMEOUT


def job_of(order: object, own: int, master: Master | None) -> tuple[int, Job, int] | None:
    """Token, job and time-out in ns of what ``order`` asks the station ``own`` to do beside its own ``master``, if any.

    None when it is none of class 2. Raises UsageError.
    """
    match order:
        case ReadService(token, address, service, expected, timeout_ns):
            if service is Service.SET_ADDRESS:
                raise UsageError("Set_Slave_Add does not read: use ChangeAddress")
            _check(address, own)
            return token, Reading(address, service, expected), timeout_ns
        case ChangeAddress(token, old, new, ident, no_add_chg, rem_slave_data, timeout_ns):
            _check(old, own)
            _check_new(old, new, own, master)
            try:
                SetSlaveAdd(new, ident or 0, no_add_chg, rem_slave_data).build()
            except PduError as error:
                raise UsageError(str(error)) from None
            return token, AddressChange(own, old, new, ident, no_add_chg, rem_slave_data), timeout_ns
    return None


def _check(address: int, own: int) -> None:
    if not 0 <= address <= UNADDRESSED:
        raise UsageError(f"{address} is no address of a slave: 0..{UNADDRESSED} ({UNADDRESSED}: as delivered)")
    if address == own:
        raise UsageError(f"{address} is the address of this master itself")


def _check_new(old: int, new: int, own: int, master: Master | None) -> None:
    if not 0 <= new <= MAX_STATION:
        raise UsageError(f"{new} is no address to give to a slave: 0..{MAX_STATION}")
    if new == own:
        raise UsageError(f"{new} is the address of this master itself: give the slave another one")
    if new == old:
        raise UsageError(f"the slave has address {new} already: nothing to do")
    if master is not None and old in master.handlers and master.handlers[old].owned:
        raise UsageError(
            f"slave {old} is parameterised by this master and takes no address meanwhile: remove it from the bus first"
        )
