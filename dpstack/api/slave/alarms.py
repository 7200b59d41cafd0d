"""``slave.alarms()``: alarms of DP-V1 and their acknowledgement; the links of a subscriber by its status messages.

Without a listener the station acknowledges alarms itself, so that no slave waits for ever. With listeners an alarm is
acknowledged when every listener has read it: a slow listener delays further alarms in the slave, and no queue grows
here. In both cases an alarm is also an event.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from dpstack.api.slave.service_errors import error_of
from dpstack.api.streams import Reader, Stream, when_dropped
from dpstack.dp.acyclic.job import Outcome, ServiceFailure
from dpstack.dp.master.events import SlaveStateChanged
from dpstack.dp.pdu.alarm_blocks import Specifier, Status
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dpv1.master.alarm_orders import AcknowledgeAlarm, AlarmDone, AlarmRaised, HoldAlarms, StatusTold
from dpstack.errors import DpError
from dpstack.trace import Event

if TYPE_CHECKING:
    from dpstack.dp.pdu.dxb import Link, LinkState
    from dpstack.dp.slave_params import SlaveParams

#: longest queue of status messages of one reader
_STATUSES: Final = 64


_UNREPORTED = "the slave has not reported yet"
_AWAY = "the slave is not in data exchange"


class SlaveAlarm:
    """One alarm of a slave, as ``slave.alarms()`` gives it.

    ``type`` 1 diagnosis, 2 process, 3 pull, 4 plug, 5 status, 6 update, 32..126 the maker's own, ``title`` in words;
    ``slot`` 0..254; ``sequence`` number 0..31; ``data`` up to 59 octets, whose meaning is in the device's manual.
    ``user_ack`` (Add_Ack): the device expects a user action besides the acknowledgement, for instance a Write.
    """

    #: station address of the slave, 0..126
    address: int
    #: name of the slave
    name: str
    #: type of the alarm: 1 diagnosis, 2 process, 3 pull, 4 plug, 5 status, 6 update, 32..126 the maker's own
    type: int
    #: ``type`` in words
    title: str
    #: slot that raised it, 0..254
    slot: int
    #: sequence number, 0..31
    sequence: int
    #: whether a fault appears or disappears
    specifier: Specifier
    #: data of the alarm, up to 59 octets; the device's manual says what they mean
    data: bytes
    user_ack: bool
    #: the diagnosis telegram that carried the alarm
    diagnosis: Diagnosis
    #: the other blocks of that diagnosis, one line each
    texts: tuple[str, ...]
    #: bus time in ns
    t_ns: int
    text: str

    def __init__(self, raised: AlarmRaised, listeners: AlarmListeners, keepers: set[_Listener]) -> None:
        self.address = raised.address
        self.name = raised.name
        self.type = raised.alarm.type
        self.title = raised.alarm.title
        self.slot = raised.alarm.slot
        self.sequence = raised.alarm.sequence
        self.specifier = Specifier(raised.alarm.specifier)
        self.data = raised.alarm.data
        self.user_ack = raised.alarm.add_ack
        self.diagnosis = raised.diagnosis
        self.texts = raised.texts
        self.t_ns = raised.t_ns
        #: slave and alarm in one line
        self.text = raised.text
        self._raised = raised
        self._bus_listeners = listeners
        #: listeners that have not read it
        self._keepers = keepers
        self._end: Outcome | None = None
        self._ended = asyncio.Event()

    def __repr__(self) -> str:
        return f"<SlaveAlarm {self.text}>"

    @property
    def appears(self) -> bool:
        """True if the alarm reports a new fault of the slot."""
        return self.specifier is Specifier.APPEARS

    @property
    def disappears(self) -> bool:
        """True if a fault has gone; :attr:`slot_good` is False while the slot has other faults."""
        return self.specifier in (Specifier.DISAPPEARS, Specifier.DISAPPEARS_OTHERS)

    @property
    def slot_good(self) -> bool | None:
        """True: the slot has no fault left; None: the alarm does not contain this."""
        return None if self.specifier is Specifier.NONE else self.specifier is Specifier.DISAPPEARS

    async def acknowledge(self) -> None:
        """Acknowledge the alarm (``alarms()`` does so by itself), and wait for the slave's confirmation. The
        acknowledgement does not wait for listeners that have not read the alarm yet.

        May be repeated. Raises AcyclicError and ServiceRefused if the slave refuses, SlaveFault when the slave left
        data exchange before (its alarms are void then), UsageError, BusError.
        """
        await self._bus_listeners.acknowledge(self)


class _Listener(Stream[SlaveAlarm]):
    """The unread alarms of one ``alarms()``. ``error``: the cause of its end, unless the bus has ended."""

    def __init__(self) -> None:
        super().__init__(None)
        self.error: DpError | None = None


class AlarmStream(AsyncIterator[SlaveAlarm]):
    """An async iterator over the alarms of one slave. Ends with the bus, or when the slave is removed from it."""

    def __init__(self, listeners: AlarmListeners, address: int, acknowledge: bool) -> None:
        self._bus_listeners = listeners
        self._address = address
        self._acknowledge = acknowledge
        self._listener = _Listener()
        listeners.listen(address, self._listener)
        # a program may leave an ``async for`` without close(): the slave must not wait for its acknowledgement
        self._leave = when_dropped(self, listeners.leave, address, self._listener)

    def close(self) -> None:
        """End the stream; its unread alarms are acknowledged. May be repeated."""
        self._leave.detach()
        self._bus_listeners.leave(self._address, self._listener)

    async def __anext__(self) -> SlaveAlarm:
        listener = self._listener
        try:
            alarm = await anext(listener)
        except StopAsyncIteration:
            raise listener.error or StopAsyncIteration from None
        if self._acknowledge:
            self._bus_listeners.release(alarm, listener)
        return alarm


class AlarmListeners:
    """The alarm and status listeners of one bus."""

    def __init__(self, command: Callable[[object], None]) -> None:
        self._command = command
        self._listeners: dict[int, list[_Listener]] = {}
        self._statuses: dict[int, set[Stream[Status]]] = {}
        #: the links in the last link status message, by the address of the subscriber
        self.links: dict[int, tuple[LinkState, ...]] = {}
        #: alarms that are not acknowledged yet, by address and number
        self._held: dict[tuple[int, int], SlaveAlarm] = {}
        self._over: DpError | None = None

    def statuses(self, address: int) -> Reader[Status]:
        """See :meth:`dpstack.api.slave.slave.Slave.status_messages`."""
        stream = Stream[Status](_STATUSES)
        streams = self._statuses.setdefault(address, set())
        streams.add(stream)
        if self._over is not None:
            stream.end()
        return Reader(stream, streams.discard)

    # --- listeners ----------------------------------------------------------------------------------------------

    def listen(self, address: int, listener: _Listener) -> None:
        """Give ``listener`` the alarms of the slave at ``address``. Raises UsageError, BusError."""
        self._command(HoldAlarms(address, True))
        self._listeners.setdefault(address, []).append(listener)

    def leave(self, address: int, listener: _Listener) -> None:
        """Undo :meth:`listen`. May be repeated."""
        listeners = self._listeners.get(address, [])
        if listener not in listeners:
            return
        listeners.remove(listener)
        listener.end()
        for alarm in tuple(self._held.values()):
            self.release(alarm, listener)
        if not listeners:
            self._order(HoldAlarms(address, False))

    def release(self, alarm: SlaveAlarm, listener: _Listener) -> None:
        """``listener`` has passed ``alarm`` to the application, or has left."""
        if listener in alarm._keepers:
            alarm._keepers.remove(listener)
            if not alarm._keepers:
                self._order(AcknowledgeAlarm(alarm.address, alarm._raised.number))
                self._drop_over(alarm)

    async def acknowledge(self, alarm: SlaveAlarm) -> None:
        """Acknowledge for all listeners; returns when the slave has confirmed."""
        for listener in tuple(alarm._keepers):
            self.release(alarm, listener)
        await alarm._ended.wait()
        assert alarm._end is not None
        if alarm._end.failure is not None:
            from dpstack.dpv1.pdu.read_write import Function  # here, as few slaves refuse

            raise error_of(alarm.address, Function.ALARM_ACK.title, alarm._end, (alarm.slot, alarm.type))

    def _drop_over(self, alarm: SlaveAlarm) -> None:
        if alarm._end is not None and not alarm._keepers:
            self._held.pop((alarm.address, alarm._raised.number), None)

    def _order(self, command: object) -> None:
        with contextlib.suppress(DpError):  # the bus has ended, or the slave was removed
            self._command(command)

    # --- events of the machine ------------------------------------------------------------------------------------

    def handle_event(self, event: Event) -> bool:
        """Handle an event of the master. True: no other reader gets it."""
        match event:
            case AlarmRaised(held=True):
                self._raised(event)
            case SlaveStateChanged(address=address):
                self.links.pop(address, None)
            case StatusTold(address=address, status=status):
                if status.links:
                    self.links[address] = status.links
                for stream in tuple(self._statuses.get(address, ())):
                    stream.put(status)
            case AlarmDone(address=address, number=number, outcome=outcome):
                self._done(address, number, outcome)
                return True
        return False

    def _raised(self, event: AlarmRaised) -> None:
        listeners = self._listeners.get(event.address, [])
        if not listeners:
            return  # the last listener left just now: the station acknowledges
        alarm = self._held[event.address, event.number] = SlaveAlarm(event, self, set(listeners))
        for listener in listeners:
            listener.put(alarm)

    def _done(self, address: int, number: int, outcome: Outcome) -> None:
        alarm = self._held.get((address, number))
        if alarm is not None:
            alarm._end = outcome
            alarm._ended.set()
            self._drop_over(alarm)

    def on_refused(self, order: HoldAlarms | AcknowledgeAlarm, error: DpError) -> None:
        """The bus process did not carry out ``order``."""
        match order:
            case HoldAlarms(address, on):
                for listener in self._listeners.pop(address, []) if on else []:
                    listener.error = error
                    listener.end()
            case AcknowledgeAlarm(address, number):
                self._done(address, number, Outcome(ServiceFailure.LINE, str(error)))

    def forget(self, address: int) -> None:
        """The slave was removed from the bus."""
        for reader in (*self._listeners.pop(address, ()), *self._statuses.pop(address, ())):
            reader.end()
        self.links.pop(address, None)
        self._end_held("was removed from the bus", address)

    def end(self, error: DpError) -> None:
        """The bus has ended; unread alarms can still be read."""
        self._over = error
        readers: Iterable[Iterable[Stream[Any]]] = (*self._listeners.values(), *self._statuses.values())
        for reader in tuple(itertools.chain(*readers)):
            reader.end()
        self._end_held(str(error))

    def _end_held(self, why: str, address: int | None = None) -> None:
        for key, alarm in tuple(self._held.items()):
            if address in (None, alarm.address):
                alarm._keepers.clear()  # the number may stand for another alarm later
                text = f"an alarm of slave {alarm.address} was not acknowledged: {why}"
                self._done(*key, alarm._end or Outcome(ServiceFailure.LINE, text))


class SlaveSubscription(Struct, frozen=True):
    """Octets that a slave takes from a publisher, and whether they come."""

    #: address of the publisher
    publisher: int
    #: name of the publisher; its address if it is not on this bus any more
    name: str
    #: first octet that is taken, from 0
    offset: int
    #: octets that are taken
    length: int
    #: first octet of the outputs of the slave that they act as; None: its manual says what it does with them
    to: int | None
    #: valid data come, by the last link status message; None: not known
    good: bool | None
    #: the state in words
    text: str


def subscriptions(
    setup: SlaveParams, states: tuple[LinkState, ...], names: Mapping[int, str], *, exchanging: bool
) -> tuple[SlaveSubscription, ...]:
    """The links of the slave with ``setup``; ``states``: those of its last link status message."""
    return tuple(_shown(setup, link, states, names, exchanging) for link in setup.links)


def _shown(
    setup: SlaveParams, link: Link, states: tuple[LinkState, ...], names: Mapping[int, str], exchanging: bool
) -> SlaveSubscription:
    good, text = None, _UNREPORTED if exchanging else _AWAY
    found = next((one for one in states if one.publisher == link.publisher), None)
    if exchanging and found is not None:
        good, text = found.status, found.words
    name = names.get(link.publisher, str(link.publisher))
    to = _output_octet(setup, link)
    return SlaveSubscription(link.publisher, name, link.offset, link.length, to, good, text)


def _output_octet(setup: SlaveParams, link: Link) -> int | None:
    """The first output octet of ``link``, whose slot counts octets of its own."""
    if link.to is None or link.slot is None:
        return link.to
    return next((slot.outputs.at + link.to for slot in setup.slots.slots if slot.number == link.slot), None)
