"""The texts of every fault of a slave: one clear line that says what, and what to do.

One function a fault kind, so that the wording of a finding stands in one place.
"""

from __future__ import annotations

from dpstack.dp.diagnosis import Diagnosis
from dpstack.dp.events import Fault, FaultKind
from dpstack.dp.setup import SlaveSetup
from dpstack.units import baud_text

#: a remark, once: Set_Prm switched the watchdog on, the diagnosis says it is off
NOT_WATCHING = (
    "does not watch its master although Set_Prm switched its watchdog on (WD_On is 0): when this master dies it keeps "
    "its outputs; see its manual"
)


def absent(address: int, baud: int) -> Fault:
    """No answer to Slave_Diag, several rounds long."""
    return Fault(
        FaultKind.ABSENT,
        f"no answer from address {address} at {baud_text(baud)}",
        "check power, address switch, cable, termination and the baud rate; it is asked again at least every second",
    )


def lost(during: str) -> Fault:
    """Stopped answering after it had answered."""
    return Fault(
        FaultKind.LOST,
        f"stopped answering during {during}",
        "check its power and the cable; it is taken up again as soon as it answers",
    )


def bus_gone(reason: str) -> Fault:
    """The port vanished, or this station is out of the ring."""
    return Fault(FaultKind.LOST, reason, "it is taken up again as soon as the bus is back")


def wrong_ident(expected: int | None, found: int) -> Fault:
    """Another device than the configuration says."""
    return Fault(
        FaultKind.WRONG_IDENT,
        f"is another device: ident 0x{found:04X} instead of 0x{expected or 0:04X}",
        'put the right device there, or correct drive, gsd or ident (ident = "ask" takes what is found)',
    )


def locked(master: int) -> Fault:
    """Parameterised by another class 1 master."""
    return Fault(
        FaultKind.LOCKED,
        f"is owned by master {master}",
        f"it is never taken away: stop master {master}, or remove the slave from one of the two configurations",
    )


def not_supported() -> Fault:
    """Diagnosis bit Not_Supported after Set_Prm."""
    return Fault(
        FaultKind.NOT_SUPPORTED,
        "does not support something that Set_Prm asked for (Not_Supported)",
        "take sync, freeze or the group out of its configuration",
    )


def refusal(setup: SlaveSetup, diagnosis: Diagnosis, sent: bytes) -> Fault | None:
    """What a diagnosis says of Set_Prm, whose octets were ``sent``; None when it is about the configuration."""
    if diagnosis.prm_fault:
        return prm_fault(setup, diagnosis, sent)
    return not_supported() if diagnosis.not_supported else None


def prm_fault(setup: SlaveSetup, diagnosis: Diagnosis, sent: bytes) -> Fault:
    """Set_Prm refused. ``sent`` are the octets of Set_Prm."""
    said = f", it adds {diagnosis.ext.hex(' ')}" if diagnosis.ext else ""
    user = setup.user_prm.hex(" ") or "none"
    return Fault(
        FaultKind.PRM_FAULT,
        f"refuses the parameters (Prm_Fault{said}): Set_Prm was {sent.hex(' ')}",
        f"octets 5-6 are the ident, from octet 8 the user parameters ({user}): compare them with its GSD file",
    )


def cfg_fault(setup: SlaveSetup, actual: bytes | None) -> Fault:
    """Chk_Cfg refused. ``actual`` is what Get_Cfg gave, None when it gave nothing."""
    sent = setup.config
    if actual is None:
        detail, remedy = "", "compare config or telegram with its GSD file (it does not tell its own by Get_Cfg)"
    elif actual == sent:
        detail = ", although Get_Cfg names the same"
        remedy = "check the parameters that choose its telegram"
    else:
        pairs = enumerate(zip(sent, actual, strict=False))
        at = next((i for i, (a, b) in pairs if a != b), min(len(sent), len(actual)))
        detail = f", it has {actual.hex(' ')}: octet {at + 1} differs"
        remedy = (
            f'configure config = "{actual.hex(" ").upper()}" (or its modules) or change the telegram set in the device'
        )
    return Fault(
        FaultKind.CFG_FAULT, f"refuses the configuration (Cfg_Fault): Chk_Cfg was {sent.hex(' ')}{detail}", remedy
    )


def not_ready(seconds: float) -> Fault:
    """Accepts parameters and configuration, never gets ready."""
    return Fault(
        FaultKind.NOT_READY,
        f"accepted parameters and configuration but is not ready after {seconds:g} s (Station_Not_Ready)",
        "look at the device: it may wait for its own start-up or for modules",
    )


def waited(diagnosis: Diagnosis, seconds: float) -> Fault:
    """Never got ready: for which of the two reasons."""
    return statically_ill(seconds) if diagnosis.stat_diag else not_ready(seconds)


def not_taken() -> Fault:
    """Prm_Req after everything was acknowledged, again and again."""
    return Fault(
        FaultKind.NOT_READY,
        "acknowledges parameters and configuration, and then wants parameters again (Prm_Req)",
        "check ident, config and user parameters with its GSD file, and whether its watchdog is too short for this bus",
    )


def statically_ill(seconds: float) -> Fault:
    """Stat_Diag stays set."""
    return Fault(
        FaultKind.NOT_READY,
        f"reports a static diagnosis for {seconds:g} s (Stat_Diag): its inputs are not valid",
        "look at the device's own fault display",
    )


def wrong_length(expected: int, got: int) -> Fault:
    """Data_Exchange answers of another length than the configuration says."""
    return Fault(
        FaultKind.WRONG_LENGTH,
        f"answers Data_Exchange with {got} octets instead of {expected}",
        "its real configuration differs from config or telegram here: compare both with its GSD file",
    )


def refused(service: str, status: str) -> Fault:
    """RS, UE or RR again and again."""
    return Fault(
        FaultKind.REFUSED,
        f"refuses {service} ({status})",
        "the service access point is not active: another kind of device, or one that needs a restart",
    )


def silent(service: str) -> Fault:
    """Alive, but never acknowledges a service."""
    return Fault(
        FaultKind.REFUSED,
        f"does not acknowledge {service} although it answers Slave_Diag",
        "some devices drop what they cannot accept: check ident, length and content of what is sent",
    )


def left(diagnosis: Diagnosis) -> Fault:
    """Fell out of data exchange by itself."""
    return Fault(
        FaultKind.LEFT,
        "left data exchange by itself and wants parameters again"
        + (" (its watchdog was on)" if diagnosis.wd_on else ""),
        "if this repeats, its watchdog is too short for this bus (see `dpstack plan`) or it restarts",
    )


def plugin(error: BaseException) -> Fault:
    """An exception in a drive plugin or another cyclic unit."""
    return Fault(
        FaultKind.PLUGIN,
        f"its plugin failed ({type(error).__name__}: {error}): outputs are at their safe values",
        "this is a defect of the plugin; restart the bus to try again",
    )
