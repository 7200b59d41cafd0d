"""Events of the DP master for the application."""

from __future__ import annotations

from enum import Enum

from msgspec import Struct

from dpstack.dp.master.commands import Mode
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.process_image import DRIVE
from dpstack.trace import Event, Severity
from dpstack.units import ms_text


class SlaveState(Enum):
    """State of the master's handling of one slave; the values are those of the JSON lines."""

    OFFLINE = "offline"
    DIAGNOSIS = "diagnosis"
    SET_PRM = "set_prm"
    CHK_CFG = "chk_cfg"
    WAIT_READY = "wait_ready"
    DATA_EXCHANGE = "data_exchange"
    FAULT = "fault"
    DEACTIVATED = "deactivated"  # taken out of service by order


class FaultKind(Enum):
    """Why a slave is not in data exchange."""

    ABSENT = "absent"  # no answer at all
    LOST = "lost"  # was in data exchange, no longer answers
    WRONG_IDENT = "wrong_ident"
    PRM_FAULT = "prm_fault"
    CFG_FAULT = "cfg_fault"
    NOT_SUPPORTED = "not_supported"
    LOCKED = "locked"  # owned by another master
    NOT_READY = "not_ready"  # accepts everything, never gets ready
    WRONG_LENGTH = "wrong_length"
    REFUSED = "refused"  # answers RS, UE, RR again and again
    LEFT = "left"  # fell out of data exchange by itself (its watchdog, another parameter set)
    ISOCHRONOUS = "isochronous"  # demands isochronous mode, which no port of a computer can keep
    PLUGIN = "plugin"  # an exception in a drive plugin or a cyclic function


class Fault(Struct, frozen=True, repr_omit_defaults=True):
    """A fault of a slave: what happened (``message``, one line), and what to do (``remedy``).

    ``actual``: the identifier octets that the slave says to have, if they differ from the configuration; else empty.
    """

    #: kind of the fault
    kind: FaultKind
    #: what happened, one line
    message: str
    #: what to do; empty if nothing helps
    remedy: str
    actual: bytes = b""

    @property
    def text(self) -> str:
        """``message`` and ``remedy`` in one line."""
        return f"{self.message}; {self.remedy}" if self.remedy else self.message


class SlaveEvent(Event):
    """Something about one slave of the master: its address, and its name in the configuration."""

    #: station address of the slave, 0..126
    address: int
    #: name of the slave in the configuration
    name: str

    @property
    def who(self) -> str:
        """The slave, at the beginning of each text."""
        return f"slave {self.address} ({self.name})"


class SlaveStateChanged(SlaveEvent):
    """The master's handling of the slave reached another state."""

    #: state in which the master has the slave
    state: SlaveState

    TEMPLATE = "{e.who}: {e.state.value}"


class SlaveFaulted(SlaveEvent):
    """The slave has a new or another fault. (Not reported again at every retry.)"""

    SEVERITY = Severity.ERROR

    #: what happened, and what to do
    fault: Fault

    TEMPLATE = "{e.who}: {e.fault.text}"


class SlaveDiagnosis(SlaveEvent):
    """A diagnosis that differs from the last one was read."""

    #: the diagnosis read
    diagnosis: Diagnosis
    #: the extended diagnosis as text, one line a block, in the words of the device's GSD file if it has some
    texts: tuple[str, ...] = ()

    def _text(self) -> str:
        says = "; ".join((", ".join(self.diagnosis.flags) or "without findings", *self.texts))
        return f"{self.who}: diagnosis {says}"


class SlaveRemark(SlaveEvent):
    """A deviation from the standard, reported once."""

    SEVERITY = Severity.WARNING

    #: the deviation, one line
    message: str

    TEMPLATE = "{e.who}: {e.message}"


class OutputsWithheld(SlaveEvent):
    """The slave gets outputs again after it was away, by ``after_return = "safe"`` its safe values: those that the
    application had set before are withheld until it sets outputs anew."""

    SEVERITY = Severity.WARNING

    #: octets that are withheld
    outputs: bytes

    def _text(self) -> str:
        return (
            f"{self.who}: it was away, and its outputs stay at their safe values until they are set anew "
            f'(after_return = "safe"); {self.outputs.hex()} is withheld: look at the plant, then set its outputs'
        )


class ModeChanged(Event):
    """The master reached a mode."""

    #: mode that the master reached
    mode: Mode

    def _text(self) -> str:
        return f"master: {self.mode.name.lower()}"


class MasterStopped(Event):
    """The master has ended."""

    #: safe values and Clear were sent; False if the master had no token to send them
    cleared: bool = True

    def _text(self) -> str:
        sent = "safe values and Clear were sent" if self.cleared else "it had no token to send safe values and Clear"
        return f"master: stopped: {sent}"


class OperateWaits(Event):
    """Operate was ordered with auto-clear; the master stays in Clear until ``slaves`` are in data exchange."""

    SEVERITY = Severity.WARNING

    #: addresses of the slaves that are not in data exchange
    slaves: tuple[int, ...]
    #: why each of them is not, one line each
    reasons: tuple[str, ...]

    def _text(self) -> str:
        return f"master: auto_clear: stays in Clear until all slaves are in data exchange: {'; '.join(self.reasons)}"


class ForcedClear(Event):
    """The master goes to Clear by itself, and stays there until Operate is ordered."""

    SEVERITY = Severity.ERROR

    #: the application must order Operate again
    MUST_ARRIVE = True

    @property
    def why(self) -> str:
        """The reason, without what to do."""
        raise NotImplementedError


class AutoCleared(ForcedClear):
    """Auto-clear: ``slaves`` had no good data exchange for the Data_Control_Time, so the master goes to Clear."""

    #: addresses of the slaves without good data exchange
    slaves: tuple[int, ...]
    #: why each of them has none, one line each
    reasons: tuple[str, ...]

    @property
    def why(self) -> str:
        """The reason, without what to do."""
        return f"auto_clear: {'; '.join(self.reasons)}"

    def _text(self) -> str:
        return f"master: auto_clear: outputs become safe: {'; '.join(self.reasons)}; operate() again when it is back"


class Blocked(Enum):
    """The obstacle that kept a master from asking its slaves; the values are those of the JSON lines."""

    PROGRAM = "program"  # the driver did not run: stopped, without a processor, or its event loop was blocked
    SUSPENDED = "suspended"  # the computer slept
    PORT = "port"  # the port was lost
    TOKEN = "token"  # another master, or noise: the token did not come


class Stalled(ForcedClear):
    """``slaves`` got no requests for longer than their watchdogs. The master goes to Clear before it asks them again.

    ``blocked``: the obstacle, None if it is not known.
    """

    #: longest time in ns without requests to one of the slaves; None if no clock shows it
    gap_ns: int | None
    #: addresses of the slaves without requests
    slaves: tuple[int, ...]
    blocked: Blocked | None
    #: obstacle and time in words
    reason: str

    @property
    def why(self) -> str:
        """The slave without requests, for how long, and the obstacle."""
        return f"stall: {self.reason}"

    def _text(self) -> str:
        return (
            f"master: stall: outputs become safe: {self.reason}; look at the plant, then operate() "
            f'(after_stall = "resume" sends the old outputs again unasked)'
        )


class ApplicationSilent(ForcedClear):
    """The application watchdog ran out: the application did not call ``alive()`` for ``limit_ns``."""

    #: time in ns that the application watchdog allows
    limit_ns: int

    @property
    def why(self) -> str:
        """The reason, without what to do."""
        return f"application watchdog: alive() was not called for {ms_text(self.limit_ns)}"

    TEMPLATE = "master: outputs become safe: {e.why}; operate() when the application works again"


class CyclesMissed(Event):
    """``count`` fixed cycles did not begin when they were due; ``missed`` with those before. Once a second at most.

    ``number``, ``late_ns`` and ``reason`` are those of the worst one (of one left out: its delay at that time).
    """

    SEVERITY = Severity.WARNING

    #: fixed cycles that did not begin when they were due
    count: int
    #: all of them since the start of the bus
    missed: int
    #: number of the worst cycle
    number: int
    #: delay of the worst cycle, in ns
    late_ns: int
    #: reason for the worst cycle, for people
    reason: str

    def _text(self) -> str:
        late = f"{ms_text(self.late_ns)} late: {self.reason}"
        if self.count == 1:
            return f"deadline miss {self.missed}: cycle {self.number} was {late}"
        return f"deadline misses {self.missed - self.count + 1} to {self.missed}: cycle {self.number} was {late}"


class ControlSent(Event):
    """The Global_Control ordered with ``token`` left the line; ``t_ns`` is the end of its last octet.

    ``missed``: slaves of its groups that were not in data exchange and did not carry it out.
    """

    MUST_ARRIVE = True

    token: int
    missed: tuple[int, ...] = ()

    def _text(self) -> str:
        missed = f"; not taken by slaves {', '.join(map(str, self.missed))}" if self.missed else ""
        return f"master: Global_Control was sent{missed}"


class PictureTaken(Event):
    """The inputs of every slave of the groups by address, each from an exchange after the order ``token`` was sent."""

    MUST_ARRIVE = True

    token: int
    inputs: dict[int, bytes]

    def _text(self) -> str:
        return f"master: inputs of one moment from slaves {', '.join(map(str, self.inputs))}"


class ControlFailed(Event):
    """The order ``token`` ended without being carried out to its end; ``address`` is of the slave that was missing."""

    MUST_ARRIVE = True
    TEMPLATE = "master: Global_Control was not carried out: {e.reason}"

    token: int
    reason: str
    address: int | None = None


class DriveEvent(SlaveEvent):
    """A drive plugin's answer or message: ``payload`` is plain JSON data with a ``"type"`` key, and with the name of
    the drive (:data:`~dpstack.dp.process_image.DRIVE`) if its slave has several."""

    #: plain JSON data with a ``"type"`` key
    payload: dict[str, object]

    def _text(self) -> str:
        payload, kind = self.payload, self.payload.get("type")
        said = kind if payload.get("text") is None else payload["text"]
        if kind == "status":
            state, faults = str(payload.get("state")), _texts(payload.get("faults"))
            if state == "fault" and faults:
                parts = [f"fault: {', '.join(faults)}"]
            else:
                parts = [state, *(f"fault {one}" for one in faults)]
            said = ", ".join((*parts, *(f"warning {one}" for one in _texts(payload.get("warnings")))))
        elif kind == "failed":
            where = payload.get("where")
            said = f"its plugin failed: {said}" + ("" if where is None else f", in {where}")
        elif kind == "result" and payload.get("ok"):
            value = payload.get("value")
            said = "order done" if value is None or isinstance(value, (dict, list)) else f"order done: {value}"
        elif kind == "result":
            said = "order failed" + ("" if payload.get("text") is None else f": {payload['text']}")
        name = f"{self.name}, {payload[DRIVE]}" if DRIVE in payload else self.name
        return f"{payload.get('of', 'drive')} {self.address} ({name}): {said}"

    @property
    def severity(self) -> Severity:
        """ERROR for a plugin that failed."""
        return Severity.ERROR if self.payload.get("type") == "failed" else Severity.INFO

    @property
    def must_arrive(self) -> bool:
        """Whether this is the result of an order."""
        return self.payload.get("type") == "result"


def _texts(value: object) -> tuple[str, ...]:
    return tuple(map(str, value)) if isinstance(value, (list, tuple)) else ()
