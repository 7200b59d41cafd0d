"""Changes of process data maps, one rule for all drives: at standstill, through an empty map, read back; what acts at
power-on keeps start and set points back."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import pytest
from drive_bench import MS, NONE, PZD, Named, PairBench, PluginBench
from support import present

from dpstack.profile import DriveDevice, DriveProfile, ParamSpec, ParamStore, SettingsState
from dpstack_drives.fuji import DRIVE as FUJI
from dpstack_drives.imo import DRIVE as IMO
from dpstack_drives.imo.simulator import ImoDevice
from dpstack_drives.keb import DRIVE as KEB
from dpstack_drives.ls import DRIVE as LS


class Watched(PairBench):
    """Notes every value that ``look`` finds in the drive, and can switch the drive off and on."""

    look: Callable[[DriveDevice], object] = staticmethod(lambda device: None)
    seen: set[object]

    def run(self, rotations: int = 1) -> bytes:
        out = b""
        for _ in range(rotations):
            out = super().run()
            self.seen = getattr(self, "seen", set()) | {self.look(self.device)}
        return out

    def power_cycle(self, drive: DriveProfile) -> None:
        core = self.core
        core.lost(self.now)
        after = drive.simulated(core.telegram.name, {}, {})
        after.inherit(self.device)
        self.now += 1000 * MS
        after.enter(core.telegram.config, self.now)
        after.operate(self.now)
        self.device = after
        self.inputs = bytes(core.telegram.input_octets)


def pair(
    drive: DriveProfile,
    telegram: str | None,
    simulated: Named = NONE,
    options: Named = NONE,
    look: Callable[[DriveDevice], object] = lambda device: None,
) -> Watched:
    class Bench(Watched):
        pass

    Bench.look = staticmethod(look)
    return Bench(drive.core("it", telegram, options, simulated=True), drive.simulated(telegram, {}, simulated), 4 * MS)


class Case(NamedTuple):
    drive: DriveProfile
    telegram: str | None
    simulated: Named
    maps: Named


CASES = [
    Case(IMO, None, PZD, {"outputs": "motoring_torque_limit=100 set_frequency", "inputs": "frequency"}),
    Case(FUJI, "PPO2", NONE, {"outputs": "F07=2.0", "inputs": "M16"}),
    Case(KEB, "PCH+8/8", NONE, {"outputs": "cS.19:long=5 sy.50 sy.52", "inputs": "ru.12:long sy.51 sy.53"}),
    Case(LS, "PPO2", NONE, {"outputs": "dr-04=2.0", "inputs": "dr-04"}),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.drive.name)
def test_no_map_changes_while_the_motor_turns(case: Case) -> None:
    """IMO: 30 Hz stood in the place of a torque limit of 300 %. KEB: the stop behind it did not arrive."""
    bench = pair(case.drive, case.telegram, case.simulated)
    bench.ok("speed", value=0.5)
    bench.ok("start")
    bench.ok("reached")
    wrote = bench.device.store.eeprom_writes
    sent = bench.out()
    refused = (
        "write_map: a start was ordered, and a map changes only at standstill and outside of operation; stop() it "
        "first, then do it at standstill"
    )
    assert bench.misuse("write_map", **case.maps) == refused
    bench.pass_time(1000)
    assert bench.out()[-len(sent) // 2 :] == sent[-len(sent) // 2 :]
    assert bench.device.store.eeprom_writes == wrote
    assert bench.core.status().settings is SettingsState.CHECKED
    assert bench.device.motor.frequency == pytest.approx(0.5)
    bench.order_and_run(30, "stop")
    assert "write_map: the drive is stopping" in bench.misuse("write_map", **case.maps)
    bench.pass_time(3000)
    assert not bench.device.motor.on
    bench.ok("write_map", **case.maps)


def test_imo_pre_excited_is_in_operation() -> None:
    bench = pair(IMO, None, PZD)
    bench.ok("pre_excite")
    bench.pass_time(100)
    assert "write_map: it inches, or is pre-excited" in bench.misuse("write_map", outputs="set_frequency torque")


def imo_words(device: DriveDevice) -> object:
    assert isinstance(device, ImoDevice)
    return tuple(device.values.get(number, 0) for number in (1, 7, 10))


def test_imo_a_set_point_never_stands_in_another_place_of_the_map() -> None:
    """25.00 Hz were 09C4h at the relay outputs, or a torque limit of 250 %; a limit of 0 came afterwards."""
    bench = pair(IMO, None, PZD, look=imo_words)
    bench.ok("speed", value=0.5)
    bench.pass_time(600)
    assert (2500, 0, 0) in bench.seen
    bench.seen.clear()
    bench.ok("write_map", outputs="output_terminals set_frequency motoring_torque_limit=120")
    bench.ok("write_map", outputs="motoring_torque_limit=130 output_terminals=3 set_frequency")
    bench.pass_time(200)
    assert {words[0] for words in bench.seen if isinstance(words, tuple)} == {2500, 0}
    assert {words[1] for words in bench.seen if isinstance(words, tuple)} <= {0, 1200, 1300}
    assert {words[2] for words in bench.seen if isinstance(words, tuple)} == {0, 3}
    assert bench.core.status().setpoint == 0, "it does not start at what stood there before"
    bench.ok("start")
    bench.pass_time(1000)
    assert bench.device.motor.frequency == 0
    bench.ok("speed", value=0.5)
    bench.ok("reached")
    bench.ok("stop")


def test_imo_every_limit_in_a_map_needs_a_value() -> None:
    """The limit was 0 afterwards, and nobody heard of it."""
    bench = pair(IMO, None, PZD)
    text = bench.misuse("write_map", outputs="set_frequency forward_limit")
    assert text == "write_map: forward_limit would be written with 0: give it a value, forward_limit=VALUE"
    bench.ok("write_map", outputs="set_frequency forward_limit=40")
    bench.ok("write_map", outputs="forward_limit set_frequency")  # the user's value moves with it
    bench.ok("speed", value=1.0)
    bench.ok("start")
    bench.pass_time(2000)
    assert bench.device.motor.frequency * 50 == pytest.approx(40)


def test_imo_the_codes_are_emptied_before_the_octets_change() -> None:
    """Requests of table 2-9 beside PZD2 and PZD3, octet by octet: P15.02 := 0 with the old words, P15.02 := 7 with the
    new ones."""
    p15 = {2: 1, 3: 4}
    bench = PluginBench(IMO.core("pump", options={"check_settings": False}), "00 " * 8 + "41 03" + " 00" * 22)
    sent: list[tuple[str, str]] = []

    def card(rotations: int) -> None:
        for _ in range(rotations):
            out = bench.run()
            number = out[3]
            if out[1] == 4:
                entry = (out[:8].hex(" ").upper(), out[10:14].hex(" ").upper())
                sent.append(entry) if sent[-1:] != [entry] else None
                p15[number] = out[7]
            reply = bytes([0, 1, 15, number, 0, 0, 0, p15.get(number, 0)]) if out[1] else bytes(8)
            bench.inputs = reply + bytes.fromhex("41 03") + bytes(22)

    card(300)
    bench.ok("output", number="torque", value=50)
    bench.ok("speed", value=0.5)
    token = bench.order("write_map", outputs="motoring_torque_limit=100 set_frequency", inputs="frequency")
    card(600)
    assert bench.value(token) == {"inputs": "frequency", "outputs": "motoring_torque_limit set_frequency"}
    assert sent == [
        ("00 04 0F 02 00 00 00 00", "00 00 01 F4"),  # the set point is 0 before anything else
        ("00 04 0F 03 00 00 00 00", "00 00 01 F4"),
        ("00 04 0F 0D 00 00 00 01", "03 E8 00 00"),
        ("00 04 0F 02 00 00 00 07", "03 E8 00 00"),
        ("00 04 0F 03 00 00 00 01", "03 E8 00 00"),
    ]


def test_a_map_that_is_another_one_afterwards_is_an_error_and_refuses_the_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A card that confirms P15.03 and keeps what it has."""
    write = ParamStore.write

    def deaf(store: ParamStore, spec: ParamSpec, raw: int, *args: int, **more: bool) -> None:
        if spec.name != "P15.03":
            write(store, spec, raw, *args, **more)

    monkeypatch.setattr(ParamStore, "write", deaf)
    bench = pair(IMO, None, PZD)
    kind, text = bench.refused("write_map", outputs="torque set_frequency")
    assert (kind, text) == (
        "parameter",
        "write_map: the drive has inputs 'frequency current torque fault_code' and outputs 'torque' afterwards, not "
        "what was written",
    )
    assert "no received PZD carries the set frequency" in bench.refused("start")[1]


# -- codes of a map ----------------------------------------------------------------------------------------------------

CODES: list[tuple[DriveProfile, str | None, list[Named]]] = [
    (IMO, None, [{"number": f"P15.{number:02}"} for number in range(2, 24)] + [{"number": 0x0F02}]),
    (FUJI, "PPO1", [{"number": f"o{number}"} for number in (40, 41, 42, 43, 48, 49, 50, 51)]),
    (FUJI, "PPO2", [{"number": pnu, "index": index} for pnu in (915, "pcd_read") for index in range(1, 5)]),
    (LS, "PPO1", [{"number": f"COM-{number}"} for number in (*range(30, 39), *range(50, 59))]),
    (LS, "PPO2", [{"number": 0x1733}, {"number": "0x1732"}, {"number": "cm-51"}]),
    (KEB, "PCH+4/4", [{"number": index, "index": 1} for index in (0x6000, 0x6001)]),
    (KEB, "PCH+4/4", [{"number": index} for index in ("6002h", 0x5FF8)]),
    (KEB, "PCH+4/4", [{"number": index, "index": 2} for index in (0x5FE0, 0x5FE1, 0x5FE2, 0x5FE3)]),
]


@pytest.mark.parametrize(("drive", "telegram", "codes"), CODES)
def test_a_plain_write_to_a_code_of_a_map_is_refused_naming_write_map(
    drive: DriveProfile, telegram: str | None, codes: list[Named]
) -> None:
    bench = pair(drive, telegram)
    bench.pass_time(100)
    for code in codes:
        text = bench.misuse("write", value=1, **code)
        assert "is a code of the process data map" in text
        assert "use write_map" in text
    assert bench.device.store.eeprom_writes == 0


def test_ls_com_94_does_not_make_a_map_act_that_a_keypad_wrote() -> None:
    """COM-51 = 1104h and COM-94 = 1 made dr-04 0.0 s at once."""
    bench = pair(LS, "PPO2", look=lambda device: device.store.value("dr-04"))
    bench.pass_time(500)
    store = bench.device.store
    code = present(store.table.named("COM-51"))
    store.write(code, 0x1104)
    text = bench.misuse("write", number="COM-94", value=1)
    assert text == (
        "COM-94 would make other maps act, which stand in the drive: inputs '000A 000E 000F' and outputs '1104 0006'; "
        "use write_map, which writes maps and values and applies them"
    )
    assert "COM-51.. are 1104 0006, the option para_control says 0005 0006" in bench.refused("start")[1]
    assert bench.ok("write_map", outputs="dr-04")
    bench.pass_time(100)
    assert bench.seen == {1.0}


# -- maps that act at power-on -----------------------------------------------------------------------------------------


def test_fuji_after_power_on_the_words_are_those_of_the_new_map() -> None:
    """F08 = 0.7 s became F07 = 0.7 s."""
    old, new = {"map_outputs": "F08=0.7"}, "F07=3.0"
    bench = pair(
        FUJI, "PPO2", {"o40": 0x0408}, old, lambda device: (device.store.value("F07"), device.store.value("F08"))
    )
    bench.ok("start")
    bench.ok("stop")
    bench.seen.clear()
    bench.ok("speed", value=0.5)
    bench.ok("write_map", outputs=new)
    bench.pass_time(300)
    bench.power_cycle(FUJI)
    bench.pass_time(1000)
    assert bench.seen == {(1.0, 0.7), (1.0, 1.0), (3.0, 1.0)}, "after power-on F08 is what is stored"
    assert bench.out().endswith("04 7E 00 00 00 1E 00 00 00 00 00 00"), "no set point"
    waits = "other maps were written to the drive, which act from its next power-on: end the bus, set map_inputs = '' "
    for op, args in (("start", {}), ("speed", {"value": 0.5})):
        text = bench.refused_as("fault", op, **args)
        assert text.startswith(waits)
    assert bench.core.status().settings is SettingsState.DIFFERENT
    assert not bench.device.motor.on
    plant = pair(FUJI, "PPO2", options={"map_outputs": new})
    plant.device = bench.device
    plant.ok("start")
    assert plant.device.store.value("F07") == 3.0


def test_fuji_the_values_of_a_map_without_them_are_those_of_the_drive() -> None:
    bench = pair(FUJI, "PPO2", {"F07": 4.5}, look=lambda device: device.store.value("F07"))
    bench.ok("write_map", outputs="F07")
    bench.power_cycle(FUJI)
    bench.pass_time(500)
    assert bench.seen == {4.5}


def test_fuji_the_maps_of_the_options_written_back_before_power_on_let_it_start() -> None:
    bench = pair(FUJI, "PPO2")
    bench.ok("write_map", outputs="F07=3")
    assert bench.refused("start")[0] == "fault"
    bench.ok("write_map", outputs="")
    bench.ok("start")
    assert bench.core.status().settings is SettingsState.CHECKED


@pytest.mark.parametrize("cycle", [True, False])
def test_keb_after_power_on_no_set_speed_stands_in_a_torque_reference(cycle: bool) -> None:
    """sy.52 = 750 became cS.19 = 750. A drive that was only away from the bus has its old map."""
    telegram = "PCH+8/8"
    bench = pair(KEB, telegram, look=lambda device: device.store.value("cS.19"))
    bench.ok("speed", value=0.5)
    bench.pass_time(500)
    bench.ok("write_map", outputs="cS.19:long=7 sy.50 sy.52", inputs="ru.12:long sy.51 sy.53")
    if cycle:
        bench.power_cycle(KEB)
    else:
        bench.core.lost(bench.now)
    for _ in range(500):
        assert bench.run()[8:] == bytes(8), "nobody can send 7 without knowing the map of the drive"
    assert bench.seen == {0}
    assert bench.refused("start")[0] == "fault"
    assert bench.refused("speed", value=0.5)[0] == "fault"
    if cycle:
        options = {"map_outputs": "cS.19:long=9 sy.50 sy.52", "map_inputs": "ru.12:long sy.51 sy.53"}
        plant = pair(KEB, telegram, options=options, look=lambda device: device.store.value("cS.19"))
        plant.device = bench.device
        plant.ok("speed", value=0.5)
        plant.pass_time(2000)
        plant.ok("start")
        plant.ok("reached")
        assert plant.seen == {0, 9}


def test_ls_vendor_keeps_its_set_point_until_the_maps_are_compared() -> None:
    """The control word stands in the map: another one would take it for something else. Over record 47."""
    core = LS.core("pump", "VENDOR 3/1", {"para_control": "dr-04=2.5 0006 0005", "para_status": "000E"})
    assert core.held
    bench = PluginBench(core, "00 01")
    bench.order("speed", value=0.5)
    assert bench.out() == "00 19 00 01 0B B8", "without record 47 nothing can be asked"


def test_fuji_with_another_map_than_the_plant_file_gets_no_set_point() -> None:
    """A keypad wrote o40, somebody switched the drive off and on; the set point was ordered before that was known."""
    bench = pair(FUJI, "PPO2", {"o40": 0x0407}, {"map_outputs": "F26=2"})
    bench.ok("speed", value=0.5)
    sent = {bench.run()[8:12].hex(" ").upper() for _ in range(1000)}
    assert sent == {"04 7E 00 00"}
    says = "o40 to o43 are F07, the option map_outputs is F26: set map_outputs = 'F07'"
    for op, args in (("start", {}), ("speed", {"value": 0.25})):
        text = bench.refused_as("fault", op, **args)
        assert says in text
    bench.ok("speed", value=0)
    agrees = pair(FUJI, "PPO2", {"o40": 0x041A}, {"map_outputs": "F26=2"})
    agrees.ok("speed", value=0.5)
    agrees.pass_time(1000)
    assert agrees.out()[24:35] == "04 7E 20 00"


def test_imo_a_map_that_a_keypad_changed_is_seen_before_the_next_start() -> None:
    """25.00 Hz in the place of a torque limit: the plugin has learned another map."""
    bench = pair(IMO, None, PZD, look=imo_words)
    bench.ok("speed", value=0.5)
    bench.ok("start")
    bench.ok("stop")
    for name, raw in (("P15.02", 4), ("P15.03", 1)):
        spec = present(bench.device.store.table.named(name))
        bench.device.store.write(spec, raw)
    bench.device._load_maps()  # type: ignore[attr-defined]
    text = bench.refused_as("fault", "start")
    assert text == (
        "the map was changed at the drive: it has inputs 'frequency' and outputs 'torque set_frequency' now, not "
        "'frequency' and 'set_frequency': order read_map to use it, or write_map"
    )
    bench.ok("read_map")
    bench.ok("start")
    bench.ok("reached")
