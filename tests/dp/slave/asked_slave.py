"""A slave of one's own on a wire, asked by a master in literal octets."""

from __future__ import annotations

from octet_wire import PARAMS, Wire, framed
from slave_kit import make_slave

from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.user_slave import DpSlave

WAIT_PRM, WAIT_CFG, DATA_EXCH = SlaveAppState.WAIT_PRM, SlaveAppState.WAIT_CFG, SlaveAppState.DATA_EXCH
TYPE = SlaveDescription(
    ident=0x0A35,
    name="own",
    configs=(bytes.fromhex("10 21"),),
    user_prm_len=(1, 2),
    sync=False,
    freeze=False,
    set_slave_add=True,
)
SC = "E5"
PRM = "3D 3E 88 01 0A 0B 0A 35 02 00"
CFG = "3E 3E 10 21"
UNLOCK = "3D 3E 40 01 01 00 0A 35 00"
READS = {
    "Slave_Diag": "3C 3E",
    "Get_Cfg": "3B 3E",
    "RD_Inp": "38 3E",
    "RD_Outp": "39 3E",
}


class Slave:
    """Slave 8 on a wire; :meth:`ask` by data unit with SAPs, :meth:`exchange` by outputs."""

    def __init__(self, description: SlaveDescription = TYPE) -> None:
        self.seen: list[bytes] = []
        self.device = DpSlave(description, self.cycle)
        station = make_slave(8, self.device, PARAMS)
        self.wire = Wire(station)
        app = station.responder
        assert isinstance(app, SlaveApp)
        self.app = app
        self.fcb = 0x6D

    def cycle(self, outputs: bytes, elapsed: int) -> bytes:
        self.seen.append(outputs)
        return bytes([outputs[0] ^ 0xFF])

    def _fc(self) -> int:
        fc = self.fcb
        self.fcb = 0x7D if fc == 0x5D else 0x5D
        return fc

    def ask(self, unit: str, sa: int = 2) -> str:
        return self.wire.ask(framed(0x88, 0x80 | sa, self._fc(), unit))

    def exchange(self, outputs: str, sa: int = 2) -> str:
        """Without outputs it is an SD1 telegram."""
        head = bytes((self.wire.station.address, sa, self._fc()))
        if outputs:
            return self.wire.ask(framed(head[0], head[1], head[2], outputs))
        return self.wire.ask((b"\x10" + head + bytes((sum(head) & 0xFF, 0x16))).hex(" "))

    def diagnosis(self, sa: int = 2) -> str:
        """The data of the answer to Slave_Diag."""
        answer = bytes.fromhex(self.ask("3C 3E", sa))
        assert answer[:9] == bytes((0x68, len(answer) - 6, len(answer) - 6, 0x68, 0x80 | sa, 0x88, 0x08, 0x3E, 0x3C))
        return answer[9:-2].hex(" ").upper()

    def to(self, state: SlaveAppState) -> Slave:
        if state is not WAIT_PRM:
            assert self.ask(PRM) == SC
        if state is DATA_EXCH:
            assert self.ask(CFG) == SC
            assert self.exchange("AA BB") == answer("55")
        assert self.app.state is state
        self.app.take_events()
        return self


def answer(data: str, dsap: str = "", sa: int = 2) -> str:
    """A positive answer of slave 8: data, with SAPs crosswise where there are any."""
    return framed(0x80 | sa if dsap else sa, 0x88 if dsap else 0x08, 0x08, f"{dsap} {data}").upper()
