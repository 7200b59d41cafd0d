"""Global_Control: the master's mode, repeated; SYNC, FREEZE and their ends, each sent exactly once
(docs/reference/protocol.md#global_control).

A further SYNC or FREEZE acts again, so the master never repeats one. An order is for groups of slaves. With a fixed
cycle the master may send FREEZE at the beginning of every cycle and SYNC at its end: inputs of one moment, outputs of
one moment. A slave that comes back into data exchange while its group is held gets a telegram of its own, before its
first outputs. On every way out of Operate the master releases all slaves, or safe values would not reach the outputs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from dpstack.dp.master.commands import Mode, SendControl
from dpstack.dp.master.events import ControlFailed, ControlSent, PictureTaken, SlaveRemark, SlaveState
from dpstack.dp.master.settings import MasterContext
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.pdu.requests import GlobalControl
from dpstack.dp.slave_params import SlaveParams, group_mask
from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import SAP_GLOBAL_CONTROL, SSAP_MS0, Req
from dpstack.params import BROADCAST
from dpstack.units import BITS_PER_CHAR, NS_PER_MS

#: Global_Control is repeated this often (sources disagree between each Data_Control_Time and 'cyclically') ...
_PERIOD: Final = 200 * NS_PER_MS
#: ... but takes no more than 1 % of the bus: 13 octets and T_ID2.
_SHARE: Final = 100
_OCTETS: Final = 13
#: number of Global_Control telegrams after a change of mode, and at the end
_URGENT: Final = 2


class GroupMode:
    """SYNC or FREEZE. ``held``: addresses of the slaves that this master holds in it.

    ``key``: "sync" or "freeze". ``groups`` (1..8): the groups that get it in every cycle in Operate.
    """

    def __init__(self, key: str, groups: tuple[int, ...]) -> None:
        if any(not 1 <= group <= 8 for group in groups):
            raise ConfigError(f"cycle_{key}: groups are numbered 1..8, {list(groups)} were given")
        self.held: set[int] = set()
        self.key = key
        self.groups = groups
        self.mask = group_mask(groups)

    @property
    def title(self) -> str:
        """The standard's name."""
        return self.key.upper()

    def applies_to(self, setup: SlaveParams) -> bool:
        """Whether the slave is parameterised for it."""
        return bool(getattr(setup, self.key))

    def check(self, setup: SlaveParams) -> None:
        """Raises ConfigError for a slave of the groups that is not parameterised for it."""
        if setup.group_mask & self.mask and not self.applies_to(setup):
            raise ConfigError(
                f"{setup.who} is in a group of cycle_{self.key} and not parameterised for {self.title}: "
                f"give it {self.key} = true if the device knows that, or leave it out of the group"
            )

    def check_order(self, command: SendControl, members: Iterable[SlaveParams]) -> None:
        """Raises UsageError if every cycle sends it already, or if ``members`` are not parameterised for it."""
        begins, ends = getattr(command, self.key), getattr(command, f"un{self.key}")
        unable = [setup.who for setup in members if begins and not self.applies_to(setup)]
        if unable:
            raise UsageError(
                f"{', '.join(unable)}: not parameterised for {self.title}; give it {self.key} = true if the device "
                f"knows that, or leave it out of the groups"
            )
        if (begins or ends) and self.groups and (not command.groups or set(command.groups) & set(self.groups)):
            named = ", ".join(map(str, self.groups))
            raise UsageError(
                f"every cycle sends {self.title} to group {named} (cycle_{self.key}): "
                f"take the groups out of there to order it yourself"
            )


class ControlOrder:
    """An order under way; ``sent``: its telegram was sent, and it waits for the picture."""

    def __init__(self, command: SendControl, handlers: Mapping[int, SlaveHandler]) -> None:
        self.command = command
        self.mask = group_mask(command.groups)
        self.sent = False
        self._handlers = handlers
        self._marks: dict[SlaveHandler, int] | None = None

    def members(self) -> list[SlaveHandler]:
        """The slaves of its groups that are in service, in any state."""
        mask = self.mask
        in_service = (h for h in self._handlers.values() if h.state is not SlaveState.DEACTIVATED)
        return [h for h in in_service if not mask or h.setup.group_mask & mask]

    def begin_round(self) -> None:
        """Count exchanges from the first round on that began after the order (after its telegram)."""
        if self._marks is None:
            self._marks = {h: h.exchanges for h in self.members()}

    def went_out(self) -> None:
        """Its telegram is on the wire: wait for a whole exchange with every slave."""
        self.sent = True
        self._marks = None

    def missing(self, members: Iterable[SlaveHandler]) -> SlaveHandler | None:
        """The first slave that is not in data exchange, if the order wants a whole exchange with each."""
        if not (self.command.settle or self.command.picture):
            return None
        return next((h for h in members if h.state is not SlaveState.DATA_EXCHANGE), None)

    def exchanged(self, members: Sequence[SlaveHandler]) -> bool:
        """Whether the whole exchange with every slave is over, if the order wants one now."""
        if not (self.sent or self.command.settle):
            return True
        marks = self._marks
        if marks is None:
            return False
        return all(h.exchanges > marks.setdefault(h, h.exchanges) for h in members)


class Controls:
    """Global_Control of a master. ``urgent``: number of telegrams that are due at once.

    ``sync`` and ``freeze``: the slaves in these modes, and the groups that get them in every cycle.
    """

    def __init__(self, context: MasterContext, handlers: Mapping[int, SlaveHandler]) -> None:
        self.sync = GroupMode("sync", context.settings.cycle_sync)
        self.freeze = GroupMode("freeze", context.settings.cycle_freeze)
        self.urgent = 0
        self._modes = (self.sync, self.freeze)
        self._context = context
        self._handlers = handlers
        params = context.params
        self._length_ns = params.ns(_OCTETS * BITS_PER_CHAR)
        #: one telegram and the idle time after it
        self.takes_ns = params.ns(_OCTETS * BITS_PER_CHAR + params.t_id2)
        self._period = max(_PERIOD, _SHARE * self.takes_ns)
        self._due = 0
        self._release = 0
        #: while one waits, each round needs an exchange with every slave
        self.orders: deque[ControlOrder] = deque()
        self._restore: deque[SlaveHandler] = deque()

    # --- orders -------------------------------------------------------------------------------------------------

    def check(self, setup: SlaveParams) -> None:
        """Raises ConfigError if every cycle sends SYNC or FREEZE to a slave that is not parameterised for it."""
        for mode in self._modes:
            mode.check(setup)

    def change_of_mode(self) -> None:
        """Send the new mode at once, twice."""
        self.urgent = _URGENT

    def order(self, command: SendControl) -> None:
        """Queue an order; the master carries out one after the other. Raises UsageError for an impossible one."""
        mode = self._context.mode
        if mode <= Mode.STOP:
            raise UsageError(
                f"SYNC and FREEZE cannot be sent in {mode.name.capitalize()}: order clear() or operate() first"
            )
        if command.settle and mode is not Mode.OPERATE:
            raise UsageError("in Clear all outputs are zero: order operate() before outputs are passed on by SYNC")
        if any(not 1 <= group <= 8 for group in command.groups):
            raise UsageError(f"groups are numbered 1..8, {list(command.groups)} were given")
        order = ControlOrder(command, self._handlers)
        members = [handler.setup for handler in order.members()]
        if not members:
            in_service = (h.setup for h in self._handlers.values() if h.state is not SlaveState.DEACTIVATED)
            groups = {group for setup in in_service for group in setup.groups}
            known = ", ".join(map(str, sorted(groups))) or "none"
            asked = ", ".join(map(str, command.groups)) or "all"
            raise UsageError(f"no slave is in group {asked}; groups of this bus: {known}")
        for group_mode in self._modes:
            group_mode.check_order(command, members)
        self.orders.append(order)

    def entered(self, handler: SlaveHandler) -> None:
        """A slave came into data exchange: send it the mode at once, and the SYNC or FREEZE of its group."""
        self.urgent = max(self.urgent, 1)
        if any(self._is_held(handler, mode) for mode in self._modes):
            self._restore.append(handler)

    def _is_held(self, handler: SlaveHandler, mode: GroupMode) -> bool:
        """Whether the slave was in ``mode``, or another slave of its groups is."""
        address, mask = handler.setup.address, handler.setup.group_mask
        return any(
            other == address or self._handlers[other].setup.group_mask & mask
            for other in mode.held
            if other in self._handlers
        )

    def holds(self, address: int) -> bool:
        """Whether this master holds the slave in SYNC or FREEZE."""
        return any(address in mode.held for mode in self._modes)

    def forget(self, address: int) -> None:
        """Forget a slave that the master gives up."""
        for mode in self._modes:
            mode.held.discard(address)

    def release_all(self, reason: str, now: int) -> None:
        """Release all held slaves after the next round, and end all orders, because outputs must become safe."""
        for mode in self._modes:
            if mode.held:
                self._release = _URGENT
            mode.held.clear()
        self._restore.clear()
        self.fail_all(reason, now)

    def fail_all(self, reason: str, now: int) -> None:
        while self.orders:
            self._fail(reason, now)

    def _fail(self, reason: str, now: int, address: int | None = None) -> None:
        order = self.orders.popleft()
        self._context.emit(ControlFailed(t_ns=now, token=order.command.token, reason=reason, address=address))

    # --- in the round -------------------------------------------------------------------------------------------

    def begin_round(self) -> None:
        """Let the first order count its exchanges from this round on."""
        if self.orders:
            self.orders[0].begin_round()

    def before_data(self, now: int) -> Request | None:
        """The telegram that puts a returned slave back into SYNC or FREEZE, before its first outputs."""
        while self._restore:
            handler = self._restore.popleft()
            setup = handler.setup
            modes = [mode for mode in self._modes if mode.applies_to(setup) and self._is_held(handler, mode)]
            if handler.state is not SlaveState.DATA_EXCHANGE or not modes:
                continue
            if not setup.group_mask & (self.sync.mask | self.freeze.mask):
                names = " and ".join(mode.title for mode in modes)
                message = (
                    f"came back into data exchange while its group is in {names}, and was put back alone: its "
                    f"data are those of the group from the next {names} on"
                )
                handler.reports.event(SlaveRemark, now, message=message)
            for mode in modes:
                mode.held.add(setup.address)
            return self._request(da=setup.address, sync=self.sync in modes, freeze=self.freeze in modes)
        return None

    def cyclic(self, mode: GroupMode) -> Request:
        """The telegram at the begin or end of a cycle (in Operate only: safe outputs wait for none)."""
        return self._request(mode, sync=mode is self.sync, freeze=mode is self.freeze, group_mask=mode.mask)

    def after_data(self, now: int, *, repeat: bool) -> Request | None:
        """The next Global_Control of this round, after all Data_Exchange; None when there is no more.

        ``repeat``: repeat the mode if that is due.
        """
        if self.urgent or self._release or (repeat and now >= self._due):
            release = self._release > 0
            self._due = now + self._period
            self.urgent = max(0, self.urgent - 1)
            self._release = max(0, self._release - 1)
            return self._request(self, unsync=release, unfreeze=release)
        while self.orders:
            order, command = self.orders[0], self.orders[0].command
            members = order.members()
            missing = order.missing(members)
            if not members:
                self._fail("no slave is left in its groups", now)
            elif missing is not None:
                setup = missing.setup
                self._fail(f"{setup.who} is not in data exchange: {missing.why_not_exchanging}", now, setup.address)
            elif not order.exchanged(members):
                return None
            elif not order.sent:
                return self._request(
                    order,
                    unfreeze=command.unfreeze,
                    freeze=command.freeze,
                    unsync=command.unsync,
                    sync=command.sync,
                    group_mask=order.mask,
                )
            else:
                self.orders.popleft()
                inputs = {h.setup.address: h.image.inputs for h in members}
                self._context.emit(PictureTaken(t_ns=now, token=command.token, inputs=inputs))
        return None

    def _request(
        self, tag: object = None, *, da: int = BROADCAST, cyclic: bool = True, group_mask: int = 0, **bits: bool
    ) -> Request:
        """Global_Control with ``bits`` besides the master's mode."""
        data = GlobalControl(clear=self._context.mode is Mode.CLEAR, group_mask=group_mask, **bits).build()
        return Request(da, Req.SDN_HIGH, data, SAP_GLOBAL_CONTROL, SSAP_MS0, tag=tag, cyclic=cyclic)

    def started(self, request: Request, at: int) -> None:
        """A Global_Control is on the line, its first bit at ``at``."""
        tag = request.tag
        if isinstance(tag, ControlOrder) and self.orders and self.orders[0] is tag:
            self._sent(tag, at + self._length_ns)
        elif isinstance(tag, GroupMode):
            exchanging = (h.setup for h in self._handlers.values() if h.state is SlaveState.DATA_EXCHANGE)
            tag.held |= {setup.address for setup in exchanging if setup.group_mask & tag.mask}

    def repetition(self, now: int) -> Request | None:
        """Between two fixed cycles: repeat the mode if that is due."""
        if now < self._due:
            return None
        self._due = now + self._period
        return self._request(self, cyclic=False)

    def held_back(self, until: int) -> None:
        """The repetition did not fit in before ``until``."""
        self._due = until

    def abandoned(self, request: Request) -> None:
        """A Global_Control could not be sent: send the mode, or the end of SYNC, again. (Orders are still queued.)"""
        if request.tag is self:
            self.urgent = max(self.urgent, 1)
            if GlobalControl.parse(request.data).unsync:
                self._release = max(self._release, 1)

    def _sent(self, order: ControlOrder, end: int) -> None:
        command = order.command
        members = order.members()
        reached = {h.setup.address for h in members if h.state is SlaveState.DATA_EXCHANGE}
        missed = tuple(h.setup.address for h in members if h.setup.address not in reached)
        for mode in self._modes:
            if getattr(command, mode.key):
                mode.held |= reached
            elif getattr(command, f"un{mode.key}"):
                mode.held -= reached.union(missed)
        self._context.emit(ControlSent(t_ns=end, token=command.token, missed=missed))
        if command.picture:
            order.went_out()
        else:
            self.orders.popleft()
