"""Global_Control: the master's mode, repeated; SYNC, FREEZE and their ends, each sent exactly once
(docs/protocol.md#global_control).

A further SYNC or FREEZE acts, so none is ever repeated. A slave that comes back into data exchange while its group is
held is put back into the mode by a telegram of its own, before its first outputs; on every way out of Operate all are
let go, or the safe values would not reach the outputs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Final

from dpstack.dp.master.commands import Mode, SendControl
from dpstack.dp.master.events import ControlFailed, ControlSent, PictureTaken, SlaveRemark, SlaveState
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.master.sync_freeze import ControlOrder, CyclicControl, check_order
from dpstack.dp.pdu.requests import GlobalControl
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import SAP_GLOBAL_CONTROL, SSAP_MS0, Req
from dpstack.params import BROADCAST, BusParams
from dpstack.trace import Event
from dpstack.units import BITS_PER_CHAR, NS_PER_MS

#: Global_Control is repeated this often (sources disagree between each Data_Control_Time and 'cyclically') ...
_PERIOD: Final = 200 * NS_PER_MS
#: ... but takes no more than 1 % of the bus: 13 octets and T_ID2.
_SHARE: Final = 100
_OCTETS: Final = 13
#: Global_Control after a change of mode, and at the end, is sent this often
_URGENT: Final = 2

Handlers = Mapping[int, SlaveHandler]


class Controls:
    """What the master owes its slaves in Global_Control. ``urgent``: so many telegrams are due at once.

    ``synced`` and ``frozen``: addresses of the slaves that are held by our order. ``cycle_freeze`` and ``cycle_sync``:
    groups that every cycle begins with a FREEZE of, and ends with a SYNC of.
    """

    __slots__ = (
        "_due", "_emit", "_handlers", "_length_ns", "_orders", "_period", "_release", "_restore", "cycle_freeze",
        "cycle_sync", "frozen", "synced", "takes_ns", "urgent",
    )  # fmt: skip

    def __init__(
        self,
        params: BusParams,
        handlers: Handlers,
        emit: Callable[[Event], None],
        settings: MasterSettings,
    ) -> None:
        self.cycle_freeze = CyclicControl(settings.cycle_freeze, freeze=True)
        self.cycle_sync = CyclicControl(settings.cycle_sync, freeze=False)
        self.urgent = 0
        self.synced: set[int] = set()
        self.frozen: set[int] = set()
        self._handlers = handlers
        self._emit = emit
        self._length_ns = params.ns(_OCTETS * BITS_PER_CHAR)
        #: one telegram and the idle time after it
        self.takes_ns = params.ns(_OCTETS * BITS_PER_CHAR + params.t_id2)
        self._period = max(_PERIOD, _SHARE * self.takes_ns)
        self._due = 0
        self._release = 0
        self._orders: deque[ControlOrder] = deque()
        self._restore: deque[SlaveHandler] = deque()

    # --- what is wanted -----------------------------------------------------------------------------------------

    def change_of_mode(self) -> None:
        """The new mode is told at once, twice."""
        self.urgent = _URGENT

    def order(self, command: SendControl, mode: Mode) -> None:
        """Take an order; they are carried out one after the other. Raises UsageError where it cannot be."""
        check_order(command, self._handlers.values(), mode)
        self.cycle_sync.refuse(command)
        self.cycle_freeze.refuse(command)
        self._orders.append(ControlOrder(command))

    @property
    def wants_all(self) -> bool:
        """An order waits for an exchange with every slave: nobody is left out of the rounds."""
        return bool(self._orders)

    def entered(self, handler: SlaveHandler) -> None:
        """A slave came into data exchange: told the mode at once, and put back into what its group is held in."""
        self.urgent = max(self.urgent, 1)
        if self._held(handler, self.synced) or self._held(handler, self.frozen):
            self._restore.append(handler)

    def _held(self, handler: SlaveHandler, held: Iterable[int]) -> bool:
        """It was in the mode itself, or somebody of one of its groups is."""
        address, mask = handler.setup.address, handler.setup.group_mask
        fellows = (self._handlers[a] for a in held if a in self._handlers)
        return any(h.setup.address == address or h.setup.group_mask & mask for h in fellows)

    def holds(self, address: int) -> bool:
        """Whether the slave is in SYNC or FREEZE by our order."""
        return address in self.synced or address in self.frozen

    def forget(self, address: int) -> None:
        """The slave is given up."""
        self.synced.discard(address)
        self.frozen.discard(address)

    def let_go(self, reason: str, now: int) -> None:
        """Outputs are to become safe: whoever is held is let go after the next round, orders end."""
        if self.synced or self.frozen:
            self._release = _URGENT
        self.synced.clear()
        self.frozen.clear()
        self._restore.clear()
        self.fail_all(reason, now)

    def fail_all(self, reason: str, now: int) -> None:
        while self._orders:
            self._fail(reason, now)

    def _fail(self, reason: str, now: int, address: int | None = None) -> None:
        order = self._orders.popleft()
        self._emit(ControlFailed(t_ns=now, token=order.command.token, reason=reason, address=address))

    # --- in the round -------------------------------------------------------------------------------------------

    def begin_round(self) -> None:
        """What is exchanged from here on was asked for after the orders."""
        if self._orders:
            self._orders[0].begin_round(self._handlers.values())

    def before_data(self, mode: Mode, now: int) -> Request | None:
        """The telegram that puts a slave back into its group's mode, before its first outputs."""
        while self._restore:
            handler = self._restore.popleft()
            setup = handler.setup
            sync = setup.sync and self._held(handler, self.synced)
            freeze = setup.freeze and self._held(handler, self.frozen)
            if handler.state is not SlaveState.DATA_EXCHANGE or not (sync or freeze):
                continue
            held = [text for text, on in (("SYNC", sync), ("FREEZE", freeze)) if on]
            message = (
                f"came back into data exchange while its group is in {' and '.join(held)}, and was put back alone: its "
                f"data are those of the group from the next {' and '.join(held)} on"
            )
            if not (self.cycle_sync.concerns(setup) or self.cycle_freeze.concerns(setup)):
                self._emit(SlaveRemark(t_ns=now, address=setup.address, name=setup.name, message=message))
            if sync:
                self.synced.add(setup.address)
            if freeze:
                self.frozen.add(setup.address)
            return self._request(GlobalControl(clear=mode is Mode.CLEAR, sync=sync, freeze=freeze), da=setup.address)
        return None

    def cyclic(self, control: CyclicControl) -> Request:
        """The telegram that a cycle begins or ends with (in Operate only: outputs that become safe wait for none)."""
        return self._request(control.control(), tag=control)

    def after_data(self, mode: Mode, now: int, *, repeat: bool) -> Request | None:
        """The next Global_Control of this round, after everybody's data; None when there is no more.

        ``repeat``: the mode is repeated here, when that is due.
        """
        if self.urgent or self._release or (repeat and now >= self._due):
            free = self._release > 0
            self._due = now + self._period
            self.urgent = max(0, self.urgent - 1)
            self._release = max(0, self._release - 1)
            return self._request(GlobalControl(clear=mode is Mode.CLEAR, unsync=free, unfreeze=free), tag=self)
        while self._orders:
            order = self._orders[0]
            members = order.members(self._handlers.values())
            missing = order.missing(members)
            if not members:
                self._fail("no slave is left in its groups", now)
            elif missing is not None:
                self._fail(missing.why, now, missing.address)
            elif not order.exchanged(members):
                return None
            elif not order.sent:
                return self._request(order.control(clear=mode is Mode.CLEAR), tag=order)
            else:
                self._orders.popleft()
                inputs = {h.setup.address: h.image.inputs for h in members}
                self._emit(PictureTaken(t_ns=now, token=order.command.token, inputs=inputs))
        return None

    def _request(
        self, control: GlobalControl, *, da: int = BROADCAST, tag: object = None, cyclic: bool = True
    ) -> Request:
        return Request(da, Req.SDN_HIGH, control.build(), SAP_GLOBAL_CONTROL, SSAP_MS0, tag=tag, cyclic=cyclic)

    def started(self, request: Request, at: int) -> None:
        """A Global_Control goes out, its first bit at ``at``."""
        order = request.tag
        if isinstance(order, ControlOrder) and self._orders and self._orders[0] is order:
            self._sent(order, at + self._length_ns)
        elif isinstance(order, CyclicControl):
            held = self.frozen if order.freeze else self.synced
            held |= {h.setup.address for h in self._handlers.values() if order.reaches(h)}

    def repetition(self, mode: Mode, now: int) -> Request | None:
        """Between two fixed cycles: the mode once more when that is due."""
        if now < self._due:
            return None
        self._due = now + self._period
        return self._request(GlobalControl(clear=mode is Mode.CLEAR), tag=self, cyclic=False)

    def held_back(self, until: int) -> None:
        """The repetition did not fit in before ``until``."""
        self._due = until

    def abandoned(self, request: Request) -> None:
        """A Global_Control could not be sent: the mode, and the end of SYNC, are told again. (Orders still stand.)"""
        if request.tag is self:
            self.urgent = max(self.urgent, 1)
            if GlobalControl.parse(request.data).unsync:
                self._release = max(self._release, 1)

    def _sent(self, order: ControlOrder, end: int) -> None:
        command = order.command
        members = order.members(self._handlers.values())
        reached = {h.setup.address for h in members if h.state is SlaveState.DATA_EXCHANGE}
        missed = tuple(h.setup.address for h in members if h.setup.address not in reached)
        for on, off, held in (
            (command.sync, command.unsync, self.synced),
            (command.freeze, command.unfreeze, self.frozen),
        ):
            if on:
                held |= reached
            elif off:
                held -= {h.setup.address for h in members}
        self._emit(ControlSent(t_ns=end, token=command.token, missed=missed))
        if command.picture:
            order.went_out()
        else:
            self._orders.popleft()
