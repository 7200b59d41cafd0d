"""``Slave``: state, diagnosis, process data and records of a slave."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Collection, Iterator, Mapping
from typing import TYPE_CHECKING, TypeVar, Unpack, overload

from dpstack import argcheck
from dpstack.api.config.slave import Changes, SlaveConfig, changed
from dpstack.api.slave.alarms import AlarmStream, SlaveSubscription, subscriptions
from dpstack.api.slave.host import TOKENS, Host
from dpstack.api.slave.records import RecordAccess, RecordWay
from dpstack.api.streams import Reader
from dpstack.argcheck import Sealed, instance, plain_function
from dpstack.dp.field_map import ReadValues
from dpstack.dp.master import fault_texts
from dpstack.dp.master.commands import ActivateSlave, DeactivateSlave, DriveCommand, Mode, ReparameteriseSlave
from dpstack.dp.master.events import Fault, SlaveState
from dpstack.dp.master.scanner import Found
from dpstack.dp.master.slave_reports import AlarmCounts
from dpstack.dp.pdu.alarm_blocks import Status
from dpstack.dp.pdu.diag_texts import conspicuous_text
from dpstack.dp.pdu.diagnosis import Diagnosis, SlaveView
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.process_image import Value, inputs_are_valid, inputs_limit_ns
from dpstack.dp.slave_params import SlaveParams
from dpstack.dp.slot_map import Direction
from dpstack.dpv1.master.alarm_orders import need_dpv1
from dpstack.drivers.futures import run_through_cancellation
from dpstack.drivers.snapshots import ImageSnapshot, SlaveSnapshot
from dpstack.errors import DpError, SlaveFault, SlaveTimeout, UsageError
from dpstack.text import did_you_mean, nearest, octets_text
from dpstack.units import ns_to_s

if TYPE_CHECKING:
    from dpstack.api.slave.device_orders import DeviceOrders
    from dpstack.api.slave.quality import QualifiedValue, SlaveQuality
    from dpstack.api.slave.typed import Inputs, Outputs
    from dpstack.dp.process_data import Field
    from dpstack.drivers.snapshots import View
    from dpstack.plant.quality import Quality

T = TypeVar("T", bool, int, float, bytes)
In = TypeVar("In", bound="Inputs")
Out = TypeVar("Out", bound="Outputs")


def sent_outputs(setup: SlaveParams, wanted: bytes, mode: Mode, *, exchanging: bool) -> bytes:
    """The outputs that the master sends to a slave whose application has set ``wanted``: these in Operate, zeros in
    Clear (none to a Fail_Safe slave), none outside data exchange."""
    match mode:
        case Mode.OPERATE if exchanging:
            return wanted
        case Mode.CLEAR if exchanging and not setup.fail_safe:
            return bytes(len(wanted))
    return b""


class Slave(Sealed, RecordAccess):
    """One slave of a bus: inputs, outputs, state, diagnosis. Made by the bus, see ``Bus.slave``."""

    #: the slave's table of the configuration
    config: SlaveConfig

    def __init__(
        self,
        bus: Host,
        config: SlaveConfig,
        setup: SlaveParams,
        *,
        has_plugin: bool,
        device_orders: DeviceOrders | None = None,
    ) -> None:
        self._bus = bus
        self._setup = setup
        self._device_orders = device_orders
        self._has_plugin = has_plugin
        #: a device file makes its outputs, with words among them that a program may set by name
        self.has_free_words = has_plugin and bool(config.output_fields)
        self.config = config
        self._quality: SlaveQuality | None = None
        self._seal(Slave)

    def _sealed_name(self) -> str:
        return self.who

    @property
    def who(self) -> str:
        """Address and name, for texts."""
        return self._setup.who

    def _no_attribute(self, name: str, *, method: bool) -> str:
        """Named outputs are items, not attributes."""
        near = nearest(name, self.config.output_fields)
        if near and not method:
            return f"{self._sealed_name()} has no attribute {name!r}: write slave[{near!r}] = ..."
        return super()._no_attribute(name, method=method)

    def _read_hint(self, name: str) -> str:
        """Named process data are items, not attributes."""
        near = nearest(name, self, 0.8)
        return f": write slave[{near!r}]" if near else super()._read_hint(name)

    def __repr__(self) -> str:
        return f"<Slave {self.address} {self.name!r} {self.state.value}>"

    @property
    def address(self) -> int:
        """station address, 0..126"""
        return self._setup.address

    @property
    def name(self) -> str:
        """The name in the configuration."""
        return self._setup.name

    @property
    def setup(self) -> SlaveParams:
        """The parameters that the master sends to the slave."""
        return self._setup

    @property
    def snapshot(self) -> SlaveSnapshot:
        """The last snapshot of the slave from its master."""
        return self._bus.view.slave(self.address)

    @property
    def process_quality(self) -> SlaveQuality:
        """The judge of the quality of its process data."""
        if self._quality is None:
            from dpstack.api.slave.quality import SlaveQuality  # here, as a program may have no named values

            self._quality = SlaveQuality(self)
        return self._quality

    @property
    def image(self) -> ImageSnapshot:
        """Inputs and outputs of one exchange, as its master has them."""
        return self._bus.view.image(self._setup)

    @property
    def state(self) -> SlaveState:
        """The state in which the master has the slave; on a read-only bus the state by its diagnosis.

        OFFLINE while the bus does not run (its bus process was killed, or is stopped). After the end of the bus, for
        reports, the one in which the slave was; ``inputs_valid`` is false then.
        """
        if self._bus.runtime.not_running is not None and not self.deactivated:
            return SlaveState.OFFLINE
        found = self.found
        if found is None:
            return self.snapshot.state
        if found.ident is not None and self.setup.is_other_ident(found.ident):
            return SlaveState.FAULT
        exchanging = found.state is SlaveView.DATA_EXCHANGE
        return SlaveState.DATA_EXCHANGE if exchanging else SlaveState.DIAGNOSIS

    @property
    def found(self) -> Found | None:
        """On a read-only bus the station found at the slave's address: type, ident, state, master."""
        view = self._bus.view
        found = view.bus().found if view.read_only else None
        return None if found is None else found.get(self.address)

    @property
    def deactivated(self) -> bool:
        """True from :meth:`deactivate` to :meth:`activate`."""
        return self.snapshot.state is SlaveState.DEACTIVATED

    @property
    def synced(self) -> bool:
        """True while the slave is in SYNC by an order of this master."""
        return self.address in self._bus.view.bus().synced

    @property
    def frozen(self) -> bool:
        """True while the slave is in FREEZE by an order of this master."""
        return self.address in self._bus.view.bus().frozen

    @property
    def ready_now(self) -> bool:
        """True while the slave is in data exchange."""
        return self.state is SlaveState.DATA_EXCHANGE

    @property
    def fault(self) -> Fault | None:
        """The cause why the slave is not in data exchange; None without a fault, and while the cause is not known."""
        bus = self._bus.view.bus()
        if bus.found is None:
            return self.snapshot.fault
        found = self.found
        if found is None:
            return fault_texts.absent(self.address, self._bus.params.baud) if bus.found_all else None
        if self.state is SlaveState.FAULT and found.ident is not None:
            return fault_texts.wrong_ident(self.setup.ident, found.ident)
        return None

    @property
    def diagnosis(self) -> Diagnosis | None:
        """The last diagnosis read, with the bits that a master sets (Station_Non_Existent, Deactivated ...)."""
        found = self.found
        return self.snapshot.diagnosis if found is None else found.diagnosis

    @property
    def diagnosis_texts(self) -> tuple[str, ...]:
        """The texts of :attr:`diagnosis`, one line each: bits, then blocks with the texts of the GSD file."""
        diagnosis = self.diagnosis
        return () if diagnosis is None else diagnosis.texts + self.block_texts

    @property
    def conspicuous(self) -> str:
        """The unusual flags and the texts of :attr:`diagnosis` in one line; empty without any."""
        diagnosis = self.diagnosis
        return "" if diagnosis is None else self.conspicuous_text(diagnosis, exchanging=self.ready_now)

    def conspicuous_text(self, diagnosis: Diagnosis, *, exchanging: bool) -> str:
        """As :attr:`conspicuous`, of any diagnosis of this slave."""
        setup = self.setup
        return conspicuous_text(diagnosis, setup.texts, dpv1=setup.has_messages, exchanging=exchanging)

    @property
    def block_texts(self) -> tuple[str, ...]:
        """The texts of the blocks of :attr:`diagnosis`, one line each, with the texts of the GSD file."""
        diagnosis = self.diagnosis
        return () if diagnosis is None else self.setup.block_texts(diagnosis)

    @property
    def inputs(self) -> bytes:
        """The last valid inputs, zeros before the first exchange; see :attr:`inputs_valid` and :attr:`inputs_age`."""
        return self.image.inputs

    @property
    def inputs_valid(self) -> bool:
        """True while the inputs are those of a slave in data exchange, and no older than :attr:`inputs_limit`."""
        exchanging = self.image.valid and self.ready_now
        return inputs_are_valid(exchanging=exchanging, age_ns=self._inputs_age_ns, limit_ns=self.inputs_limit_ns)

    @property
    def inputs_age(self) -> float | None:
        """The age of the inputs in seconds; None before the first ones."""
        age_ns = self._inputs_age_ns
        return None if age_ns is None else ns_to_s(age_ns)

    @property
    def inputs_limit(self) -> float:
        """The greatest age of valid inputs in seconds: the slave's watchdog time (1 s if it is off), and never less
        than two of its poll intervals as the plan counts them."""
        return ns_to_s(self.inputs_limit_ns)

    @property
    def inputs_limit_ns(self) -> int:
        """:attr:`inputs_limit` in ns."""
        return inputs_limit_ns(self.snapshot.watchdog_ns, self._bus.poll_interval_ns(self._setup))

    @property
    def _inputs_age_ns(self) -> int | None:
        at = self.image.input_time
        return max(0, self._bus.runtime.now() - at) if at else None

    @property
    def outputs(self) -> bytes:
        """The outputs of the next Data_Exchange in Operate. Assigning is atomic and goes out in the next rotation.

        With ``after_return = "safe"`` they become the safe values each time that the slave was away, until they are set
        anew; see :attr:`outputs_withheld`.

        Raises UsageError on a bus that is not open; assigning also if the length does not fit, a drive plugin makes
        the outputs, or the bus is read-only.
        """
        self._bus.check_open()
        return self.outputs_held

    @outputs.setter
    def outputs(self, octets: bytes) -> None:
        self._set_outputs(octets if type(octets) is bytes else argcheck.octets(f"{self.who}: outputs", octets))

    def _set_outputs(self, octets: bytes) -> None:
        self._bus.check_open()
        view, setup = self._bus.view, self._setup
        self._check_outputs(octets, view, setup)
        view.set_outputs(setup.address, octets)

    @property
    def outputs_held(self) -> bytes:
        """The octets of :attr:`outputs`, also before the bus is open and after its end."""
        return self.image.outputs

    @property
    def outputs_withheld(self) -> bytes | None:
        """With ``after_return = "safe"``: the outputs from before the slave was away, which are not sent, while its
        outputs wait to be set anew; else None. Whatever sets outputs of the slave ends that: values that it does not
        set stay safe. Outputs that are set while the slave is away are withheld, too.
        """
        return self.snapshot.withheld

    @property
    def outputs_sent(self) -> bytes:
        """The outputs that the master sends at present: :attr:`outputs` in Operate, zeros in Clear (none to a
        Fail_Safe slave), none outside data exchange.
        """
        if self._bus.view.read_only:
            return b""
        return sent_outputs(self.setup, self.outputs_held, self._bus.mode, exchanging=self.ready_now)

    @property
    def held_because(self) -> str | None:
        """The reason why the master holds :attr:`outputs` back at present, and what to do; None while it sends them.

        Outputs that a program sets meanwhile are prepared: they go out when the reason is over, however long that
        takes (in Clear: with ``operate()``).
        """
        bus = self._bus
        operate = f"(of a run: dpstack ctl {bus.config.bus.port} operate)"
        if (forced := bus.forced_clear) is not None:
            return f"the bus went to Clear by itself ({forced.why}): look at the plant, then operate() {operate}"
        if not self.ready_now:
            why = self.fault.text if self.fault else f"it is in {self.state.value}"
            return f"slave {self.address} is not in data exchange: {why}"
        if bus.mode is not Mode.OPERATE:
            mode = bus.mode.name.capitalize()
            return f"the bus is in {mode}, nothing reaches {self.name}: call operate() first {operate}"
        return None

    def check_outputs(self, octets: bytes) -> None:
        """Raises UsageError if ``octets`` cannot become the outputs (see :attr:`outputs`)."""
        self._bus.check_open()
        self._check_outputs(octets, self._bus.view, self._setup)

    def _check_outputs(self, octets: bytes, view: View, setup: SlaveParams) -> None:
        length = setup.output_len
        why = ""
        if view.read_only:
            why = "this bus is read-only; leave read_only out"
        elif self._has_plugin:
            free = f", or set {', '.join(self.config.output_fields)} by name" if self.config.output_fields else ""
            how = "give the drive an order (bus.drive())"
            if self._device_orders is not None:
                how = f"give it an order, slave.order() ({', '.join(self.orders) or 'it has none in this telegram'})"
            why = f"its {'drive plugin' if self._device_orders is None else 'plugin'} makes the outputs; {how}{free}"
        elif len(octets) != length:
            why = f"{octets_text(len(octets))} of outputs given, the slave's configuration has {length}"
        if why:
            raise UsageError(f"{self.who}: {why}")

    # --- named fields -------------------------------------------------------------------------------------------

    @property
    def input_values(self) -> dict[str, Value]:
        """The named inputs (``inputs = {...}`` in the configuration), all of one exchange."""
        return self.config.input_fields.values(self.inputs)

    @property
    def output_values(self) -> dict[str, Value]:
        """The named outputs of the next Data_Exchange in Operate."""
        return self.config.output_fields.values(self.outputs_held)

    def __contains__(self, name: object) -> bool:
        return name in self.config.input_fields or name in self.config.output_fields

    def __iter__(self) -> Iterator[str]:
        return iter((*self.config.input_fields, *self.config.output_fields))

    def __getitem__(self, name: str) -> Value:
        """A named input or output. Raises UsageError naming those there are, and on a bus that is not open."""
        self._bus.check_open()
        found = self.config.input_fields.fields.get(name)
        if found is not None:
            return found.get(self.inputs)
        found = self.config.output_fields.fields.get(name)
        if found is not None:
            return found.get(self.outputs)
        raise self._unknown(name, "field", tuple(self))

    def __setitem__(self, name: str, value: object) -> None:
        """Change the bits of one named output, and no others. Raises UsageError as :meth:`update` does."""
        self.update({name: value})

    def update(self, values: Mapping[str, object]) -> None:
        """Change several named outputs: they go out in the same rotation, all of them or none.

        The free words of a drive or a device by its device file are named outputs too; they are back at their neutral
        values when it was away, and by the value None. Raises UsageError for a name that is no output, a value that
        does not fit, and as :attr:`outputs` does.
        """
        if not self.has_free_words:
            bus, setup = self._bus, self._setup
            bus.check_open()
            view = bus.view
            octets = put_values(self, view.image(setup).outputs, values)
            self._check_outputs(octets, view, setup)
            view.set_outputs(setup.address, octets)
            return
        check_words(self, values)
        words = [{"name": name, "value": self.output_field(name).number_of(value)} for name, value in values.items()]
        self._bus.command(DriveCommand(self.address, "set", {"values": words}, next(TOKENS)))

    @property
    def orders(self) -> tuple[str, ...]:
        """The orders of :meth:`order`: those of its device, if it has the key ``device``."""
        return () if self._device_orders is None else tuple(self._device_orders.core.operations)

    async def order(self, op: str, timeout: float | None = None, **args: object) -> object:
        """Give a device that is no drive one of its :attr:`orders`: ``await slave.order("preset", value=1000)``.
        Returns when it is carried out, with its result.

        ``timeout`` in seconds; None: the time of its device file. Raises UsageError for wrong use, SlaveTimeout,
        SlaveError when the slave leaves data exchange meanwhile; an order that fails has no effect later. For a drive
        see ``bus.drive()``.
        """
        self._bus.check_open()
        if self._device_orders is None:
            todo = "give the drive its order: bus.drive().order()" if self._has_plugin else "it has no key device"
            raise UsageError(f"{self.who} takes no orders here: {todo}")
        if self._bus.view.read_only:
            raise UsageError(f"{self.who}: this bus is read-only; leave read_only out")
        return await self._device_orders.order(self, op, timeout, args)

    @overload
    def value(self, name: str, kind: None = None) -> QualifiedValue: ...
    @overload
    def value(self, name: str, kind: type[T]) -> T: ...
    def value(self, name: str, kind: type[T] | None = None) -> QualifiedValue | T:
        """A named input or output with its quality: ``slave.value("level").quality``.

        With ``kind`` the value alone, whatever its quality, as bool, int, float (also of a whole number), bytes. Raises
        UsageError if the field has another type, and as ``slave[name]`` does.
        """
        value = self[name]
        if kind is None:
            return self._qualified(name)
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if type(value) is not kind:
            raise UsageError(f"{self.who}: {name} is {type(value).__name__}, not {kind.__name__}")
        return value

    def quality(self, name: str) -> Quality:
        """The quality of a named input or output: good, uncertain, stale or bad; :meth:`value` has the reason.

        Raises UsageError as ``slave[name]`` does.
        """
        return self.value(name).quality

    def _qualified(self, name: str) -> QualifiedValue:
        from dpstack.api.slave.quality import qualified

        field = self.config.input_fields.fields.get(name)
        if field is not None:
            return qualified(self, field, Direction.INPUT)
        return qualified(self, self.config.output_fields.fields[name], Direction.OUTPUT)

    def inputs_as(self, kind: type[In]) -> In:
        """The last valid inputs as an object of ``kind``, a class of :class:`dpstack.Inputs`; all of one exchange.

        See :attr:`inputs_valid`. Raises UsageError if the class does not fit the configuration.
        """
        from dpstack.api.slave.typed import Inputs, typed  # here: a program with such a class has loaded it

        return typed(Inputs, kind).taken(self.inputs, self.config.input_fields, self.who)

    def outputs_as(self, kind: type[Out]) -> Out:
        """The outputs of the next Data_Exchange in Operate as an object of ``kind``, a class of
        :class:`dpstack.Outputs`. Raises UsageError if the class does not fit the configuration."""
        from dpstack.api.slave.typed import Outputs, typed  # as above

        return typed(Outputs, kind).taken(self.outputs, self.config.output_fields, self.who)

    def send(self, outputs: Outputs) -> None:
        """Change the outputs that ``outputs`` has, and no others: they go out in the same rotation.

        Raises UsageError if the class does not fit the configuration, or a value its field; and as :attr:`outputs`.
        """
        from dpstack.api.slave.typed import Outputs  # as above

        if not isinstance(outputs, Outputs):
            raise UsageError(
                f"{self.who}: send({outputs!r}) takes an object of a class of dpstack.Outputs; update() takes names"
            )
        self.outputs = outputs.put(self.outputs, self.config.output_fields, self.who)

    async def until(self, condition: Callable[[Mapping[str, Value]], bool], timeout: float | None = None) -> None:
        """Wait until ``condition(inputs)`` is true: ``await slave.until(lambda v: v["limit"])``. It gets the named
        inputs of each round while they are valid.

        ``timeout`` in seconds. Raises what ``condition`` raises, SlaveFault if an input that it looks at is bad by the
        slave's own diagnosis (line break ...), SlaveTimeout with the reason, and the reason of the end when the bus
        ends meanwhile. An uncertain input counts.
        """

        plain_function("condition", condition, 'until(lambda v: v["limit"])')

        def holds() -> bool:
            if not self.inputs_valid:
                return False
            values = ReadValues(self.input_values)
            reached = condition(values)
            for name in values.read:
                found = self._qualified(name)
                if found.quality.value == "bad":
                    raise SlaveFault(self.address, f"{self.who}: {name} is bad, nothing can wait for it: {found.text}")
            return reached

        try:
            await self._bus.until_round(holds, timeout)
        except TimeoutError:
            why = "its inputs are valid, the condition is not true"
            if not self.inputs_valid:
                why = self.fault.text if self.fault else f"its inputs are not valid, it is in {self.state.value}"
            raise SlaveTimeout(self.address, f"{self.who}: not reached in {timeout:g} s: {why}") from None

    async def readings(self, name: str) -> AsyncIterator[QualifiedValue]:
        """A named input with its quality: the present one, then each time that value, quality or reason is another
        one, seen at the ends of rounds. A slow reader gets the latest one. Ends with the bus.

        Raises UsageError for a name that is no input.
        """
        self._input_field(name)
        self._bus.check_open()
        told: tuple[Value, str] | None = None

        def changed() -> bool:
            found = self._qualified(name)
            return (found.value, found.text) != told

        while True:
            try:
                if not changed():
                    await self._bus.until_round(changed)
            except DpError:
                return
            found = self._qualified(name)
            told = found.value, found.text
            yield found

    async def changes(self, name: str) -> AsyncIterator[Value]:
        """Each new value of a named input, seen at the ends of rounds while the inputs are valid. A slow reader gets
        the latest one. Ends with the bus. The value at the beginning is none of them: for it see :meth:`follow`. Their
        quality is not looked at: :meth:`readings` has it.

        Raises UsageError for a name that is no input.
        """
        field = self._input_field(name)
        self._bus.check_open()
        told = field.get(self.inputs)

        def changed() -> bool:
            return self.inputs_valid and field.get(self.inputs) != told

        while True:
            try:
                await self._bus.until_round(changed)
            except DpError:
                return
            told = field.get(self.inputs)
            yield told

    async def follow(self, name: str, kind: type[T]) -> AsyncIterator[T]:
        """The value of a named input as ``kind`` (see :meth:`value`): the present one as soon as the inputs are valid,
        then each new one, as :meth:`changes`. It goes on when the slave was lost and comes back.

        Raises UsageError for a name that is no input, and if the field has another type.
        """
        self._input_field(name)
        told = self.value(name, kind)
        first = True

        def is_new() -> bool:
            return self.inputs_valid and (first or self.value(name, kind) != told)

        while True:
            try:
                await self._bus.until_round(is_new)
            except DpError:
                return
            told, first = self.value(name, kind), False
            yield told

    def _input_field(self, name: str) -> Field:
        found = self.config.input_fields.fields.get(name)
        if found is None:
            raise self._unknown(name, "input", tuple(self.config.input_fields))
        return found

    def output_field(self, name: str) -> Field:
        """The declaration of a named output. Raises UsageError naming those there are."""
        found = self.config.output_fields.fields.get(name)
        if found is None:
            raise self._unknown(name, "output", tuple(self.config.output_fields))
        return found

    def _unknown(self, name: object, what: str, known: tuple[str, ...]) -> UsageError:
        who = self.who
        if name in self:
            if what == "input":
                return UsageError(f"{who}: {name} is an output: give the name of an input")
            return UsageError(f"{who}: {name} is an input: only outputs can be set")
        hint = did_you_mean(str(name), known, f"there are: {', '.join(known) or 'none'}")
        return UsageError(f"{who}: no {what} is called {name!r}; {hint}")

    @property
    def exchanges(self) -> int:
        """Successful data exchanges since the start."""
        return self.image.exchanges

    @property
    def retries(self) -> int:
        """Repeated requests since the start."""
        return self._bus.view.link.station(self.address).retries

    @property
    def timeouts(self) -> int:
        """Requests given up since the start."""
        return self._bus.view.link.station(self.address).timeouts

    @property
    def watchdog_ms(self) -> int:
        """The effective watchdog in ms, 0 when off."""
        return self.snapshot.watchdog_ns // 1_000_000

    # --- DP-V1 --------------------------------------------------------------------------------------------------

    def alarms(self, *, acknowledge: bool = True) -> AlarmStream:
        """Alarms from now on: an async iterator of :class:`~dpstack.api.slave.alarms.SlaveAlarm`, each one once, in
        order.

        dpstack acknowledges an alarm when every listener has read it. With ``acknowledge=False`` the program does so by
        ``await alarm.acknowledge()``; until then the slave may raise no further one. The iterator goes on when the
        slave leaves data exchange and comes back, and ends with the bus. Without a listener dpstack acknowledges alarms
        at once. ``dpv1 = { alarms = [...] }`` enables the kinds of alarms. Raises UsageError for a slave without DP-V1
        and a bus that is not open.
        """
        self._bus.check_open()
        need_dpv1(self.setup, read_only=self._bus.view.read_only)
        return AlarmStream(self._bus.services.alarms, self.address, acknowledge)

    def status_messages(self) -> Reader[Status]:
        """Status messages, module status, PrmCmdAck ... from now on (:class:`~dpstack.dp.pdu.alarm_blocks.Status`): an
        async iterator. Status messages have no acknowledgement; a slow reader loses the oldest.

        Raises UsageError for a slave without DP-V1 and a bus that is not open.
        """
        self._bus.check_open()
        need_dpv1(self.setup, "no status messages")
        return self._bus.services.alarms.statuses(self.address)

    @property
    def links(self) -> tuple[SlaveSubscription, ...]:
        """Its data of other slaves (data exchange broadcast, key ``subscribes``), and whether they come."""
        states = self._bus.services.alarms.links.get(self.address, ())
        names = {one.address: one.name for one in self._bus.view.setups.values()}
        return subscriptions(self._setup, states, names, exchanging=self.state is SlaveState.DATA_EXCHANGE)

    @property
    def alarm_counts(self) -> AlarmCounts | None:
        """Counters of its alarms since the start; None for a slave that is not parameterised for DP-V1."""
        return self.snapshot.alarms

    @property
    def _way(self) -> RecordWay:
        services, address = self._bus.services, self.address
        dpv1 = self.setup.dpv1 or Dpv1()
        longest = dpv1.c1_max_data_len
        limit = f"its GSD file says C1_Max_Data_Len = {longest}: write less"
        response_ns = dpv1.c1_response_timeout_ns
        return RecordWay(services, address, self.who, longest, limit, response_ns, services.im_calls[address])

    @property
    def _slave_config(self) -> SlaveConfig:
        return self.config

    async def deactivate(self) -> None:
        """Take the slave out of service: safe outputs for 50 ms, Unlock, then no telegram until :meth:`activate`.

        Returns when the master has the order; the bus does not end before the master has carried it out. A drive's
        pending orders end with DriveError.
        """
        await self._bus.order(DeactivateSlave(self.address))

    async def activate(self) -> None:
        """Start the slave again; :meth:`ready` waits for data exchange."""
        await self._bus.order(ActivateSlave(self.address))

    async def reparameterise(self, *, timeout: float | None = 5.0, **changes: Unpack[Changes]) -> None:
        """Change parameters while the bus runs: safe outputs for 50 ms, Unlock, a new bring-up, data exchange.

        ``changes`` are keys of [[slave]], in the units of a configuration, see :class:`Changes`. Raises ConfigError
        before it changes anything (also if a named field would lie outside, or the GSD file excludes the change),
        UsageError for other lengths under a drive plugin, SlaveFault or SlaveTimeout as :meth:`ready`. A drive's
        pending orders end with DriveError. ``timeout`` in seconds.
        """
        await run_through_cancellation(self._change(changed(self.config, changes)))
        if not self.deactivated:
            await self.ready(timeout)

    async def _change(self, config: SlaveConfig) -> None:
        setup = self._bus.fitting(config)
        if setup.dpv1 is not None:
            await self._bus.load_layouts()
        await self._bus.order(ReparameteriseSlave(setup))
        self.config, self._setup = config, setup

    async def wait_state(self, *states: SlaveState, timeout: float | None = None) -> SlaveState:
        """Wait until the slave is in one of ``states``. Raises SlaveTimeout with the state that it is in."""
        for state in states or (None,):
            instance("state", state, SlaveState, "wait_state(SlaveState.DATA_EXCHANGE, timeout=5)")
        try:
            await self._bus.until(lambda: self.state in states, timeout)
        except TimeoutError:
            raise self._late(" or ".join(s.value for s in states), timeout) from None
        return self.state

    async def ready(self, timeout: float | None = 5.0) -> None:
        """Wait until the slave is in data exchange.

        Raises UsageError for a deactivated slave, SlaveFault as soon as the slave refuses (parameters, configuration,
        ident, another master), SlaveTimeout with the reason after ``timeout`` seconds (None: no limit).
        """
        try:
            await self._bus.until(self._is_ready, timeout)
        except TimeoutError:
            raise self._late("data exchange", timeout) from None

    def _is_ready(self) -> bool:
        if self.ready_now:  # first: while many slaves come up, this is asked of those that are up at each event
            return True
        fault = self.fault
        if self.deactivated:
            raise UsageError(f"{self.who} is out of service: activate() it first")
        if self.state is SlaveState.FAULT and fault is not None:
            raise SlaveFault(self.address, f"{self.who}: {fault.text}")
        return False

    def _late(self, wanted: str, timeout: float | None) -> SlaveTimeout:
        fault = self.fault
        why = fault.text if fault else f"its state is {self.state.value}"
        text = f"{self.who}: not in {wanted} after {timeout:g} s: {why}"
        return SlaveTimeout(self.address, text)


async def all_ready(bus: Host, slaves: Collection[Slave], timeout: float | None) -> None:
    """Wait until all ``slaves`` are in data exchange. Raises as ``Slave.ready`` for the first that is not."""
    try:
        await bus.until(lambda: all(slave._is_ready() for slave in slaves), timeout)
    except TimeoutError:
        for slave in slaves:
            if not slave.ready_now:
                raise slave._late("data exchange", timeout) from None
        raise


async def bring_up_anew(slave: Slave, config: SlaveConfig) -> None:
    """Give ``slave`` the parameters of ``config`` as :meth:`Slave.reparameterise` does, without waiting for it."""
    await slave._change(config)


def check_words(slave: Slave, values: Mapping[str, object]) -> None:
    """Raises UsageError if ``values`` cannot become free words of a drive or device. None takes an order back."""
    slave._bus.check_open()
    for name in values:
        slave.output_field(name)
    values = {name: value for name, value in values.items() if value is not None}
    put_values(slave, bytes(slave.setup.output_len), values)
    profile = slave.config.any_profile
    if profile is None or profile.check_word is None:
        return
    for name, value in values.items():
        try:
            profile.check_word(name, value)
        except ValueError as error:
            raise UsageError(f"{slave.who}: {error}") from None


def put_values(slave: Slave, octets: bytes, values: Mapping[str, object]) -> bytes:
    """The outputs ``octets`` of ``slave`` with the named ``values`` in them, words before their bits. Raises UsageError
    as ``Slave.update``."""
    names = values if len(values) < 2 else sorted(values, key=lambda name: -slave.output_field(name).width)
    fields = slave.config.output_fields.fields
    for name in names:
        field = fields.get(name) or slave.output_field(name)
        try:
            octets = field.put(octets, values[name])
        except ValueError as error:
            raise UsageError(f"{slave.who}: {error}") from None
    return octets
