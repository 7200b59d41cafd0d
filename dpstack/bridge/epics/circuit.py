"""The connection of one client: its channels, monitors and puts, with a bound for each.

The protocol is that of caproto's sans-I/O core; what a client gets and when is decided here. A monitor that a client
does not take in time gets the newest value instead of all: a client that does not read delays no other one.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable, Iterable
from typing import Any, Final, NamedTuple, Protocol

import caproto as ca

from dpstack.bridge.epics.variables import Variable, cut
from dpstack.bridge.processor_share import ProcessorShare
from dpstack.plant.quality import Value

#: channels, and monitors, of one client
MOST_CHANNELS: Final = 20_000
#: octets of a message: a put has some hundreds
MOST_OCTETS: Final = 16_384
#: puts of one client that wait for their result
MOST_PUTS: Final = 64
#: s that a read waits for a put of the same client before it
PUT_S: Final = 1.0
#: s that a client may take to read what it has got
PATIENCE_S: Final = 10.0
#: monitors that are answered before others have their turn
_AT_ONCE: Final = 50
#: s for the last values at the end
LAST_S: Final = 0.5
_READ: Final = 4096
#: octets of the reason of a refused put
_MOST_REASON: Final = 200
_VERSION: Final = ca.DEFAULT_PROTOCOL_VERSION


class Refused(NamedTuple):
    """A request that is refused; ``status``: that of Channel Access, ``reason``: in words."""

    status: Any
    reason: str


class Plant(Protocol):
    """The variables of a server, and the run behind them."""

    def knows(self, name: str) -> bool:
        """Whether there is a variable ``name``, which may have a field."""

    async def find(self, name: str) -> Variable | None:
        """The variable ``name``, with its field; None without one, or if there is no room for it."""

    def may_put(self, variable: Variable) -> bool: ...

    async def put(self, variable: Variable, value: Value, who: str) -> Refused | None:
        """Give the order of ``variable``; the reason if it is refused."""

    def refuse(self, variable: Variable, reason: str, who: str) -> None:
        """Report a put that was refused for its form."""


class _Monitor(NamedTuple):
    channel: Any
    variable: Variable
    request: Any


#: of caproto, which has no number for a text
_CONVERSION: Final = (ca.CaprotoError, ValueError, TypeError)


def _not_as(variable: Variable, command: Any, error: Exception) -> Refused:
    """The answer to a read of a text as a number, for instance."""
    type_ = ca.ChannelType(command.data_type)  # an unknown one ends the connection
    return Refused(ca.CAStatus.ECA_NOCONVERT, f"it cannot be read as {type_.name} ({type(error).__name__})")


class _BrokenError(Exception):
    """The client does not keep to the protocol, or to a bound; its text says how."""


def version_answer(request: Any) -> Any:
    """The answer to a version. It has the number of the request, by which libca finds out how fast its searches are
    answered; caproto answers each with the number 1."""
    answer = ca.VersionResponse(_VERSION)
    answer.header.data_type, answer.header.parameter1 = request.header.data_type, request.header.parameter1
    return answer


class Circuit:
    """``address``: of the client. ``port``: of this server. ``cut_off``: called with the reason if the client is cut
    off."""

    def __init__(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, plant: Plant, share: ProcessorShare,
        port: int, cut_off: Callable[[str], object],
    ) -> None:  # fmt: skip
        address = writer.get_extra_info("peername")
        self.address = str(address[0])
        self._reader = reader
        self._writer = writer
        self._plant = plant
        self._share = share
        self._port = port
        self._cut_off = cut_off
        self._core = ca.VirtualCircuit(ca.SERVER, address[:2], None)
        self._core.our_address = writer.get_extra_info("sockname")[:2]
        self._user = ""
        self._variables: dict[int, Variable] = {}
        self._monitors: dict[int, _Monitor] = {}
        self._news: dict[int, None] = {}
        self._has_news = asyncio.Event()
        self._events = asyncio.Event()
        self._events.set()
        #: puts that wait for their result, and what they set
        self._puts: dict[asyncio.Task[None], Variable] = {}

    @property
    def variables(self) -> Iterable[Variable]:
        """Those that the client has channels of."""
        return self._variables.values()

    async def run(self) -> None:
        """Serve the client until it has gone, breaks a rule, or this is cancelled."""
        sending = asyncio.create_task(self._send_news(), name="dpstack epics: monitors")
        reading = asyncio.create_task(self._read_requests(), name="dpstack epics: requests")
        try:
            await asyncio.wait((sending, reading), return_when=asyncio.FIRST_COMPLETED)
            for task in (sending, reading):
                if task.done() and not task.cancelled() and (error := task.exception()) is not None:
                    self._report(error)
        finally:
            for one in (sending, reading, *self._puts):
                one.cancel()
            for monitor in self._monitors.values():
                monitor.variable.watchers.pop(self._key(monitor), None)
            if self._writer.transport.get_write_buffer_size():
                self._writer.transport.abort()  # the client does not read: it would stay for ever
            else:
                self._writer.close()

    async def flush(self) -> None:
        """Send the last values, as far as the client takes them soon."""
        with contextlib.suppress(TimeoutError, OSError):
            async with asyncio.timeout(LAST_S):
                while self._news and self._events.is_set():  # noqa: ASYNC110  the task that sends them reports nothing
                    await asyncio.sleep(0.01)
                await self._writer.drain()

    def drop(self, is_gone: Callable[[Variable], bool]) -> None:
        """End the channels of variables that are gone: the client looks for them again."""
        for sid, variable in tuple(self._variables.items()):
            if is_gone(variable):
                channel = self._core.channels_sid[sid]
                self._forget(sid)
                self._send(channel.disconnect())

    def _report(self, error: BaseException) -> None:
        if isinstance(error, _BrokenError):
            self._cut_off(str(error))
        elif isinstance(error, TimeoutError):
            self._cut_off(f"it did not read its values for {PATIENCE_S:g} s")
        elif not isinstance(error, (OSError, EOFError)):
            self._cut_off(f"it does not keep to the protocol ({type(error).__name__})")

    # --- to the client --------------------------------------------------------------------------------------------

    def _send(self, *commands: Any) -> None:
        if commands and not self._writer.is_closing():
            self._writer.write(b"".join(self._core.send(*commands)))

    async def _drain(self) -> None:
        async with asyncio.timeout(PATIENCE_S):
            await self._writer.drain()

    async def _send_news(self) -> None:
        while True:
            await self._has_news.wait()
            await self._events.wait()
            begun = time.thread_time()
            for number in list(self._news)[:_AT_ONCE]:
                del self._news[number]
                if (monitor := self._monitors.get(number)) is not None:
                    await self._send_value(monitor)
            if not self._news:
                self._has_news.clear()
            await self._drain()
            await self._share.pause(begun)

    async def _send_value(self, monitor: _Monitor) -> None:
        request = monitor.request
        try:
            metadata, values = await self._values(monitor.variable, request)
        except _CONVERSION:  # a text was empty, which is 0, and is no number now: the old value would look good
            self._forget(monitor.channel.sid)
            self._send(monitor.channel.disconnect())
            return
        count = request.data_count or monitor.variable.length(values)
        self._send(
            monitor.channel.subscribe(values, request.subscriptionid, request.data_type, count, 1, metadata=metadata)
        )

    async def _values(self, variable: Variable, request: Any) -> tuple[Any, Any]:
        """Metadata and as many values as ``request`` asks for, zeros behind those that there are; 0: those that there
        are."""
        count = request.data_count
        if count > variable.count:
            raise _BrokenError(f"it asked for {count} values of {variable.pv.name}, which has {variable.count}")
        metadata, values = await variable.encoded(request.data_type)
        if not count:
            return metadata, values
        missing = count - variable.length(values)
        return metadata, [*values, *[0] * missing] if missing > 0 else values[:count]

    def _mark(self, number: int) -> None:
        self._news[number] = None
        self._has_news.set()

    # --- from the client ------------------------------------------------------------------------------------------

    async def _read_requests(self) -> None:
        while octets := await self._reader.read(_READ):
            begun = time.thread_time()
            commands, wanted = self._core.recv(octets)
            if wanted > MOST_OCTETS:
                raise _BrokenError(f"it sent a message of more than {MOST_OCTETS} octets")
            for number, command in enumerate(commands, 1):
                if isinstance(command, ca.VersionRequest):
                    self._core.priority = command.priority  # libca counts its searches by TCP there
                self._core.process_command(command)
                answer = self._ANSWERS.get(type(command))
                if answer is not None:
                    self._send(*await answer(self, command))
                if number % _AT_ONCE == 0:
                    await self._drain()
                    begun = await self._share.pause(begun)
            await self._drain()
            await self._share.pause(begun)

    async def _version(self, command: Any) -> Iterable[Any]:
        return (version_answer(command),)

    async def _echo(self, command: Any) -> Iterable[Any]:
        return (ca.EchoResponse(),)

    async def _host(self, command: Any) -> Iterable[Any]:
        return ()

    async def _client(self, command: Any) -> Iterable[Any]:
        self._user = command.name[:40]
        return ()

    async def _search(self, command: Any) -> Iterable[Any]:
        if self._plant.knows(command.name):
            return (ca.SearchResponse(self._port, None, command.cid, _VERSION),)
        return (ca.NotFoundResponse(_VERSION, command.cid),) if command.reply == ca.DO_REPLY else ()

    async def _create(self, command: Any) -> Iterable[Any]:
        variable = await self._plant.find(command.name) if len(self._variables) < MOST_CHANNELS else None
        if variable is None:
            self._send(ca.CreateChFailResponse(command.cid))
            self._core.channels.pop(command.cid, None)  # caproto keeps those that it refuses
            return ()
        rights = ca.AccessRights.READ
        if self._plant.may_put(variable):
            rights |= ca.AccessRights.WRITE
        sid = self._core.new_channel_id()
        self._variables[sid] = variable
        return (
            ca.AccessRightsResponse(command.cid, rights),
            ca.CreateChanResponse(variable.type, variable.count, command.cid, sid),
        )

    async def _read(self, command: Any) -> Iterable[Any]:
        channel, variable = self._channel(command.sid)
        if puts := [task for task, put in self._puts.items() if put is variable]:
            await asyncio.wait(puts, timeout=PUT_S)  # `caput` reads right behind its put
        try:
            metadata, values = await self._values(variable, command)
        except _CONVERSION as error:
            return (self._refusal(command, channel, _not_as(variable, command, error)),)
        is_notify = isinstance(command, ca.ReadNotifyRequest)
        count = variable.length(values)
        return (channel.read(values, command.ioid, command.data_type, count, 1, metadata=metadata, notify=is_notify),)

    async def _write(self, command: Any) -> Iterable[Any]:
        channel, variable = self._channel(command.sid)
        if len(self._puts) >= MOST_PUTS:
            return (self._refusal(command, channel, Refused(ca.CAStatus.ECA_PUTFAIL, "too many puts wait")),)
        task = asyncio.create_task(self._put(command, channel, variable), name="dpstack epics: a put")
        self._puts[task] = variable
        task.add_done_callback(self._end_put)
        await asyncio.sleep(0)  # it comes before the requests behind it
        return ()

    async def _monitor(self, command: Any) -> Iterable[Any]:
        if len(self._monitors) >= MOST_CHANNELS:
            raise _BrokenError(f"it has more than {MOST_CHANNELS} monitors")
        channel, variable = self._channel(command.sid)
        number = command.subscriptionid
        try:
            await self._values(variable, command)
        except _CONVERSION as error:
            self._core.event_add_commands.pop(number, None)
            return (self._error(command, channel, _not_as(variable, command, error)),)
        self._forget_monitor(number)  # the client has given its number away again
        monitor = self._monitors[number] = _Monitor(channel, variable, command)
        alarms_only = command.mask == ca.SubscriptionType.DBE_ALARM
        if command.mask != ca.SubscriptionType.DBE_PROPERTY:  # nothing of that changes while the variable is there
            variable.watchers[self._key(monitor)] = lambda alarm: (
                self._mark(number) if alarm or not alarms_only else None
            )
        self._mark(number)
        return ()

    async def _cancel(self, command: Any) -> Iterable[Any]:
        monitor = self._forget_monitor(command.subscriptionid)
        if monitor is None:
            return ()
        return (monitor.channel.unsubscribe(command.subscriptionid, command.data_type, monitor.request.data_count),)

    async def _events_off(self, command: Any) -> Iterable[Any]:
        self._events.clear()
        return ()

    async def _events_on(self, command: Any) -> Iterable[Any]:
        self._events.set()
        return ()

    async def _clear(self, command: Any) -> Iterable[Any]:
        channel, _ = self._channel(command.sid)
        self._forget(command.sid)
        return (channel.clear(),)

    _ANSWERS: Final[dict[type, Callable[[Circuit, Any], Awaitable[Iterable[Any]]]]] = {
        ca.VersionRequest: _version,
        ca.EchoRequest: _echo,
        ca.HostNameRequest: _host,
        ca.ClientNameRequest: _client,
        ca.SearchRequest: _search,
        ca.CreateChanRequest: _create,
        ca.ReadRequest: _read,
        ca.ReadNotifyRequest: _read,
        ca.WriteRequest: _write,
        ca.WriteNotifyRequest: _write,
        ca.EventAddRequest: _monitor,
        ca.EventCancelRequest: _cancel,
        ca.EventsOffRequest: _events_off,
        ca.EventsOnRequest: _events_on,
        ca.ClearChannelRequest: _clear,
    }

    # --- puts -----------------------------------------------------------------------------------------------------

    def _end_put(self, task: asyncio.Task[None]) -> None:
        del self._puts[task]
        if not task.cancelled() and (error := task.exception()) is not None:  # its answer has no place any more
            self._report(error)
            self._writer.transport.abort()

    async def _put(self, command: Any, channel: Any, variable: Variable) -> None:
        refused = await self._judge(variable, command)
        if self._core.channels_sid.get(command.sid) is not channel:
            return  # it was closed meanwhile
        if refused is not None:
            self._send(self._refusal(command, channel, refused))
        elif isinstance(command, ca.WriteNotifyRequest):
            for number, monitor in tuple(self._monitors.items()):  # a client has the new value when its put ends
                if monitor.variable is variable and number in self._news and self._events.is_set():
                    del self._news[number]
                    await self._send_value(monitor)
            self._send(channel.write(command.ioid, command.data_type, command.data_count, 1))

    async def _judge(self, variable: Variable, command: Any) -> Refused | None:
        # Channel Access proves neither the name of the user nor that of the computer
        who = f"{self.address}, which says it is {self._user!r}" if self._user else self.address
        if not self._plant.may_put(variable):
            reason = "it is not in allow_commands" if variable.pv.node.order else "it can only be read"
            self._plant.refuse(variable, reason, who)
            return Refused(ca.CAStatus.ECA_NOWTACCESS, reason)
        try:
            value = variable.given(command.data, command.data_type)
        except (ValueError, TypeError, OverflowError) as error:
            self._plant.refuse(variable, str(error), who)
            return Refused(ca.CAStatus.ECA_PUTFAIL, str(error))
        return await self._plant.put(variable, value, who)

    def _refusal(self, command: Any, channel: Any, refused: Refused) -> Any:
        self._core._ioids.pop(command.ioid, None)  # caproto waits for another answer
        return self._error(command, channel, refused)

    def _error(self, command: Any, channel: Any, refused: Refused) -> Any:
        return ca.ErrorResponse(command, channel.cid, refused.status, cut(refused.reason, _MOST_REASON))

    # --- channels -------------------------------------------------------------------------------------------------

    def _channel(self, sid: int) -> tuple[Any, Variable]:
        return self._core.channels_sid[sid], self._variables[sid]

    def _forget(self, sid: int) -> None:
        self._variables.pop(sid, None)
        for number, monitor in tuple(self._monitors.items()):
            if monitor.channel.sid == sid:
                self._forget_monitor(number)
                self._core.event_add_commands.pop(number, None)  # caproto keeps them

    def _forget_monitor(self, number: int) -> _Monitor | None:
        monitor = self._monitors.pop(number, None)
        self._news.pop(number, None)
        if monitor is not None:
            monitor.variable.watchers.pop(self._key(monitor), None)
        return monitor

    def _key(self, monitor: _Monitor) -> object:
        return id(self), monitor.request.subscriptionid
