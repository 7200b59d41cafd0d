"""Messages between a bus process and its application: JSON with a length in front, never pickle.

The application sends a :class:`Question`, the bus process :class:`News`. Orders, events and everything inside them are
classes of plain values (msgspec's, some dataclasses); msgspec writes them and reads them back by their type hints. A
value that can be of several classes stands as a pair of the class's name and its fields.
"""

from __future__ import annotations

import contextlib
import functools
import socket
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Final, Generic, TypeVar

import msgspec
from msgspec import Struct, field

from dpstack import errors
from dpstack.dp.master.fixed_cycle import CycleData
from dpstack.dp.master.settings import StackSpec
from dpstack.dp.slave_params import DriveTelegrams
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.process.plugins import AttachPlugin
from dpstack.drivers.snapshots import BusSnapshot, SlaveSnapshot
from dpstack.drivers.tap import Tapped
from dpstack.errors import BusError, DpError
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.machine import Order
from dpstack.trace import Event
from dpstack.units import NEVER

if TYPE_CHECKING:
    import asyncio

    from dpstack.drivers.line.select_loop import SelectLoop

T = TypeVar("T")

#: longest message that is accepted; the longest one sent is a set-up of 125 slaves
MAX_MESSAGE: Final = 4 * 1024 * 1024
_LENGTH: Final = 4
#: beyond this events are dropped (and counted) until somebody reads again
FULL: Final = 256 * 1024
_LAST_WORDS_S: Final = 0.5
_CHUNK: Final = 65_536

#: a class by name, and the fields of one of its objects
Named = tuple[str, object]


# --- orders of the application that no machine knows ----------------------------------------------------------------


class SetUp(Order):
    """The first message: all data that the bus process needs.

    ``ctrl_z``: the application decides about Ctrl-Z, which must not stop the bus process by itself. ``echo``, ``tune``:
    as :class:`dpstack.drivers.line.asyncio_runtime.AsyncioRuntime` has them. ``cpus``: the processors of the bus
    process, empty for all that it may run on.
    """

    port: str
    event_char: bool
    rs485: bool
    echo: Echo
    tune: bool
    stack: StackSpec
    plugins: tuple[AttachPlugin, ...] = ()
    ctrl_z: bool = False
    cpus: tuple[int, ...] = ()


class TakeOutputs(Order):
    """Read the outputs that the application has published; the answer comes after that."""


class LoadServices(Order):
    """Load the acyclic services and construct for their PDUs, beside the running bus; the answer comes after that."""


class LoadFdl(Order):
    """Load the FDL services, whose orders follow, beside the running bus; the answer comes after that."""


class ReadHistory(Order):
    """The answer is the :class:`~dpstack.dp.master.bring_ups.History` of the slave at ``address``."""

    address: int


class CloseBus(Order):
    """Release the port and end the process, after the end of the bus. The answer is the last :class:`Counters`."""

    ENDS = True


# --- messages of the bus process -------------------------------------------------------------------------------------


class Hello(Struct, frozen=True):
    port_name: str
    paced: bool


class Answer(Struct):
    """The answer to the question ``number``: an error (class, text), or a value."""

    number: int
    error: tuple[str, str] | None = None
    value: object = None


class News(Struct):
    """Events in order, the state after them, then an ``answer``. Parts of the state that did not change are left out.

    ``round_over``: a round ended, ``cycle`` is its data (sent while the application watches the rounds). ``over``: the
    reason of the end, in the last message; ``defect``: the machine failed (a defect of dpstack, no memory),
    ``cleared``: Clear was sent all the same. ``silence``: the bus process answers that it is alive to an application
    that found it silent for the so-many-th time; everything of the state is in this message. ``dropped``: outputs that
    came too late, by address with their ``until_ns``. ``tapped``: octets on the line, in a message of their own;
    ``tap_lost``: number of entries lost directly before them.
    """

    bus: BusSnapshot | None = None
    slaves: dict[int, SlaveSnapshot] = field(default_factory=dict)
    events: list[Named] = field(default_factory=list)
    answer: Answer | None = None
    round_over: bool = False
    cycle: CycleData | None = None
    over: str | None = None
    defect: bool = False
    cleared: bool = False
    silence: int = 0
    dropped: dict[int, int] = field(default_factory=dict)
    tapped: list[Tapped] = field(default_factory=list)
    tap_lost: int = 0


class Question(Struct):
    """An order with a number that its answer carries. The bus process drops it if it does not take it before
    ``until_ns`` (CLOCK_MONOTONIC)."""

    number: Annotated[int, msgspec.Meta(ge=0, le=(1 << 63) - 1)]
    order: Named
    until_ns: int = NEVER


# --- the codec -------------------------------------------------------------------------------------------------------


def _plain(value: object) -> object:
    """Encode types that msgspec does not know. Texts of a GSD file and of a drive plugin stay in the application (see
    ``client``)."""
    if isinstance(value, DiagTexts | DriveTelegrams):
        return None
    raise TypeError(f"{type(value).__name__} does not go to another process")


def _strange(kind: type, value: object) -> object:
    if kind is object:  # plain JSON data
        return value
    raise TypeError(f"{kind} does not come from another process")


_encoder: Final = msgspec.json.Encoder(enc_hook=_plain)


@contextlib.contextmanager
def _readable(what: str) -> Iterator[None]:
    """Raises BusError for octets that msgspec cannot read, for text that is no UTF-8 and for too deep nesting."""
    try:
        yield
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise BusError(f"{what} cannot be read: {error}") from None


def framed(message: Question | News) -> bytes:
    """The octets of one message. Raises TypeError for what is not plain data."""
    octets = _encoder.encode(message)
    return len(octets).to_bytes(_LENGTH, "big") + octets


class Frames(Generic[T]):
    """Cuts the octets of a socket into messages of ``kind``."""

    def __init__(self, kind: type[T]) -> None:
        self._decoder = msgspec.json.Decoder(kind, dec_hook=_strange)
        self._rest = bytearray()

    def feed(self, octets: bytes) -> Iterator[T]:
        """The messages that are complete now. Raises BusError for octets that are no message."""
        rest = self._rest
        rest += octets
        while len(rest) >= _LENGTH:
            length = int.from_bytes(rest[:_LENGTH], "big")
            if length > MAX_MESSAGE:
                raise BusError(f"a message of {length} octets between bus process and application")
            if len(rest) < _LENGTH + length:
                return
            octets = bytes(rest[_LENGTH : _LENGTH + length])
            del rest[: _LENGTH + length]
            with _readable("a message between bus process and application"):
                message = self._decoder.decode(octets)
            yield message


#: buffer of :func:`received`, made once: a read only needs memory for the octets that have come
_received: Final = memoryview(bytearray(_CHUNK))


def received(sock: socket.socket) -> bytes | None:
    """The octets that ``sock`` has now: None without any yet, empty if the other process has hung up."""
    try:
        return bytes(_received[: sock.recv_into(_received)])
    except BlockingIOError:
        return None
    except OSError:
        return b""


class Outbox:
    """Messages on their way into ``sock``, in order. It never waits for the other process, which may not read."""

    def __init__(self, loop: asyncio.AbstractEventLoop | SelectLoop, sock: socket.socket) -> None:
        self._loop = loop
        self._sock = sock
        self._waiting = bytearray()
        self._watched = False

    @property
    def full(self) -> bool:
        """The other process does not read: only answers are still sent."""
        return len(self._waiting) > FULL

    @property
    def waiting(self) -> bool:
        """Octets were not taken yet."""
        return bool(self._waiting)

    def send(self, message: Question | News) -> None:
        """Put one message at the end; as much as the socket takes leaves at once."""
        self._waiting += framed(message)
        if not self._watched:
            self._flush()

    def _flush(self) -> None:
        waiting = self._waiting
        try:
            while waiting:
                del waiting[: self._sock.send(waiting)]
        except BlockingIOError:
            pass
        except OSError:  # the other process has gone; the reader of the socket learns of it
            waiting.clear()
        if bool(waiting) is not self._watched:
            self._watched = bool(waiting)
            if waiting:
                self._loop.add_writer(self._sock.fileno(), self._flush)
            else:
                self._loop.remove_writer(self._sock.fileno())

    def forget(self) -> None:
        """Drop the octets that were not taken yet."""
        self._waiting.clear()
        if self._watched:
            self._watched = False
            self._loop.remove_writer(self._sock.fileno())

    def close(self) -> None:
        """Send the rest within a time limit, then hang up."""
        if self._watched:
            self._loop.remove_writer(self._sock.fileno())
        with contextlib.suppress(OSError):
            self._sock.settimeout(_LAST_WORDS_S)
            self._sock.sendall(self._waiting)
        self._sock.close()


def typed(value: object, kind: type[T]) -> T:
    """``value`` as it came out of a message as an object of ``kind``. Raises BusError."""
    with _readable(kind.__name__):
        return msgspec.convert(value, kind, str_keys=True, dec_hook=_strange)


def named(thing: object) -> Named:
    """``thing`` with the name of its class."""
    return type(thing).__name__, thing


def order_of(named_order: Named) -> Order:
    """The order that :func:`named` was given. Raises BusError."""
    return _made(named_order, order_classes)


def event_of(named_event: Named) -> Event:
    """The event that :func:`named` was given. Raises BusError, also for one whose text cannot be made."""
    event = _made(named_event, event_classes)
    try:
        _ = event.text
    except Exception as error:
        raise BusError(f"{named_event[0]} cannot be read: {error}") from None
    return event


def _made(named_thing: Named, classes: functools._lru_cache_wrapper[dict[str, type[T]]]) -> T:
    name, fields = named_thing
    kind = classes().get(name)
    if kind is None:
        classes.cache_clear()  # the module of the class may have been loaded since
        kind = classes().get(name)
    if kind is None:
        raise BusError(f"{name!r} is nothing that bus process and application tell each other")
    return typed(fields, kind)


@functools.cache
def order_classes() -> dict[str, type[Order]]:
    """Every class of orders in the modules that are loaded, by name."""
    return {kind.__name__: kind for kind in _below(Order)}


@functools.cache
def event_classes() -> dict[str, type[Event]]:
    """All classes of events in the modules that are loaded, by name, without those that have no text: they are only
    bases of others."""
    found = (kind for kind in _below(Event) if hasattr(kind, "TEMPLATE") or kind._text is not Event._text)
    return {kind.__name__: kind for kind in found}


def _below(kind: type[T]) -> Iterator[type[T]]:
    for sub in kind.__subclasses__():
        if not getattr(sub, "__abstractmethods__", None):
            yield sub
        yield from _below(sub)


def error_pair(error: Exception) -> tuple[str, str]:
    """An exception as it goes in an :class:`Answer`; what is no DpError is a defect of ours."""
    if isinstance(error, DpError):
        return type(error).__name__, str(error)
    return BusError.__name__, f"a defect in dpstack, please report it: {type(error).__name__}: {error}"


def error_of(pair: tuple[str, str]) -> DpError:
    """The exception again: orders raise only those that carry a text and nothing else."""
    name, text = pair
    kind = getattr(errors, name, None)
    if not (isinstance(kind, type) and issubclass(kind, DpError)):
        return BusError(text)
    try:
        return kind(text)
    except (TypeError, DpError):  # it carries more, or something else
        return BusError(text)


def checked_arguments(args: Mapping[str, object]) -> dict[str, object]:
    """The arguments of a drive's order as JSON can carry them: what is no number there goes as text, to be refused."""
    return {key: _checked(value) for key, value in args.items()}


def _checked(value: object) -> object:
    """Lists and tables by their members."""
    match value:
        case list() | tuple():
            return [_checked(one) for one in value]
        case dict() if all(isinstance(key, str) for key in value):
            return {key: _checked(one) for key, one in value.items()}
    import json  # here, as orders with arguments are those of drives

    try:
        json.dumps(value, allow_nan=False, ensure_ascii=False).encode()
    except (TypeError, ValueError):  # bytes and objects; infinite numbers, text that is no UTF-8
        return repr(value)
    return value
