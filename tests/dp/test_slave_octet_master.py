"""Every DP-V0 service at the slave in literal octets on the wire: right, too short, too long, wrong state, SAP, master.

The rows are (what is asked, what is answered, the state afterwards); telegrams are put together by hand.
"""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from octet_wire import BIT, MS, PARAMS, Wire, framed
from property_kit import examples

from dpstack.dp.dp_slave import DpSlave
from dpstack.dp.slave_description import SlaveDescription
from dpstack.dp.slaveapp import SlaveApp, SlaveAppState, make_slave

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
#: RS (status 3) from slave 8 to master 2, and to 9
RS = {2: "10 02 08 03 0D 16", 9: "10 09 08 03 14 16"}
NR = "10 02 08 09 13 16"
PRM = "3D 3E 88 01 0A 0B 0A 35 02 00"
CFG = "3E 3E 10 21"
UNLOCK = "3D 3E 40 01 01 00 0A 35 00"


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


READS = {
    "Slave_Diag": "3C 3E",
    "Get_Cfg": "3B 3E",
    "RD_Inp": "38 3E",
    "RD_Outp": "39 3E",
}
ANSWERS = {
    ("Slave_Diag", WAIT_PRM): "02 05 00 FF 0A 35",
    ("Slave_Diag", WAIT_CFG): "02 0C 00 02 0A 35",
    ("Slave_Diag", DATA_EXCH): "00 0C 00 02 0A 35",
    ("Get_Cfg", WAIT_PRM): "10 21",
    ("Get_Cfg", WAIT_CFG): "10 21",
    ("Get_Cfg", DATA_EXCH): "10 21",
    ("RD_Inp", DATA_EXCH): "55",
    ("RD_Outp", DATA_EXCH): "AA BB",
}


@pytest.mark.parametrize("sa", [2, 9])
@pytest.mark.parametrize("state", list(SlaveAppState))
@pytest.mark.parametrize("service", list(READS))
def test_reading_services(service: str, state: SlaveAppState, sa: int) -> None:
    """B5: Slave_Diag and Get_Cfg always, RD_Inp and RD_Outp in Data_Exch; of any master, also of class 2."""
    slave = Slave().to(state)
    unit = READS[service]
    data = ANSWERS.get((service, state))
    wanted = RS[sa] if data is None else answer(data, f"3E {unit[:2]}", sa)
    assert slave.ask(unit, sa) == wanted
    assert slave.ask(unit, sa) == wanted
    assert slave.app.state is state


@pytest.mark.parametrize(
    ("unit", "answered", "state", "diagnosis"),
    [
        ("3D 3E 88 01 0A 0B 0A 35 02 00", SC, WAIT_CFG, "02 0C 00 02 0A 35"),
        ("3D 3E 80 01 01 0B 0A 35 00 00 00", SC, WAIT_CFG, "02 04 00 02 0A 35"),  # watchdog off
        ("3D 3E 80 00 00 0B 0A 35 00 00", SC, WAIT_CFG, "02 04 00 02 0A 35"),  # factors without WD_On are nothing
        ("3D 3E 87 01 01 0B 0A 35 00 00", SC, WAIT_CFG, "02 04 00 02 0A 35"),  # reserved bits are ignored
        ("3D 3E", SC, WAIT_PRM, "42 05 00 FF 0A 35"),
        ("3D 3E 88 01 0A 0B 0A 35", SC, WAIT_PRM, "42 05 00 FF 0A 35"),  # octet 7 is missing
        ("3D 3E 88 01 0A 0B 0A 35 02", SC, WAIT_PRM, "42 05 00 FF 0A 35"),  # a user parameter is missing
        ("3D 3E 88 01 0A 0B 0A 35 02 00 00 00", SC, WAIT_PRM, "42 05 00 FF 0A 35"),  # one too many
        ("3D 3E 88 01 0A 0B 0A 36 02 00", SC, WAIT_PRM, "42 05 00 FF 0A 35"),  # ident number
        ("3D 3E 88 00 0A 0B 0A 35 02 00", SC, WAIT_PRM, "42 05 00 FF 0A 35"),  # WD_Fact_1
        ("3D 3E 88 0A 00 0B 0A 35 02 00", SC, WAIT_PRM, "42 05 00 FF 0A 35"),  # WD_Fact_2
        ("3D 3E A8 01 0A 0B 0A 35 02 00", SC, WAIT_PRM, "12 05 00 FF 0A 35"),  # Sync_Req: Not_Supported
        ("3D 3E 98 01 0A 0B 0A 35 02 00", SC, WAIT_PRM, "12 05 00 FF 0A 35"),  # Freeze_Req: Not_Supported
        (UNLOCK, SC, WAIT_PRM, "02 05 00 FF 0A 35"),
        ("3D 3E C0 01 01 00 0A 35 00", SC, WAIT_PRM, "02 05 00 FF 0A 35"),  # 11 releases too
        ("3D 3E C8 01 01 00 0A 36 00", SC, WAIT_PRM, "42 05 00 FF 0A 35"),  # a release for another device
    ],
)
@pytest.mark.parametrize("start", list(SlaveAppState))
def test_set_prm(start: SlaveAppState, unit: str, answered: str, state: SlaveAppState, diagnosis: str) -> None:
    """B2, J: acknowledged whatever it is; the diagnosis tells. In any state the same comes of it."""
    slave = Slave().to(start)
    assert slave.ask(unit) == answered
    assert slave.app.state is state
    assert slave.diagnosis() == diagnosis


@pytest.mark.parametrize("start", list(SlaveAppState))
def test_set_prm_without_lock_and_unlock_changes_min_tsdr_only(start: SlaveAppState) -> None:
    """B2, p734; whatever the ident number. 0 keeps, less than 11 counts as 11."""
    slave = Slave().to(start)
    for octet, bits in (("37", 0x37), ("00", 0x37), ("FF", 0xFF), ("05", 11)):
        assert slave.ask(f"3D 3E 00 00 00 {octet} FF FF 00") == SC
        assert slave.app.state is start
        begin = slave.wire.now + 1000 * BIT
        slave.diagnosis()
        assert slave.wire.out[0][0] - begin == bits * BIT


@pytest.mark.parametrize("octet", ["0B", "64", "00"])
def test_min_tsdr_holds_for_every_kind_of_answer(octet: str) -> None:
    """Octet 4 of Set_Prm: SC, data, RS and FDL status start no earlier."""
    slave = Slave()
    slave.ask(f"3D 3E 88 01 0A {octet} 0A 35 02 00")
    bits = max(int(octet, 16), 11)
    for octets in (
        framed(0x88, 0x82, 0x5D, CFG),
        framed(0x08, 0x02, 0x7D, "01 02"),
        framed(0x88, 0x82, 0x5D, "3C 3E"),
        framed(0x88, 0x82, 0x7D, "37 3E 05 0A 35 00"),
        "10 08 02 49 53 16",
    ):
        begin = slave.wire.now + 1000 * BIT
        assert slave.wire.ask(octets)
        assert slave.wire.out[0][0] - begin == bits * BIT
    slave.app.restart(slave.wire.now)  # as switched on
    begin = slave.wire.now + 1000 * BIT
    slave.wire.ask("10 08 02 49 53 16")
    assert slave.wire.out[0][0] - begin == 11 * BIT


@pytest.mark.parametrize(
    ("unit", "state", "diagnosis"),
    [
        (CFG, DATA_EXCH, "00 0C 00 02 0A 35"),
        ("3E 3E", WAIT_PRM, "06 05 00 FF 0A 35"),
        ("3E 3E 10", WAIT_PRM, "06 05 00 FF 0A 35"),
        ("3E 3E 10 20", WAIT_PRM, "06 05 00 FF 0A 35"),
        ("3E 3E 10 21 00", WAIT_PRM, "06 05 00 FF 0A 35"),
        ("3E 3E C0", WAIT_PRM, "06 05 00 FF 0A 35"),
    ],
)
@pytest.mark.parametrize("start", [WAIT_CFG, DATA_EXCH])
def test_chk_cfg(start: SlaveAppState, unit: str, state: SlaveAppState, diagnosis: str) -> None:
    slave = Slave().to(start)
    assert slave.ask(unit) == SC
    assert slave.app.state is state
    assert slave.diagnosis() == diagnosis


def test_chk_cfg_before_set_prm_changes_nothing() -> None:
    slave = Slave()
    assert slave.ask(CFG) == SC
    assert slave.diagnosis() == "02 05 00 FF 0A 35"


@pytest.mark.parametrize("start", [WAIT_CFG, DATA_EXCH])
@pytest.mark.parametrize("unit", [PRM, UNLOCK, "3D 3E 00 01 01 37 0A 35 00", "3D 3E", CFG, "3E 3E 11"])
def test_what_another_master_sends_changes_nothing(unit: str, start: SlaveAppState) -> None:
    """B2: locked; acknowledged, and the diagnosis names the owner."""
    slave = Slave().to(start)
    before = slave.diagnosis(9)
    assert slave.ask(unit, 9) == SC
    assert slave.diagnosis(9) == before
    assert slave.app.state is start
    assert slave.app.master == 2
    assert slave.exchange("01 02", 9) == RS[9]
    begin = slave.wire.now + 1000 * BIT
    slave.diagnosis(9)
    assert slave.wire.out[0][0] - begin == 11 * BIT  # nor min T_SDR


def test_data_exchange() -> None:
    slave = Slave()
    assert slave.exchange("01 02") == RS[2]
    slave.to(WAIT_CFG)
    assert slave.exchange("01 02") == RS[2]
    assert slave.app.state is WAIT_CFG
    slave.ask(CFG)
    assert slave.exchange("01 02") == answer("FE")
    # SRD low is answered as SRD high
    assert slave.wire.ask(framed(0x08, 0x02, slave._fc() - 1, "03 02")) == answer("FC")
    assert slave.seen == [b"\1\2", b"\3\2"]


@pytest.mark.parametrize("outputs", ["", "01", "01 02 03", "00 " * 244])
def test_data_exchange_of_the_wrong_length(outputs: str) -> None:
    """J: Wait_Prm with Cfg_Fault; an empty frame too, the slave is not Fail_Safe. Outputs safe."""
    slave = Slave().to(DATA_EXCH)
    assert slave.exchange(outputs) == RS[2]
    assert slave.diagnosis() == "06 05 00 FF 0A 35"
    assert slave.seen == [b"\xaa\xbb", b"\0\0"]


@pytest.mark.parametrize("state", list(SlaveAppState))
@pytest.mark.parametrize("sap", [0, 48, 49, 50, 51, 53, 54, 58, 63])
def test_saps_that_are_not_open(sap: int, state: SlaveAppState) -> None:
    """RS: the SAP is not active (A3). Global_Control is no SRD."""
    slave = Slave().to(state)
    assert slave.ask(f"{sap:02X} 3E 00 00") == RS[2]
    assert slave.app.state is state


@pytest.mark.parametrize(
    ("unit", "da", "sa", "clear"),
    [
        ("3A 3E 02 00", 127, 2, True),
        ("3A 3E 02 02", 127, 2, True),  # group 2 is the slave's
        ("3A 3E 02 02", 8, 2, True),  # to the slave alone
        ("3A 3E 02 01", 127, 2, False),  # another group
        ("3A 3E 00 00", 127, 2, False),
        ("3A 3E C1 00", 127, 2, False),  # reserved bits
        ("3A 3E 02", 127, 2, False),  # one octet
        ("3A 3E 02 00 00", 127, 2, False),  # three
        ("3A 3E", 127, 2, False),
        ("3A 3E 02 00", 127, 9, False),  # not the owner
        ("39 3E 02 00", 127, 2, False),  # another SAP
        ("3A 3E 02 00", 7, 2, False),  # another station
    ],
)
def test_global_control(unit: str, da: int, sa: int, clear: bool) -> None:
    slave = Slave().to(DATA_EXCH)
    assert slave.wire.ask(framed(0x80 | da, 0x80 | sa, 0x46, unit)) == ""
    assert slave.app.clear is clear
    assert slave.seen[1:] == ([b"\0\0"] if clear else [])
    slave.wire.ask(framed(0xFF, 0x82, 0x46, "3A 3E 00 00"))
    assert not slave.app.clear
    assert slave.exchange("01 02") == answer("FE")


@pytest.mark.parametrize("state", [WAIT_PRM, WAIT_CFG])
def test_global_control_before_data_exchange_is_dropped(state: SlaveAppState) -> None:
    slave = Slave().to(state)
    slave.wire.ask(framed(0xFF, 0x82, 0x46, "3A 3E 02 00"))
    slave.ask(PRM)
    slave.ask(CFG)
    assert not slave.app.clear


def test_sync_and_freeze_that_are_not_supported_do_nothing() -> None:
    slave = Slave().to(DATA_EXCH)
    slave.wire.ask(framed(0xFF, 0x82, 0x46, "3A 3E 28 00"))
    assert slave.exchange("01 02") == answer("FE")
    assert slave.app.outputs == b"\1\2"
    assert slave.diagnosis() == "00 0C 00 02 0A 35"


# --- any order ----------------------------------------------------------------------------------------------------

#: what a master of octets may send: (data unit or outputs, kind)
UNITS = st.one_of(
    st.sampled_from([PRM, CFG, UNLOCK, "3D 3E 88 01 0A 0B 0A 36 02 00", "3E 3E 11", "3D 3E 00 01 01 37 FF FF 00"]),
    st.sampled_from([*READS.values(), "37 3E 09 0A 35 00", "37 3E 08 0A 35 FF"]),
    st.binary(max_size=12).map(lambda octets: "3D 3E " + octets.hex(" ")),
    st.binary(max_size=4).map(lambda octets: "3E 3E " + octets.hex(" ")),
    st.tuples(st.integers(0, 63), st.binary(max_size=6)).map(lambda pair: f"{pair[0]:02x} 3e {pair[1].hex(' ')}"),
)
STEPS = st.one_of(
    st.tuples(st.just("ask"), st.sampled_from([2, 9]), UNITS),
    st.tuples(st.just("bring-up"), st.sampled_from([2, 2, 9]), st.just("")),
    st.tuples(
        st.just("exchange"), st.sampled_from([2, 2, 9]), st.sampled_from(["SS SS", "SS SS", "SS", "", "SS SS SS"])
    ),
    st.tuples(st.just("control"), st.sampled_from([2, 9]), st.binary(max_size=3).map(lambda octets: octets.hex(" "))),
    st.tuples(st.just("control"), st.just(2), st.sampled_from(["20 00", "10 00", "02 00", "00 00", "22 00", "28 00"])),
    st.tuples(st.just("time"), st.just(0), st.sampled_from(["1", "50", "99", "101", "400"])),
    st.tuples(st.just("noise"), st.just(0), st.binary(min_size=1, max_size=9).map(lambda octets: octets.hex(" "))),
    st.tuples(st.just("restart"), st.just(0), st.just("")),
)
SYNCABLE = SlaveDescription(ident=0x0A35, configs=(bytes.fromhex("10 21"),), user_prm_len=(0, 9), set_slave_add=True)


class Player(Slave):
    """A slave with SYNC, and what may befall it. Outputs tell who sent them: master 2 sends 02 02."""

    def send(self, sa: int, unit: str) -> str:
        return self.wire.ask(framed(0x80 | self.wire.station.address, 0x80 | sa, self._fc(), unit))

    def play(self, what: str, sa: int, arg: str) -> str:
        """The answer. The FCB does not turn after a request that had none (A4)."""
        fcb = self.fcb
        answered = self._play(what, sa, arg)
        if not answered:
            self.fcb = fcb
        return answered

    def _play(self, what: str, sa: int, arg: str) -> str:
        match what:
            case "ask":
                return self.send(sa, arg)
            case "bring-up":
                self.send(sa, "3D 3E 88 01 0A 0B 0A 35 02")
                return self.send(sa, CFG)
            case "exchange":
                return self.exchange(arg.replace("SS", f"{sa:02x}"), sa)
            case "control":
                return self.wire.ask(framed(0xFF, 0x80 | sa, 0x46, "3A 3E " + arg))
            case "time":
                self.wire.pass_time(int(arg) * MS)
            case "noise":
                return self.wire.ask(arg)
            case "restart":
                self.app.restart(self.wire.now)
        return ""


@examples(150)
@example(
    [("restart", 0, ""), ("ask", 2, "37 3E 09 0A 35 00"), ("ask", 9, PRM)]
)  # the address of a master is given to it
@example(
    [("restart", 0, ""), ("ask", 2, "37 3E 09 0A 35 00"), ("ask", 2, PRM), ("ask", 9, PRM), ("exchange", 2, "SS SS")]
)  # nor does what such a master sends stand between two requests of another one
@given(st.lists(STEPS, max_size=30))
def test_whatever_a_master_of_octets_sends(script: list[tuple[str, int, str]]) -> None:
    slave = Player(SYNCABLE)
    app = slave.app
    owner_prm: int | None = None  # who sent the last Set_Prm that could lock the slave, as octets say
    for what, sa, arg in [("bring-up", 2, ""), *script]:
        state, held, master, address = app.state, app.outputs, app.master, slave.wire.station.address
        synced = bool(app.diagnosis(slave.wire.now).sync)
        slave.seen.clear()
        answered = slave.play(what, sa, arg)
        if what == "bring-up" or (what == "ask" and arg.upper().startswith("3D 3E")):
            owner_prm = sa if master is None or master == sa else owner_prm
        # what the process has is what the slave says, and safe as soon as it says nothing
        if slave.seen:
            assert slave.seen[-1] == (app.outputs or b"\0\0")
        # data exchange only after Set_Prm and Chk_Cfg of one and the same master, the owner of the lock
        if app.state is DATA_EXCH:
            assert app.master is not None
            assert app.master == owner_prm
            assert set(app.outputs) <= {0, app.master}
            assert state is not WAIT_PRM or what == "bring-up"
        else:
            assert app.outputs == b""
            assert state is not DATA_EXCH or slave.seen[-1:] == [b"\0\0"]
        assert (app.master is None) is (app.state is WAIT_PRM)
        # outputs under SYNC change with Global_Control of the owner only, or to the safe ones
        if synced and app.state is DATA_EXCH and state is DATA_EXCH and app.outputs != held:
            assert (what, sa) == ("control", master) or what == "bring-up"
        # only the owner is served data
        if what == "exchange" and answered and not answered.endswith("03 " + answered[-5:]):
            assert (state, sa) == (DATA_EXCH, master)
        # one answer at most, from its own address, and every service has one, but for what seems to be its own
        assert len(slave.wire.out) <= 1
        if what in ("ask", "exchange"):
            assert bool(answered) is (address != sa)
        assert app.failure is None
    assert all(event.text for event in app.take_events())
