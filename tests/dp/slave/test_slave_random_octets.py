"""Random octets of a master to a slave: owner and outputs stay right, one answer at most."""

from __future__ import annotations

from hypothesis import example, given
from hypothesis import strategies as st
from octet_wire import MS, framed
from property_kit import examples

from dpstack.dpv1.slave.description import SlaveDescription
from tests.dp.slave.asked_slave import CFG, DATA_EXCH, PRM, READS, UNLOCK, WAIT_PRM, Slave

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
        """The answer. The FCB does not turn after a request that had none
        (docs/reference/protocol.md#frame-count-bit)."""
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
def test_random_octets_from_two_masters(script: list[tuple[str, int, str]]) -> None:
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
