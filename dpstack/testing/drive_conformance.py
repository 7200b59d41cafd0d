"""``DriveConformance``: the checks of a drive plugin against its simulated drive."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Coroutine, Iterator, Mapping, Sequence
from random import Random
from typing import ClassVar, Final, NamedTuple

from msgspec import Struct

from dpstack.api.slave.drive import Drive
from dpstack.devices.finding import find
from dpstack.dp.master.commands import Mode
from dpstack.errors import DpError, DriveError, ParameterError, UsageError
from dpstack.gsd.identifiers import io_lengths
from dpstack.profile import FAULTED, DriveDevice, DriveProfile, ListedParam, State
from dpstack.profile.master.core import NO_NAME, NOT_NAMED
from dpstack.profile.model.drive_type import CHECK_SETTINGS
from dpstack.profile.registry import also
from dpstack.testing.bus import BusFactory, SimulatedBus, VirtualTime
from dpstack.units import BAUD_RATES, NS_PER_MS

_NAME: Final = "tested"
_ADDRESS: Final = 7
#: slowest rate of a check: a slow bus has few telegrams to simulate
_LEAST_BAUD: Final = 93_750
#: per unit of the rated speed: the shaft counts as at rest
_REST: Final = 0.005
#: of the reference, between set point and reported speed
_NEAR: Final = 0.02
#: parameters that are read, and tries to write one
_READ: Final = 20
_WRITES: Final = 10
#: random octets at each end
_RANDOM: Final = 200


class _Rig(NamedTuple):
    """A bus with the drive."""

    bus: SimulatedBus
    drive: Drive

    @property
    def device(self) -> DriveDevice:
        return self.bus.device(_NAME).drive

    def runs(self) -> bool:
        return self.drive.status.running

    def fault(self) -> str | None:
        return self.drive.status.fault

    def moves(self) -> bool:
        """Whether the shaft turns, or is about to."""
        motor = self.device.motor
        return abs(motor.speed) > _REST

    def run_at(self, speed: float) -> None:
        self.drive.speed = speed
        self.bus.run(self.drive.start())
        self.bus.run(self.drive.reached())

    def refuses(self, order: Coroutine[object, object, object]) -> bool:
        """Whether the plugin refuses ``order`` with a reason."""
        try:
            self.bus.run(order)
        except (DriveError, UsageError) as error:
            return bool(str(error))
        return False

    def rests_within(self, seconds: float) -> bool:
        end = self.bus.now + seconds
        while self.moves() and self.bus.now < end:
            self.bus.wait(0.1)
        return not self.moves()


class DriveConformance:
    """Checks of a drive plugin against its simulated drive, on a simulated bus. Subclass it in a test module::

        class TestMyDrive(DriveConformance):
            drive = "my-drive"

    Each check is one test method, once for each of ``telegrams``. Override a method to change or to leave out a check.
    """

    #: the name of an installed drive (its entry point); or give ``profile``
    drive: ClassVar[str] = ""
    #: the drive itself, instead of its name
    profile: ClassVar[DriveProfile | None] = None
    #: names of telegrams; none: the default telegram
    telegrams: ClassVar[Sequence[str]] = ()
    #: the table ``options`` of the slave
    options: ClassVar[Mapping[str, object]] = {}
    #: the table ``simulated`` of the slave
    simulated: ClassVar[Mapping[str, object]] = {}
    #: further keys of the slave
    keys: ClassVar[Mapping[str, object]] = {}
    #: bit/s; None: the lowest rate of the drive from 93,750 on
    baud: ClassVar[int | None] = None
    #: set points in parts of the reference, one a direction
    speeds: ClassVar[Sequence[float]] = (0.5, -0.25)
    #: a fault of the simulated drive; "": the first that it knows
    fault: ClassVar[str] = ""
    #: False: neither these telegrams nor a parameter give its faults a name
    names_faults: ClassVar[bool] = True
    #: False: the drive has no quick stop, and the plugin refuses the order
    has_quick_stop: ClassVar[bool] = True
    #: parameters to write and read back, by name or number; none: the first ones that can be written keep their value
    writes: ClassVar[Mapping[str | int, float]] = {}
    #: False: the drive, as delivered, runs on when it hears no master
    stops_when_lost: ClassVar[bool] = True
    #: seconds after which the shaft is at rest once its outputs are safe, or its master is lost
    rest_s: ClassVar[float] = 10.0

    @classmethod
    def dpstack_telegrams(cls) -> list[str]:
        """The telegrams of the checks, for the plugin of pytest."""
        if cls.profile is None and not cls.drive:
            raise UsageError(f'{cls.__name__}: set drive = "NAME" or profile = DRIVE in the class')
        return [cls._profile().telegram(name).name for name in cls.telegrams or (None,)]

    @classmethod
    def _profile(cls) -> DriveProfile:
        found = find(cls.drive) if cls.profile is None else cls.profile
        if found.device_factory is None:
            raise UsageError(f"{cls.__name__}: {found.name} has no simulated drive, and the checks need one")
        return found

    def _open(self, buses: BusFactory, telegram: str) -> _Rig:
        """A bus in Operate with the drive in data exchange."""
        profile = self._profile()
        slave = {
            "name": _NAME,
            "address": _ADDRESS,
            "drive": profile.name,
            "telegram": telegram,
            "options": self.options,
            "simulated": self.simulated,
            **self.keys,
        }
        rates = sorted(profile.rates(self.options) or BAUD_RATES)
        baud = self.baud or next((rate for rate in rates if rate >= _LEAST_BAUD), rates[-1])
        with also(profile):
            bus = buses(slaves=[slave], baud=baud)
        return _Rig(bus, bus.drive(_NAME))

    # --- declarations -----------------------------------------------------------------------------------------------

    def test_telegrams_have_the_lengths_of_their_identifiers(self) -> None:
        """The identifier octets of each telegram declare as many octets as the plugin takes and sends."""
        profile = self._profile()
        profile.telegram(None)  # the default one exists
        for spec in profile.telegrams.values():
            declared = io_lengths(spec.config)
            own = spec.input_octets, spec.output_octets
            assert declared == own, (
                f"{spec.name}: its identifiers {spec.config.hex(' ')} have {declared[0]} octets of inputs and "
                f"{declared[1]} of outputs, the telegram {own[0]} and {own[1]}"
            )
            assert min(spec.inputs, spec.outputs) >= 2, f"{spec.name}: no room for status or control word"

    def test_rates_are_those_of_profibus(self) -> None:
        """Rates and T_SDR are for rates that exist."""
        profile = self._profile()
        strange = {*profile.rates(self.options), *profile.max_tsdr} - {*BAUD_RATES}
        assert not strange, f"no rates of PROFIBUS: {', '.join(map(str, sorted(strange)))} bit/s"

    # --- on the bus -------------------------------------------------------------------------------------------------

    def test_it_comes_into_data_exchange_at_rest(self, dpstack_bus: BusFactory, dpstack_telegram: str) -> None:
        """Bring-up in the order of the standard, the lengths of the telegram, a known state, and nothing turns."""
        rig = self._open(dpstack_bus, dpstack_telegram)
        rig.bus.run(rig.drive.settled(10))
        rig.bus.wire.assert_brought_up(_NAME)
        spec = self._profile().telegram(dpstack_telegram)
        seen = {(len(one.outputs), len(one.inputs or b"")) for one in rig.bus.wire.exchanges(_NAME)}
        wanted = {(spec.output_octets, spec.input_octets)}
        assert seen == wanted, f"octets (outputs, inputs) on the line: {seen}, the telegram has {wanted}"
        status = rig.drive.status
        assert status.state not in (State.UNKNOWN, State.OFFLINE), f"state {status.state} with words {_words(rig)}"
        assert not rig.runs(), "it runs without a start"
        assert not rig.moves(), "its motor turns without a start"

    def test_it_starts_and_stops(self, dpstack_bus: BusFactory, dpstack_telegram: str) -> None:
        """``start()`` until it runs, ``stop()`` until it rests."""
        rig = self._open(dpstack_bus, dpstack_telegram)
        rig.run_at(self.speeds[0])
        assert rig.runs(), f"state {rig.drive.status.state} after start(), words {_words(rig)}"
        assert rig.moves(), "running and reached, but the motor of the simulated drive stands still"
        rig.bus.run(rig.drive.stop())
        assert not rig.runs(), f"state {rig.drive.status.state} after stop()"
        assert rig.rests_within(self.rest_s), f"its motor still turns {self.rest_s:g} s after stop()"

    def test_set_points_in_each_direction(self, dpstack_bus: BusFactory, dpstack_telegram: str) -> None:
        """The reported speed and the motor follow each set point, its sign too."""
        rig = self._open(dpstack_bus, dpstack_telegram)
        for speed in self.speeds:
            rig.run_at(speed)
            actual, motor = rig.drive.status.speed, rig.device.motor.speed
            assert actual is None or abs(actual - speed) <= _NEAR, f"set point {speed:+.2f}, it reports {actual:+.3f}"
            assert motor * speed > 0, f"set point {speed:+.2f}, the motor turns at {motor:+.3f}"

    def test_quick_stop_and_coast(self, dpstack_bus: BusFactory, dpstack_telegram: str) -> None:
        """Both end the run; a new start works after them."""
        rig = self._open(dpstack_bus, dpstack_telegram)
        for name in ("quick_stop", "coast"):
            rig.run_at(self.speeds[0])
            if name == "quick_stop" and not self.has_quick_stop:
                assert rig.refuses(rig.drive.quick_stop()), "quick_stop() did not say that the drive has none"
                continue
            rig.bus.run(rig.drive.quick_stop() if name == "quick_stop" else rig.drive.coast())
            assert not rig.runs(), f"state {rig.drive.status.state} after {name}()"
            assert rig.rests_within(self.rest_s), f"its motor still turns {self.rest_s:g} s after {name}()"

    def test_a_fault_is_reported_and_acknowledged(self, dpstack_bus: BusFactory, dpstack_telegram: str) -> None:
        """A trip becomes a fault with a name, start() refuses, acknowledge() ends it, and it starts again."""
        rig = self._open(dpstack_bus, dpstack_telegram)
        rig.run_at(self.speeds[0])
        known = list(rig.device.trips.values())
        assert self.fault or known, "the simulated drive knows no fault: give its trips, or fault in this class"
        rig.bus.faults.trip(_NAME, self.fault or known[0])
        rig.bus.run(rig.bus.master.until(lambda: rig.drive.status.state in FAULTED, 5))
        assert rig.refuses(rig.drive.start()), "start() worked although a fault stands"
        rig.bus.wait(1)
        told = rig.fault()
        assert told, f"no fault in its status, words {_words(rig)}"
        named = told != NOT_NAMED and not told.startswith(NO_NAME)
        assert named or not self.names_faults, (
            f'fault {told}: give the plugin the number of its fault (the input word "fault", or fault_parameter), or '
            "set names_faults = False"
        )
        assert rig.rests_within(self.rest_s), f"its motor still turns {self.rest_s:g} s after the fault"
        rig.bus.run(rig.drive.acknowledge(60), timeout=120)
        assert rig.fault() is None, f"fault {rig.drive.status.fault} after acknowledge()"
        assert not rig.moves(), "acknowledge() alone makes the motor turn"
        rig.bus.run(rig.drive.start())
        assert rig.runs(), f"state {rig.drive.status.state} after acknowledge() and start()"

    def test_parameters_are_read_and_written(self, dpstack_bus: BusFactory, dpstack_telegram: str) -> None:
        """Declared parameters can be read, what was written is read back, an unknown name is refused."""
        rig = self._open(dpstack_bus, dpstack_telegram)
        try:
            listed = [one for one in rig.drive.parameters if one.why_not is None]
        except UsageError:
            return  # neither a parameter channel nor record 47
        for one in listed[:: max(1, len(listed) // _READ)]:
            rig.bus.run(_read(rig.drive, one))
        for name, value in self.writes.items():
            rig.bus.run(rig.drive.write(name, value))
            found = rig.bus.run(rig.drive.read(name))
            assert abs(found - value) < 1e-9, f"parameter {name}: {value:g} was written, {found:g} is read"
        if not self.writes:
            self._write_what_was_read(rig, [one for one in listed if not one.read_only])
        assert rig.refuses(rig.drive.read("no such parameter")), "a parameter that does not exist was read"

    def _write_what_was_read(self, rig: _Rig, listed: Sequence[ListedParam]) -> None:
        refused: list[str] = []
        for one in listed[:_WRITES]:
            value = rig.bus.run(_read(rig.drive, one))
            try:
                rig.bus.run(rig.drive.write(one.name, value, data_set=one.data_set, index=one.index))
            except ParameterError as error:
                refused.append(str(error))
                continue
            found = rig.bus.run(_read(rig.drive, one))
            assert found == value, f"parameter {one.name}: {value:g} was written, {found:g} is read"
            return
        assert not refused, f"no parameter can be written, give writes in this class: {'; '.join(refused)}"

    # --- ways out ---------------------------------------------------------------------------------------------------

    def test_clear_brings_it_to_rest(self, dpstack_bus: BusFactory, dpstack_telegram: str) -> None:
        """Clear stops a running drive by safe outputs, and back in Operate it stays at rest."""
        rig = self._open(dpstack_bus, dpstack_telegram)
        rig.run_at(self.speeds[0])
        began = rig.bus.now
        rig.bus.run(rig.bus.master.clear())
        rig.bus.wait(0.2)
        rig.bus.wire.assert_clear(began)
        rig.bus.wire.assert_last_outputs_safe(_NAME)
        assert rig.rests_within(self.rest_s), f"its motor still turns {self.rest_s:g} s after Clear"
        rig.bus.run(rig.bus.master.operate())
        self._assert_it_stays_at_rest(rig, "Clear and Operate")

    def test_the_end_of_the_bus_brings_it_to_rest(self, dpstack_bus: BusFactory, dpstack_telegram: str) -> None:
        """``close()`` with a running drive: its last outputs are safe."""
        rig = self._open(dpstack_bus, dpstack_telegram)
        rig.run_at(self.speeds[0])
        began = rig.bus.now
        rig.bus.close()
        rig.bus.wire.assert_clear(began)
        rig.bus.wire.assert_last_outputs_safe(_NAME)

    def test_a_lost_master_brings_it_to_rest(self, dpstack_bus: BusFactory, dpstack_telegram: str) -> None:
        """Its watchdog expires when it hears no master; with the master back it does not turn by itself."""
        rig = self._open(dpstack_bus, dpstack_telegram)
        rig.run_at(self.speeds[0])
        watchdog_ms = rig.drive.slave.watchdog_ms
        assert watchdog_ms, "its watchdog is off"
        with rig.bus.faults.silence_master():
            rig.bus.wait(watchdog_ms / 1000 + 0.1)
            device = rig.bus.device(_NAME)
            assert not device.exchanging, f"still in data exchange after its watchdog of {watchdog_ms} ms"
            rests = not self.stops_when_lost or rig.rests_within(self.rest_s)
            assert rests, f"its motor still turns {self.rest_s:g} s after its watchdog"
        if not self.stops_when_lost:
            return
        rig.bus.run(rig.bus.master.wait_state(Mode.OPERATE, 30))
        rig.bus.run(rig.bus.master.ready(30))
        self._assert_it_stays_at_rest(rig, "the master came back")

    def test_power_off_and_on(self, dpstack_bus: BusFactory, dpstack_telegram: str) -> None:
        """Without power it is offline; with power again it is brought up, and does not turn by itself."""
        rig = self._open(dpstack_bus, dpstack_telegram)
        rig.run_at(self.speeds[0])
        with rig.bus.faults.power_off(_NAME):
            rig.bus.run(rig.bus.master.until(lambda: not rig.drive.slave.ready_now, 10))
            assert rig.drive.status.state is State.OFFLINE, f"state {rig.drive.status.state} without power"
        rig.bus.run(rig.drive.slave.ready(30))
        self._assert_it_stays_at_rest(rig, "power off and on")

    def _assert_it_stays_at_rest(self, rig: _Rig, after: str) -> None:
        rig.bus.wait(1)
        assert not rig.runs(), f"it runs by itself after {after}"
        assert not rig.moves(), f"its motor turns by itself after {after}"

    # --- each end alone ---------------------------------------------------------------------------------------------

    def test_unchanged_inputs_return_the_same_outputs(self, dpstack_telegram: str) -> None:
        """The plugin is called once a rotation: with unchanged inputs it returns the same object, and builds none."""
        profile = self._profile()
        core = profile.core(_NAME, dpstack_telegram, {**self.options, CHECK_SETTINGS: False}, simulated=True)
        device = profile.simulated(dpstack_telegram, self.options, self.simulated)
        now = NS_PER_MS
        device.enter(core.telegram.config, now)
        device.operate(now)
        inputs = bytes(core.telegram.input_octets)
        for _ in range(_RANDOM):
            now += 2 * NS_PER_MS
            inputs = device.exchange(core.cyclic(inputs, now), now)
        first = core.cyclic(inputs, now)
        assert core.cyclic(inputs, now + 1) is first, "cyclic() builds its outputs anew although nothing has changed"

    def test_random_octets_break_neither_end(self, dpstack_telegram: str) -> None:
        """Any inputs give outputs of the right length, any outputs give inputs, and nothing raises."""
        profile = self._profile()
        core = profile.core(_NAME, dpstack_telegram, self.options, simulated=True)
        device = profile.simulated(dpstack_telegram, self.options, self.simulated)
        spec, random, now = core.telegram, Random(0), NS_PER_MS
        device.enter(spec.config, now)
        device.operate(now)
        for _ in range(_RANDOM):
            now += random.randrange(20 * NS_PER_MS)
            outputs = core.cyclic(random.randbytes(spec.input_octets), now)
            assert len(outputs) == spec.output_octets, f"{len(outputs)} octets of outputs from the plugin"
            core.status().as_dict()
            inputs = device.exchange(random.randbytes(spec.output_octets), now)
            assert len(inputs) == spec.input_octets, f"{len(inputs)} octets of inputs from the simulated drive"


async def _read(drive: Drive, one: ListedParam) -> float | int:
    return await drive.read(one.name, data_set=one.data_set, index=one.index)


def _words(rig: _Rig) -> str:
    return " ".join(f"{word:04X}" for word in rig.drive.status.words)


# --- without pytest ---------------------------------------------------------------------------------------------------
class Outcome(Struct, frozen=True):
    """A check with one telegram; ``telegram`` is "" for a check of the declarations, ``reason`` if it passed."""

    check: str
    telegram: str
    reason: str

    @property
    def passed(self) -> bool:
        return not self.reason


def run_checks(
    profile: DriveProfile, telegrams: Sequence[str] = (), *, nameless: Collection[str] = (), **settings: object
) -> Iterator[Outcome]:
    """Run all checks of ``profile`` in virtual time, with each of ``telegrams`` (none: the default one).

    ``nameless``: telegrams with which a fault has no name. ``settings``: attributes of :class:`DriveConformance`, such
    as ``speeds``. Raises UsageError under ``python -O``, which leaves assertions out.
    """
    if not __debug__:
        raise UsageError("the checks are assertions, which python -O leaves out: run it without -O")
    kind: type[DriveConformance] = type("Checks", (DriveConformance,), {"profile": profile, **settings})
    names = [name for name, _ in inspect.getmembers(DriveConformance, inspect.isfunction) if name.startswith("test_")]
    lines = {name: getattr(DriveConformance, name).__code__.co_firstlineno for name in names}
    chosen = telegrams or (profile.default_telegram,)
    for name in sorted(names, key=lines.__getitem__):
        wanted = inspect.signature(getattr(DriveConformance, name)).parameters
        for telegram in chosen if "dpstack_telegram" in wanted else ("",):
            checks = kind()
            checks.names_faults = telegram not in nameless  # type: ignore[misc]
            yield Outcome(name.removeprefix("test_").replace("_", " "), telegram, _reason(checks, name, telegram))


def run_exchange(device: str, telegram: str, keys: Mapping[str, object]) -> Outcome:
    """The check of a device that is no drive: it is brought up, in data exchange, and its values can be read.

    ``device``: the path of its file; ``keys``: further ones of its slave.
    """

    def check(buses: BusFactory) -> None:
        slave = {"name": _NAME, "address": _ADDRESS, "device": device, "telegram": telegram, **keys}
        bus = buses(slaves=[slave])
        bus.wait(1)
        bus.wire.assert_brought_up(_NAME)
        tested = bus.slave(_NAME)
        assert tested.ready_now, "it left data exchange"
        for name in bus.config.slaves[0].input_fields:
            assert tested[name] is not None

    return Outcome("it comes into data exchange", telegram, _outcome(check))


def _reason(checks: DriveConformance, name: str, telegram: str) -> str:
    """Why the check failed; "" if it passed."""
    wanted = inspect.signature(getattr(checks, name)).parameters

    def check(buses: BusFactory) -> None:
        given = {"dpstack_bus": buses, "dpstack_telegram": telegram}
        getattr(checks, name)(**{key: given[key] for key in wanted})

    return _outcome(check)


def _outcome(check: Callable[[BusFactory], None]) -> str:
    """Why ``check`` failed in virtual time; "" if it passed."""
    time = VirtualTime()
    buses = BusFactory(time)
    try:
        check(buses)
        buses.close()
    except AssertionError as error:
        return str(error).partition("\nassert ")[0] or "its condition does not hold"  # pytest adds its own lines
    except DpError as error:
        return str(error)
    except Exception as error:  # the Python of a package may raise anything
        return f"{type(error).__name__}: {error}"
    finally:
        time.close()
    return ""
