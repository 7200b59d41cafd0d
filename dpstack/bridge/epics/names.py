"""The process variables of a tree by name: ``PREFIX`` ``SLAVE:in:NAME``, ``SLAVE:drive:speed``, ``bus:mode``.

An EPICS name has 60 characters at most (the size of a record's name in EPICS base since 3.14). A longer one is an error
of the configuration; it is not cut, as nobody would find it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple

from dpstack.bridge.names import EPICS_PART, unique_names
from dpstack.errors import ConfigError
from dpstack.plant.nodes import Described, Kind, Node, OfferedOrder

#: characters of a name
MOST_NAME: Final = 60
#: the longest prefix: names need some room behind it
_MOST_PREFIX: Final = 40
_PREFIX: Final = re.compile(rf"[{re.escape(EPICS_PART.only)}:]+")
#: short names of the groups of a slave
GROUPS: Final[Mapping[str, str]] = {"Inputs": "in", "Outputs": "out", "Drive": "drive", "Statistics": "stat"}
#: the group of the orders of a drive
ORDERS: Final = "cmd"
#: the node that shows the effect of an order: its value for a set point, its quality for all
_SHOWS: Final[Mapping[str, str]] = {"speed": "setpoint"}


class Pv(NamedTuple):
    """A process variable. It shows ``node``; one of an order without a value shows whether that node is good, and 0.
    ``order``: the order that a put gives, None: it can only be read."""

    name: str
    node: Node
    order: OfferedOrder | None = None

    @property
    def is_button(self) -> bool:
        """Whether a put of 1 gives the order, which has no argument."""
        return self.order is not None and self.order.type is None


class PvNames(NamedTuple):
    """Process variables by name. ``changed``: one line for each name that is not the one given; ``too_long``: names
    with more than :data:`MOST_NAME` characters."""

    pvs: Mapping[str, Pv]
    changed: tuple[str, ...]
    too_long: tuple[str, ...]


def check_prefix(prefix: str) -> None:
    """Raises ConfigError for a prefix that is not part of an EPICS name."""
    if not _PREFIX.fullmatch(prefix) or len(prefix) > _MOST_PREFIX:
        raise ConfigError(
            f"prefix {prefix!r} cannot begin an EPICS name; write at most {_MOST_PREFIX} of letters, digits and "
            f'_ - + : [ ] < > ;, for instance prefix = "DP:"'
        )


def pvs_of(
    prefix: str, bus: Sequence[Node], slaves: Mapping[int, Described], takes: Callable[[OfferedOrder], bool]
) -> PvNames:
    """All process variables, those of ``slaves`` by address. ``takes``: whether an order may be given; an order of a
    drive that may not has none."""
    found = unique_names(EPICS_PART, [("bus", "bus"), *((f"slave {at}", one.name) for at, one in slaves.items())])
    changed = list(found.changed)
    pvs: dict[str, Pv] = {}
    too_long: list[str] = []
    parts: list[Pv] = list(_of_branch("bus", bus, (), changed, takes))
    for address, one in slaves.items():
        parts += _of_branch(found.names[f"slave {address}"], one.nodes, one.orders, changed, takes)
    for part in parts:
        name = prefix + part.name
        if len(name) > MOST_NAME:
            too_long.append(name)
        else:
            pvs[name] = part._replace(name=name)
    return PvNames(pvs, tuple(changed), tuple(too_long))


def check_lengths(names: PvNames) -> None:
    """Raises ConfigError with the longest name, if one is too long."""
    if names.too_long:
        name = max(names.too_long, key=len)
        more = f", and {len(names.too_long) - 1} more are too long" if len(names.too_long) > 1 else ""
        raise ConfigError(
            f"{name} has {len(name)} characters, and an EPICS name at most {MOST_NAME}{more}; "
            f"give a shorter prefix, slave or value name"
        )


def _of_branch(
    own: str,
    nodes: Sequence[Node],
    orders: Iterable[OfferedOrder],
    changed: list[str],
    takes: Callable[[OfferedOrder], bool],
) -> Iterator[Pv]:
    groups: dict[tuple[str, ...], list[tuple[str, str]]] = {}
    for node in nodes:
        groups.setdefault(node.path[:-1], []).append((node.id, _label(node)))
    names: dict[str, str] = {}
    for group in groups.values():
        found = unique_names(EPICS_PART, group)
        names.update(found.names)
        changed += found.changed
    drive = {node.keys[-1]: node for node in nodes if node.kind is Kind.DRIVE}
    for node in nodes:
        folder = [GROUPS.get(part, EPICS_PART.valid(part)) for part in node.path[:-1]]
        order = node.order if node.order is not None and takes(node.order) else None
        yield Pv(":".join((own, *folder, names[node.id])), node, order)
    for order in orders:
        if order.operation is not None and takes(order):
            shown = drive[_SHOWS.get(order.operation, "state")]
            yield Pv(f"{own}:{ORDERS}:{order.operation}", shown, order)


def _label(node: Node) -> str:
    """Names of dpstack are small letters without spaces; those of the user stay as they are."""
    return node.path[-1] if node.kind is Kind.VALUE else node.path[-1].lower().replace(" ", "_")
