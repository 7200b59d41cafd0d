"""For tests of the DP slave: requests as telegrams, and a device that writes down what it is told."""

from __future__ import annotations

from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave.device import DpV0Device, Leave
from dpstack.dpv1.slave.device import Device
from dpstack.fdl.interface import Reply
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Kind, Req, Telegram
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience

MS = 1_000_000
MASTER = 2
OTHER = 9
SLAVE = 8

# Literal PDUs (docs/reference/protocol.md#known-telegrams, docs/reference/protocol.md#set_prm): lock, watchdog 1 x 10
# (100 ms), min T_SDR 11, ident 0A35, group 2
PRM = bytes.fromhex("88 01 0A 0B 0A 35 02")
PRM_NO_WD = bytes.fromhex("80 01 01 0B 0A 35 00")
UNLOCK = bytes.fromhex("40 01 01 00 0A 35 00")
KEEP = bytes.fromhex("00 01 01 37 FF FF 00")
#: 1 octet in, 1 octet out
CFG = bytes.fromhex("10 20")

WAIT_PRM, WAIT_CFG, DATA_EXCH = SlaveAppState.WAIT_PRM, SlaveAppState.WAIT_CFG, SlaveAppState.DATA_EXCH

CLEAR, OPERATE = b"\x02\x00", b"\x00\x00"
SYNC, UNSYNC, FREEZE, UNFREEZE = b"\x20\x00", b"\x10\x00", b"\x08\x00", b"\x04\x00"


def make_slave(
    address: int, device: DpV0Device, params: BusParams, *, t_sdr: int | None = None, patience: Patience = EXACT
) -> PassiveStation:
    """A passive station at ``address`` whose responder is a SlaveApp around ``device``; ``t_sdr``: its response time in
    bit times."""
    return PassiveStation(address, SlaveApp(device, address=address), params, t_sdr=t_sdr, patience=patience)


class Recorder(Device):
    """Inputs count the exchanges: the first is 1. ``calls`` are what the device was told, in order."""

    ident = 0x0A35
    name = "recorder"

    def __init__(self, *configs: bytes) -> None:
        self.configs = configs or (CFG,)
        self.calls: list[str] = []
        self.count = 0
        self.outputs = b""
        self.ext = b""
        self.input_len = 1
        self.prm_reason: str | None = None
        self.broken = ""
        self.keeps = False  # an address from Set_Slave_Add, over a restart

    def _call(self, text: str) -> None:
        self.calls.append(text)
        if text.split()[0] == self.broken:
            raise ZeroDivisionError("the device is broken")

    def check_prm(self, user_prm: bytes) -> str | None:
        self._call(f"check_prm {user_prm.hex()}".strip())
        return self.prm_reason

    def check_cfg(self, config: bytes) -> str | None:
        self._call(f"check_cfg {config.hex()}")
        return super().check_cfg(config)

    def enter(self, config: bytes, now: int) -> None:
        self._call("enter")

    def exchange(self, outputs: bytes, now: int) -> bytes:
        self._call(f"exchange {outputs.hex()}".strip())
        self.outputs = outputs
        self.count += 1
        return bytes([self.count & 0xFF]) * self.input_len

    def clear(self, now: int) -> None:
        self._call("clear")

    def operate(self, now: int) -> None:
        self._call("operate")

    def leave(self, reason: Leave, now: int) -> None:
        self._call(f"leave {reason.value}")

    def ext_diag(self) -> bytes:
        if self.broken == "ext_diag":
            raise ZeroDivisionError("the device is broken")
        return self.ext

    def address_set(self, address: int, fixed: bool, rem_slave_data: bytes) -> bool:
        self._call(f"address_set {address} {fixed} {rem_slave_data.hex()}".strip())
        return self.keeps

    def take(self) -> list[str]:
        calls, self.calls = self.calls, []
        return calls


def srd(dsap: int | None, data: bytes = b"", sa: int = MASTER, function: int = Req.SRD_HIGH) -> Telegram:
    """A request to the slave as its station hands it on."""
    return Telegram(Kind.SD2, SLAVE, sa, 0x40 | function, dsap, None if dsap is None else 62, data)


def global_control(data: bytes, sa: int = MASTER) -> Telegram:
    """Global_Control to all."""
    return Telegram(Kind.SD2, 127, sa, 0x46, 58, 62, data)


class Bench:
    """A slave application under test, with the time it is told."""

    def __init__(self, device: DpV0Device | None = None, app: SlaveApp | None = None) -> None:
        self.device = device or Recorder()
        self.app = app or SlaveApp(self.device, address=SLAVE)
        self.now = 0

    @property
    def recorder(self) -> Recorder:
        assert isinstance(self.device, Recorder)
        return self.device

    def ask(self, dsap: int | None, data: bytes = b"", sa: int = MASTER) -> Reply:
        reply = self.app.serve(srd(dsap, data, sa), self.now)
        assert reply is not None
        return reply

    def prm(self, data: bytes = PRM, sa: int = MASTER) -> Reply:
        return self.ask(61, data, sa)

    def cfg(self, data: bytes = CFG, sa: int = MASTER) -> Reply:
        return self.ask(62, data, sa)

    def prm_and_cfg(self, prm: bytes = PRM, cfg: bytes = CFG, sa: int = MASTER) -> None:
        self.prm(prm, sa)
        self.cfg(cfg, sa)

    def dx(self, data: bytes = b"\x55", sa: int = MASTER) -> Reply:
        return self.ask(None, data, sa)

    def diag(self, sa: int = MASTER) -> bytes:
        return self.ask(60, b"", sa).data

    def control(self, data: bytes, sa: int = MASTER) -> None:
        self.app.indicate(global_control(data, sa), self.now)

    def pass_time(self, ns: int) -> None:
        """Let time pass and the application have its ticks."""
        end = self.now + ns
        for _ in range(10_000):
            due = self.app.wake_at()
            if due > end:
                break
            self.now = max(self.now, due)
            self.app.tick(self.now)
        self.now = end

    def up(self, prm: bytes = PRM, cfg: bytes = CFG) -> Bench:
        """Into data exchange; what was told until then is forgotten."""
        self.prm_and_cfg(prm, cfg)
        self.app.take_events()
        if isinstance(self.device, Recorder):
            self.device.take()
        return self

    def texts(self) -> list[str]:
        return [event.text for event in self.app.take_events()]


def in_state(state: SlaveAppState, device: Device | None = None, prm: bytes = PRM) -> Bench:
    """A bench whose slave is in ``state``; what was told until then is forgotten."""
    bench = Bench(device)
    if state is not WAIT_PRM:
        bench.prm(prm)
    if state is DATA_EXCH:
        bench.cfg()
        bench.dx()
    assert bench.app.state is state
    bench.app.take_events()
    return bench
