"""hypothesis: any services in any order, from anybody, at any time."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples
from slave_kit import CFG, KEEP, MS, PRM, PRM_NO_WD, SLAVE, UNLOCK, Bench, Recorder, global_control, srd

from dpstack.dp.slave.application import SlaveAppState
from dpstack.fdl.interface import RS_REPLY, Reply
from dpstack.fdl.telegram import Kind, Telegram

# Outputs tell who sent them: master 2 sends 02, master 9 sends 09.
masters = st.sampled_from([2, 9])
prms = st.sampled_from([PRM, PRM_NO_WD, KEEP, UNLOCK, PRM[:6], b"", PRM[:4] + b"\0\0\0", PRM + bytes(240)])
configs = st.sampled_from([CFG, b"\x10", b"\x20", b"", b"\xc3\xc1", b"\x11"])
steps = st.one_of(
    # what a working master does, so that scripts get somewhere
    st.just(("prm", 2, PRM)),
    st.just(("cfg", 2, CFG)),
    st.just(("dx", 2, 1)),
    st.just(("dx", 2, 1)),
    # and everything else
    st.tuples(st.just("prm"), masters, prms),
    st.tuples(st.just("cfg"), masters, configs),
    st.tuples(st.just("dx"), masters, st.sampled_from([0, 1, 1, 1, 2])),
    st.tuples(st.just("read"), masters, st.sampled_from([56, 57, 59, 60, 55, 0, 63])),
    st.tuples(st.just("control"), masters, st.binary(max_size=3)),
    st.tuples(st.just("time"), masters, st.sampled_from([0, 1, 30, 99, 100, 101, 1000])),
    st.tuples(st.just("restart"), masters, st.just(0)),
    st.tuples(st.just("ext"), masters, st.binary(max_size=4)),
    st.tuples(st.just("raw"), masters, st.tuples(st.integers(0, 255), st.integers(0, 63), st.binary(max_size=8))),
)


def play(bench: Bench, what: str, sa: int, arg: object) -> Reply | None:
    match what, arg:
        case "prm", bytes(data):
            return bench.prm(data, sa)
        case "cfg", bytes(data):
            return bench.cfg(data, sa)
        case "dx", int(length):
            return bench.dx(bytes([sa]) * length, sa)
        case "read", int(dsap):
            return bench.ask(dsap, b"", sa)
        case "control", bytes(data):
            bench.app.indicate(global_control(data, sa), bench.now)
        case "time", int(ms):
            bench.pass_time(ms * MS)
        case "restart", _:
            bench.app.restart(bench.now)
        case "ext", bytes(data):
            bench.recorder.ext = data
        case "raw", (int(fc), int(dsap), bytes(data)):
            bench.app.indicate(Telegram(Kind.SD2, SLAVE, sa, fc, dsap, 62, data), bench.now)
            return bench.app.serve(Telegram(Kind.SD2, SLAVE, sa, fc | 0x40, dsap, 62, data), bench.now)
        case _:
            raise AssertionError(what)
    return None


@examples(300)
@given(st.sampled_from(["", "prm", "prm cfg"]), st.lists(steps, max_size=40))
def test_random_services_from_two_masters(begin: str, script: list[tuple[str, int, object]]) -> None:
    bench = Bench(Sized())
    app, device = bench.app, bench.recorder
    opening = [("prm", 2, PRM), ("cfg", 2, CFG)][: len(begin.split())]
    for what, sa, arg in [*opening, *script]:
        before, owner = app.state, app.master
        device.take()
        reply = play(bench, what, sa, arg)
        told = device.take()
        exchanging = app.state is SlaveAppState.DATA_EXCH
        assert app.failure is None
        # locked exactly while parameterised
        assert (app.master is None) is (app.state is SlaveAppState.WAIT_PRM)
        # outputs only in data exchange, and never another master's
        assert exchanging or app.outputs == b""
        assert exchanging or app.clear
        assert set(app.outputs) <= {0, app.master}
        # leaving is told, once, and outputs end with it
        left = sum(call.startswith("leave") for call in told)
        assert left <= 1
        assert left == 1 or before is not SlaveAppState.DATA_EXCH or exchanging
        # data are served to the owner in data exchange only
        if what == "dx" and reply != RS_REPLY:
            assert before is SlaveAppState.DATA_EXCH
            assert sa == owner
        if what != "dx" and what != "control" and not (what == "raw" and isinstance(arg, tuple)):
            assert not any(call.startswith("exchange") for call in told)
        # the diagnosis can always be read and tells the truth
        octets = app.serve(srd(60, b"", 33), bench.now)
        assert octets is not None
        status1, status2, _, master = octets.data[:4]
        assert bool(status1 & 2) is not exchanging
        assert bool(status2 & 1) is (app.state is SlaveAppState.WAIT_PRM)
        assert status2 & 4
        assert master == (255 if app.master is None else app.master)
        assert app.wake_at() > bench.now
    assert all(event.text for event in app.take_events())


class Sized(Recorder):
    """Accepts three configurations, with inputs to match."""

    def __init__(self) -> None:
        super().__init__(CFG, b"\x10", b"\x20")

    def enter(self, config: bytes, now: int) -> None:
        super().enter(config, now)
        self.input_len = 0 if config == b"\x20" else 1
