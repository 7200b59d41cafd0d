"""Parameters in the process data: never sent without a value, kept on every way out, against literal octets."""

from __future__ import annotations

import asyncio

import pytest
from api_kit import operating
from drive_bench import ALONE, PairBench, PluginBench

from dpstack.errors import ConfigError
from dpstack.profile import DriveDevice
from dpstack_drives.demag import DRIVE as DEMAG
from dpstack_drives.fuji import DRIVE as FUJI
from dpstack_drives.imo import DRIVE as IMO
from dpstack_drives.keb import DRIVE as KEB
from dpstack_drives.ls import DRIVE as LS
from dpstack_drives.ls.plugin import LsCore
from dpstack_drives.ls.simulator import LsDevice

pytestmark = pytest.mark.virtual_time

ZERO = "00 " * 8
DRIVES = {"demag": DEMAG, "fuji": FUJI, "imo": IMO, "keb": KEB, "ls": LS}
#: drive, telegram, options, the safe outputs behind the parameter channel
MAPS = [
    ("ls", "PPO2", {"para_control": "0005 0006 dr-04=2.5"}, "04 7E 00 00 00 00 00 00 00 19 00 00"),
    ("ls", "PPO4", {"para_control": "dr-04=2.5, 0x1103=1", "swap": True}, "7E 04 00 00 19 00 0A 00 00 00 00 00"),
    ("ls", "PPO4", {"profile": "ls", "para_control": "0000 dr-04=2.5"}, "60 01 00 00 00 00 00 19"),
    ("ls", "VENDOR 3/1", {"para_control": "dr-04=2.5 0006 0005", "para_status": "000E"}, "00 19 00 01 00 00"),
    ("fuji", "PPO2", {"map_outputs": "S06 F07=6.00 041A=2"}, "04 7E 00 00 00 00 00 3C 00 02 00 00"),
    ("fuji", "PPO4", {"map_outputs": "- F07=6"}, "04 7E 00 00 00 00 00 3C 00 00 00 00"),
    ("keb", "8/8", {"map_outputs": "2F13:long=100000 2032 2034", "map_inputs": "2200:long 2033 2035"}, "00 01 86 A0"),
    # with a channel it asks for the map first: see test_keb_map.py
    ("keb", "4/4", {"map_outputs": "2032 2301=-5"}, "00 00 FF FB"),
]


@pytest.mark.parametrize(("drive", "telegram", "options", "octets"), MAPS)
def test_a_value_in_the_option_is_in_the_first_telegram_and_in_the_safe_ones(
    drive: str, telegram: str, options: dict[str, object], octets: str
) -> None:
    core = DRIVES[drive].core("it", telegram, options)
    begin = 8 if core.telegram.channel else 0
    octets = octets.ljust(3 * core.telegram.outputs - 1, "x").replace("x", " 00")[: 3 * core.telegram.outputs - 1]
    assert core.safe(core.safe_outputs)[begin:].hex(" ").upper() == octets
    assert core.cyclic(b"", 0)[begin:].hex(" ").upper() == octets
    core.lost(0)
    assert core.cyclic(b"", 1)[begin:].hex(" ").upper() == octets
    assert core.safe(core.safe_outputs)[begin:].hex(" ").upper() == octets
    assert core.safe(b"\xff" * core.telegram.output_octets) == b"\xff" * core.telegram.output_octets, "the user's own"


@pytest.mark.parametrize(
    ("drive", "telegram", "options", "says"),
    [
        ("ls", "PPO2", {"para_control": "0005 0006 dr-04"}, "dr-04 would be written with 0 .* dr-04=VALUE"),
        ("ls", "VENDOR 3/1", {"para_control": "dr-04 0006 dr-03"}, "dr-04, dr-03 would be written with 0"),
        ("fuji", "PPO4", {"map_outputs": "S06 F07"}, "map_outputs: F07 would be written with 0 .* F07=VALUE"),
        ("keb", "8/8", {"map_outputs": "2032 oP.10"}, r"oP.10 \(230Ah\) would be written with 0 .* oP.10=VALUE"),
        ("ls", "PPO2", {"para_control": "dr-04=601"}, "para_control: .*outside 0..600"),
        ("ls", "PPO2", {"para_control": "dr-04=fast"}, "dr-04=fast: 'fast' is no number"),
        ("ls", "PPO2", {"para_control": "dr-04="}, "dr-04=: '' is no number"),
        ("ls", "PPO2", {"para_status": "dr-04=1"}, "is no address"),
        ("fuji", "PPO2", {"map_outputs": "-=1"}, "map_outputs: =1: an empty word has no value"),
        ("fuji", "PPO2", {"map_inputs": "F07=1"}, "map_inputs: 'F07=1' is no function code"),
        ("fuji", "PPO2", {"map_outputs": "S06=1"}, "bits 0 and 1"),
        ("keb", "8/8", {"map_outputs": "2032 2301=1.5"}, "takes 16-bit integers"),
        ("keb", "8/8", {"map_outputs": "2032 2301=inf"}, "'inf' is no number"),
        ("imo", "PKW+12", {"map_outputs": "set_frequency forward_limit=51"}, "map_outputs: .*outside 0..50 Hz"),
        ("demag", "PPO4", {"map_outputs": "percent=301"}, "map_outputs: .*outside -300..300 %"),
    ],
)
def test_a_map_without_its_values_is_refused_before_anything_is_sent(
    drive: str, telegram: str, options: dict[str, object], says: str
) -> None:
    with pytest.raises(ConfigError, match=says):
        DRIVES[drive].core("it", telegram, options)


def test_the_last_value_of_an_output_stays() -> None:
    bench = PluginBench(LS.core("pump", "PPO4", {"para_control": "dr-04=2.5 0005"}), "02 35 00 00 " + "00 " * 8)
    bench.order("output", number="dr-04", value=10)
    assert bench.out_after("output", number="0005", value=30) == "04 7E 00 00 00 64 0B B8 00 00 00 00"
    assert bench.core.safe(bench.core.safe_outputs).hex(" ").upper() == "04 7E 00 00 00 64 00 00 00 00 00 00"
    bench.core.lost(bench.now)
    assert bench.out() == "04 7E 00 00 00 64 00 00 00 00 00 00"


def test_values_of_the_option_come_back_where_commands_do_not() -> None:
    core = DEMAG.core("hoist", "PPO4", {"map_outputs": "percent=30 bool", "reference_hz": 60})
    bench = PluginBench(core, "02 40" + " 00" * 10)
    assert bench.out() == "00 00 00 00 0B B8 00 00 00 00 00 00"
    bench.order("output", number="pzd3", value=-55.36)
    assert bench.out_after("output", number="pzd4", value=1) == "00 00 00 00 EA 60 FF FF 00 00 00 00"
    assert core.safe(core.safe_outputs) == bytes(12), "sources of the drive, not parameters"
    core.lost(bench.now)
    assert bench.out() == "00 00 00 00 0B B8 00 00 00 00 00 00"


# -- a map that counts while the drive is on the bus ------------------------------------------------------------------

S2 = "02 35 00 00"


def test_a_new_map_begins_with_the_present_value_of_the_drive() -> None:
    """dr-04 is asked for, the old map goes, and the value stands in its word before COM-51 says what it is."""
    bench = PluginBench(LS.core("pump", "PPO2", ALONE), ZERO + S2 + " 00" * 8)
    token = bench.order("write_map", inputs="000E", outputs="dr-04")
    sent: list[tuple[str, str]] = []
    stored = {"0 11 04": "00 19"}
    for _ in range(160):
        out = bench.out()
        request, word = out[:23], out[36:41]
        if not request.startswith("00"):
            if (request, word) not in sent:
                sent.append((request, word))
            if request.startswith("2"):
                stored[request[1:8]] = request[18:]
            bench.see(f"1{request[1:18]}{stored[request[1:8]]} {S2}" + " 00" * 8)
        else:
            bench.see(ZERO + S2 + " 00" * 8)
    assert sent == [
        ("10 11 04 00 00 00 00 00", "00 00"),
        ("20 17 33 00 00 00 00 00", "00 00"),
        ("20 17 32 00 00 00 00 01", "00 00"),
        ("20 17 5E 00 00 00 00 01", "00 00"),
        ("20 17 1F 00 00 00 00 0E", "00 19"),
        ("20 17 1E 00 00 00 00 01", "00 19"),
        ("20 17 33 00 00 00 11 04", "00 19"),
        ("20 17 32 00 00 00 00 01", "00 19"),
        ("20 17 5E 00 00 00 00 01", "00 19"),
        ("10 17 32 00 00 00 00 00", "00 19"),
        ("10 17 33 00 00 00 00 00", "00 19"),
        ("10 17 1E 00 00 00 00 00", "00 19"),
        ("10 17 1F 00 00 00 00 00", "00 19"),
    ]
    assert bench.value(token) == {"inputs": "000E", "outputs": "1104"}
    assert bench.core.safe(bench.core.safe_outputs)[8:].hex(" ").upper() == "04 7E 00 00 00 19 00 00 00 00 00 00"


class Watched(PairBench):
    """Notes every ramp time that the drive ever has."""

    seen: set[float]

    def run(self, rotations: int = 1) -> bytes:
        out = b""
        for _ in range(rotations):
            out = super().run()
            self.seen = getattr(self, "seen", set()) | {ramps(self.device)}
        return out


def ramps(device: DriveDevice) -> float:
    assert isinstance(device, LsDevice)
    return device.store.value("dr-04")


@pytest.mark.parametrize(("outputs", "values"), [("dr-04", {2.0}), ("dr-04=7.5", {2.0, 7.5}), ("dr-03 dr-04", {2.0})])
def test_a_ramp_time_is_never_0_on_the_way_to_its_map(outputs: str, values: set[float]) -> None:
    bench = Watched(LS.core("pump", "PPO2"), LS.simulated("PPO2", {}, {"dr-04": 2.0, "dr-03": 3.0}))
    bench.ok("write_map", outputs=outputs)
    bench.ok("start")
    bench.ok("stop")
    bench.ok("write_map", outputs="dr-03 dr-20 dr-04" if "dr-03" in outputs else "dr-03 dr-04")  # it moves
    bench.pass_time(100)
    assert bench.seen == values


def test_start_is_refused_for_a_limit_without_a_value() -> None:
    """A keypad wrote the map; ``write_map`` takes none without a value."""
    maps = {"P15.02": 1, "P15.03": 5, "P15.04": 8, "P15.13": 1}
    bench = PairBench(
        IMO.core("pump", options={"map_outputs": "braking_torque_limit=120"}), IMO.simulated(None, {}, maps)
    )
    assert "would be written with 0: give it a value, motoring_torque_limit=VALUE" in bench.misuse(
        "write_map", outputs="set_frequency motoring_torque_limit"
    )
    bench.ok("speed", value=0.5)
    assert bench.refused("start") == (
        "fault",
        "forward_limit in the output map would be written with 0: give a value first, "
        "by order('output', number='forward_limit', value=...) or in the option of the map",
    )
    bench.ok("output", number="forward_limit", value=40)
    bench.ok("start")
    safe = bench.core.safe(bench.core.safe_outputs)[8:].hex(" ").upper()
    assert safe == "00 05 00 00 0F A0 04 B0" + " 00 00" * 8, "it needs its torque to brake"
    bench.core.lost(bench.now)
    assert bench.core.safe(bench.core.safe_outputs)[8:].hex(" ").upper() == safe


@pytest.mark.parametrize("way", ["clear", "remove", "defect", "leave"])
async def test_no_way_out_takes_the_ramp_away(way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every telegram with a control word has dr-04 beside it, until Clear's zeros."""
    options = {"para_control": "0005 0006 dr-04=4"}
    pump = {"name": "pump", "address": 6, "drive": "ls-s100", "telegram": "PPO2", "options": options}
    frames: list[str] = []
    exchange = LsDevice.exchange

    def noted(device: LsDevice, outputs: bytes, now: int) -> bytes:
        frames.append(outputs[8:].hex(" ").upper())
        return exchange(device, outputs, now)

    def defect(core: LsCore) -> None:
        raise RuntimeError(core.name)

    monkeypatch.setattr(LsDevice, "exchange", noted)
    async with operating(pump) as bus:
        drive = bus.drive("pump")
        drive.speed = 1.0
        await drive.start()
        await drive.order("output", number="dr-04", value=5)
        await asyncio.sleep(0.1)
        frames.clear()
        match way:
            case "clear":
                await bus.clear()
            case "remove":
                await bus.remove(6)
            case "defect":
                monkeypatch.setattr(LsCore, "received", defect)
                await asyncio.sleep(0.1)
    assert set(frames) - {" ".join(["00"] * 12)} <= {
        "04 7F 40 00 00 00 00 00 00 32 00 00",
        "04 7E 00 00 00 00 00 00 00 32 00 00",
    }
    assert "04 7E 00 00 00 00 00 00 00 32 00 00" in frames


def test_maps_that_act_later_are_needed_as_options_before_the_drive_runs_again() -> None:
    """The words of the old map would stand in the places of the new one: a control word in a torque limit."""
    telegram = "PCH+8/8"
    bench = PairBench(KEB.core("saw", telegram, simulated=True), KEB.simulated(telegram, {}, {}))
    maps = {"inputs": "ru.12:long sy.51 sy.53", "outputs": "cS.19:long sy.50 sy.52"}
    bench.ok("write_map", **maps)
    needed = "map_inputs = '220C:long 2033 2035' and map_outputs = '2F13:long 2032 2034' (with cS.19=VALUE)"
    told = [text for text in bench.notices() if needed in text]
    assert told[0].startswith(
        "other maps were written to the drive, which act from its next power-on: end the bus, set "
    )
    for _ in range(2):
        assert bench.refused("speed", value=0.5) == ("fault", told[0])
        assert bench.refused("start") == ("fault", told[0])
        bench.run(2)
        assert bench.core.status().settings_texts[:1] == tuple(told[:1])
        bench.core.lost(bench.now)
        bench.pass_time(500)
    known = {"map_inputs": maps["inputs"], "map_outputs": "cS.19:long=100 sy.50 sy.52"}
    drive = KEB.simulated(telegram, {}, {})
    bench = PairBench(KEB.core("saw", telegram, known, simulated=True), drive)
    bench.ok("write_map")
    assert "act from the drive's next power-on: switch it off and on" in bench.refused("start")[1]
    bench.core.lost(bench.now)
    after = KEB.simulated(telegram, {}, {})
    after.inherit(drive)
    after.enter(bench.core.telegram.config, bench.now)
    after.operate(bench.now)
    bench.device = after
    bench.pass_time(1000)
    bench.ok("start")
