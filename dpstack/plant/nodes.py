"""The nodes of a bus and of a slave with type, unit, scale and dead band; the orders that they take.

Everything comes from the item ``plant`` of a live stream, which somebody else has made: texts are cut, counts bounded.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from enum import StrEnum
from typing import Final

from dpstack.plant.items import PPI, FieldPlant, Plant, SlavePlant
from dpstack.plant.judge import STATES
from dpstack.plant.orders import Argument, DriveOrder, Operation, SetCpuValues, SetOutputs
from dpstack.plant.quality import BOOL, BYTES, COUNT, FLOAT, LIMITS, TEXT, TYPES, Value, base_type, clean, value_of

#: kinds of an order that sets named outputs
_Setting = type[SetOutputs]

#: named values of one slave: its 244 octets of inputs and of outputs have this many bits
MOST_FIELDS: Final = 2 * 244 * 8
#: nodes of a plant; the fields beyond them are left out
MOST_NODES: Final = 50_000
#: digits behind the point that are shown
_MOST_DIGITS: Final = 6
#: characters of a name
_MOST_NAME: Final = 120


class Kind(StrEnum):
    BUS = "bus"
    SLAVE = "slave"
    DRIVE = "drive"
    VALUE = "value"
    DIAGNOSIS = "diagnosis"
    STATISTIC = "statistic"


class Source(StrEnum):
    """The part of the stream that gives the value of a node; the rule for its quality depends on it."""

    MASTER = "master"  # what the master knows by itself: valid as long as the bus and its stream run
    INPUT = "input"
    OUTPUT = "output"
    DRIVE = "drive"


@dataclass(frozen=True, slots=True)
class OfferedOrder:
    """An order that a connector may give to the run: it sets ``output``, a named output of ``slave``, or is an
    ``operation`` of its drive. ``name``: ``SLAVE.NAME``, as ``allow_commands`` lists it; ``type``: of its
    argument, None: it has none; ``sets``: kind of the order that sets ``output``."""

    name: str
    slave: int
    output: str = ""
    operation: Operation | None = None
    type: str | None = None
    sets: _Setting = SetOutputs

    def argument(self, value: Value) -> Argument | None:
        """``value`` as an argument of this order. Raises ValueError if it has another type; an order without an
        argument takes None and True."""
        if self.type is None:
            if value is not None and value is not True:
                raise ValueError(f"{self.name} takes true, not {clean(repr(value))}")
            return None
        given = value_of(value, self.type)
        if given is None or isinstance(given, str):
            raise ValueError(f"{self.name} takes {self.type}, not {clean(repr(value))}")
        return given

    def typed(self, argument: Argument | None = None) -> SetOutputs | DriveOrder:
        """This order with a result of :meth:`argument`."""
        if self.operation is not None:
            return DriveOrder(self.slave, self.operation, argument)
        assert argument is not None, "an output has a value"
        return self.sets(self.slave, {self.output: argument})


@dataclass(frozen=True, slots=True)
class Node:
    """One value of the tree. ``id``: stable, with the address of the slave and not its name. ``path``: the names for
    people below the bus or the slave, as given; :mod:`dpstack.bridge.names` makes them valid for a connector.

    ``low`` and ``high``: range in ``unit``, None if it is not known. ``dead_band``: changes up to so much, in
    ``unit``, are no news. ``order``: the order that sets it, None: it can only be read.
    """

    id: str
    kind: Kind
    source: Source
    path: tuple[str, ...]
    type: str
    slave: int | None = None
    unit: str = ""
    scale: float = 1
    offset: float = 0
    low: float | None = None
    high: float | None = None
    dead_band: float = 0
    order: OfferedOrder | None = None
    text: str = ""
    #: key of the value: of ``bus`` or of a slave in a snapshot, and further keys in it
    keys: tuple[str, ...] = ()
    #: all values of a text that is a state; a newer version of the stream may have others
    states: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Described:
    """A slave, or the bus, as the plant describes it. ``left_out``: the number of its fields that do not fit."""

    name: str
    nodes: tuple[Node, ...]
    orders: tuple[OfferedOrder, ...] = ()
    about: Mapping[str, str] = field(default_factory=dict)
    watchdog_ms: float = 0.0
    left_out: int = 0


#: counters of a slave by their key in the live stream
SLAVE_COUNTERS: Final[Mapping[str, str]] = {
    "exchanges": "Data_Exchange with valid answers",
    "telegrams": "telegrams to and from the slave",
    "retries": "repeated requests to the slave",
    "timeouts": "requests that the slave did not answer",
    "late": "answers of the slave after the slot time",
    "wrong": "answers of a kind that does not fit the request",
}
_ALARM_COUNTS: Final = ("raised", "acknowledged", "repeated", "refused", "too_many", "dropped", "not_enabled")
#: states of a drive by their numbers, with those of dpstack.profile (tests compare them)
DRIVE_STATES: Final = (
    "offline", "unknown", "not_ready", "switch_on_inhibited", "ready_to_switch_on", "ready", "running", "stopping",
    "quick_stop", "fault_reaction", "fault",
)  # fmt: skip
#: modes of a master
MODES: Final = ("offline", "stop", "clear", "operate")
#: quantities of a drive: name, type, unit, dead band, text
_DRIVE: Final[Sequence[tuple[str, str, str, float, str]]] = (
    ("state", TEXT, "", 0, "state of the drive by the common names of dpstack"),
    ("running", BOOL, "", 0, ""),
    ("reached", BOOL, "", 0, "the set point is reached"),
    ("remote", BOOL, "", 0, "the drive follows the bus"),
    ("setpoint", FLOAT, "", 0.001, "part of the reference: 1.0 is 100 %"),
    ("speed", FLOAT, "", 0.001, "part of the reference: 1.0 is 100 %"),
    ("frequency_hz", FLOAT, "Hz", 0.05, ""),
    ("current", FLOAT, "", 0.005, "part of the rated current"),
    ("torque", FLOAT, "", 0.005, "part of the rated torque"),
    ("faults", TEXT, "", 0, "faults by name"),
    ("warnings", TEXT, "", 0, "warnings by name"),
    ("settings", TEXT, "", 0, "comparison of the drive's settings with those that its plugin relies on"),
)
#: orders to a drive, with the type of their argument
_DRIVE_ORDERS: Final[Sequence[tuple[Operation, str | None]]] = (
    ("start", None),
    ("stop", None),
    ("quick_stop", None),
    ("coast", None),
    ("acknowledge", None),
    ("speed", FLOAT),
)
_BUS_STATISTICS: Final = (
    "rotations",
    "telegrams",
    "sent",
    "retries",
    "timeouts",
    "late",
    "stray",
    "garbled",
    "tokens",
    "tokens_lost",
    "token_retries",
    "gap_polls",
)
_OF_FIXED_CYCLE: Final = ("missed", "left_out")
#: they separate slave, name and value in an order
_NOT_IN_ORDERS: Final = frozenset(".=")


def bus_of(plant: Plant) -> Described:
    """The nodes of the bus itself. Those of the fixed cycle are there if the plant has one."""
    about = {key: clean(str(getattr(plant, key))) for key in ("port", "baud", "driver", "address", "config_digest")}
    fixed = plant.plan is not None and plant.plan.cycle_us is not None
    return Described(about["port"], tuple(_bus_nodes(fixed=fixed)), about=about)


def _bus_nodes(*, fixed: bool) -> Iterator[Node]:
    def node(kind: Kind, path: tuple[str, ...], type_: str, *keys: str, unit: str = "", text: str = "") -> Node:
        id_, band = f"bus/{'/'.join(keys)}", 1 if unit else 0
        states = MODES if keys == ("mode",) else ()
        return Node(
            id_, kind, Source.MASTER, path, type_, unit=unit, dead_band=band, text=text, keys=keys, states=states
        )

    yield node(Kind.BUS, ("Mode",), TEXT, "mode", text="offline, stop, clear or operate")
    yield node(Kind.BUS, ("In ring",), BOOL, "in_ring", text="the master is in the token ring")
    yield node(Kind.BUS, ("Masters",), TEXT, "masters", text="addresses of the masters in the ring")
    yield node(Kind.BUS, ("Clear",), TEXT, "clear", text="reason of a Clear that the master went to by itself")
    for name in (*_BUS_STATISTICS, *(_OF_FIXED_CYCLE if fixed else ())):
        yield node(Kind.STATISTIC, ("Statistics", name), COUNT, name)
    for name in ("rotation_us", "token_us", "host_us", *(("late_us",) if fixed else ())):
        for point in ("p50", "p99", "max"):
            yield node(Kind.STATISTIC, ("Statistics", name, point), FLOAT, name, point, unit="us")
    yield node(Kind.STATISTIC, ("Statistics", "behind"), FLOAT, "behind_ms", unit="ms", text="lag of a simulated bus")


def slave_of(address: int, plant: SlavePlant, *, writable: bool, room: int = MOST_NODES) -> Described:
    """The nodes and orders of the slave at ``address``, ``plant`` its part of the plant. ``writable``: the run takes
    orders. ``room``: named values at most."""
    name = _name(plant.name) or f"slave {address}"
    own = f"slave/{address}"
    nodes = [*_own_nodes(own, address, read_only=not writable, dpv1=plant.dpv1 is True)]
    orders: list[OfferedOrder] = []
    drive = plant.drive
    sets = SetCpuValues if plant.protocol == PPI else SetOutputs
    taken: set[str] = set()
    left_out = 0
    for source, fields, group in ((Source.INPUT, plant.inputs, "Inputs"), (Source.OUTPUT, plant.outputs, "Outputs")):
        for number, given in enumerate(fields or ()):
            node = _field_node(own, address, source, group, given)
            if node is None or node.keys[-1] in taken or number >= MOST_FIELDS or room <= 0:
                left_out += 1
                continue
            room -= 1
            taken.add(node.keys[-1])
            # the outputs of a drive are made by its plugin
            if writable and drive is None and (order := _order_of(node, name, sets)) is not None:
                orders.append(order)
                node = replace(node, order=order)
            nodes.append(node)
    about = {key: clean(getattr(plant, key)) for key in ("ident", "vendor", "model", "gsd")}
    if drive is not None:
        nodes += _drive_nodes(own, address)
        about |= {"profile": clean(drive.profile), "telegram": clean(drive.telegram)}
        if writable:
            orders += (
                OfferedOrder(f"{name}.{word}", address, operation=word, type=type_) for word, type_ in _DRIVE_ORDERS
            )
    return Described(name, tuple(nodes), tuple(orders), about, plant.watchdog_ms or 0.0, left_out)


def digits_of(node: Node, default: int) -> int:
    """Digits behind the point of a number that mean something; ``default`` if neither scale nor dead band says it."""
    if node.scale != 1 or node.offset != 0:
        steps = [abs(node.scale), abs(node.offset)]
    elif node.dead_band:
        steps = [node.dead_band]
    else:
        return default
    exponents = [Decimal(repr(float(step))).normalize().as_tuple().exponent for step in steps if step]
    return min(max(0, *(-one for one in exponents if isinstance(one, int))), _MOST_DIGITS)


def _name(given: object) -> str:
    return clean(given)[:_MOST_NAME]


def _own_nodes(own: str, address: int, *, read_only: bool, dpv1: bool) -> Iterator[Node]:
    def node(kind: Kind, path: tuple[str, ...], type_: str, *keys: str, unit: str = "", text: str = "") -> Node:
        states = tuple(STATES) if keys == ("state",) else ()
        id_ = f"{own}/{'/'.join(keys)}"
        return Node(id_, kind, Source.MASTER, path, type_, address, unit=unit, text=text, keys=keys, states=states)

    yield node(Kind.SLAVE, ("State",), TEXT, "state", text="state in which the master has the slave")
    yield node(Kind.SLAVE, ("Fault",), TEXT, "fault", text="why the slave is not in data exchange")
    yield node(Kind.SLAVE, ("Watchdog",), FLOAT, "watchdog_ms", unit="ms", text="0: off")
    if read_only:
        yield node(Kind.SLAVE, ("Master",), "u8", "master", text="address of its master")
    yield node(Kind.DIAGNOSIS, ("Diagnosis",), TEXT, "conspicuous", text="unusual flags and texts of the diagnosis")
    for name, text in SLAVE_COUNTERS.items():
        yield node(Kind.STATISTIC, ("Statistics", name), COUNT, name, text=text)
    for name in _ALARM_COUNTS if dpv1 else ():
        yield node(Kind.STATISTIC, ("Statistics", "alarms", name), COUNT, "alarms", name)


def _drive_nodes(own: str, address: int) -> Iterator[Node]:
    for name, type_, unit, band, text in _DRIVE:
        keys = ("drive", name)
        yield Node(
            f"{own}/drive/{name}",
            Kind.DRIVE,
            Source.DRIVE,
            ("Drive", name),
            type_,
            address,
            unit=unit,
            dead_band=band,
            text=text,
            keys=keys,
            states=DRIVE_STATES if name == "state" else (),
        )


def _order_of(node: Node, slave: str, sets: _Setting) -> OfferedOrder | None:
    """The order that sets the named output ``node``; None for an input, and for a name or type that no order has."""
    name = node.keys[-1]
    if node.slave is None or node.source is not Source.OUTPUT or node.type == TEXT or set(name) & _NOT_IN_ORDERS:
        return None
    return OfferedOrder(f"{slave}.{clean(name)}", node.slave, output=name, type=node.type, sets=sets)


def _field_node(own: str, address: int, source: Source, group: str, given: FieldPlant) -> Node | None:
    """The node of a named value; None for one without a name or of an unknown type."""
    name, raw = given.name, _type(given)
    if not name or len(name) > _MOST_NAME or raw not in TYPES:
        return None
    scale, offset = _number(given.scale, 1), _number(given.offset, 0)
    scaled = scale != 1 or offset != 0
    low, high = LIMITS.get(raw, (None, None))
    ends = None if low is None or high is None else sorted((low * scale + offset, high * scale + offset))
    type_ = FLOAT if scaled and raw not in (BOOL, BYTES, TEXT) else raw
    return Node(
        f"{own}/{source}/{name}",
        Kind.VALUE,
        source,
        (group, clean(name)),
        type_,
        address,
        unit=clean(given.unit)[:_MOST_NAME],
        scale=scale,
        offset=offset,
        low=None if ends is None else ends[0],
        high=None if ends is None else ends[1],
        dead_band=abs(_number(given.dead_band, 0)),
        text=clean(given.at),
        keys=("fields", name),
    )


def _type(given: FieldPlant) -> str:
    """The type of a field: ``type``, or that in front of ``at``. A recording calls every number so."""
    raw = base_type(given.at) if given.type is None else given.type
    return FLOAT if raw == "number" else raw


def _number(given: float | None, default: float) -> float:
    """A whole number as one: so 3 does not become 3.0."""
    if given is None:
        return default
    return int(given) if float(given).is_integer() else given
