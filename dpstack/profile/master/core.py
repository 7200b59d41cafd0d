"""Master side of one drive, called once a rotation: state machine, set point, orders, status events.

A plugin subclasses :class:`DriveCore`: its class attributes declare the drive's words, scales, states, texts and
parameters, and for many drives that is all. The hooks at the end of the class are for behaviour that is not data. Time
comes in as ``now`` in ns; nothing here blocks or reads a clock.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from dpstack.profile.channel.base import ParameterChannel, ParamKey, ParamRef, plain_ref
from dpstack.profile.channel.indexed import IndexedChannel, IndexedDialect
from dpstack.profile.channel.pkw import PLAIN_PKW, PkwAccess, PkwDialect
from dpstack.profile.master.guarded_writes import guarded_write
from dpstack.profile.master.lookup import Lookup, Lookups
from dpstack.profile.master.messages import PATIENCE_NS, MessageParameter, read_messages
from dpstack.profile.master.new_address import NewAddress
from dpstack.profile.master.settings import Setting, SettingsCheck
from dpstack.profile.model.drive_type import CHANNEL_LEN, CHECK_SETTINGS, DriveType, Options, TelegramSpec
from dpstack.profile.model.jobs import Args, CommandError, DriveJob, DriveJobs, Steps
from dpstack.profile.model.params import ListedParam, ParamSpec, ParamTable, Use, listing
from dpstack.profile.model.states import FAULTED, MOVING, ControlTable, Goal, State
from dpstack.profile.model.status import DriveStatus
from dpstack.profile.model.words import SPEED, Scale
from dpstack.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from dpstack.dpv1.master.plugin_queue import RecordQueue
    from dpstack.profile.record47.drive_access import AcyclicAccess

#: the orders that move a drive
_MOTION: Final = ("start", "stop", "quick_stop", "coast", "acknowledge")
_GOALS: Final = {"stop": Goal.STOP, "quick_stop": Goal.QUICK_STOP, "coast": Goal.COAST}
#: set points in a unit: their reference may have to be read first
_IN_UNITS: Final = ("frequency", "rpm")
_STOPPING: Final = frozenset(_GOALS.values())
#: of the reference: below it the actual speed counts as 0
_STILL: Final = 0.005
#: states in which a stop that was ordered may not be over
_MAY_TURN: Final = MOVING | {State.OFFLINE, State.UNKNOWN}
_PARAMETERS: Final = ("read_many", "read", "write")
#: The orders every drive knows, with the ones that move it first.
OPS: Final = (*_MOTION, "speed", "frequency", "rpm", "reached", "settled", *_PARAMETERS)
#: default time-outs in s; 15 s of that of acknowledge is the time some drives lock a fault
_TIMEOUTS: Final = {
    "start": 5.0,
    "stop": 60.0,
    "quick_stop": 60.0,
    "coast": 5.0,
    "acknowledge": 20.0,
    "reached": 60.0,
    "settled": 5.0,
    "frequency": 5.0,
    "rpm": 5.0,
    **dict.fromkeys(_PARAMETERS, 5.0),
}
#: of the reference, for a drive that has no bit for it
_CLOSE: Final = 0.01
#: of the reference: how far the actual speed may be from the set point if the drive's bit says that it is reached.
#: More than the rounding of any drive; a wrong scale or source of the set point is off by more at most set points
_BELIEVED: Final = 0.02

#: a fault whose name the plugin is asking for
NOT_NAMED: Final = "not yet named"
#: begins the text of a fault whose name the plugin cannot find out; the reason follows
NO_NAME: Final = "without a name"
_LEAST_NS: Final = 20 * NS_PER_MS
#: in Clear: a drive that has just come up has shown its status after this time
_CLEAR_NS: Final = NS_PER_S


class DriveCore:
    """Implements :class:`dpstack.dp.process_image.CyclicPlugin` for one drive called ``name``.

    ``profile``: the drive as the registry has it; ``options``: those of the drive, checked. The options
    ``reference_hz`` and ``reference_rpm`` (frequency and speed that 100 % means) go before the profile's.
    """

    #: control word, status word, states
    table: ControlTable
    #: the control word of the safe outputs; the set point is 0 then
    safe_control: int = 0
    #: time that the drive may take to notice outputs and show it in its inputs, in ns
    scan_ns: int
    #: the words of the process data received, in order: ``status`` first, then ``speed``, ``current``, ``torque``,
    #: ``fault`` (a number), ``warning`` (bits or a number), or a name of its own; a telegram has as many of them as it
    #: has words
    inputs: tuple[str, ...] = ("status", "speed")
    #: scale of speed and set point, in parts of the reference
    scale: Scale = SPEED
    #: scale of current and torque, in parts of the rated ones; 0x4000 = 100 %
    current_scale: Scale = Scale("current")
    #: texts by number of the fault
    fault_names: Mapping[int, str] = {}
    #: text of a fault that has none, a format of its number
    unknown_fault: str = "number {}"
    #: the parameter that has the numbers of the present faults, if no word of the telegram has; None: none has
    fault_parameter: MessageParameter | None = None
    #: texts by bit of the warning word, or by number of the warning
    warning_names: Mapping[int, str] = {}
    #: the warning word, or the warning's parameter, is a number
    warning_numbers: bool = False
    #: text of a warning that has none, a format of its number; "": ``number`` or ``bit`` with it
    unknown_warning: str = ""
    #: the parameter that has the present warnings while the status bit ``warning`` is set, if no word of the telegram
    #: has; None: none has
    warning_parameter: MessageParameter | None = None
    #: what the parameter channel and record 47 reach; None: the drive has no parameters
    parameter_table: ParamTable | None = None
    #: layout of the telegram's parameter channel, and its differences from plain PKW
    dialect: PkwDialect | IndexedDialect = PLAIN_PKW
    #: the slot of record 47 of a drive whose parameters have the same numbers there; None: it has no record 47
    record_slot: int | None = None
    #: the drive object in record 47, 0..255: the axis of a drive with several, DO-ID of SINAMICS
    record_object: int = 1
    #: why the drive may ignore an acknowledgement, for people
    lock_hint: str = ""
    #: what to check when the drive does not start for no known reason, for people
    start_hint: str = ""
    #: name of the parameter that holds the station address; "": the drive has none
    address_parameter: str = ""
    #: when a new station address takes effect, for people; "": at once
    address_acts: str = "when it is switched off and on"
    #: name of the parameter that makes a new station address take effect when it is written; "": none does
    address_trigger: str = ""
    #: text about the outputs while they are :attr:`held`
    held_hint: str = "its set point is 0 until then"
    #: orders beyond those of every drive, see :meth:`order`
    own_ops: tuple[str, ...] = ()

    def __init__(self, profile: DriveType, name: str, telegram: TelegramSpec, options: Options) -> None:
        if self.inputs[:1] != ("status",) or len(set(self.inputs)) != len(self.inputs):
            raise ValueError(f"inputs must begin with 'status' and name each word once, not {self.inputs}")
        #: name of the drive in the configuration
        self.name = name
        #: name of the drive profile, such as ``fuji-frenic``
        self.drive: str = profile.name
        #: the drive in messages about the configuration
        self.title = f"drive {name} ({profile.name})"
        #: telegram in use
        self.telegram = telegram
        #: frequency in Hz that 100 % speed means; 0: not known
        self.reference_hz = float(options.get("reference_hz", profile.reference_hz))
        #: speed in rpm that 100 % speed means; 0: not known
        self.reference_rpm = float(options.get("reference_rpm", profile.reference_rpm))
        #: octets of the parameter channel in front of the process data
        self.offset: int = CHANNEL_LEN if telegram.channel else 0
        #: octets of the outputs for every way out
        self.safe_outputs: bytes = (
            bytes(self.offset) + self.safe_control.to_bytes(2, "big").ljust(telegram.outputs, b"\0")[: telegram.outputs]
        )
        self._rotation_ns = 0  # from one call of cyclic() to the next
        self._called_at: int | None = None
        #: parameter channel; None if the telegram has none, or the drive has no parameters
        self.access: ParameterChannel | None = None
        if telegram.channel and self.parameter_table is not None:
            self.access = self.open_channel()
            self.access.notice = self.notice
        #: Reads and Writes to its slave (record 47); None until its master gives it one
        self.records: RecordQueue | None = None
        if self.record_slot is not None:  # now: later an import would hold up a running bus
            import dpstack.profile.record47.drive_access  # noqa: F401 -- for over_records()
        #: bus time of the present cycle in ns
        self.now = 0
        #: the inputs are those of a drive in data exchange
        self.online = False
        #: the process data received, 16 bits each
        self.words: tuple[int, ...] = (0,) * (telegram.inputs // 2)
        self._places = {word: place for place, word in enumerate(self.inputs[: len(self.words)])}
        self._faults: Lookup[tuple[str, ...]] = Lookup(self._faults_asked, self._ask_faults, patience_ns=PATIENCE_NS)
        self._warnings: Lookup[tuple[str, ...]] = Lookup(
            self._warnings_asked, self._ask_warnings, patience_ns=PATIENCE_NS
        )
        #: requests over ``access`` that depend on the status word; a plugin adds its own
        self.lookups: Lookups = () if self.access is None else self._message_lookups()
        #: last status word received, 16 bits
        self.status_word = 0
        #: state of the drive; OFFLINE outside data exchange
        self.state = State.OFFLINE
        #: what the control word leads to
        self.goal = Goal.IDLE
        #: set point as a part of the reference (1.0 = 100 %)
        self.setpoint = 0.0
        #: bus time of the last change of the set point, in ns
        self.setpoint_at = 0
        self._setpoint_word = 0
        self._setpoints_given = 0
        #: the process data are those of :meth:`encode_held`, as long as the drive might not understand others
        self.held = False
        #: in Clear: since when there are inputs, and what is read once
        self._watched_from: int | None = None
        self._clear_job: Steps[None] | None = None
        #: jobs during which no start begins, for people
        self._no_start: list[str] = []
        self._control = self.table.word(Goal.IDLE, State.OFFLINE)
        self._achieved = False
        #: the outputs are built again in this rotation
        self.dirty = True
        #: inputs of the last rotation, with the parameter channel; empty after :meth:`lost`
        self.last_inputs = b""
        #: outputs of the last rotation, with the parameter channel
        self.last_outputs = b""
        #: words of the inputs: ``unpack(octets, offset)``
        self.unpack: Callable[..., tuple[int, ...]] = struct.Struct(f">{telegram.inputs // 2}H").unpack_from
        #: octets of the words of the outputs: ``pack(*words)``
        self.pack: Callable[..., bytes] = struct.Struct(f">{telegram.outputs // 2}H").pack
        #: words of the outputs behind control word and set point
        self.rest: tuple[int, ...] = (0,) * (telegram.outputs // 2 - 2)
        self._orders = DriveJobs()
        #: returns plain JSON data for the application, oldest first; the master calls it in every cycle
        self.take_events: Callable[[], list[dict[str, object]]] = self._orders.take_events
        #: comparison of the drive's settings with those that the plugin relies on
        self.settings_check = SettingsCheck(self, enabled=bool(options.get(CHECK_SETTINGS, True)))
        named = None if self.parameter_table is None else self.parameter_table.named(self.address_parameter)
        label = self.address_parameter if named is None else named.label
        self._new_address = NewAddress(self.address_parameter, label, self.address_acts, self.address_trigger)
        self._last_event: tuple[object, ...] = ()  # key of the last status event
        bits = self.table.status.bits
        self._event_mask = self.table.status.mask(*(n for n in ("reached", "remote", "keypad", "warning") if n in bits))

    # -- CyclicPlugin -----------------------------------------------------------------------------------------------

    def cyclic(self, inputs: bytes, now: int) -> bytes:
        """Called just before each Data_Exchange in Operate: the last inputs, the time in ns -> the outputs.

        ``inputs`` are empty while there are no valid ones of this stay in data exchange.
        """
        self.now = now
        if self._called_at is not None:
            self._rotation_ns = now - self._called_at
        self._called_at = now
        if inputs != self.last_inputs and len(inputs) == self.telegram.input_octets:
            self.last_inputs = inputs
            self.words = self.unpack(inputs, self.offset)
            self.status_word = self.status_of(inputs[self.offset :])
            begins = not self.online
            self.online = True
            self.received()
            if begins:
                self._watched_from, self._clear_job = None, None  # what was not over in Clear waits for nothing more
                self._new_address.answered()
                self.settings_check.begin()
            for lookup in self.lookups:
                lookup.watch(self)
            self.update()
        access = self.access
        if access is not None and access.busy and self.online:
            access.step(self.last_inputs, now)
            self.dirty = True
        orders = self._orders
        if orders.jobs and (now >= orders.due_ns or self.status_word != orders.status):
            orders.step(now, self.status_word)
        if self.dirty:
            self._build()
        return self.last_outputs

    def watch(self, inputs: bytes, now: int) -> None:
        """Called in Clear before each Data_Exchange, where no outputs go out: report what would refuse a start, as far
        as the status word shows it, or record 47, which needs no outputs.
        """
        self.now = now
        if len(inputs) != self.telegram.input_octets:
            self._watched_from, self._clear_job = None, None
        elif self._watched_from is None:
            self._watched_from = now
        elif self._clear_job is None and now >= self._watched_from + _CLEAR_NS:
            self._clear_job = self._look_in_clear(inputs)
        if self._clear_job is not None:
            next(self._clear_job, None)

    def _look_in_clear(self, inputs: bytes) -> Steps[None]:
        self.words = self.unpack(inputs, self.offset)
        self.status_word = self.status_of(inputs[self.offset :])
        if (why := self.refused_in_clear()) is not None:
            self.notice(f"{why}; start is refused until then")
        comparison = self.settings_check.in_clear()
        if comparison is not None:
            yield from comparison

    def lost(self, now: int) -> None:
        """The slave left data exchange, or outputs went to their safe values: pending orders end with a reason.

        An order that stops the drive keeps its control word for the return, unless the drive had stopped.
        """
        self.now = now
        self.online = False
        self._called_at = None
        self._watched_from, self._clear_job = None, None
        self._orders.end(CommandError("lost", "the drive left data exchange"))
        if self.access is not None:
            self.access.reset()
        for lookup in self.lookups:
            lookup.reset()
        self.settings_check.reset()
        self.last_inputs = b""
        if self.goal in _STOPPING and self.state in _MAY_TURN:
            self.update()
        else:
            self.set_goal(Goal.IDLE)
        self.state = State.OFFLINE
        self._tell_status()
        self._build()

    def moved(self, address: int) -> str | None:
        """See :class:`CyclicPlugin`."""
        return self._new_address.where(address)

    def command(self, op: str, args: Mapping[str, object], token: int, now: int) -> None:
        """An order of the application in plain JSON data; its result is an event that carries ``token``.

        A drive that is not yet in data exchange keeps the order until it is, or until the order's time is over.
        """
        self.now = now
        checked = Args(op, args)
        try:
            steps = self._steps(op, checked)
            checked.done()
        except CommandError as error:
            self._orders.failed(token, error)
            return
        self._orders.begin(DriveJob(op, token, steps, motion=op in _MOTION))

    # -- for the application in the same process ------------------------------------------------------------------

    def status(self) -> DriveStatus:
        online = self.online
        speed, current, torque = self.measured() if online else (None, None, None)
        if self.settings_check.differs(Use.SCALE) is not None:
            speed = None
        word = self.status_word if online else 0
        bits = self.table.status
        return DriveStatus(
            state=self.state,
            running=self.state is State.RUNNING,
            reached=bits.is_set(word, "reached") if "reached" in bits.bits else _near(self, speed),
            remote=self.remote(word),
            setpoint=self.setpoint,
            speed=speed,
            frequency_hz=speed * self.reference_hz if speed is not None and self.reference_hz else None,
            speed_rpm=speed * self.reference_rpm if speed is not None and self.reference_rpm else None,
            current=current,
            torque=torque,
            warnings=self.warnings() if online else (),
            faults=self.faults() if online else (),
            words=self.words if online else (),
            bits=bits.names(word),
            reference_hz=self.reference_hz or None,
            reference_rpm=self.reference_rpm or None,
            settings=self.settings_check.state,
            settings_texts=self.settings_check.texts,
        )

    def read_inputs(self, inputs: bytes, control: int | None) -> DriveStatus:
        """The status in ``inputs`` of the telegram's length, for a program that only listens: no order begins.

        ``control``: the control word that another master sent last, None if it is not known.
        """
        self.online = True
        self.words = self.unpack(inputs, self.offset)
        self.status_word = word = self.status_of(inputs[self.offset :])
        self.received()
        self.state = self.table.states.decode(word) if control is None else self.table.state(word, control)
        self.take_events()
        return self.status()

    def faults(self) -> tuple[str, ...]:
        """The present faults by name."""
        if self.raw_state not in FAULTED:
            return ()
        texts = self.fault_texts()
        return (NOT_NAMED,) if texts is None else texts

    # -- for jobs and plugins -------------------------------------------------------------------------------------

    def may_turn(self) -> str | None:
        """Why the motor may turn, or be about to, for people; None if it stands and nothing starts it."""
        if self.goal is Goal.RUN or self._orders.runs("start"):
            return "a start was ordered"
        if self.state in MOVING:
            return f"the drive is {self.state}"
        if self.state in (State.UNKNOWN, State.OFFLINE):
            return "nobody knows whether the motor turns"
        speed = self.measured()[0]
        return None if speed is None or abs(speed) <= _STILL else f"the motor turns at {speed:.1%}"

    @contextlib.contextmanager
    def without_start(self, what: str) -> Iterator[None]:
        """A start that is ordered meanwhile waits until ``what`` is over."""
        self._no_start.append(what)
        try:
            yield
        finally:
            self._no_start.remove(what)

    def in_data_exchange(self, deadline: int) -> Steps[None]:
        """Wait for data exchange. Raises CommandError."""
        while not self.online:
            if self.now >= deadline:
                raise CommandError("lost", "the drive is not in data exchange")
            yield

    def free_to_start(self, deadline: int) -> Steps[None]:
        """Wait until no job keeps a start from beginning. Raises CommandError."""
        while self._no_start:
            if self.now >= deadline:
                raise CommandError("timeout", f"{self._no_start[0]} is not over")
            yield

    def label_of(self, key: ParamKey) -> str:
        """The parameter for people."""
        spec = self._spec(key)
        return f"parameter {key.name}" if spec is None else spec.label

    def use_of(self, key: ParamKey) -> Use:
        """The use of the parameter to the plugin, by its table or by a setting that refuses a start."""
        spec = self._spec(key)
        if spec is not None and spec.use is not Use.NONE:
            return spec.use
        keys = (one for setting in self.all_settings() if setting.refuse for one in setting.keys)
        return Use.SETTING if any(self.same_parameter(key, one) for one in keys) else Use.NONE

    def acts_of(self, key: ParamKey) -> str:
        """When a write counts, see :class:`ParamSpec`."""
        spec = self._spec(key)
        return "" if spec is None else spec.acts

    def applier_of(self, key: ParamKey) -> str | None:
        """The name of the parameter if a write of it makes others count, else None."""
        spec, table = self._spec(key), self.parameter_table
        return spec.name if spec is not None and table is not None and spec.name in table.applies else None

    def same_parameter(self, one: ParamKey, other: ParamKey) -> bool:
        """Data sets and elements aside."""
        return self.place_of(one) == self.place_of(other)

    def _spec(self, key: ParamKey) -> ParamSpec | None:
        table = self.parameter_table
        return None if table is None else table.get(*self.place_of(key))

    @property
    def settle_ns(self) -> int:
        """After this time the inputs belong to the outputs given now, in ns: three scans of the drive, and three
        rotations (outputs leave, inputs come, their turn here), 20 ms at least.
        """
        return 3 * self.scan_ns + max(3 * self._rotation_ns, _LEAST_NS)

    def answers_until(self, deadline: int) -> int:
        """Until when a start may wait for answers of the parameter channel: the rest is for the way to RUNNING."""
        left = deadline - self.now
        return deadline - min(max(NS_PER_S, 4 * self.settle_ns), 3 * left // 4)

    @property
    def raw_state(self) -> State:
        """State by the status word alone."""
        return self.table.states.decode(self.status_word) if self.online else State.OFFLINE

    def set_goal(self, goal: Goal) -> None:
        """Work towards ``goal`` from now on."""
        if goal is not self.goal:
            self.goal = goal
            self._achieved = False
        self.update()

    def achieved(self) -> None:
        """RUN was reached: when the drive leaves it by itself, the master does not start it again."""
        self._achieved = True

    def update(self) -> None:
        """Derive state and control word from the status word and the goal; emit a status event on changes."""
        if self.online:
            status = self.status_word
            raw = self.table.states.decode(status)
            if (
                self._achieved
                and self.goal is Goal.RUN
                and self.table.state(status, self._control) is not State.RUNNING
            ):
                self._achieved = False
                self.goal = Goal.IDLE
                self.spawn("left", _left(self))
            control = self.table.word(self.goal, raw)
            self.state = self.table.state(status, control)
        else:
            control = self.table.word(self.goal, State.OFFLINE)
        control |= self.control_bits()
        if control != self._control:
            self._control = control
            self.dirty = True
        if self.online:
            self._tell_status()

    def change_words(self, table: ControlTable) -> None:
        """Use the words of ``table``; the control word that is out is replaced, and not judged by them."""
        self.table = table
        self._control = table.word(self.goal, self.raw_state) | self.control_bits()
        self.dirty = True

    def notice(self, text: str) -> None:
        """Report ``text`` to the application, one line."""
        self._orders.tell({"type": "notice", "text": text})

    def sleep_until(self, due_ns: int) -> None:
        """For the job that runs, just before it yields: resume it at ``due_ns``, or when the status word changes."""
        self._orders.sleep_until = due_ns

    def spawn(self, op: str, steps: Steps[dict[str, object]]) -> None:
        """Run a job without a result event; its failure is silent."""
        self._orders.spawn(DriveJob(op, None, steps, motion=False))

    def set_speed(self, fraction: float) -> None:
        """The set point of the next rotation. Raises CommandError with the range."""
        try:
            word = self.setpoint_word(fraction)
        except ValueError as error:
            raise CommandError("usage", str(error)) from None
        if fraction != self.setpoint:
            self.setpoint = fraction
            self.setpoint_at = self.now
        self._setpoint_word = word
        self._setpoints_given += 1
        self.dirty = True
        self.update()

    def has_setpoint(self, fraction: float) -> bool:
        """Whether the drive gets exactly this set point already, so that an order for it would change nothing."""
        if not self.online or fraction != self.setpoint or self.held:
            return False
        if self._orders.jobs and any(job.op in _IN_UNITS for job in self._orders.jobs):
            return False  # one that waits for its reference ends when another set point is given
        try:
            return self.setpoint_word(fraction) == self._setpoint_word and (not fraction or not self.refuses_setpoint())
        except ValueError:
            return False

    def known_reference(self, unit: str) -> float:
        """What 100 % speed means in ``unit``, Hz or rpm. Raises CommandError if nobody knows it."""
        name = f"reference_{unit.lower()}"
        known: float = getattr(self, name)
        if not known:
            raise CommandError("usage", f"nobody knows how many {unit} 100 % is: give the drive its option {name}")
        return known

    def stand_still(self, deadline: int) -> Steps[None]:
        """Send the idle control word and the set point 0, until the drive has seen them."""
        self.set_goal(Goal.IDLE)
        self.setpoint, self._setpoint_word = 0.0, 0
        self.setpoint_at = self.now
        self.dirty = True
        yield from settled(self, lambda: False, deadline)

    # -- hooks for a plugin -------------------------------------------------------------------------------------

    def cannot(self, op: str) -> str | None:
        """Why an order that moves the drive can never be carried out as things are configured; None if it can."""
        return None

    def learns_reference(self, unit: str) -> bool:
        """Whether the drive itself will say what 100 % is in ``unit``, Hz or rpm, and has not said it yet."""
        return False

    def order(self, op: str, args: Args) -> Steps[dict[str, object]] | None:
        """An order of this drive's own (named in ``own_ops``), not begun yet. Raises CommandError."""
        return None

    def safe(self, configured: bytes) -> bytes:
        """See :class:`CyclicPlugin`."""
        return configured

    def status_of(self, process: bytes) -> int:
        """The status word in the process data received."""
        return self.words[0]

    def encode(self, control: int, setpoint: int) -> bytes:
        """The process data to send, as many octets as the telegram has."""
        return self.pack(control, setpoint, *self.rest)

    def decode(self, process: bytes) -> tuple[int | None, float | None]:
        """The reverse of :meth:`encode`, for a program that only listens: the control word, and the set point of the
        reference; None if ``process`` does not have them.
        """
        words = struct.unpack_from(f">{len(process) // 2}H", process)
        return words[0] if words else None, self.scale.decode(words[1]) if len(words) > 1 else None

    def parameter(self, number: int, index: int) -> ParamSpec | None:
        """A parameter by its number and index in the parameter channel or in record 47."""
        table = self.parameter_table
        return None if table is None else table.get(number, index) or table.get(number)

    def received(self) -> None:
        """``words`` are new: decode the fields that the table does not have."""

    def control_bits(self) -> int:
        """Bits of the control word besides those that the goal asks for (selectors, direction)."""
        return 0

    def setpoint_word(self, fraction: float) -> int:
        """The set point of ``fraction`` of the reference as its word. Raises ValueError with the range."""
        return self.scale.encode(fraction)

    def remote(self, word: int) -> bool | None:
        """Whether the drive follows the bus by its status word; None if no bit says it."""
        status = self.table.status
        return status.is_set(word, "remote") if "remote" in status.bits else None

    def word(self, name: str) -> int | None:
        """The word of the process data called ``name`` in ``inputs``; None if the telegram does not reach it."""
        place = self._places.get(name)
        return None if place is None else self.words[place]

    def measured(self) -> tuple[float | None, float | None, float | None]:
        """Speed of the reference, current and torque of the rated ones, as far as they are in the process data."""
        current, torque = (_decoded(self.current_scale, self.word(name)) for name in ("current", "torque"))
        return _decoded(self.scale, self.word("speed")), current, torque

    def fault_texts(self) -> tuple[str, ...] | None:
        """The fault that stands in the status word, by name; None while the drive has not yet named it."""
        number = self.word("fault")
        if number is not None:
            return (self.fault_text(number),) if number else None
        if self.fault_parameter is not None and self.access is not None:
            return self._faults.value
        channel = "" if self.fault_parameter is None else ", and it has no parameter channel"
        return (f"{NO_NAME}: telegram {self.telegram.name} does not carry it{channel}",)

    def fault_text(self, number: int) -> str:
        """The text of the fault with this number."""
        return self.fault_names.get(number) or self.unknown_fault.format(number)

    def warnings(self) -> tuple[str, ...]:
        """The present warnings by name."""
        word = self.word("warning")
        return self._warnings.value or () if word is None else self.warning_texts(word)

    def warning_texts(self, value: int) -> tuple[str, ...]:
        """The texts of the warnings in a warning word, or of the warning with this number; none for 0."""
        if self.warning_numbers:
            unknown, found = self.unknown_warning or "number {}", [value] if value else []
        else:
            unknown = self.unknown_warning or "bit {}"
            found = [bit for bit in range(value.bit_length()) if value >> bit & 1]
        return tuple(self.warning_names.get(one) or unknown.format(one) for one in found)

    def open_channel(self) -> ParameterChannel:
        """The master's end of the telegram's parameter channel."""
        if isinstance(self.dialect, IndexedDialect):
            return IndexedChannel(self.dialect, self, self.resolve)
        return PkwAccess(self.dialect, self)

    def over_records(self, queue: RecordQueue) -> AcyclicAccess | None:
        """Parameter access over record 47 by the services in ``queue``; None for a drive without record 47."""
        if self.record_slot is None or self.parameter_table is None:
            return None
        from dpstack.profile.record47.client import PLUGIN, ParameterClient
        from dpstack.profile.record47.drive_access import AcyclicAccess, plain_places

        places = plain_places(self.parameter_table, self.drive)
        messages = self._message_lookups()
        self.lookups = (*messages, *(one for one in self.lookups if one not in messages))
        client = ParameterClient(self.record_slot, object=self.record_object, references=PLUGIN)
        return AcyclicAccess(client, queue, places, self)

    def resolve(self, key: ParamKey) -> ParamRef:
        """Find the parameter that a user has named, for the parameter channel. Raises CommandError."""
        assert self.parameter_table is not None
        return plain_ref(key, self.parameter_table, self.drive, self.dialect)

    def place_of(self, key: ParamKey) -> tuple[int, int]:
        """Number and index of the parameter that a user has named, as ``parameter_table`` has them. Raises
        CommandError."""
        assert self.parameter_table is not None
        spec = key.spec_in(self.parameter_table)
        return (int(key.name), 0) if spec is None else (spec.number, spec.index)

    def written(self, ref: ParamRef) -> None:
        """The drive has taken a write over the parameter channel."""

    def before_applied(self, name: str, deadline: int) -> Steps[None]:
        """Before the parameter ``name`` is written, which makes others count. Raises CommandError."""
        yield from ()

    def parameters(self) -> tuple[ListedParam, ...]:
        """The drive's parameters in the order of its table: what a dump reads (see ``listing``)."""
        return () if self.parameter_table is None else listing(self.parameter_table)

    def obstacle(self) -> str | None:
        """The reason in the status word why the drive cannot run, with the remedy; or None."""
        return None

    def refused_in_clear(self) -> str | None:
        """:meth:`obstacle` as far as the status word has it while all outputs are 0; or None."""
        return None

    def why_left(self) -> Steps[str | None]:
        """Why the drive left RUNNING by itself without a fault; or None."""
        yield from ()
        return self.obstacle()

    def prepare(self, deadline: int) -> Steps[None]:
        """Before a start: find out what would make it fail, and raise CommandError with the remedy."""
        yield from ()

    def before_acknowledge(self, deadline: int) -> Steps[None]:
        """Before an acknowledgement: raise CommandError if the drive would take its bit for something else."""
        yield from ()

    def halted(self, deadline: int) -> Steps[None]:
        """An order that stops the drive was carried out: choose the control word from now on."""
        yield from ()

    def wanted_speed(self) -> float:
        """The speed, of the reference, at which the set point is reached."""
        return self.setpoint

    def settings(self) -> Sequence[Setting]:
        """The settings of the drive that the plugin relies on, with its present options and maps."""
        return ()

    def all_settings(self) -> Sequence[Setting]:
        """:meth:`settings`, and those of a common base of plugins."""
        return self.settings()

    def settings_judged(self) -> None:
        """The settings were compared, as far as they could be read."""

    def refuses_setpoint(self) -> str | None:
        """Why no set point is accepted now, nor a start; or None."""
        return None

    def encode_held(self) -> bytes:
        """The process data to send while they are :attr:`held`."""
        return self.encode(self._control, 0)

    def before_settings(self, deadline: int) -> Steps[None]:
        """Before the settings are read: find out where they are (the active data set). Raises CommandError."""
        yield from ()

    # -- inside ---------------------------------------------------------------------------------------------------

    def _message_lookups(self) -> Lookups:
        """The requests for faults and warnings that the telegram does not have."""
        asked = ((self.fault_parameter, "fault", self._faults), (self.warning_parameter, "warning", self._warnings))
        return tuple(lookup for parameter, word, lookup in asked if parameter is not None and word not in self._places)

    def _faults_asked(self) -> bool:
        return self.raw_state in FAULTED

    def _ask_faults(self, deadline: int) -> Steps[tuple[str, ...]]:
        assert self.fault_parameter is not None
        try:
            numbers = yield from read_messages(self, self.fault_parameter, deadline)
        except CommandError as error:
            if error.kind in ("timeout", "lost"):
                raise
            return (f"{NO_NAME}: {error.text}",)
        return tuple(map(self.fault_text, numbers))

    def _warnings_asked(self) -> bool:
        return self.online and self.table.status.is_set(self.status_word, "warning")

    def _ask_warnings(self, deadline: int) -> Steps[tuple[str, ...]]:
        assert self.warning_parameter is not None
        try:
            values = yield from read_messages(self, self.warning_parameter, deadline)
        except CommandError as error:
            if error.kind in ("timeout", "lost"):
                raise
            return (f"{NO_NAME}: {error.text}",)
        return tuple(text for value in values for text in self.warning_texts(value))

    def _build(self) -> None:
        self.dirty = False
        data = self.encode_held() if self.held else self.encode(self._control, self._setpoint_word)
        access = self.access
        if access is not None:
            data = access.octets + data
        elif self.offset:
            data = bytes(self.offset) + data
        self.last_outputs = data

    def _tell_status(self) -> None:
        """A status event when state, remote, reached, warnings or faults changed."""
        check = self.settings_check
        key: tuple[object, ...] = (self.state,)
        if self.online:
            word = self.status_word & self._event_mask
            key = (self.state, word, self.faults(), self.warnings(), check.state, check.texts)
        if key != self._last_event:
            self._last_event = key
            self._orders.tell({"type": "status", **self.status().as_dict()})

    def _steps(self, op: str, args: Args) -> Steps[dict[str, object]]:
        """The job of the order ``op``. Raises CommandError."""
        if op in _MOTION and (why := self.cannot(op)) is not None:
            raise CommandError("usage", why)
        deadline = self.now + args.timeout_ns(_TIMEOUTS.get(op, 0))  # every order may come with one
        match op:
            case "start":
                return _start(self, deadline)
            case "stop" | "quick_stop" | "coast":
                return _halt(self, op, deadline)
            case "acknowledge":
                return _acknowledge(self, deadline)
            case "speed":
                return self._speed(args.number("value"))
            case "frequency":
                return self._speed_in("Hz", args.number("value"), deadline)
            case "rpm":
                return self._speed_in("rpm", args.number("value"), deadline)
            case "reached":
                return _reached(self, deadline, args.optional("tolerance"))
            case "settled":
                return _settled(self, deadline)
            case "read" | "write" | "read_many":
                return _parameter_steps(self, op, args, deadline)
            case "cancel":
                return self._cancel(args.integer("order"))
        steps = self.order(op, args)
        if steps is None:
            known = ", ".join((*OPS, *self.own_ops))
            raise CommandError("usage", f"{self.drive} has no order {op!r}; it has {known}")
        return steps

    def _cancel(self, token: int | None) -> Steps[dict[str, object]]:
        """End the order with ``token`` now, so that a start() does not take effect later."""
        yield from ()
        return {"value": self._orders.cancel(token)}

    def _speed_in(self, unit: str, value: float, deadline: int) -> Steps[dict[str, object]]:
        """A set point in ``unit``, whose reference the drive may have to say first: it never overtakes a later one."""
        if not self.learns_reference(unit):
            return self._speed(value / self.known_reference(unit))
        return self._speed_when_known(unit, value, deadline)

    def _speed_when_known(self, unit: str, value: float, deadline: int) -> Steps[dict[str, object]]:
        given = self._setpoints_given
        while self.learns_reference(unit) and self.now < deadline:
            yield
        if given != self._setpoints_given:
            raise CommandError("usage", "another set point was given before the drive had said what 100 % is")
        return (yield from self._speed(value / self.known_reference(unit)))

    def _speed(self, fraction: float) -> Steps[dict[str, object]]:
        yield from ()
        if fraction and (why := self.refuses_setpoint()) is not None:
            raise CommandError("fault", why)
        self.set_speed(fraction)
        rpm = {"speed_rpm": fraction * self.reference_rpm} if self.reference_rpm else {}
        hz = {"frequency_hz": fraction * self.reference_hz} if self.reference_hz else {}
        return {"value": fraction, **hz, **rpm}


# --- the orders that move a drive ---
def _start(core: DriveCore, deadline: int) -> Steps[dict[str, object]]:
    """Walk to RUNNING. On any failure the goal falls back to IDLE: a drive never starts later by surprise."""
    try:
        yield from core.in_data_exchange(deadline)
        yield from core.free_to_start(deadline)
        yield from settled(core, lambda: core.raw_state not in FAULTED, deadline)
        if core.raw_state in FAULTED:
            text = yield from _fault_text(core, deadline)
            raise CommandError("fault", f"{text}; acknowledge it first")
        yield from core.prepare(deadline)
        yield from core.settings_check.known(deadline)
        if core.held:
            why = f"the drive's process data map has not been read yet: {core.held_hint}; give start more time"
            raise CommandError("timeout", why)
        # a status word that says running already may be older than our last stop
        trust = core.now + (core.settle_ns if core.raw_state in MOVING else 0)
        core.set_goal(Goal.RUN)
        since: int | None = None
        while core.state is not State.RUNNING or core.now < trust:
            if core.raw_state in FAULTED:
                raise CommandError("fault", (yield from _fault_text(core, deadline)))
            if core.now >= deadline:
                raise CommandError(
                    "timeout", core.obstacle() or f"the drive reports {core.raw_state}, not running{core.start_hint}"
                )
            if core.obstacle() is None:
                since = None
            elif since is None:
                since = core.now
            elif core.now >= since + core.settle_ns:
                yield from core.prepare(deadline)  # raises when it is there to stay
                since = None
            yield
    except BaseException:
        core.set_goal(Goal.IDLE)
        raise
    core.achieved()
    return {"value": str(core.state)}


def _halt(core: DriveCore, op: str, deadline: int) -> Steps[dict[str, object]]:
    """Ramp, quick stop or coast; done when the drive reports that the power stage is off."""
    core.set_goal(_GOALS[op])
    yield from core.in_data_exchange(deadline)
    trust = core.now + core.settle_ns
    while core.state in MOVING or core.now < trust:
        if core.now >= deadline:
            speed = core.status().speed
            still = "" if speed is None else f" at {speed:.1%}"
            raise CommandError("timeout", f"the drive still reports {core.raw_state}{still}")
        yield
    value = str(core.state)
    yield from core.halted(deadline)
    return {"value": value}


def _acknowledge(core: DriveCore, deadline: int) -> Steps[dict[str, object]]:
    """Edges of the acknowledge bit until the fault is gone; a drive may lock it for a while."""
    yield from core.in_data_exchange(deadline)
    yield from settled(core, lambda: core.raw_state in FAULTED, deadline)
    if core.raw_state not in FAULTED:
        return {"value": str(core.state)}
    yield from core.before_acknowledge(deadline)
    try:
        while core.raw_state in FAULTED:
            for goal in (Goal.ACK_HIGH, Goal.ACK_LOW):
                core.set_goal(goal)
                until = core.now + core.settle_ns
                while core.now < until:
                    yield
            if core.now >= deadline and core.raw_state in FAULTED:
                text = f"fault {', '.join(core.faults()) or NO_NAME}"
                raise CommandError("fault", f"{text} cannot be acknowledged{core.lock_hint}")
    finally:
        core.set_goal(Goal.IDLE)
    return {"value": str(core.state)}


def _reached(core: DriveCore, deadline: int, tolerance: float | None) -> Steps[dict[str, object]]:
    """The drive says that it has reached its reference, and its actual speed (if it sends one) agrees within 2 % of
    the reference. With ``tolerance``, or if the drive has no bit for it: by its speed alone.
    """
    yield from core.in_data_exchange(deadline)
    if tolerance is None and "reached" not in core.table.status.bits:
        tolerance = _CLOSE
    if tolerance is not None and core.measured()[0] is None:
        raise CommandError("usage", "the drive does not report its speed, so nobody knows when it is reached")
    while True:
        if core.raw_state in FAULTED:
            raise CommandError("fault", (yield from _fault_text(core, deadline)))
        if core.state is not State.RUNNING and core.goal is not Goal.RUN:
            raise CommandError("usage", f"the drive is not running (it reports {core.state}): start it first")
        if (other := core.settings_check.differs(Use.SCALE)) is not None:
            raise CommandError("fault", f"nobody knows whether it is reached: {other}")
        status = core.status()
        speed = status.speed
        off = None if speed is None else abs(speed - core.wanted_speed())
        if tolerance is not None:
            done = off is not None and off <= tolerance
        else:
            # the bit may still belong to the last set point
            near = off is not None and off <= 0.001
            done = status.reached and (near or core.now >= core.setpoint_at + core.settle_ns)
            done = done and (off is None or off <= _BELIEVED)
        if done and status.running:
            return {"value": speed}
        if core.now >= deadline:
            at = "" if speed is None else f", at {speed:.1%}"
            if tolerance is None and status.reached:
                at += (
                    f" (the drive itself reports its set point as reached; more than {_BELIEVED:.0%} of the reference "
                    "lie between: are scale and source of the set point right, or is it limited?)"
                )
            raise CommandError("timeout", f"{core.wanted_speed():.1%} not reached{at}")
        yield


def _settled(core: DriveCore, deadline: int) -> Steps[dict[str, object]]:
    """Wait until the inputs belong to the present outputs, and a fault has its name if the drive gives one."""
    yield from core.in_data_exchange(deadline)
    yield from settled(core, lambda: False, deadline)
    if core.raw_state in FAULTED:
        yield from _fault_text(core, deadline)
    return {"value": str(core.state)}


def _near(core: DriveCore, speed: float | None) -> bool:
    """Running, and with this speed close to its set point."""
    return core.state is State.RUNNING and speed is not None and abs(speed - core.wanted_speed()) <= _CLOSE


def _left(core: DriveCore) -> Steps[dict[str, object]]:
    """Report why the drive left RUNNING by itself, as soon as the fault has a name."""
    if core.raw_state in FAULTED:
        why = yield from _fault_text(core, core.now + PATIENCE_NS)
    else:
        reports = f"it reports {core.raw_state}"
        why = (yield from core.why_left()) or reports
    core.notice(f"left the running state by itself: {why}; it stays off until the next start")
    return {}


def _decoded(scale: Scale, word: int | None) -> float | None:
    return None if word is None else scale.decode(word)


def settled(core: DriveCore, wanted: Callable[[], bool], deadline: int) -> Steps[None]:
    """Wait until ``wanted()`` is true, at most until the inputs belong to the present outputs."""
    until = min(core.now + core.settle_ns, deadline)
    while not wanted() and core.now < until:
        yield


def _fault_text(core: DriveCore, deadline: int) -> Steps[str]:
    """The fault's text; some drives send its number only some cycles later, others are asked for it."""
    by_parameter = core.fault_parameter is not None and core.access is not None
    until = deadline if by_parameter else min(core.now + 4 * core.settle_ns, deadline)
    while core.raw_state in FAULTED and core.fault_texts() is None and core.now < until:
        yield
    return f"fault {', '.join(core.faults()) or NO_NAME}"


# --- orders over the parameter channel ---
def _parameter_steps(core: DriveCore, op: str, args: Args, deadline: int) -> Steps[dict[str, object]]:
    """The job of one of the orders :data:`_PARAMETERS`. Raises CommandError."""
    access = core.access
    if access is None:
        raise CommandError("usage", f"{core.telegram.name} of {core.drive} has no parameter channel")
    if op == "read_many":
        return _several(access, [_listed(one) for one in args.tables("parameters")], deadline)
    number, data_set, index = args.name_or_number("number"), args.integer("data_set"), args.integer("index")
    if op == "read":
        return access.read(ParamKey(number, data_set, index), deadline)
    key = ParamKey(number, data_set, index, args.flag("ram"))
    return _written(core, guarded_write(core, access, key, args.number("value"), deadline))


def _written(core: DriveCore, writing: Steps[dict[str, object]]) -> Steps[dict[str, object]]:
    outcome = yield from writing
    core._new_address.written(outcome)
    return outcome


def _listed(one: Args) -> ParamKey:
    key = ParamKey(one.name_or_number("number"), one.integer("data_set"), one.integer("index"))
    one.done()
    return key


def _several(access: ParameterChannel, keys: list[ParamKey], deadline: int) -> Steps[dict[str, object]]:
    return {"values": (yield from access.read_many(keys, deadline))}
