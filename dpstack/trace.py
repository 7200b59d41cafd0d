"""Base classes of events for the application, and the wire log of telegrams.

Nothing here decodes or prints protocol: :mod:`dpstack.decode.wire_log` renders a wire log for people.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from enum import Enum
from typing import Any, ClassVar, NamedTuple, dataclass_transform

from msgspec import Struct, StructMeta

from dpstack.text import printable
from dpstack.units import NS_PER_S


class Severity(Enum):
    """Severity of a message for people."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"

    @property
    def rank(self) -> int:
        """A greater number is worse."""
        return tuple(Severity).index(self)


class _EventMeta(StructMeta):
    """Makes derived classes that take keyword arguments only, as :class:`Event` does."""

    def __new__(cls, name: str, bases: tuple[type, ...], namespace: dict[str, Any], **config: Any) -> _EventMeta:
        return super().__new__(cls, name, bases, namespace, **{"kw_only": True, **config})


@dataclass_transform(frozen_default=True, kw_only_default=True)
class Event(Struct, metaclass=_EventMeta, frozen=True):
    """Something happened at ``t_ns`` (the machine's time). Layers derive their own events from this one.

    A derived class is immutable, with keyword arguments, by itself. It has a ``TEMPLATE`` of its :attr:`text`, in which
    ``{e.name}`` stands for an attribute of the event, or ``_text()`` if the words depend on the attributes. Two events
    are equal if all attributes but ``wall_ns`` are.
    """

    #: pattern of :attr:`text`; ``{e.name}`` stands for an attribute of the event
    TEMPLATE: ClassVar[str]
    #: :attr:`must_arrive` of the class
    MUST_ARRIVE: ClassVar[bool] = False
    #: :attr:`severity` of the class
    SEVERITY: ClassVar[Severity] = Severity.INFO

    #: the machine's time at which it happened, in ns
    t_ns: int
    #: wall clock (ns since 1970, UTC) at ``t_ns``; None until the bus hands the event to its application
    wall_ns: int | None = None

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self._told() == other._told()

    def __hash__(self) -> int:
        return hash((type(self), self._told()))

    def __repr__(self) -> str:
        names = (name for name in self.__struct_fields__ if name != "wall_ns")
        return f"{type(self).__name__}({', '.join(f'{name}={getattr(self, name)!r}' for name in names)})"

    def _told(self) -> tuple[object, ...]:
        return tuple(getattr(self, name) for name in self.__struct_fields__ if name != "wall_ns")

    @property
    def text(self) -> str:
        """One line for people: what happened, and what to do if something is to be done. Names out of files and from
        devices are printable in it (:mod:`dpstack.text`); other attributes are as the file or the device has them."""
        return printable(self._text())

    def _text(self) -> str:
        return self.TEMPLATE.format(e=self)

    @property
    def severity(self) -> Severity:
        """WARNING: somebody should look at it; ERROR: outputs or inputs of the plant are concerned."""
        return self.SEVERITY

    @property
    def time(self) -> datetime | None:
        """The wall clock (UTC) at which it happened; None until the bus hands the event to its application."""
        return None if self.wall_ns is None else datetime.fromtimestamp(self.wall_ns / NS_PER_S, UTC)

    @property
    def must_arrive(self) -> bool:
        """True for the answer to a command that a caller waits for: a driver must not drop it."""
        return self.MUST_ARRIVE


class Notice(Event):
    """A remark worth one line that has no type of its own. ``source`` names the layer or the station."""

    #: layer or station that the remark comes from
    source: str
    #: the remark, one line
    message: str
    #: how much it matters
    severity: Severity = Severity.INFO

    TEMPLATE = "{e.source}: {e.message}"

    def details(self) -> dict[str, object]:
        """More about it for programs, as JSON values."""
        return {}


class WireEntry(NamedTuple):
    """One transmission on the wire: octets as sent, first start edge, end of the last stop bit, remarks.

    ``sender``: name or address of the station; None if it is unknown.
    """

    start_ns: int
    end_ns: int
    octets: bytes
    sender: str | None = None
    note: str = ""


#: of a :class:`WireEntry`, in its order
WireFields = tuple[int, int, bytes, str | None, str]
#: judges transmissions that begin with these fields, the oldest first: puts one with a remark into the place of its own
Judge = Callable[[list[Any]], None]


class WireLog:
    """The last ``keep`` transmissions, and a listener for all of them (a capture). Cheap when nobody listens or reads:
    it is handed the fields of a :class:`WireEntry` and makes the entry for a reader.

    With :meth:`judged_by` or :meth:`hand_to` the transmissions of :attr:`add_plain` wait for it, until somebody reads,
    or calls :meth:`settle`; with a listener none waits.
    """

    def __init__(self, keep: int = 400, listener: Callable[[WireEntry], None] | None = None) -> None:
        self.keep = keep
        self._entries: deque[WireFields] = deque(maxlen=keep)
        #: the transmissions that wait
        self.waiting: list[Any] = []
        #: a judge needs more than the fields in :attr:`add_plain`
        self.is_judged = False
        self._judge: Judge | None = None
        self._take: Callable[[list[WireFields]], None] | None = None
        self.listener = listener

    def judged_by(self, judge: Judge) -> None:
        """Hand the transmissions of :attr:`add_plain` to ``judge``."""
        self.settle()
        self._judge, self.is_judged = judge, True
        self._bind()

    @property
    def listener(self) -> Callable[[WireEntry], None] | None:
        return self._listener

    @listener.setter
    def listener(self, listener: Callable[[WireEntry], None] | None) -> None:
        self.settle()
        self._listener = listener
        self._take = None
        self._bind()

    def hand_to(self, take: Callable[[list[WireFields]], None]) -> None:
        """Call ``take`` instead of the listener: it gets lists of the fields, and makes entries of what somebody
        reads."""
        self.settle()
        self._listener = None
        self._take = take
        self._bind()

    def settle(self) -> None:
        """Have the transmissions judged, and hand them out, that wait."""
        if self.waiting:
            batch = self.waiting.copy()
            self.waiting.clear()
            if self._judge is not None:
                self._judge(batch)
                wanted = batch if self._take is not None else batch[-self.keep :]
                batch = [fields[:5] for fields in wanted]  # plain values are nothing for the garbage collection
            self._entries.extend(batch)
            if self._take is not None:
                self._take(batch)

    def _bind(self) -> None:
        listens, append = self._listener is not None, self._entries.append
        #: appends an entry, dropping the oldest one when full; the deque's own method while nobody listens
        self.add: Callable[[Any], None] = self._add_and_tell if listens or self._take is not None else append
        #: the same for an entry that the judge has not seen; if :attr:`is_judged`, with what it needs behind the fields
        self.add_plain: Callable[[Any], None] = self._judge_and_tell if listens else append
        if not listens and (self._judge is not None or self._take is not None):
            self.add_plain = self.waiting.append

    def _judge_and_tell(self, plain: Any) -> None:
        batch = [plain]
        if self._judge is not None:
            self._judge(batch)
        self._add_and_tell(batch[0][:5])

    def _add_and_tell(self, fields: WireFields) -> None:
        self._entries.append(fields)
        if self._listener is not None:
            self._listener(WireEntry._make(fields))
        elif self._take is not None:
            self._take([fields])

    def __iter__(self) -> Iterator[WireEntry]:
        self.settle()
        return map(WireEntry._make, self._entries)

    def __len__(self) -> int:
        self.settle()
        return len(self._entries)
