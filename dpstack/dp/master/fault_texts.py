"""The texts of all faults of a slave, one function a fault: what happened, and what to do."""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

from dpstack.dp.master.events import Fault, FaultKind, SlaveState
from dpstack.dp.master.slave_states import Trigger
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.requests import SET_PRM_LEN
from dpstack.dp.slave_params import IsochronousDemand, SlaveParams
from dpstack.fdl.interface import Failure
from dpstack.gsd.identifiers import agree
from dpstack.phy.patience import Lateness
from dpstack.text import octets_text
from dpstack.units import baud_text, ms_text


class CfgFault(Fault, frozen=True, kw_only=True):
    """A fault that is complete with the difference between Chk_Cfg and the answer to Get_Cfg (:meth:`compared`).

    ``setup``: of the slave. ``remedy``: the advice if no difference is known; ``unanswered``: the advice if the slave
    does not answer Get_Cfg. ``or_else`` follows the advice to correct a difference. ``perhaps``: a difference may be
    the reason; without one the fault stays as it is.
    """

    setup: SlaveParams
    unanswered: str = ""
    or_else: str = ""
    perhaps: bool = False

    def compared(self, actual: bytes | None) -> Fault:
        """The fault with the ``actual`` octets of Get_Cfg, None if the slave gave none."""
        wanted = self.setup.config
        differs = actual is not None and not agree(actual, wanted)
        if self.perhaps and not differs:
            return Fault(self.kind, self.message, self.remedy)
        difference, remedy = f"Chk_Cfg {'is' if self.perhaps else 'was'} {wanted.hex(' ')}", self.remedy
        if actual is None:
            remedy = self.unanswered or remedy
        elif actual == wanted:
            difference += ", although Get_Cfg names the same"
        else:
            pairs = enumerate(zip(wanted, actual, strict=False))
            at = next((i for i, (a, b) in pairs if a != b), min(len(wanted), len(actual)))
            difference += f", it has {actual.hex(' ')}: octet {at + 1} differs"
            config = actual.hex(" ").upper()
            change = f'configure config = "{config}" (or its modules) or change the telegram set in the device'
            remedy = self.remedy if self.perhaps else change + self.or_else
        joint = ", and " if self.perhaps else ": "
        fault = Fault(self.kind, f"{self.message}{joint}{difference}", remedy, (actual or b"") if differs else b"")
        return in_words(fault, self.setup)


def in_words(fault: Fault, setup: SlaveParams) -> Fault:
    """``fault`` with the telegram that the drive is set to, or with the first slot that differs, and what to change, by
    the names of plugin and GSD file. (The bus process has neither: there the application calls it.)"""
    found = _difference(fault, setup) if fault.actual else None
    if found is None:
        return fault
    text, remedy = found
    head, _, rest = fault.message.partition(": ")
    if fault.kind is FaultKind.NOT_READY:
        remedy += f"; or {_LOOK}"
    return Fault(fault.kind, f"{head}: {text}; {rest}", remedy, fault.actual)


def _difference(fault: Fault, setup: SlaveParams) -> tuple[str, str] | None:
    """The difference between configuration and slave, and the remedy; None if there are no names for it."""
    # Prm_Fault comes before Chk_Cfg: until then a drive may show any of its telegrams
    if setup.telegrams is not None and fault.kind is not FaultKind.PRM_FAULT:
        other = setup.telegrams.other(fault.actual)
        if other is not None:
            return other.text, other.remedy
    if setup.texts is None:
        return None
    device, modules = setup.texts.device, setup.texts.modules
    from dpstack.gsd.module_comparison import compare_modules  # here, as few slaves have a GSD file

    found = compare_modules(setup.config, fault.actual, device, modules, device.first_slot)
    return (found.short, found.remedy) if found.key else None


_LOOK: Final = "look at the device: it may wait for its own start-up or for modules"


#: a remark: Set_Prm switched the watchdog on, the diagnosis says that it is off
NOT_WATCHING = (
    "does not watch its master although Set_Prm switched its watchdog on (WD_On is 0): when this master dies it keeps "
    "its outputs; see its manual"
)


#: a remark: the driver of an adapter counted damaged octets only after it had delivered them
IN_DOUBT = (
    "its inputs are not valid until its next exchange: the adapter's driver counted damaged octets after it had "
    "delivered them, so nobody knows whether its last answer was one of them; look for the noise, or take an adapter "
    "that marks damaged octets (`dpstack doctor`)"
)


def unlisted(state: SlaveState, trigger: Trigger) -> str:
    """A remark: the table of states has no row for ``trigger`` in ``state``."""
    return (
        f"ignored in {state.value}: {trigger.value!r}; the table of states has no row for it, please report this to "
        "the makers of dpstack"
    )


_UNREADABLE: Final = (
    "this is noise, or two stations that talk at once, rather than a slave without power: check cable, shielding and "
    "termination, and look for a second station with its address"
)


def absent(address: int, baud: int, why: Failure = Failure.NO_ANSWER) -> Fault:
    """No answer to several requests of Slave_Diag; ``why``: the end of the last one."""
    if why is not Failure.NO_ANSWER:
        return Fault(
            FaultKind.ABSENT,
            f"address {address} answers at {baud_text(baud)}, but not readably",
            f"{_UNREADABLE}; it is asked again at least every second",
        )
    return Fault(
        FaultKind.ABSENT,
        f"no answer from address {address} at {baud_text(baud)}",
        "check power, address switch, cable, termination and the baud rate; it is asked again at least every second",
    )


def lost(during: str, why: Failure, moved: str | None = None) -> Fault:
    """The slave stopped answering; ``why``: the end of the last request; ``moved``: where it is if its plugin knows."""
    if why is not Failure.NO_ANSWER:
        return Fault(
            FaultKind.LOST,
            f"its answers to {during} cannot be read any more",
            f"{_UNREADABLE}; it is taken up again as soon as its answers can be read",
        )
    return Fault(
        FaultKind.LOST,
        f"stopped answering during {during}",
        f"{moved or 'check its power and the cable'}; it is taken up again as soon as it answers",
    )


def bus_gone(reason: str) -> Fault:
    """The port vanished, or this station is out of the ring."""
    return Fault(FaultKind.LOST, reason, "it is taken up again as soon as the bus is back")


def wrong_ident(expected: int | None, found: int) -> Fault:
    """The ident number is another one than the configuration says."""
    return Fault(
        FaultKind.WRONG_IDENT,
        f"is another device: ident 0x{found:04X} instead of 0x{expected or 0:04X}",
        'put the right device there, or correct drive, gsd or ident (ident = "ask" takes what is found); a process '
        f"device that adapts its ident number needs ident = {{ configured = 0x{expected or 0:04X}, adapts = true }}",
    )


def not_adapted(expected: int, found: int, why: str, sent: bytes) -> Fault:
    """A device with the ident number ``found`` does not adapt to the one in Set_Prm, whose octets were ``sent``.

    ``why``: its answer.
    """
    return Fault(
        FaultKind.WRONG_IDENT,
        f"is another device: ident 0x{found:04X} instead of 0x{expected:04X}, and it does not adapt ({why}): Set_Prm "
        f"was {sent.hex(' ')}",
        f"put the right device there, set its selector of ident numbers (IDENT_NUMBER_SELECTOR) to automatic or to "
        f"0x{expected:04X}, or correct gsd or ident; if it adapts, compare the user parameters with its GSD file",
    )


def adapts(expected: int, found: int) -> str:
    """The remark before Set_Prm to a device that shows another ident number and adapts."""
    return (
        f"its diagnosis shows ident 0x{found:04X}; Set_Prm goes out once with the configured 0x{expected:04X}, as its "
        f"ident number adapts"
    )


def locked(diagnosis: Diagnosis, master: int, masters: Collection[int] | None) -> Fault:
    """Parameterised by another class 1 ``master``; ``masters``: those in the token ring, None: not known."""
    if masters is not None and master not in masters:
        return Fault(FaultKind.LOCKED, *left_locked(diagnosis, master))
    return Fault(
        FaultKind.LOCKED,
        f"is owned by master {master}",
        f"it is never taken away: stop master {master}, or remove the slave from one of the two configurations",
    )


def left_locked(diagnosis: Diagnosis, master: int) -> tuple[str, str]:
    """Message and remedy for a slave of a ``master`` that is not on the bus (any more)."""
    wait = (
        "wait: its watchdog is on and gives it free; or switch it off and on"
        if diagnosis.wd_on
        else f"its watchdog is off: switch it off and on, or let master {master} take it up again and end in order"
    )
    return f"is still locked by master {master}, which is not in the token ring (any more)", wait


#: diagnosis bit Not_Supported after Set_Prm
_NOT_SUPPORTED: Final = Fault(
    FaultKind.NOT_SUPPORTED,
    "does not support something that Set_Prm asked for (Not_Supported)",
    "take sync, freeze or the group out of its configuration",
)


def refusal(setup: SlaveParams, diagnosis: Diagnosis, sent: bytes) -> Fault:
    """The fault if ``diagnosis`` refuses Set_Prm, whose octets were ``sent``, or Chk_Cfg."""
    if diagnosis.prm_fault:
        return prm_fault(setup, diagnosis, sent)
    return _NOT_SUPPORTED if diagnosis.not_supported else cfg_fault(setup)


def prm_fault(setup: SlaveParams, diagnosis: Diagnosis, sent: bytes) -> Fault:
    """Set_Prm refused. ``sent`` are the octets of Set_Prm.

    Modules have parameters of their own, so a wrong module is a usual reason. Get_Cfg shows it if the configuration
    has several octets.
    """
    said = f", it adds {diagnosis.ext.hex(' ')}" if diagnosis.ext else ""
    user = sent[SET_PRM_LEN:].hex(" ") or "none"
    doubt = f"; {setup.prm_note}" if setup.prm_note else ""
    message = f"refuses the parameters (Prm_Fault{said}): Set_Prm was {sent.hex(' ')}"
    remedy = (
        f"octets 5-6 are the ident, from octet 8 the user parameters ({user}): compare them with its GSD file{doubt}"
    )
    if len(sent) > SET_PRM_LEN and len(setup.config) > 1:
        return CfgFault(FaultKind.PRM_FAULT, message, remedy, setup=setup, perhaps=True)
    return Fault(FaultKind.PRM_FAULT, message, remedy)


def cfg_fault(setup: SlaveParams) -> CfgFault:
    """Chk_Cfg refused."""
    return CfgFault(
        FaultKind.CFG_FAULT,
        "refuses the configuration (Cfg_Fault)",
        "check the parameters that choose its telegram",
        setup=setup,
        unanswered="compare config or telegram with its GSD file (it does not give its own by Get_Cfg)",
    )


def not_ready(setup: SlaveParams, seconds: float) -> CfgFault:
    """Accepts parameters and configuration, never gets ready."""
    return CfgFault(
        FaultKind.NOT_READY,
        f"accepted parameters and configuration but is not ready after {seconds:.0f} s (Station_Not_Ready)",
        _LOOK,
        setup=setup,
        or_else=f"; or {_LOOK}",
    )


def not_taken(setup: SlaveParams) -> CfgFault:
    """Prm_Req after everything was acknowledged, again and again."""
    return CfgFault(
        FaultKind.NOT_READY,
        "acknowledges parameters and configuration, and then wants parameters again (Prm_Req)",
        "check ident, config and user parameters with its GSD file; its watchdog may be too short for this bus",
        setup=setup,
    )


def statically_ill(seconds: float) -> Fault:
    """Stat_Diag stays set."""
    return Fault(
        FaultKind.NOT_READY,
        f"reports a static diagnosis for {seconds:g} s (Stat_Diag): its inputs are not valid",
        "look at the device's own fault display",
    )


def wrong_length(setup: SlaveParams, expected: int, got: int) -> CfgFault:
    """Data_Exchange answers with ``got`` octets instead of ``expected``."""
    return CfgFault(
        FaultKind.WRONG_LENGTH,
        f"answers Data_Exchange with {octets_text(got)} instead of {expected}",
        "its real configuration differs from config or telegram here: compare both with its GSD file",
        setup=setup,
    )


#: remedy after a negative status of a service of MS0
_REFUSED: Final = {
    "RS": "the service access point is not active: another kind of device, or one that needs a restart",
    "RR": "the device says that it has no resources left for it: it is busy or hangs, look at its fault display",
    "UE": "the device's own application reports an error: look at its fault display",
}
#: the same for Data_Exchange, of a slave whose diagnosis wants no parameters
_REFUSED_DATA: Final = _REFUSED | {
    "RS": "it is not in data exchange, although its diagnosis wants no parameters (Prm_Req is 0); the master "
    "parameterises it again; look at its fault display",
}
_NO_ANSWER_TO_IT: Final = "no standard has that answer: another kind of device, or two stations with this address"


def refused(service: str, status: str) -> Fault:
    """A negative ``status`` (RS, UE, RR ...) again and again."""
    known = _REFUSED_DATA if service == "Data_Exchange" else _REFUSED
    return Fault(FaultKind.REFUSED, f"refuses {service} ({status})", known.get(status, _NO_ANSWER_TO_IT))


def prm_silent(sent: bytes) -> Fault:
    """Alive, but never acknowledges Set_Prm, whose octets were ``sent``."""
    return Fault(
        FaultKind.REFUSED,
        f"does not acknowledge Set_Prm although it answers Slave_Diag: Set_Prm was {sent.hex(' ')}",
        _DROPPED,
    )


def cfg_silent(setup: SlaveParams) -> CfgFault:
    """Alive, but never acknowledges Chk_Cfg."""
    return CfgFault(
        FaultKind.REFUSED,
        "does not acknowledge Chk_Cfg although it answers Slave_Diag",
        _DROPPED,
        setup=setup,
    )


_DROPPED: Final = "some devices drop what they cannot accept: check ident, length and content of what is sent"


def left(diagnosis: Diagnosis, status: str) -> Fault:
    """Fell out of data exchange by itself. ``status``: how it refused Data_Exchange, "" if it did not."""
    if status and not diagnosis.prm_req:
        return refused("Data_Exchange", status)
    return Fault(
        FaultKind.LEFT,
        "left data exchange by itself and wants parameters again"
        + (" (its watchdog was on)" if diagnosis.wd_on else ""),
        "if this repeats, its watchdog is too short for this bus (see `dpstack plan`) or it restarts",
    )


def isochronous(demand: IsochronousDemand, lateness: Lateness | None) -> Fault:
    """It demands isochronous mode. ``lateness``: that of the port, None in virtual time."""
    if lateness is None:
        figure = "this bus is simulated, and its master has no such mode either"
    else:
        late = f"this port is up to {ms_text(lateness.p999_ns)} late in 999 of 1000 cases"
        measured = f"measured of {lateness.answers} answers" if lateness.answers else "not measured: that of its kind"
        figure = f"{late} ({measured})"
    return Fault(
        FaultKind.ISOCHRONOUS,
        f"demands isochronous mode ({demand.why}): its clock telegram may be {demand.window_us:g} us off (T_PLL_W); "
        f"{figure}",
        "it needs a master with isochronous mode, or parameters without it, if the device can work so",
    )


def plugin(error: BaseException) -> Fault:
    """An exception in a drive plugin."""
    return Fault(
        FaultKind.PLUGIN,
        f"its plugin failed ({type(error).__name__}: {error}): outputs are at their safe values",
        "this is a defect of the plugin; restart the bus to try again",
    )
