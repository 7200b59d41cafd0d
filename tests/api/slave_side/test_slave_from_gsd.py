"""A slave from a GSD file and a function, and what a simulation makes of a [[slave]] table with a GSD file.

The other end is octets put together by hand.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from api_kit import operating
from gsd_kit import FILES, HEAD, device, made
from octet_wire import PARAMS, Wire, framed
from slave_kit import make_slave

import dpstack
from dpstack.api.bus.events_json import event_json
from dpstack.api.config.config import slave_config
from dpstack.api.slave_side.virtual_bench import device_of
from dpstack.dpv1.pdu.im import Im0
from dpstack.dpv1.slave.description_from_gsd import slave_description
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.record_table import RecordTable
from dpstack.dpv1.slave.user_slave import SlaveOptions
from dpstack.errors import ConfigError
from dpstack.gsd.configuration import configure

WHOLE = str(FILES / "whole.gsd")
SC = "E5"
#: ident 1A2B, watchdog off, eight octets of user parameters
PRM = "3D 3E 80 01 01 0B 1A 2B 00 80 00 00 08 00 01 01 F4"


def echo(outputs: bytes, elapsed: int) -> bytes:
    return outputs


class Octets:
    """Requests of master 2 to slave 8."""

    def __init__(self, device: Device) -> None:
        self.wire = Wire(make_slave(8, device, PARAMS))
        self.fc = 0x6D

    def ask(self, unit: str) -> str:
        answer = self.wire.ask(framed(0x88, 0x82, self.fc, unit))
        self.fc = 0x7D if self.fc == 0x5D else 0x5D
        return answer

    def diagnosis(self) -> str:
        return bytes.fromhex(self.ask("3C 3E"))[9:-2].hex(" ").upper()

    def exchange(self, outputs: str) -> str:
        answer = self.wire.ask(framed(0x08, 0x02, self.fc, outputs))
        self.fc = 0x7D if self.fc == 0x5D else 0x5D
        return bytes.fromhex(answer)[7:-2].hex(" ").upper()


def test_it_takes_all_that_a_slave_takes() -> None:
    """All options of DpSlave reach it."""

    def called(*arguments: object) -> None:
        return None

    records = RecordTable({})
    options: dict[str, Any] = {name: called for name in SlaveOptions.__annotations__ if name.startswith("on_")}
    options |= {"config": b"\x20", "safe": b"\x01", "im": [Im0(order_id="T")], "parameters": records, "ms2": 3}
    assert set(options) == set(SlaveOptions.__annotations__)
    slave = dpstack.slave.slave_from_gsd(WHOLE, echo, ["8 DO"], **options)
    found = [slave._calls[name] for name in options if name.startswith("on_")]
    assert found == [called] * len(found)
    assert (slave.configs, slave.safe, slave.ms2, len(slave.im)) == ((b"\x20",), b"\x01", 3, 1)
    with pytest.raises(TypeError, match=r"DpSlave\(\) got an unexpected keyword argument 'colour'"):
        dpstack.slave.slave_from_gsd(WHOLE, echo, colour=1)  # type: ignore[call-arg]


def test_plugged_modules_may_differ_from_the_preset() -> None:
    assert dpstack.slave.slave_from_gsd(WHOLE, echo, config=b"\x10\x20").configs[0] == b"\x10\x20"
    with pytest.raises(ConfigError, match="configuration 10 is not 20"):
        dpstack.slave.slave_from_gsd(WHOLE, echo, ["8 DO"], config=b"\x10")


def test_three_lines_make_a_slave() -> None:
    slave = dpstack.slave.slave_from_gsd(WHOLE, echo, ["8 DO", "8 DI"])
    master = Octets(slave)
    assert master.ask("3B 3E")[27:].startswith("20 10")  # Get_Cfg: what is plugged
    assert master.ask(PRM) == SC
    assert master.ask("3E 3E 20 10") == SC
    assert master.exchange("5A") == "5A"


@pytest.mark.parametrize(
    ("prm", "diagnosis"),
    [
        ("3D 3E 80 01 01 0B 1A 2C 00 80 00 00 08 00 01 01 F4", "42 05 00 FF 1A 2B"),  # another ident number
        ("3D 3E 80 01 01 0B 1A 2B 00 80 00 00", "42 05 00 FF 1A 2B"),  # the modules' parameters are missing
        ("3D 3E B0 01 01 0B 1A 2B 00 80 00 00 08 00 01 01 F4", "02 04 00 02 1A 2B"),  # SYNC and FREEZE are supported
    ],
)
def test_parameters_are_judged_by_the_file(prm: str, diagnosis: str) -> None:
    master = Octets(dpstack.slave.slave_from_gsd(WHOLE, echo, ["8 DO", "8 DI"]))
    assert master.ask(prm) == SC
    assert master.diagnosis() == diagnosis


def test_only_what_is_plugged_is_accepted() -> None:
    slave = dpstack.slave.slave_from_gsd(WHOLE, echo, ["8 DO", "8 DI"])
    assert slave.check_cfg(b"\x20\x10") is None
    assert slave.check_cfg(b"\x10\x20") == "configuration 10 20 is not 20 10"


def test_any_row_of_modules_where_none_is_named() -> None:
    slave = dpstack.slave.slave_from_gsd(WHOLE, echo)
    assert slave.configs == (b"\x20",)  # the preset one
    assert slave.check_cfg(b"\x10\x20\x43\x43\x01\x02\x03") is None
    assert slave.check_cfg(b"\x20\x00\x10") is None  # an empty slot between
    assert slave.check_cfg(b"\x20\x10\x20\x10\x20") == "5 modules, 4 are possible"
    assert slave.check_cfg(b"\x11") == "octet 1 (11) of the configuration begins no module of this slave"
    assert slave.check_prm(bytes(30)) is None
    assert slave.check_prm(bytes(31)) == "31 octets of user parameters, 0..30 are expected"


def test_the_description_has_the_keywords() -> None:
    found = slave_description(device("whole"))
    assert (found.ident, found.name) == (0x1A2B, "Terminal 8")
    assert (found.sync, found.freeze, found.fail_safe, found.set_slave_add, found.wd_base_1ms) == (
        True, True, True, False, True,
    )  # fmt: skip
    assert (found.max_modules, found.max_input_len, found.max_output_len, found.max_data_len) == (4, 16, 8, 20)
    assert (found.max_diag_len, found.user_prm_len, found.min_slave_interval_ns) == (32, (0, 30), 600_000)
    assert dict(found.rates) == {9600: 60, 45_450: 250, 500_000: 100, 12_000_000: 800}


def test_a_compact_station_takes_one_of_its_modules() -> None:
    compact = made('Max_Input_Len = 0\nModule = "a" 0x10\nEndModule\nModule = "b" 0x21\nEndModule\n').device
    found = slave_description(compact)
    assert (found.check_cfg(b"\x10"), found.check_cfg(b"\x21")) == (None, None)
    assert found.check_cfg(b"\x10\x21") == "configuration 10 21 is not 10 or 21"
    assert found.check_cfg(b"\x00") is not None  # no slots, so none is empty


def test_a_compact_station_has_all_of_its_modules(tmp_path: Path) -> None:
    path = tmp_path / "compact.gsd"
    path.write_text(HEAD + 'Module = "a" 0x10\nEndModule\nModule = "b" 0x21\nEndModule\n')
    slave = dpstack.slave.slave_from_gsd(path, echo)
    assert (slave.configs, slave.check_cfg(b"\x10")) == ((b"\x10\x21",), "configuration 10 is not 10 21")


def test_exactly_what_the_parameters_of_the_modules_need() -> None:
    chosen = configure(device("prm"), ["AI"])
    assert slave_description(chosen.device, chosen).user_prm_len == (11, 11)


@pytest.mark.parametrize(
    ("path", "modules", "message"),
    [
        ("whole.gsd", ["8 DY"], "whole.gsd: there is no module '8 DY'; nearest are '8 DO'"),
        ("none.gsd", None, "none.gsd: No such file or directory; give the path of a GSD file"),
        ("whole.gsd", ["8 DI"] * 5, "whole.gsd: 5 modules, the device takes at most 4 (Max_Module); take out some"),
    ],
)
def test_refused(path: str, modules: list[int | str] | None, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        dpstack.slave.slave_from_gsd(FILES / path, echo, modules)
    assert str(caught.value).startswith(f"{FILES}/{message}")


def test_a_file_without_modules_or_number(tmp_path: Path) -> None:
    bare = tmp_path / "bare.gsd"
    bare.write_text('#Profibus_DP\nGSD_Revision = 3\nVendor_Name = "x"\nIdent_Number = 0x1234\n')
    with pytest.raises(ConfigError, match=r"the GSD file has no module with identifier octets"):
        dpstack.slave.slave_from_gsd(bare, echo)


def test_a_bundled_drives_file_is_found_by_name() -> None:
    slave = dpstack.slave.slave_from_gsd("demag-dedrive", echo, ["PPO3 (2 words)"])
    assert (slave.ident, slave.configs) == (0x0696, (b"\x71",))


# --- the simulated device of a [[slave]] table -------------------------------------------------------------------


def simulated(**keys: object) -> Octets:
    table = {"name": "io", "address": 8, "gsd": WHOLE, "modules": ["8 DO", "8 DI"]}
    return Octets(device_of(slave_config(table | keys)))


def test_a_simulated_slave_is_what_its_file_says() -> None:
    slave = simulated()
    assert slave.ask("37 3E 09 1A 2B 00") != SC  # Set_Slave_Add_supp = 0
    assert slave.ask("3D 3E 80 01 01 0B 1A 2B 00 80") == SC  # seven octets of parameters too few
    assert slave.diagnosis() == "42 05 00 FF 1A 2B"
    assert slave.ask(PRM) == SC
    assert slave.ask("3E 3E 10 20") == SC
    assert slave.diagnosis() == "06 05 00 FF 1A 2B"  # Cfg_Fault
    assert slave.ask(PRM) == SC
    assert slave.ask("3E 3E 20 10") == SC
    assert slave.exchange("33") == "33"


def test_it_refuses_sync_where_the_file_does(tmp_path: Path) -> None:
    gsd = tmp_path / "no_sync.gsd"
    gsd.write_text(
        (FILES / "whole.gsd").read_text(encoding="utf-8").replace("Sync_Mode_supp = 1", "Sync_Mode_supp = 0")
    )
    slave = simulated(gsd=str(gsd))
    assert slave.ask("3D 3E A0 01 01 0B 1A 2B 00 80 00 00 08 00 01 01 F4") == SC
    assert slave.diagnosis() == "12 05 00 FF 1A 2B"  # Not_Supported


def test_its_ident_number_is_the_tables() -> None:
    slave = simulated(ident=0x4711)
    assert slave.ask("3D 3E 80 01 01 0B 47 11 00 80 00 00 08 00 01 01 F4") == SC
    assert slave.diagnosis() == "02 04 00 02 47 11"


async def bring_up() -> tuple[str, bytes]:
    world = dpstack.World()
    slave = dpstack.slave.slave_from_gsd(WHOLE, lambda outputs, elapsed: bytes([outputs[0] ^ 0xFF]), ["8 DO", "8 DI"])
    table = {"name": "io", "address": 9, "gsd": WHOLE, "modules": ["8 DO", "8 DI"], "sync": True, "freeze": True}
    async with (
        dpstack.slave.serve_slave(slave, world=world, address=9),
        operating(table, world=world) as bus,
    ):
        bus.slave("io").outputs = b"\x0f"
        await bus.rotated(bus.stats.rotations + 5)
        return bus.slave("io").state.value, bus.slave("io").inputs


def test_the_same_file_at_both_ends() -> None:
    assert dpstack.run_virtual(bring_up()) == ("data_exchange", b"\xf0")


# --- its diagnosis in the words of the file ------------------------------------------------------------------------

#: device related bits 0 and 9; identifier related module 0; channel 3 of module 0, a bit, input, error 16
EXT = bytes.fromhex("03 01 02 42 01 80 43 30")
DIAGNOSIS = str(FILES / "diagnosis.gsd")


async def diagnosis_of(ext: bytes) -> tuple[tuple[str, ...], list[dict[str, object]]]:
    """(diagnosis_texts, lines of run --json)."""
    world = dpstack.World()
    slave = dpstack.slave.slave_from_gsd(DIAGNOSIS, lambda outputs, elapsed: b"\0", ["own texts"])
    async with (
        dpstack.slave.serve_slave(slave, world=world, address=9),
        operating({"name": "io", "address": 9, "gsd": DIAGNOSIS}, world=world) as bus,
    ):
        events = bus.events()
        slave.diag = dpstack.slave.UserDiag(ext, True)
        await bus.until(lambda: getattr(bus.slave("io").diagnosis, "ext", b"") == ext, timeout=1)
        await bus.rotated(bus.stats.rotations + 5)
        assert bus.slave("io").ready_now
        texts = bus.slave("io").diagnosis_texts
    return texts, [line async for event in events if (line := event_json(event, 0.0)) is not None]


def test_a_diagnosis_reaches_the_program_and_the_json_lines() -> None:
    texts, lines = dpstack.run_virtual(diagnosis_of(EXT))
    words = (
        "fuse blown (replace F1)",
        "too hot",
        "no load voltage",
        "slots with a diagnosis: 1 (own texts)",
        "slot 1 (own texts), input channel 3 (bit): coil open",
    )
    assert texts[-5:] == words
    told = [line for line in lines if line["event"] == "diagnosis" and "ext_diag" in str(line["flags"])]
    assert [line["texts"] for line in told] == [list(words)]


def test_block_lengths_that_lie_are_told_once_and_what_is_there_is_decoded() -> None:
    texts, lines = dpstack.run_virtual(diagnosis_of(bytes.fromhex("03 01 02 48 05")))
    assert texts[-1] == "slots with a diagnosis: 1 (own texts), 3"
    assert "fuse blown (replace F1)" in texts
    findings = [str(line) for line in lines if "announces a block of 8 octets" in str(line)]
    assert len(findings) == 1
