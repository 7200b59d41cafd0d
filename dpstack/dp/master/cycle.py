"""One round over the slaves and the order of its requests.

First Global_Control that has to precede data (a slave put back into its group's mode, a cyclic FREEZE); Data_Exchange
with every slave whose turn it is, from the process image; a cyclic SYNC; farewells of removed slaves; Global_Control
when due. Free running services belong to the round (bring-up, diagnosis; :mod:`dpstack.dp.master.poll_order`): one
while any slave is in data exchange, so that a bring-up does not delay the other slaves, else one for each slave. With a
fixed cycle they come between the rounds, one a token hold, as far as they fit in
(:mod:`dpstack.fdl.active.cycle_window`). The order is that of the Siemens S120 and Heidenhain manuals
(docs/reference/protocol.md#order-in-a-cycle).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.fixed_cycle import Cadence, CycleData
from dpstack.dp.master.global_control import Controls
from dpstack.dp.master.outputs_watch import OutputsWatch
from dpstack.dp.master.poll_order import Turns
from dpstack.dp.master.settings import MasterContext
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.master.slave_list import Leaving, Roster
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import SAP_CHK_CFG, SAP_GET_CFG, SAP_GLOBAL_CONTROL, SAP_SET_PRM

# asked in every exchange: an enum's member costs ten times a name of the module
_DATA_EXCHANGE: Final = SlaveState.DATA_EXCHANGE
_OPERATE: Final = Mode.OPERATE
_OFFLINE: Final = Mode.OFFLINE
_STOP: Final = Mode.STOP
#: octets of a diagnosis without known Max_Diag_Data_Len; after the first longer one, the length of that
_DIAGNOSIS: Final = 32
#: octets of the answers with a known length, by SAP
_ANSWERS: Final = {SAP_SET_PRM: 0, SAP_CHK_CFG: 0, SAP_GET_CFG: 244}
_NOBODY: Final = frozenset[int]()


class Round:
    """The rounds over the slaves, one after the other; ``open`` during a round. At its end it calls ``ended(now)``."""

    def __init__(
        self,
        context: MasterContext,
        roster: Roster,
        turns: Turns,
        controls: Controls,
        cadence: Cadence,
        watch: OutputsWatch,
        ended: Callable[[int], None],
    ) -> None:
        self.open = False
        #: the next Data_Exchange is the first of the round
        self.first_data = False
        self._context = context
        self._roster = roster
        self._turns = turns
        self._rates = turns.rates
        self._controls = controls
        self._cadence = cadence
        self._watch = watch
        self._ended = ended
        self._due: list[SlaveHandler] = []
        self._left: Iterator[SlaveHandler] = iter(())  # those of ``_due`` whose turn is still to come
        self._at_begin = True  # nobody had a turn in this round yet
        self._services = 0
        self._operating = False  # the round began in Operate
        self._unsent = False  # no request of this round was sent yet
        self._at_once = False  # the grid has ended, and the next round begins within this hold
        self._published = 0
        self._has_cyclic_controls = bool(controls.freeze.groups or controls.sync.groups)
        self._freeze = self._sync = False  # still to be sent in this round
        #: address -> earliest time in ns of the next exchange, only of slaves with a Min_Slave_Interval
        self._spaced: dict[int, int] = {}
        self._some_turns = False  # a slave has a turn in some of the rounds only
        self._any_turns = False  # that, or a slave has a Min_Slave_Interval
        self._paused = False  # the round waits for a Min_Slave_Interval
        self._free_at = 0  # end in ns of the last Global_Control and its idle time

    # --- calls of the link layer ------------------------------------------------------------------------------------

    def token(self, now: int) -> None:
        """A token hold begins. While rounds run free, begin a new round if the last one has ended and the next one is
        due."""
        if self._cadence.fixed:
            self._services = 1
        elif not self.open and self._cadence.due(now) and self._may_begin(now):
            self._begin(now)

    def next_request(self, now: int, _high_only: bool) -> Request | None:
        """The next request, in the round or between two fixed cycles.

        Everything a master sends to its slaves is high priority, so ``_high_only`` changes nothing.
        """
        watch = self._watch
        if now >= watch.look_at:
            watch.look(now)
        if watch.outdated:
            watch.outdated = False
        if not self.open:
            fixed = self._cadence.fixed
            if not (fixed or self._at_once) or self._context.mode <= _STOP:
                return None
            # the link layer reports the end of Global_Control as it begins, and nothing can begin before its end
            if not self._cadence.due(max(now, self._free_at) if fixed else now):
                return self._between(now) if fixed else None
            if not (fixed or self._may_begin(now)):
                return None
            self._begin(now)
        if self._at_begin:
            if (request := self._before_data(now)) is not None:
                return request
            self._at_begin = not self._due
        if self._paused:
            self._paused = False
            self._cadence.resume()
        for handler in self._left:
            if handler.state is not _DATA_EXCHANGE:
                continue
            if self._any_turns and not self._has_turn(handler, now):
                if self._paused:
                    return None
                continue  # its turn comes in the next cycle
            if self.first_data:
                handler.tell_start()
            image, request = handler.image, handler.data
            if not (self._operating and self._context.operates):
                request.data = self._safe_outputs(handler, now)
            elif image.plugin is None:
                request.data = image.latched
            else:
                request.data = handler.plugin_host.outputs(now)
            return request
        if self._sync:
            self._sync = False
            return self._controls.cyclic(self._controls.sync)
        if self._roster.leaving and (request := self._roster.farewell(now, self._spaced)) is not None:
            return request
        fixed = self._cadence.fixed
        request = self._controls.after_data(now, repeat=bool(self._turns.exchanging) and not fixed)
        if request is not None:
            return request
        if not fixed and (request := self._service(now)) is not None:
            return request
        self._end(now)
        return self._between(now, room=True) if fixed else None

    # --- parts of a round ---------------------------------------------------------------------------------------------

    def _begin(self, now: int) -> None:
        turns, context, controls = self._turns, self._context, self._controls
        turns.begin_round()
        exchanging = turns.exchanging
        descending = context.descending
        wants_all = bool(controls.orders)
        all_slaves = descending or wants_all
        interval = turns.interval_all if all_slaves else turns.interval
        self._cadence.begin(now, fixed=bool(exchanging) and not descending, interval=interval)
        if wants_all:
            controls.begin_round()
        in_turn = all_slaves or not turns.rates.has_slower_slaves
        self._due = due = exchanging if in_turn else turns.due(self._cadence.number)
        on_begin = context.on_begin
        on_begin()
        for image in turns.images.values():
            image.latched = image.next_outputs
        self.open = True
        self._at_once = False
        self._some_turns = turns.rates.has_slower_slaves
        self._any_turns = self._some_turns or bool(self._spaced)
        self._left = iter(due)
        self._at_begin = True
        self._unsent = True
        self.first_data = bool(due)
        # a mode reached in the middle of a round counts from the next round on, for all slaves at once
        self._operating = context.mode is _OPERATE
        if self._has_cyclic_controls:
            held = context.operates and bool(due)
            self._freeze = held and bool(controls.freeze.groups)
            self._sync = held and bool(controls.sync.groups)
        if self._roster.leaving:
            self._roster.begin_round()
        if self._cadence.fixed:
            self._services = 1
        else:
            self._services = 1 if exchanging else turns.candidates
            if context.target is _OFFLINE:
                self._services = 0

    def _may_begin(self, now: int) -> bool:
        """Whether a round may begin that is due: one in which every slave has a turn, because the master is on the way
        to a lower mode or an order needs it, has an interval of its own."""
        wants_all = self._context.descending or self._controls.orders
        return not wants_all or self._cadence.due(now, self._turns.interval_all)

    def _before_data(self, now: int) -> Request | None:
        request = self._controls.before_data(now)
        if request is None and self._freeze:
            self._freeze = False
            request = self._controls.cyclic(self._controls.freeze)
        return request

    def _has_turn(self, handler: SlaveHandler, now: int) -> bool:
        """Note a turn of ``handler``, unless its Min_Slave_Interval is not over: then wait for it, if that is over soon
        enough for this round."""
        address, cadence = handler.setup.address, self._cadence
        until = self._spaced.get(address, 0)
        if now >= until:
            if self._some_turns:
                self._rates.had_turn(address, cadence.number)
            return True
        if not cadence.fixed or until - now <= cadence.book.cycle_ns // 2:
            self._paused = True
            cadence.pause(until)
            self._at_begin = handler is self._due[0]
            self._left = iter([handler, *self._left])
        return False

    def _safe_outputs(self, handler: SlaveHandler, now: int) -> bytes:
        """The outputs of a round in which outputs are safe."""
        if self._operating and self._context.mode is _OPERATE:
            return handler.plugin_host.safe_outputs()
        # Clear: a Fail_Safe slave gets an empty frame, the others zeros (docs/reference/protocol.md#clear)
        handler.plugin_host.watch(now)
        return b"" if handler.setup.fail_safe else bytes(handler.image.output_len)

    def _service(self, now: int, *, room: bool = True) -> Request | None:
        while self._services:
            self._services -= 1
            chosen = self._turns.next(now, self._roster.is_leaving, room=room)
            if chosen is not None:
                return chosen.service_request(now, long=self._turns.is_long_poll(chosen, now))
        return None

    def _between(self, now: int, *, room: bool = False) -> Request | None:
        """The next service or repeated Global_Control between two fixed cycles, or None.

        ``room``: the cycle has just ended, so that all of the time before the next one is left.
        """
        self._turns.sort()
        request = self._controls.repetition(now)
        if request is None:
            request = self._service(now, room=room)
        if request is not None and isinstance(request.tag, SlaveHandler):
            longest = request.tag.setup.max_diag_len
            last = request.tag.reports.diagnosis
            if longest is None:
                longest = _DIAGNOSIS if last is None else max(_DIAGNOSIS, 6 + len(last.ext))
            request = request.replaced(answer=_ANSWERS.get(request.dsap or 0, longest))
        return request

    def _end(self, now: int) -> None:
        self.open = False
        self._cadence.over(now)
        ended = self._ended
        ended(now)

    def started(self, request: Request, at: int) -> None:
        """The first bit of ``request`` is on the line at ``at``."""
        if self._unsent and request.cyclic:
            self._unsent = False
            self._cadence.started(at)
        if request.dsap == SAP_GLOBAL_CONTROL:
            self._free_at = at + self._controls.takes_ns
        elif request.dsap is None:
            tag = request.tag
            handler = tag.handler if isinstance(tag, Leaving) else tag
            if isinstance(handler, SlaveHandler) and handler.setup.min_slave_interval_ns:
                self.space(handler, at)

    def space(self, handler: SlaveHandler, at: int) -> None:
        """A Data_Exchange with ``handler`` began at ``at``: the next one not before its Min_Slave_Interval."""
        setup = handler.setup
        self._spaced[setup.address] = at + setup.min_slave_interval_ns

    def held_back(self, request: Request) -> None:
        """Postpone ``request``, because it does not fit in before the next cycle."""
        handler = request.tag
        if isinstance(handler, SlaveHandler):
            handler.restart |= request.restart
            self._turns.postpone(handler)
        else:
            self._controls.held_back(self._cadence.window.next_at)

    def cut(self, now: int) -> None:
        """End the round under way and the fixed cycle. A whole round follows at once."""
        self.open = False
        self._at_once = self._cadence.fixed
        self._paused = False
        self._cadence.stop(now)

    def publish(self) -> CycleData | None:
        """The data of the round that has ended; None if nothing was sent in it."""
        if self._unsent or not self._due:
            return None
        self._published += 1
        cadence = self._cadence
        started_at = cadence.started_at
        images, announced = self._turns.images, self._context.announced
        return CycleData(
            number=cadence.number,
            published=self._published,
            t_ns=started_at,
            due_ns=cadence.due_at,
            inputs={address: image.inputs for address, image in images.items()},
            fresh=frozenset([address for address, image in images.items() if image.input_time >= started_at]),
            missed=cadence.book.missed,
            announced=frozenset(announced) if announced else _NOBODY,
        )
