"""A slave of octets that raises alarms, and a master that acknowledges them.

The slave knows telegrams as numbers only; nothing of the project is used to read or to make them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from ms1_kit import MS, Ms1Bus, OctetMs1Slave, is_data_exchange
from octet_slave import DL, RS, SC, sd1, sd2

from dpstack.dp.master.events import SlaveRemark
from dpstack.dp.master.slave_reports import AlarmCounts
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.alarm_orders import AcknowledgeAlarm, AlarmDone, AlarmRaised, HoldAlarms, StatusTold

DH = 0x0A
#: every kind enabled
ALL = ("pull_plug", "process", "diagnostic", "manufacturer", "status", "update")


def block(kind: int, slot: int, specifier: int = 1, sequence: int = 0, data: str = "", add_ack: bool = False) -> bytes:
    """A device related block with an alarm (or, from 0x80 on, a status)."""
    octets = bytes.fromhex(data)
    return bytes((4 + len(octets), kind, slot, sequence << 3 | add_ack << 2 | specifier)) + octets


@dataclass
class AlarmSlave(OctetMs1Slave):
    """Raises the blocks of ``queue``, in order; ``at_a_time`` 0: the next of a type when its last is acknowledged.

    ``taken``: acknowledged alarms in order, ``strays``: acknowledgements of alarms that are not open; ``on_stray`` says
    how they are answered. ``rest``: other blocks of the diagnosis; ``static``: Stat_Diag is set. ``keeps``: alarms
    stay in it when they are acknowledged. ``sap``: where it is acknowledged. ``polls``:
    how often it is polled in vain before each answer; -1: it answers in the request itself. ``loses`` says for each
    telegram at SAP 51 whether request ("r") or answer ("a") gets lost.
    """

    at_a_time: int = 0
    sap: int = 51
    polls: int = 0
    queue: list[bytes] = field(default_factory=list)
    open: list[bytes] = field(default_factory=list)
    taken: list[bytes] = field(default_factory=list)
    strays: list[bytes] = field(default_factory=list)
    on_stray: Callable[[bytes], bytes | None] = lambda ack: ack
    rest: bytes = b""
    static: bool = False
    keeps: bool = False
    loses: Callable[[], str] = lambda: ""
    flag: bool = False
    #: the master has read the diagnosis, if it had the answer; ``offers_again`` where that is not known
    unsure: bool = False
    offers_again: bool = True
    shown: bytes = b""
    diagnosed: int = 0
    acks: list[bytes] = field(default_factory=list)
    #: codes of negative responses to the next acknowledgements
    refuses: list[str] = field(default_factory=list)
    left: list[bytes] = field(default_factory=list)
    wait: int = 0
    last: tuple[int, bytes, tuple[int, bytes] | None] | None = None

    def lose(self, what: Iterable[str]) -> None:
        """The next telegrams at SAP 51: the part of each that is lost, see ``loses``."""
        lost = iter(what)
        self.loses = lambda: next(lost, "")

    def raises(self, *blocks: bytes) -> None:
        """Raise ``blocks``, one after the other."""
        self.queue += blocks
        self.next_one()

    def changes(self, rest: bytes) -> None:
        """Put ``rest`` beside the alarm into the diagnosis."""
        self.rest = rest
        self.flag = True

    def next_one(self) -> None:
        """Show the next alarm where it may be shown."""
        if not self.queue or (self.shown and (self.flag or self.unsure)):
            return  # one at a time, and only after the last one was read
        kinds = [entry[1] for entry in self.open]
        full = len(self.open) >= self.at_a_time if self.at_a_time else self.queue[0][1] in kinds
        if not full:
            self.shown = self.queue.pop(0)
            self.open.append(self.shown)
            self.flag = True

    def __call__(self, octets: bytes, now: int) -> tuple[int, bytes] | None:
        control = octets[6] if octets[0] == 0x68 else octets[3]
        fate = self.loses() if octets[0] == 0x68 and octets[4] & 0x80 and octets[7] in (50, 51) else ""
        if fate == "r":
            return None
        if control & 0x10 and self.last is not None and (control, octets) == self.last[:2]:
            found = self.last[2]  # the same frame count bit: the answer once more
        else:
            if control & 0x0F != 9 and self.unsure:
                self.unsure = False
                if control & 0x10 or not self.offers_again:
                    self.next_one()
                else:  # the frame count bit begins anew: nobody knows whether the diagnosis was read
                    self.flag = bool(self.shown)
            found = super().__call__(octets, now)
            self.last = (control, octets, found)
        if found is not None and is_data_exchange(octets):
            found = found[0], self.data_exchange(octets)
        return None if fate == "a" else found

    def data_exchange(self, octets: bytes, control: int = DL) -> bytes:
        return super().data_exchange(octets, DH if self.flag else control)

    def service(self, octets: bytes) -> bytes | None:
        match octets[7]:
            case sap if sap in self.says:
                return self.says[sap](octets)
            case 60 if self.master != 255:
                self.flag = False
                self.unsure = True
                self.diagnosed += 1
                ext = self.shown + self.rest
                data = bytes((8 if ext else 0, 0x0E if self.static else 0x0C, 0, self.master)) + self.ident + ext
                return sd2(octets[5] & 0x7F, self.address, DL, octets[8], 60, data)
            case sap if sap == self.sap and (octets[9:10] == b"\x5c" or self.left or sap == 50):
                return self.alarm_sap(octets[9:-2])
        return super().service(octets)

    def alarm_sap(self, data: bytes) -> bytes | None:
        if data:
            self.acks.append(data)
            answer = self.acknowledged(data)
            self.left = [] if answer is None else [answer]
            self.wait = self.polls
            if self.polls >= 0:
                return SC
        if self.wait > 0 or not self.left:
            self.wait -= 1
            return SC
        return sd2(2, self.address, DL, 51, self.sap, self.left.pop())

    def acknowledged(self, ack: bytes) -> bytes | None:
        if self.refuses:
            return refusing(self.refuses.pop(0))(ack)
        for entry in self.open:
            if (entry[2], entry[1], entry[3]) == tuple(ack[1:4]):
                self.open.remove(entry)
                self.taken.append(entry)
                if self.shown is entry and not self.keeps:
                    self.shown = b""
                    self.flag = True
                self.next_one()
                return ack
        self.strays.append(ack)
        return self.on_stray(ack)


def refusing(code: str = "B5") -> Callable[[bytes], bytes | None]:
    """A negative response to an Alarm_Ack."""
    return lambda ack: bytes.fromhex(f"DC 80 {code} 00")


@dataclass
class AlarmBus(Ms1Bus):
    """Station 2 with alarm slaves in data exchange."""

    dpv1: Dpv1 | None = field(default_factory=lambda: Dpv1(alarms=ALL, alarm_mode=0))
    kind: type[OctetMs1Slave] = field(default=AlarmSlave, kw_only=True)

    @property
    def alarm_slave(self) -> AlarmSlave:
        """The first."""
        slave = self.slave
        assert isinstance(slave, AlarmSlave)
        return slave

    def hold(self, on: bool = True, address: int = 4) -> None:
        """From now on the test acknowledges the alarms."""
        self.send(HoldAlarms(address, on))

    def acknowledge(self, number: int, address: int = 4) -> None:
        """Acknowledge one alarm."""
        self.send(AcknowledgeAlarm(address, number))

    def until_ended(self, count: int = 1) -> None:
        """Run until ``count`` alarms have ended."""
        self.until(lambda: len(self.ends) == count)

    def raise_and_run(self, ms: int, *blocks: bytes) -> None:
        """The slave raises ``blocks``; run for ``ms``."""
        self.alarm_slave.raises(*blocks)
        self.run(ms)

    def change_and_run(self, ms: int, rest: bytes) -> None:
        """Put ``rest`` beside the alarm into the slave's diagnosis; run for ``ms``."""
        self.alarm_slave.changes(rest)
        self.run(ms)

    def raise_and_end(self, *blocks: bytes, count: int | None = None) -> None:
        """The slave raises ``blocks``; run until as many alarms, or ``count``, have ended since the start."""
        self.alarm_slave.raises(*blocks)
        self.until_ended(len(blocks) if count is None else count)

    def until_taken(self, count: int = 1, ms: int = 20_000) -> None:
        """Run until the slave has taken ``count`` acknowledgements."""
        self.until(lambda: len(self.alarm_slave.taken) == count, ms)

    @property
    def raised(self) -> list[AlarmRaised]:
        """Alarms delivered."""
        return self.events_of(AlarmRaised)

    @property
    def blocks(self) -> list[bytes]:
        """Alarms delivered, in octets."""
        return [octets_of(event) for event in self.raised]

    @property
    def ends(self) -> list[AlarmDone]:
        """The ends of alarms."""
        return self.events_of(AlarmDone)

    @property
    def statuses(self) -> list[StatusTold]:
        return self.events_of(StatusTold)

    @property
    def remarks(self) -> list[str]:
        """The texts of deviations."""
        return [event.message for event in self.events_of(SlaveRemark)]

    @property
    def counts(self) -> AlarmCounts:
        """The alarm counters of the first slave."""
        counts = self.counts_of(self.addresses[0])
        assert counts is not None
        return counts

    def counts_of(self, address: int) -> AlarmCounts | None:
        """The alarm counters of one slave; None without DP-V1."""
        return self.master.handlers[address].alarm_counts


def octets_of(event: AlarmRaised) -> bytes:
    """The block of the alarm, made by hand."""
    alarm = event.alarm
    specifier = alarm.sequence << 3 | alarm.add_ack << 2 | alarm.specifier
    return bytes((4 + len(alarm.data), alarm.type, alarm.slot, specifier)) + alarm.data


__all__ = ["ALL", "DH", "MS", "RS", "SC", "AlarmBus", "AlarmSlave", "block", "octets_of", "refusing", "sd1"]
