"""Any order of services, resets, faults, removals, new parameters ends in data exchange or in the one right fault.

A master and three slaves in virtual time: two are built with this project's slave, the third knows octets only. Devices
are exchanged, switched off and reset, slaves added, removed, taken out of service and parameterised anew, modes
changed, SYNC and FREEZE ordered, the token lost, and a class 2 master gives slaves other addresses meanwhile, in
whatever order hypothesis finds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from faults.slaves import RefusesParameters, locked_by, refuses_config, wrong_ident
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule
from property_kit import examples
from scripted_link import MS, ScriptedLink
from support_responder import Slave as OctetSlave

from dpstack.dp.master.commands import (
    ActivateSlave,
    AddSlave,
    DeactivateSlave,
    Mode,
    RemoveSlave,
    ReparameteriseSlave,
    SendControl,
    SetMode,
)
from dpstack.dp.master.events import ControlFailed, ControlSent, PictureTaken, SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import BusError, UsageError
from dpstack.fdl.codec import decode
from dpstack.fdl.interface import Failure, Reply, Request
from dpstack.fdl.telegram import SAP_SET_SLAVE_ADD, SHORT_ACK, UNANSWERED, Kind, Telegram
from dpstack.machine import LineDown
from dpstack.params import BusParams

IDENT, CONFIG, OTHER_CONFIG = 0x0696, bytes.fromhex("20 10"), bytes.fromhex("21 11")
ADDRESSES = (3, 4, 5)
OCTETS_ONLY = 5
#: nobody's in the configuration: where a slave may be sent to and come back from
SPARE = 6
CLASS_2 = 9
#: the longest back-off is 10 s, and a reset may come just before a retry
SETTLED = 25_000 * MS


class Far(Protocol):
    """The other end at one address."""

    def ask(self, request: Request, now: int) -> Telegram | Failure: ...

    def hear(self, request: Request, now: int) -> None: ...

    def reset(self, now: int) -> None: ...


class Ours:
    """A slave application of this project."""

    def __init__(self, app: SlaveApp) -> None:
        self.app = app

    def ask(self, request: Request, now: int) -> Telegram | Failure:
        reply: Reply | None = self.app.serve(self._telegram(request), now)
        if reply is None:
            return Failure.NO_ANSWER
        if reply.short:
            return SHORT_ACK
        kind = Kind.SD2 if reply.data else Kind.SD1
        saps = (request.ssap, request.dsap) if reply.data else (None, None)
        return Telegram(kind, 2, request.da, int(reply.status), *saps, reply.data)

    def hear(self, request: Request, now: int) -> None:
        self.app.indicate(self._telegram(request), now)

    def reset(self, now: int) -> None:
        self.app.restart(now)

    def readdress(self, old: int, new: int, now: int) -> bool:
        """Set_Slave_Add of a class 2 master; whether the slave goes to ``new``."""
        data = bytes((new,)) + self.app.device.ident.to_bytes(2, "big") + b"\0"
        self.app.serve(Telegram(Kind.SD2, old, CLASS_2, 0x4D, SAP_SET_SLAVE_ADD, 62, data), now)
        return self.app.address == new

    def _telegram(self, request: Request) -> Telegram:
        return Telegram(Kind.SD2, request.da, 2, 0x40 | request.function, request.dsap, request.ssap, request.data)


class Octets:
    """The slave that knows octets only."""

    def __init__(self, slave: OctetSlave) -> None:
        self.slave = slave

    def ask(self, request: Request, now: int) -> Telegram | Failure:
        telegram = decode(self._answer(request))
        return Failure.NO_ANSWER if telegram is None else telegram

    def hear(self, request: Request, now: int) -> None:
        self._answer(request)

    def reset(self, now: int) -> None:
        slave = self.slave
        slave.prm_ok = slave.cfg_ok = slave.foreign
        slave.prm_fault = slave.cfg_fault = False

    def _answer(self, request: Request) -> bytes:
        saps = b"" if request.dsap is None else bytes((request.dsap, request.ssap or 0))
        return self.slave.answer(2, 0x40 | request.function, saps, request.data)


def octets(**keys: str) -> Octets:
    ident = bytes.fromhex(keys.pop("ident", "0696"))
    return Octets(OctetSlave(OCTETS_ONLY, ident, CONFIG, 1, 1, **keys))


#: device -> how it is made, and the fault it must end in (empty: data exchange)
DEVICES: dict[str, tuple[Callable[[], SlaveApp], Callable[[], Octets], str]] = {
    "good": (lambda: SlaveApp(MirrorDevice(IDENT, CONFIG)), octets, ""),
    "other device": (
        lambda: wrong_ident(MirrorDevice(IDENT, CONFIG)), lambda: octets(ident="DEAD"), "wrong_ident",
    ),
    "refuses parameters": (
        lambda: SlaveApp(RefusesParameters(IDENT, CONFIG)), lambda: octets(refuse="prm"), "prm_fault",
    ),
    "refuses configuration": (
        lambda: refuses_config(IDENT, OTHER_CONFIG), lambda: octets(refuse="cfg"), "cfg_fault",
    ),
    "of another master": (
        lambda: locked_by(MirrorDevice(IDENT, CONFIG), 9), lambda: octets(owner="9"), "locked",
    ),
}  # fmt: skip


class Link(ScriptedLink):
    """Grants holds to the master; the other ends are real slaves whose watchdogs run."""

    far: dict[int, Far]

    def _answer(self, request: Request) -> Telegram | Failure:
        if request.function in UNANSWERED:
            for address, far in self.far.items():
                if request.da in (127, address):
                    far.hear(request, self.now)
            return SHORT_ACK
        asked = self.far.get(request.da)
        return Failure.NO_ANSWER if asked is None else asked.ask(request, self.now)

    def hold(self) -> list[Request]:
        for far in self.far.values():
            if isinstance(far, Ours) and far.app.wake_at() <= self.now:
                far.app.tick(self.now)
        return super().hold()


def setup(address: int, **changes: Any) -> SlaveParams:
    values: dict[str, Any] = {
        "address": address, "name": f"s{address}", "ident": IDENT, "config": CONFIG, "user_prm": b"\x01",
        "groups": (1,), "sync": True, "freeze": True,
    }  # fmt: skip
    return SlaveParams(**(values | changes))


addresses = st.sampled_from(ADDRESSES)


class RandomSequences(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.bus = Link(Master(BusParams.preset(500_000, address=2), map(setup, ADDRESSES)), period=15 * MS)
        self.bus.far = {}
        self.devices = dict.fromkeys(ADDRESSES, "off")
        self.tokens = 0
        self.refused = 0
        for address in ADDRESSES:
            self.switch_on(address, "good")

    def order(self, command: object) -> None:
        self.bus.master.command(command, self.bus.now)

    def handled(self, address: int) -> bool:
        return address in self.bus.master.handlers

    # --- the field ---

    @rule(address=addresses, device=st.sampled_from(sorted(DEVICES)))
    def switch_on(self, address: int, device: str) -> None:
        ours, octet, _ = DEVICES[device]
        self.bus.far[address] = octet() if address == OCTETS_ONLY else Ours(ours())
        self.devices[address] = device

    @rule(address=addresses)
    def switch_off(self, address: int) -> None:
        self.bus.far.pop(address, None)
        self.devices[address] = "off"

    @rule(address=addresses)
    def reset(self, address: int) -> None:
        if address in self.bus.far and self.devices[address] != "of another master":
            self.bus.far[address].reset(self.bus.now)

    @rule(old=st.sampled_from((3, 4, SPARE)), new=st.sampled_from((3, 4, SPARE)))
    def give_another_address(self, old: int, new: int) -> None:
        far = self.bus.far.get(old)
        if isinstance(far, Ours) and new not in self.bus.far and far.readdress(old, new, self.bus.now):
            self.bus.far[new] = self.bus.far.pop(old)
            self.devices[new], self.devices[old] = self.devices[old], "off"

    @rule(ms=st.integers(1, 3_000))
    def pass_time(self, ms: int) -> None:
        self.bus.run(ms * MS)

    @rule(reason=st.sampled_from(["unplugged", "this station holds no token"]))
    def lose_the_line(self, reason: str) -> None:
        self.order(LineDown(reason))

    # --- the application ---

    @rule(mode=st.sampled_from([Mode.STOP, Mode.CLEAR, Mode.OPERATE]))
    def change_mode(self, mode: Mode) -> None:
        self.order(SetMode(mode))

    @rule(address=addresses)
    def add_or_remove(self, address: int) -> None:
        self.order(RemoveSlave(address) if self.handled(address) else AddSlave(setup(address)))

    @rule(address=addresses, active=st.booleans())
    def take_out_of_service_and_back(self, address: int, active: bool) -> None:
        if self.handled(address):
            self.order(ActivateSlave(address) if active else DeactivateSlave(address))

    @rule(address=addresses, groups=st.sampled_from([(), (1,), (1, 2)]), watchdog=st.sampled_from([0, 200, 500]))
    def parameterise_anew(self, address: int, groups: tuple[int, ...], watchdog: int) -> None:
        if self.handled(address):
            self.order(ReparameteriseSlave(setup(address, groups=groups, watchdog_ms=watchdog)))

    @rule(groups=st.sampled_from([(), (1,), (2,)]), what=st.sampled_from(["sync", "unsync", "freeze", "unfreeze"]),
          settle=st.booleans(), picture=st.booleans())  # fmt: skip
    def control(self, groups: tuple[int, ...], what: str, settle: bool, picture: bool) -> None:
        try:
            self.order(SendControl(self.tokens, groups, **{what: True}, settle=settle, picture=picture))
        except (UsageError, BusError):
            return
        self.tokens += 1

    @precondition(lambda self: self.bus.now > 100 * MS)
    @rule(value=st.integers(0, 255))
    def write(self, value: int) -> None:
        for image in self.bus.master.images.values():
            image.outputs = bytes((value,))

    # --- the end of it ---

    def teardown(self) -> None:
        master = self.bus.master
        self.order(SetMode(Mode.OPERATE))
        self.bus.run(SETTLED)
        for address, handler in master.handlers.items():
            device = self.devices[address]
            if handler.state is SlaveState.DEACTIVATED:
                assert handler.diagnosis is not None
                assert "deactivated" in handler.diagnosis.flags
                continue
            fault = handler.fault.kind.value if handler.fault else ""
            if device == "off":
                assert (handler.state, fault in ("absent", "lost")) == (SlaveState.OFFLINE, True), fault
            elif device == "good":
                assert (handler.state, fault) == (SlaveState.DATA_EXCHANGE, ""), (address, handler.fault)
                assert handler.image.valid
            else:
                assert (handler.state, fault) == (SlaveState.FAULT, DEVICES[device][2]), (address, handler.fault)
        self._every_order_ended()

    def _every_order_ended(self) -> None:
        kinds = (ControlSent, ControlFailed, PictureTaken)
        ended = {event.token for event in self.bus.events if isinstance(event, kinds)}
        assert ended == set(range(self.tokens))


TestRandomSequences = RandomSequences.TestCase
TestRandomSequences.settings = settings(examples(25), stateful_step_count=25)
