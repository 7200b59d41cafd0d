"""The parameter channel of a drive without peculiarities: every parameter by its PNU, PROFIdrive's error numbers.

Both ends for a drive that is declared: :func:`plain_resolver` for
:class:`~dpstack.profile.channel.pkw_access.PkwAccess`, :func:`plain_server` over a
:class:`~dpstack.profile.simulator.param_store.ParamStore`. Source: PROFIdrive V2, parameter channel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.profile.channel.base import ParamKey
from dpstack.profile.channel.pkw import Order, Pkw, PkwDialect, PkwServer, Reply
from dpstack.profile.channel.pkw_access import ParamRef, Resolver
from dpstack.profile.model.jobs import CommandError
from dpstack.profile.model.param_errors import PARAMETER_ERRORS
from dpstack.profile.model.params import ParamSpec, ParamTable
from dpstack.profile.simulator.param_store import ParamStore

#: words and double words, no arrays, no data sets
PLAIN_PKW: Final = PkwDialect(
    answers={Order.READ: (Reply.WORD, Reply.LONG), Order.WRITE_WORD: (Reply.WORD,), Order.WRITE_LONG: (Reply.LONG,)},
    errors={**PARAMETER_ERRORS, 17: "not in this operating state", 18: "another error"},  # V2 has words of its own
)
#: the highest PNU that PKE holds
_MOST: Final = 0x7FF


def plain_resolver(table: ParamTable, drive: str) -> Resolver:
    """Finds parameters of ``table`` by name or number; a number that is not in it goes as it is, without a scale."""

    def resolve(key: ParamKey) -> ParamRef:
        spec = key.spec_in(table)
        number = spec.number if spec is not None else int(key.name)
        label = f"parameter {spec.label}" if spec is not None else f"parameter {number}"
        if not 1 <= number <= _MOST:
            raise CommandError("usage", f"{label}: parameter numbers are 1..{_MOST}")
        if key.data_set is not None or key.index is not None:
            raise CommandError("usage", f"{label}: {drive} has neither data sets nor indexes")
        if key.ram:
            raise CommandError("usage", f"{label}: {drive} has no writes to RAM only")
        return ParamRef(number, 0, False, spec, label)

    return resolve


def plain_server(
    store: ParamStore,
    *,
    live: Callable[[ParamSpec], int | None] = lambda spec: None,
    locked: Callable[[ParamSpec], bool] = lambda spec: False,
    dialect: PkwDialect = PLAIN_PKW,
) -> PkwServer:
    """The drive's end. ``live``: the actual value on the wire where it is not stored; ``locked``: error 17 now."""

    def carry_out(order: Pkw) -> tuple[int, int]:
        spec = store.table.get(order.pnu)
        if spec is None or spec.text:
            return Reply.ERROR, 0
        reply = Reply.LONG if spec.long else Reply.WORD
        if order.id == Order.READ:
            actual = live(spec)
            return reply, spec.pwe(store.raw(spec) if actual is None else actual)
        if spec.read_only:
            return Reply.ERROR, 1
        if order.id != (Order.WRITE_LONG if spec.long else Order.WRITE_WORD):
            return Reply.ERROR, 5
        raw = spec.from_pwe(order.pwe)
        if not spec.low <= spec.to_value(raw) <= spec.high:
            return Reply.ERROR, 2
        if locked(spec):
            return Reply.ERROR, 17
        store.write(spec, raw)
        return reply, spec.pwe(raw)

    return PkwServer(dialect, carry_out)
