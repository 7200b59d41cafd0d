"""Orders of a page: the table of those that there are, and how the run carries each out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Protocol

from dpstack.api.control.commands import NOW
from dpstack.errors import DpError, UsageError
from dpstack.web.messages import PageOrder
from dpstack.web.rights import Visitor
from dpstack.web.source import Source


class Tell(Protocol):
    """Informs all pages and the log; ``pages`` False: the log alone."""

    def __call__(self, text: str, severity: str = "info", *, pages: bool = True, **more: object) -> None: ...


def _same(*command: str) -> Callable[[tuple[str, ...]], tuple[str, ...]]:
    return lambda args: (*command, *args)


def _write(args: tuple[str, ...]) -> tuple[str, ...]:
    if len(args) != 4:
        raise UsageError("write takes SLAVE SLOT INDEX HEX, for instance: write 8 1 47 00FF")
    return ("acyclic", args[0], "write", *args[1:])


def _pa(args: tuple[str, ...]) -> tuple[str, ...]:
    if len(args) != 3:
        raise UsageError("pa takes SLAVE NAME VALUE, for instance: pa 8 tb1.lower_range 0")
    return ("acyclic", args[0], "pa", "write", *args[1:])


#: for each order the command of the control socket, with its arguments
_COMMANDS: Final[dict[str, Callable[[tuple[str, ...]], tuple[str, ...]]]] = {
    **{one: _same(one) for one in ("operate", "clear", "stop")},
    # whoever looks at a page does not stand beside the plant
    **{one: _same(one, NOW) for one in ("set", "outputs", "drive")},
    "write": _write,
    "pa": _pa,
    # inputs of slaves that the run simulates; on a real bus it refuses both
    "force": _same("set", NOW),
    "release": _same("mirror"),
}
#: starts the run if none exists
START: Final = "start"
ORDERS: Final = (*_COMMANDS, START)


async def carry_out(source: Source, visitor: Visitor, order: PageOrder, tell: Tell) -> object:
    """Carry ``order`` out for ``visitor``, and return the answer of the run. The log has each order that may be given
    before it is carried out, with the name of who gave it; log and pages have its result. The log of the run has each
    order that is refused. Raises DpError.
    """
    if why := _refusal(visitor, order):
        await source.refused(visitor.who, order.text, why)
        raise UsageError(why)
    about: dict[str, Any] = {"by": visitor.who, "command": order.command, "args": list(order.args)}
    text = f"order of {visitor.who}: {order.text}"
    tell(text, pages=False)
    try:
        if order.command == START:
            if order.args:
                raise UsageError("start takes no arguments")
            result = await source.start()
        else:
            result = await source.order(visitor.who, *_COMMANDS[order.command](order.args))
    except BaseException as error:
        why = str(error) if isinstance(error, (DpError, ValueError)) else "given up"
        tell(f"{text}: failed: {why}", "warning", **about, ok=False)
        raise
    tell(f"{text}: done", "info", **about, ok=True)
    return result


def _refusal(visitor: Visitor, order: PageOrder) -> str:
    """The reason why ``order`` does not get to the run; empty: none."""
    if not visitor.control:
        return "this page may look only: orders need --control, and the address or token for them"
    if order.command not in ORDERS:
        return f"there is no order {order.command!r}; there are {', '.join(ORDERS)}"
    if not order.confirmed:
        return f"{order.command}: the order was not confirmed on the page, so it was not carried out"
    return ""
