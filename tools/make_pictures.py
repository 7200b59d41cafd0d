"""Draws the pictures of the documents as Mermaid: rooms and their imports, and the tables of states.

Writes docs/reference/states.md, and in docs/development/architecture.md the block behind each ``<!-- picture: NAME
-->``, and for the book docs/pictures/NAME.svg (tools/draw_pictures.py). A test holds all to what this makes: no picture
is drawn by hand.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Final

from dpstack.dp.master import slave_states
from dpstack.dp.master.events import SlaveState
from dpstack.dp.slave import state_table
from dpstack.dpv1.slave import ms2_states
from dpstack.fdl.active import states as ring_states
from tools import draw_pictures
from tools.syntax import import_statements

ROOT: Final = Path(__file__).resolve().parent.parent
ARCHITECTURE: Final = ROOT / "docs" / "development" / "architecture.md"
STATES: Final = ROOT / "docs" / "reference" / "states.md"
RING: Final = ROOT / "docs" / "reference" / "fdl-states.md"
#: single modules that everything may import
_BASE: Final = "base"
#: public namespaces: they only gather names, and nothing of ours imports them
_NAMESPACES: Final = ("events", "slave")
_MARK: Final = re.compile(r"<!-- picture: ([\w-]+) -->\n(?:```mermaid\n.*?^```\n)?", re.DOTALL | re.MULTILINE)

Graph = dict[str, set[str]]


def imports(path: Path) -> Iterator[str]:
    """The names that ``path`` imports, also for type checking and inside functions."""
    for node in import_statements(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def room(module: str, deep: frozenset[str]) -> str | None:
    """The room of a module's dotted name: ``fdl``, or ``dp/master`` in one of the packages in ``deep``."""
    parts = module.split(".")
    if parts[0] == "dpstack_drives":
        return "drives"
    if parts[0] != "dpstack" or len(parts) < 2:
        return None
    folder = ROOT / "dpstack" / parts[1]
    if parts[1] in _NAMESPACES:
        return None
    if not folder.is_dir():
        return _BASE if folder.with_suffix(".py").exists() else None
    if parts[1] in deep and len(parts) > 2 and (folder / parts[2]).is_dir():
        return f"{parts[1]}/{parts[2]}"
    return parts[1]


def graph(deep: frozenset[str] = frozenset()) -> Graph:
    found: Graph = {}
    for top, name in ((ROOT / "dpstack", "dpstack"), (ROOT / "drives" / "dpstack_drives", "dpstack_drives")):
        for path in sorted(set(top.rglob("*.py")) - {top / "__init__.py", top / "__main__.py"}):
            own = room(".".join((name, *path.relative_to(top).with_suffix("").parts)), deep)
            if own is None:
                continue
            targets = {target for module in imports(path) if (target := room(module, deep)) not in (None, own)}
            found.setdefault(own, set()).update(target for target in targets if target)
    return found


def reach(arrows: Graph, start: str) -> set[str]:
    """Every room that ``start`` imports, directly or through others."""
    seen: set[str] = set()
    todo = [start]
    while todo:
        for target in arrows.get(todo.pop(), ()):
            if target not in seen:
                seen.add(target)
                todo.append(target)
    return seen


def reduced(arrows: Graph) -> Graph:
    """Without the arrows that follow from others, so that a picture shows the floors. Rooms that import each other keep
    theirs: neither stands below the other."""
    reached = {name: reach(arrows, name) for name in arrows}
    found: Graph = {}
    for name, targets in arrows.items():
        below = [other for other in targets if name not in reached[other]]
        found[name] = {
            target
            for target in targets
            if not any(target in reached[other] and other not in reached[target] for other in below if other != target)
        }
    return found


def flowchart(arrows: Graph, labels: Mapping[str, str]) -> str:
    """An arrow leads to what is imported; rooms that import each other have one with two heads."""
    lines = ["flowchart TD", *(f'    {_id(name)}["{labels.get(name, name)}"]' for name in sorted(arrows))]
    for name in sorted(arrows):
        for target in sorted(arrows[name]):
            mutual = name in arrows.get(target, ())
            if not mutual:
                lines.append(f"    {_id(name)} --> {_id(target)}")
            elif name < target:
                lines.append(f"    {_id(name)} <--> {_id(target)}")
    return "\n".join(lines)


def _id(name: str) -> str:
    return name.replace("/", "_")


def packages() -> str:
    """The packages of the project."""
    labels = {_BASE: "params, units, machine, errors, ...", "drives": "drives (dpstack_drives)"}
    return flowchart(reduced(graph()), labels)


def protocol_rooms() -> str:
    """The rooms of the protocol: link layer, DP and DP-V1."""
    arrows = graph(frozenset({"fdl", "dp", "dpv1"}))
    kept = {name for name in arrows if name.split("/")[0] in {"fdl", "dp", "dpv1"}}
    return flowchart(reduced({name: arrows[name] & kept for name in kept}), {})


def diagram(start: str, arrows: Iterable[tuple[str, str, str]]) -> str:
    """A state diagram; ``arrows`` are (from, to, on what), those that stay where they are left out."""
    joined: dict[tuple[str, str], list[str]] = {}
    for source, target, on in arrows:
        if source != target:
            joined.setdefault((source, target), []).append(on.replace(":", " -"))  # a colon ends a state's name
    lines = ["stateDiagram-v2", f"    [*] --> {start}"]
    lines += [f"    {source} --> {target}: {', '.join(names)}" for (source, target), names in joined.items()]
    return "\n".join(lines)


def _title(text: Hashable) -> str:
    return "_".join(part.capitalize() for part in str(text).split("_"))


def slave_handler() -> str:
    """The master's handling of one slave, without the ways to Offline, Fault and Deactivated."""
    back = {SlaveState.OFFLINE, SlaveState.FAULT, SlaveState.DEACTIVATED}
    table = slave_states.TABLE.items()
    kept = [(s, row.next, e.value) for (s, e), row in table if row.next not in back]
    return diagram("Offline", ((_title(s.value), _title(after.value), on) for s, after, on in kept))


def slave() -> str:
    """A slave."""
    table = state_table.TABLE
    return diagram("Wait_Prm", ((_name(s), _name(row.next), e.value) for (s, e), row in table.items()))


def _name(state: state_table.SlaveAppState) -> str:
    return _title(state.name.lower())


def ring() -> str:
    """An active station, without disturbances."""
    state = ring_states.State
    regular = {
        state.OFFLINE: {state.LISTEN_TOKEN},
        state.LISTEN_TOKEN: {state.ACTIVE_IDLE},
        state.CHECK_TOKEN_PASS: {state.ACTIVE_IDLE},
    }
    left_out = {state.OFFLINE, state.LISTEN_TOKEN, state.ACTIVE_IDLE}
    arrows = (
        (_title(row.state.name.lower()), _title(target.name.lower()), row.input.name.lower().replace("_", " "))
        for row in ring_states.TABLE
        for target in row.next
        if target not in left_out - regular.get(row.state, set())
    )
    return diagram("Offline", arrows)


PICTURES: Final[dict[str, Callable[[], str]]] = {
    "packages": packages,
    "protocol-rooms": protocol_rooms,
    "slave-handler": slave_handler,
    "slave": slave,
    "ring": ring,
}


def block(name: str) -> str:
    """The block of a picture in a page."""
    return f"<!-- picture: {name} -->\n```mermaid\n{PICTURES[name]()}\n```\n"


def architecture(text: str) -> str:
    """``text`` with its pictures made anew."""
    return _MARK.sub(lambda found: block(found[1]), text)


def token_ring() -> str:
    """The page of the active station's table."""
    parts = [f"{_RING_HEAD}\n{block('ring')}"]
    for state in ring_states.State:
        parts.append(f"## {_title(state.name.lower())}\n\n{_RING_COLUMNS}")
        for row in ring_states.TABLE:
            if row.state is state:
                owner, handler = row.handler.split(".")
                targets = ", ".join(dict.fromkeys(_title(s.name.lower()) for s in row.next))
                where = f"`{_RING_CLASSES[owner]}.{handler}`"
                parts.append(f"| {row.input.name.lower()} | {row.does} | {targets} | {where} | {_source(row.source)} |")
        parts.append("")
    return "\n".join(parts)


def _source(text: str) -> str:
    """A source of a table with its citations as links."""
    return re.sub(r"docs/reference/([\w/-]+\.md)(#[\w-]+)", r"[\2](\1\2)", text)


def states() -> str:
    """The page of the tables of states."""
    parts = [_STATES_HEAD]
    rows = [
        f"| {_title(state.value)} | {event.value} | {_title(row.next.value)} | {_source(row.clause)} |"
        for (state, event), row in slave_states.TABLE.items()
    ]
    parts.append(
        _section(_HANDLER, "slave-handler", "| state | what happened | next | source |\n|---|---|---|---|", rows)
    )
    rows = [
        f"| {_name(state)} | {event.value} | {_name(row.next)} | {_source(row.clause)} |"
        for (state, event), row in state_table.TABLE.items()
    ]
    parts.append(_section(_SLAVE, "slave", "| state | what happened | next | source |\n|---|---|---|---|", rows))
    rows = [
        f"| {access.name} | {'default' if sap is None else sap} | {', '.join(sorted(map(_name, access.states)))} "
        f"| {'owner' if access.owner_only else 'any master'} | {_source(access.clause)} |"
        for sap, access in state_table.ACCESS.items()
    ]
    parts.append("\n".join([_ACCESS, *rows]) + "\n")
    rows = [
        f"| {state.value} | {event.value} | {row.act.value} | {_source(row.source)} |"
        for (state, event), row in ms2_states.TABLE.items()
    ]
    parts.append("\n".join([_CONNECTION, *rows]) + "\n")
    return "\n".join(parts)


def _section(head: str, picture: str, columns: str, rows: Iterable[str]) -> str:
    return "\n".join([head, block(picture), columns, *rows]) + "\n"


_STATES_HEAD: Final = """# Tables of states

Written by `tools/make_pictures.py` from the tables of the program; do not edit. Those of the token ring:
[fdl-states.md](fdl-states.md). The documents named as sources: [protocol.md](protocol.md#sources).
"""
_RING_HEAD: Final = """# The states of an active station

Made from `dpstack/fdl/active/states.py` by `tools/make_pictures.py`; do not edit. The picture shows the ring without
disturbances. It leaves out the ways back to Offline (a lost line, an order), to Listen_Token (a second station with
this address) and to Active_Idle (another station holds the token), which nearly every state has. An input that a state
does not list is ignored and counted. A handler may pass an input on to the state it entered; what happens then is that
state's row. The documents named as sources: [protocol.md](protocol.md#sources).
"""
_RING_COLUMNS: Final = "| input | what is done | next | handler | source |\n|---|---|---|---|---|"
_RING_CLASSES: Final = {
    "idle": "listen_idle_claim.Waiting",
    "hold": "use_token.TokenHold",
    "poll": "use_token.GapPoll",
    "exchange": "exchange.Exchange",
    "passing": "pass_token.TokenPass",
}
_HANDLER: Final = """## A slave at its master

`dpstack/dp/master/slave_states.py`. The picture leaves out events that change nothing, and the ways to Offline (no
answer), to Fault (a refusal) and to Deactivated (by order), which nearly every state has.
"""
_SLAVE: Final = """## A slave

`dpstack/dp/slave/state_table.py`.
"""
_ACCESS: Final = """### Services by state of a slave

| service | SAP | open in | to | source |
|---|---|---|---|---|"""
_CONNECTION: Final = """## A class 2 connection at the slave

`dpstack/dpv1/slave/ms2_states.py`.

| state | what happened | what it does | source |
|---|---|---|---|"""


def main() -> None:
    for name, make in PICTURES.items():
        draw_pictures.write(name, make(), (make.__doc__ or "").rstrip("."))
    STATES.write_text(states(), encoding="utf-8")
    RING.write_text(token_ring(), encoding="utf-8")
    ARCHITECTURE.write_text(architecture(ARCHITECTURE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
