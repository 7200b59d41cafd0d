"""Our slaves and our master on one wire in virtual time: each way to be faulty ends in the one right fault."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from faults.slaves import (
    Dies,
    NeverReady,
    RefusesParameters,
    SilentRefusal,
    WrongLength,
    locked_by,
    refuses_config,
    wrong_ident,
)
from slave_kit import MS

from dpstack.dp.master.commands import Mode, RemoveSlave, SetMode
from dpstack.dp.master.events import FaultKind, SlaveDiagnosis, SlaveFaulted, SlaveState, SlaveStateChanged
from dpstack.dp.master.master import Master
from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.passive.station import PassiveStation
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Event

PARAMS = BusParams.preset(500_000, address=2)
IDENT = 0x1234
CFG = bytes.fromhex("11 21")


class Plant:
    """A master, a healthy slave at 3 and the one under test at 4."""

    def __init__(self, app: SlaveApp, *, config: bytes = CFG, user_prm: bytes = b"") -> None:
        self.events: list[Event] = []
        self.app = app
        self.healthy = SlaveApp(MirrorDevice(IDENT, CFG))
        setups = [
            SlaveParams(address=3, name="healthy", ident=IDENT, config=CFG, initial=b"\x11\x22"),
            SlaveParams(address=4, name="tested", ident=IDENT, config=config, user_prm=user_prm, watchdog_ms=50),
        ]
        self.master = Master(PARAMS, setups)
        self.world = World()
        self.station = ActiveStation(PARAMS, [self.master])
        self.world.add(self.station, name="master", on_events=self.events.extend)
        for address, responder in ((3, self.healthy), (4, app)):
            self.world.add(PassiveStation(address, responder, PARAMS), name=f"slave {address}")
        self.world.command(self.station, GoOnline())
        self.world.command(self.station, SetMode(Mode.OPERATE))

    def run(self, ms: int) -> Plant:
        self.world.run_until(self.world.now + ms * MS)
        assert self.world.referee is not None
        self.world.referee.check()
        return self

    def faults(self) -> list[FaultKind]:
        return [event.fault.kind for event in self.events if isinstance(event, SlaveFaulted) and event.address == 4]

    def states(self, address: int = 4) -> list[SlaveState]:
        return [
            event.state for event in self.events if isinstance(event, SlaveStateChanged) and event.address == address
        ]

    def assert_the_other_goes_on(self) -> None:
        assert self.states(3)[-1] is SlaveState.DATA_EXCHANGE
        assert self.states(3).count(SlaveState.DATA_EXCHANGE) == 1
        assert self.healthy.outputs == b"\x11\x22"
        assert self.master.images[3].inputs == b"\x11\x22"


def mirror(config: bytes = CFG) -> Device:
    return MirrorDevice(IDENT, config)


@pytest.mark.parametrize("config", ["11 21", "11", "21", "00", "C3 C1 C1 FD 00 01", "1F 2F"])
def test_data_exchange_with_every_shape(config: str) -> None:
    octets = bytes.fromhex(config)
    plant = Plant(SlaveApp(mirror(octets)), config=octets).run(100)
    plant.assert_the_other_goes_on()
    assert plant.states()[-1] is SlaveState.DATA_EXCHANGE
    assert plant.faults() == []
    image = plant.master.images[4]
    image.outputs = bytes(range(1, 1 + image.output_len))
    plant.run(20)
    assert plant.app.outputs == image.outputs
    assert image.inputs == (image.outputs + bytes(image.input_len))[: image.input_len]


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (lambda: wrong_ident(mirror()), FaultKind.WRONG_IDENT),
        (lambda: refuses_config(IDENT, b"\x11"), FaultKind.CFG_FAULT),
        (lambda: SlaveApp(RefusesParameters(IDENT, CFG)), FaultKind.PRM_FAULT),
        (lambda: WrongLength(mirror()), FaultKind.WRONG_LENGTH),
        (lambda: WrongLength(mirror(), -1), FaultKind.WRONG_LENGTH),
        (lambda: SilentRefusal(mirror(b"\x11")), FaultKind.CFG_FAULT),
        (lambda: locked_by(mirror(), 9), FaultKind.LOCKED),
        (lambda: Dies(mirror(), 20), FaultKind.LOST),
    ],
)
def test_each_faulty_slave_ends_in_its_fault(make: Callable[[], SlaveApp], kind: FaultKind) -> None:
    plant = Plant(make(), user_prm=b"\x01").run(200)
    assert plant.faults()[0] is kind
    assert plant.states()[-1] is not SlaveState.DATA_EXCHANGE
    plant.assert_the_other_goes_on()


def test_the_master_only_waits_for_a_slave_that_never_gets_ready() -> None:
    plant = Plant(NeverReady(mirror())).run(200)
    assert plant.states()[-1] is SlaveState.WAIT_READY
    plant.assert_the_other_goes_on()


def test_a_dead_slave_is_taken_up_again_when_it_is_back() -> None:
    app = Dies(mirror(), 20)
    plant = Plant(app).run(200)
    assert plant.faults() == [FaultKind.LOST]
    assert app.state is SlaveAppState.WAIT_PRM  # its own watchdog, 50 ms
    app.revive(plant.world.now)
    plant.run(1500)
    assert plant.states()[-1] is SlaveState.DATA_EXCHANGE
    plant.assert_the_other_goes_on()


def test_a_broken_device_leaves_data_exchange_and_is_reported() -> None:
    class Breaks(MirrorDevice):
        count = 0

        def exchange(self, outputs: bytes, now: int) -> bytes:
            self.count += 1
            if self.count == 20:
                raise KeyError("plugin")
            return super().exchange(outputs, now)

    plant = Plant(SlaveApp(Breaks(IDENT, CFG))).run(1200)  # the master's back-off for those that fall out early: 1 s
    assert plant.app.failure == "KeyError: 'plugin'"
    assert plant.states().count(SlaveState.DATA_EXCHANGE) == 1
    assert plant.faults()[0] is FaultKind.LEFT
    diagnoses = [event.diagnosis for event in plant.events if isinstance(event, SlaveDiagnosis) and event.address == 4]
    assert diagnoses[-1].stat_diag
    assert diagnoses[-1].not_ready
    plant.assert_the_other_goes_on()


def test_extended_diagnosis_is_fetched_at_once_and_once() -> None:
    class Tells(MirrorDevice):
        said = b""

        def ext_diag(self) -> bytes:
            return self.said

    device = Tells(IDENT, CFG)
    plant = Plant(SlaveApp(device)).run(100)
    device.said = b"\x03\x01\x02"
    plant.run(100)
    diagnoses = [event.diagnosis for event in plant.events if isinstance(event, SlaveDiagnosis) and event.address == 4]
    assert diagnoses[-1].ext == b"\x03\x01\x02"
    assert plant.states()[-1] is SlaveState.DATA_EXCHANGE
    served = plant.app.stats.services
    plant.run(100)
    # nothing is asked any more but what the cyclic Global_Control brings
    assert plant.app.stats.services - served <= 100


def test_a_removed_slave_is_given_free() -> None:
    plant = Plant(SlaveApp(mirror())).run(100)
    plant.world.command(plant.station, RemoveSlave(4))
    plant.run(100)
    assert (plant.app.state, plant.app.master) == (SlaveAppState.WAIT_PRM, None)
    assert plant.app.stats.watchdogs == 0
    plant.assert_the_other_goes_on()


def test_clear_and_operate_reach_the_device() -> None:
    plant = Plant(SlaveApp(mirror())).run(100)
    plant.master.images[4].outputs = b"\x77\x88"
    plant.run(20)
    assert plant.app.outputs == b"\x77\x88"
    plant.world.command(plant.station, SetMode(Mode.CLEAR))
    plant.run(40)
    assert (plant.app.outputs, plant.app.clear) == (b"\0\0", True)
    plant.world.command(plant.station, SetMode(Mode.OPERATE))
    plant.run(40)
    assert (plant.app.outputs, plant.app.clear) == (b"\x77\x88", False)
