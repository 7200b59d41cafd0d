"""Alarms of DP-V1 and the ends of class 2 connections: orders of programs to a master, and events for every program.

Plain data; times in ns. Records and the opening of connections: :mod:`dpstack.dpv1.master.orders`, which loads their
PDUs. A class 2 connection is named by the token of the order that opened it.
"""

from __future__ import annotations

from dpstack.dp.acyclic.job import Outcome
from dpstack.dp.master.events import SlaveEvent
from dpstack.dp.pdu.alarm_blocks import Alarm, Specifier, Status, full_text
from dpstack.dp.pdu.diag_blocks import FIRST_SLOT
from dpstack.dp.pdu.diag_texts import texts_of
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import UsageError
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.machine import Order
from dpstack.params import DPV1_STATUS_LEN
from dpstack.trace import Event, Severity

# --- ends of class 2 connections --------------------------------------------------------------------------------


class CloseConnection(Order):
    """Abort ``connection``, also while it is being opened. Its services end. A connection that is over is no error."""

    ENDS = True

    connection: int


class CloseConnections(Order):
    """Abort all connections, then emit ConnectionsClosed: for the end of a bus."""

    ENDS = True


class ConnectionOver(Event):
    """The one end of a connection that was open, emitted when the slave has it back: ``reason`` says who ended it and
    why.

    ``abort``: subnet, instance and reason of the Abort that either end sent; None without any. ``ordered``: the program
    that opened it ended it.
    """

    #: number of the connection on this bus
    connection: int
    #: station address of the slave, 0..126
    address: int
    #: SAP of the slave for the connection, 0..48
    server_sap: int
    #: who ended it, and why
    reason: str
    abort: tuple[int, int, int] | None = None
    ordered: bool = False

    MUST_ARRIVE = True

    TEMPLATE = "slave {e.address}: class 2 connection (server SAP {e.server_sap}) is over: {e.reason}"

    @property
    def severity(self) -> Severity:
        """INFO for an end that the program ordered, else WARNING."""
        return Severity.INFO if self.ordered else Severity.WARNING


class ConnectionsClosed(Event):
    """The end of CloseConnections: no slave holds anything for this master any more, as far as could be done."""

    MUST_ARRIVE = True
    TEMPLATE = "no class 2 connection is open any more"


# --- alarms ------------------------------------------------------------------------------------------------------


class HoldAlarms(Order):
    """``on``: from now on only AcknowledgeAlarm acknowledges alarms of the slave at ``address``; otherwise the station
    does it again, and begins with those that wait."""

    address: int
    on: bool


class AcknowledgeAlarm(Order):
    """Acknowledge the alarm ``number`` (of AlarmRaised) of the slave at ``address``; its end is AlarmDone."""

    address: int
    number: int


class AlarmRaised(SlaveEvent):
    """The slave raised ``alarm``; ``number`` counts the alarms of this slave. ``diagnosis`` is the one with the alarm.

    ``held``: it waits for AcknowledgeAlarm. ``texts``: the other blocks of that diagnosis (channels, modules), and the
    texts of the GSD file for the alarm, one line each.
    """

    #: number of the alarm, counted for each slave
    number: int
    #: the alarm
    alarm: Alarm
    #: the diagnosis that carried the alarm
    diagnosis: Diagnosis
    held: bool = False
    texts: tuple[str, ...] = ()

    @property
    def must_arrive(self) -> bool:
        """The slave waits for its acknowledgement."""
        return self.held

    @property
    def severity(self) -> Severity:
        """WARNING for an alarm about an error that appears."""
        return Severity.WARNING if self.alarm.specifier == Specifier.APPEARS else Severity.INFO

    def _text(self) -> str:
        return "; ".join((f"{self.who}: {self.alarm.full_text}", *self.texts))


class AlarmDone(SlaveEvent):
    """The one end of the alarm ``number``: the slave took its acknowledgement, or why it got none."""

    MUST_ARRIVE = True

    number: int
    outcome: Outcome

    def _text(self) -> str:
        """The outcome names the slave too: once is enough."""
        failed = self.outcome.text.removeprefix(f"{self.who} ").removeprefix(f"slave {self.address} ")
        return f"{self.who}: " + (failed or f"took the acknowledgement of alarm {self.number}")


class StatusTold(SlaveEvent):
    """The slave's diagnosis holds a new ``status``. Nobody acknowledges it."""

    #: the new status
    status: Status
    #: slot of the first module of a module status
    first_slot: int = FIRST_SLOT

    def _text(self) -> str:
        return f"{self.who}: {full_text(self.status, self.first_slot)}"


def texts_beside(diagnosis: Diagnosis, alarm: Alarm, texts: DiagTexts | None) -> tuple[str, ...]:
    """The texts of the GSD file for ``alarm``, and the texts of the other blocks of ``diagnosis``."""
    block = alarm.build()
    own = () if texts is None else tuple(found.text for found in texts.unit_diag_texts(block[1:]))
    others = tuple(other for other in diagnosis.blocks if other.octets != block)
    return own + texts_of(others, texts, dpv1=True)


def need_dpv1(setup: SlaveParams, lacks: str = "no Read, Write, alarms", *, read_only: bool = False) -> None:
    """Raises UsageError for a slave that this master has not parameterised for DP-V1; ``lacks``: for the message."""
    if read_only:
        raise UsageError("this bus is read-only: its slaves are not in data exchange with it; leave read_only out")
    if setup.dpv1 is None:
        keys = "dpv1 = true"
        if len(setup.user_prm) < DPV1_STATUS_LEN:
            keys = f'user_prm = "{bytes(DPV1_STATUS_LEN).hex(" ")}" and {keys}'
        raise UsageError(
            f"{setup.who} is not parameterised for DP-V1: {lacks}; if it has them put {keys} into its [[slave]] table"
        )
