"""pyprofibus, the other Python stack, at one end: its master before our slaves, its sniffer and its GSD parser.

It is installed and run as a program, in processes of its own; nothing here imports it.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from far_ends import HANG_S, eventually
from plant_files import plant_file
from programs import Starter
from step7_kit import PLANT as STEP7
from step7_kit import RACK_GSD, VALVES_GSD, address, gsd_folder, section

import dpstack
from dpstack.cli.main import main

pytestmark = pytest.mark.strangers

HERE: Final = Path(__file__).parent
ROOT: Final = Path(dpstack.__file__).parent
DRIVES: Final = ROOT.parent / "drives" / "dpstack_drives"
STATION: Final = ROOT / "sim" / "io_station" / "io-station.gsd"
MISSING: Final = "pyprofibus is not installed; `make strangers` installs it (pip install -e '.[strangers]')"

IO: Final = {"name": "io", "address": 8, "gsd": STATION, "modules": ["8 DI", "8 DO"]}
IMO: Final = {"options": {"baud_index": 5}, "simulated": {"P15.02": 1, "P15.13": 1}}
PLANT: Final[list[dict[str, object]]] = [
    {"name": "demag", "address": 3, "drive": "demag-dedrive", "telegram": "PPO1", "simulated": {"412": 1}},
    {"name": "fuji", "address": 4, "drive": "fuji-frenic", "ident": "ask", "telegram": "PPO1"},
    {"name": "keb", "address": 5, "drive": "keb-f5", "telegram": "PCH+4/4"},
    {"name": "ls", "address": 6, "drive": "ls-s100", "telegram": "PPO1"},
    {"name": "imo", "address": 7, "drive": "imo-hd2", "telegram": "PKW+12", **IMO},
    IO,
]

#: a GSD file for a drive whose manual has none: what pyprofibus needs to send ident number and identifier octets
GSD = """#Profibus_DP
GSD_Revision = 1
Vendor_Name = "dpstack test"
Model_Name = "{name}"
Revision = "1"
Ident_Number = {ident}
Protocol_Ident = 0
Station_Type = 0
500_supp = 1
MaxTsdr_500 = 100
Modular_Station = 1
Max_Module = 1
Max_Input_Len = 32
Max_Output_Len = 32
Max_Data_Len = 64
Module = "all" {config}
EndModule
"""

#: slave: address, its GSD file, its modules, octets each way
SLAVES: Final[dict[str, tuple[int, Path | str, tuple[str, ...], int]]] = {
    "demag": (3, DRIVES / "demag/demag-dedrive.gsd", ("PPO1 (PKW and 2 words)",), 12),
    "fuji": (4, GSD.format(name="fuji", ident="0xDD04", config="0xF3, 0x71"), ("all",), 12),
    "keb": (5, DRIVES / "keb/keb-f5.gsd", ("Parameter channel", "Outputs 4 byte", "Inputs 4 byte"), 12),
    "ls": (6, DRIVES / "ls/ls-s100.gsd", ("PPO1",), 12),
    "imo": (7, GSD.format(name="imo", ident="0xDD02", config="0xF3, 0x7B"), ("all",), 32),
    "io": (8, STATION, ("8 DI", "8 DO"), 1),
}

#: slave: what is sent in turn, and what its inputs begin with then (process data; from the manuals, as the tests of
#: the simulated drives have them)
RUNS: Final[dict[str, tuple[tuple[str, str], ...]]] = {
    "demag": (("0006 0000", "0221"), ("0007 0000", "0223"), ("000F 2000", "06272000"), ("0006 0000", "0221")),
    "fuji": (("047E 4000", "0231"), ("047F 4000", "03374000"), ("047E 4000", "02310000")),
    "keb": (("0005 05DC", "001505DC"), ("0000 0000", "0001")),
    "ls": (("047E 4000", "0235"), ("047F 4000", "03374000"), ("047E 4000", "02350000")),
    "imo": (("0001 09C4", "410109C4"), ("0005 09C4", "41030000")),
}


@pytest.fixture
def start(start: Starter) -> Starter:
    assert importlib.util.find_spec("pyprofibus"), MISSING
    return start


@pytest.fixture
def segment(tmp_path: Path, start: Starter) -> Path:
    """A segment of three stations; the folder with their ports."""
    directory = tmp_path / "bus"
    start.segment(directory, 3)
    return directory


def tool(name: str) -> str:
    """A program that pyprofibus installs beside its package."""
    path = Path(sys.executable).with_name(name)
    assert path.exists(), f"{path} is missing: {MISSING}"
    return str(path)


class Pyprofibus:
    """Its master as a process. ``sent``: what it will send to each slave."""

    def __init__(self, folder: Path, port: Path, slaves: dict[str, Any], watchdog_ms: int = 5000) -> None:
        sections = [f"[PROFIBUS]\ndebug=2\n[PHY]\ntype=serial\ndev={port}\nbaud=500000\n[DP]\nmaster_addr=2\n"]
        for number, (name, (station, gsd, modules, octets)) in enumerate(slaves.items()):
            path = gsd
            if isinstance(gsd, str):
                path = folder / f"{name}.gsd"
                path.write_text(gsd, encoding="latin-1")
            lines = [f"[SLAVE_{number}]", f"name={name}", f"addr={station}", f"gsd={path}"]
            into, out = octets if isinstance(octets, tuple) else (octets, octets)  # seen from the slave
            lines += [f"watchdog_ms={watchdog_ms}", f"input_size={into}", f"output_size={out}"]
            lines += [f"module_{i}={module}" for i, module in enumerate(modules)]
            sections.append("\n".join(lines) + "\n")
        config = folder / "pyprofibus.conf"
        config.write_text("".join(sections), encoding="utf-8")
        self._out = folder / "pyprofibus.out"
        with self._out.open("wb") as out, self._out.with_suffix(".err").open("wb") as err:
            words = [sys.executable, "-W", "ignore", str(HERE / "pyprofibus_master.py"), str(config)]
            self.process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=out, stderr=err, text=True)

    @property
    def lines(self) -> list[dict[str, Any]]:
        whole = self._out.read_text(encoding="utf-8").rpartition("\n")[0]
        return [json.loads(line) for line in whole.splitlines()]

    @property
    def inputs(self) -> dict[str, str]:
        return self.lines[-1].get("inputs", {}) if self.lines else {}

    @property
    def connected(self) -> list[str]:
        return self.lines[-1].get("connected", []) if self.lines else []

    def send(self, outputs: dict[str, str]) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(outputs) + "\n")
        self.process.stdin.flush()

    def until(self, happened: Callable[[], bool], what: str) -> None:
        def told() -> str:
            return f"{what}: {self.lines[-1:]} {self._out.with_suffix('.err').read_text(encoding='utf-8')[-2000:]}"

        eventually(lambda: happened() or self.process.poll() is not None, told)
        assert happened(), told()

    def kill(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.kill()
        self.process.wait()


@contextlib.contextmanager
def pyprofibus(folder: Path, port: Path, slaves: dict[str, Any], watchdog_ms: int = 5000) -> Iterator[Pyprofibus]:
    master = Pyprofibus(folder, port, slaves, watchdog_ms)
    try:
        yield master
    finally:
        master.kill()


def process_data(name: str, words: str) -> str:
    """Outputs: no parameter channel, the process data, zeros."""
    return ("00" * 8 + words.replace(" ", "")).ljust(2 * SLAVES[name][3], "0")


def test_its_master_runs_every_drive(tmp_path: Path, segment: Path, start: Starter) -> None:
    """Bring-up with the GSD files; every drive started and stopped with its manual's words; the drives' watchdogs when
    the master is killed. One after the other: it sends to the next slave before the last one has answered, and with
    several on a bus they answer into each other.
    """
    plant = plant_file(tmp_path, *PLANT, port=segment / "0")
    slaves = start("sim", str(plant), "--port", str(segment / "0"), "--json")
    for name, slave in SLAVES.items():
        with pyprofibus(tmp_path, segment / "1", {name: slave}, watchdog_ms=2000) as master:
            master.until(lambda name=name: master.connected == [name], f"data exchange with {name}")  # type: ignore[misc]
            for words, expected in RUNS.get(name, ()):
                master.send({name: process_data(name, words)})
                master.until(
                    lambda name=name, expected=expected: (  # type: ignore[misc]
                        master.inputs.get(name, "")[16:].upper().startswith(expected)
                    ),
                    f"{name}: {expected} after {words}",
                )
            if name == "io":
                assert master.lines[0]["sent"]["io"]["cfg"] == "1020"
            if name == "ls":
                assert master.lines[0]["sent"]["ls"]["prm"][14:] == "800000"
    for name in SLAVES:
        slaves.wait_for(f'"name":"{name}","state":"wait_prm","master":null,"why":"watchdog expired"')


RACK_OUT: Final = "6ES7 322-1BH01-0AA0 16DO"


@pytest.mark.parametrize("has_gsd", [True, False])
def test_its_master_runs_the_plant_of_a_step7_project(
    tmp_path: Path, segment: Path, start: Starter, has_gsd: bool
) -> None:
    """An export imported, its plant simulated, pyprofibus as the PLC; a listener has the names of the plant. Without
    GSD files the simulation of Siemens' own slave takes what the PLC says."""
    # pyprofibus takes no slave without outputs
    lamps = 'DPSUBSYSTEM 1, DPADDRESS 12, SLOT 6, "6ES7 322-1BH01-0AA0", "DO16xDC24V"'
    export = STEP7 + section(lamps, *address("OUT", 20, 2), 'SYMBOL  O , 8, "Lampe", ""')
    (tmp_path / "plant.cfg").write_bytes(export.encode("cp1252"))
    plant = tmp_path / "plant.toml"
    gsd = gsd_folder(tmp_path / "gsd")
    files = ["--gsd", str(gsd)] if has_gsd else []
    assert main(["import", str(tmp_path / "plant.cfg"), *files, "--out", str(plant)]) == 0
    assert main(["plan", str(plant)]) == 0
    start("sim", str(plant), "--port", str(segment / "0"), "--baud", "500000", "--json")
    slaves: dict[str, Any] = {
        "Hauptschrank": (10, VALVES_GSD, ("coupler", "4AI 0-20mA", "8DI 24V DC", "8DO 24V DC"), (1, 9)),
        "Halle 2": (12, RACK_GSD, ("6ES7 321-1BH02-0AA0 16DI", "6ES7 331-1KF01-0AB0 8AI", RACK_OUT), (2, 18)),
    }
    for name, slave in slaves.items():
        with pyprofibus(tmp_path, segment / "1", {name: slave}, watchdog_ms=2000) as master:
            master.until(lambda name=name: master.connected == [name], f"data exchange with {name}")  # type: ignore[misc]
            master.send({name: "81" * slave[3][0]})
            listen = ("capture", "--port", str(segment / "2"), "--baud", "500000", "--config", str(plant))
            heard = start(*listen, "--seconds", "2")
            assert heard.process.wait(HANG_S) == 0
            text = heard.out
            assert ("NA_INT" if name == "Hauptschrank" else "Lampe: yes") in text


def test_our_program_recognises_its_bus_by_listening(tmp_path: Path, segment: Path, start: Starter) -> None:
    """pyprofibus passes no token, so dpstack cannot join it as a master; ``dpstack baud`` only listens."""
    sim = ("sim", "--gsd", "io-station", "--modules", "8 DI", "8 DO", "--address", "8", "--port", str(segment / "0"))
    slave = start(*sim, "--json")
    with pyprofibus(tmp_path, segment / "1", {"io": SLAVES["io"]}) as master:
        master.until(lambda: master.connected == ["io"], "data exchange")
        found = start("baud", "--port", str(segment / "2"), "--json")
        found.wait_for('"baud":500000')
        assert found.process.wait(HANG_S) == 0
        states = [line["state"] for line in slave.lines if line.get("event") == "slave"]
        assert states == ["wait_cfg", "data_exchange"]
    assert_bring_up(tmp_path / "pyprofibus.err")


def assert_bring_up(log: Path) -> None:
    """``dpstack decode`` finds the bring-up of slave 8 in a log of pyprofibus, and says of every other line that it has
    no octets."""
    words = [sys.executable, "-m", "dpstack.cli.main", "decode", str(log), "--json"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=HANG_S, check=False)
    telegrams = [json.loads(line) for line in done.stdout.splitlines()]
    steps = [one["service"] for one in telegrams if 8 in (one["da"], one["from"] if one["kind"] == "SC" else None)]
    for service in ("Slave_Diag", "Set_Prm", "Chk_Cfg", "Slave_Diag", "Data_Exchange"):
        assert service in steps, (service, steps[:20])
        steps = steps[steps.index(service) :]
    assert "was not understood" not in done.stderr


def test_its_sniffer_reads_our_bus(tmp_path: Path, segment: Path, start: Starter) -> None:
    """At 9600 bit/s, the only rate it has."""
    sim = ("sim", "--gsd", "io-station", "--modules", "8 DI", "8 DO", "--address", "8", "--port", str(segment / "0"))
    start(*sim, "--baud", "9600")
    plant = plant_file(tmp_path, IO, port=segment / "1", baud=9600)
    heard = tmp_path / "heard"
    with heard.open("wb") as out:
        sniffer = subprocess.Popen([sys.executable, "-u", tool("profisniff"), str(segment / "2")], stdout=out)
    try:
        run = start("run", str(plant), "--outputs", "8=a5", "--json")
        run.wait_for_slaves(1)
        eventually(lambda: "a5" in heard.read_text(encoding="utf-8").lower() or sniffer.poll() is not None, "A5")
    finally:
        sniffer.kill()
        sniffer.wait()
    text = heard.read_text(encoding="utf-8")
    bring_up = (
        "da=0x08, sa=0x02, fc=0x6D, dae=3C, sae=3E, du=Empty",
        "da=0x02, sa=0x08, fc=0x08, dae=3E, sae=3C, du=02 05 00 FF 10 D5",
        "dae=3D, sae=3E, du=88",
        "sd=SC",
        "dae=3E, sae=3E, du=10 20",
        "da=0x02, sa=0x08, fc=0x08, dae=3E, sae=3C, du=00 0C 00 02 10 D5",
        "da=0x08, sa=0x02, fc=0x7D, dae=Empty, sae=Empty, du=A5",
    )
    for line in bring_up:
        assert line in text
        text = text[text.index(line) :]
    whole = tmp_path / "whole"
    whole.write_text(heard.read_text(encoding="utf-8").rpartition("\n")[0], encoding="utf-8")  # killed within a line
    assert_bring_up(whole)


@pytest.mark.parametrize("path", [*sorted(DRIVES.glob("*/*.gsd")), STATION], ids=lambda path: path.name)
def test_its_parser_reads_our_gsd_files_as_we_do(path: Path) -> None:
    assert importlib.util.find_spec("pyprofibus"), MISSING
    summary = subprocess.run([tool("gsdparser"), str(path)], capture_output=True, text=True, timeout=HANG_S, check=True)
    ours = subprocess.run(
        [sys.executable, "-m", "dpstack.cli.main", "gsd", "show", str(path), "--json"],
        capture_output=True,
        text=True,
        timeout=HANG_S,
        check=True,
    )
    shown = json.loads(ours.stdout)
    assert f"Ident {shown['ident']}".lower() in summary.stdout.lower()
    for module in shown["modules"]:
        assert f'Available module:  "{module["name"]}"' in summary.stdout


#: a slave of one's own, and what its parser makes of the written file
OWN: Final = """
from dpstack.slave import SlaveDescription
from dpstack.dpv1.slave.description import SlaveModule, SlaveParameter
from dpstack.gsd.model import DiagText

TANK = SlaveDescription(
    ident=0x4711, name="Tank 3000", vendor="Nobody & Sons", configs=(b"\\x11\\x20",), user_prm_len=(5, 20), dpv1=True,
    alarms=("process",), ms2=2, rates={500_000: 100}, parameters=(SlaveParameter("Delay", 3, "Unsigned16", 500),),
    diag_texts=(DiagText("channel", None, None, 17, "valve stuck", "clean it"),),
)
RACK = SlaveDescription(
    ident=0x4712, name="Rack", modules=(SlaveModule("8 DI", b"\\x10"), SlaveModule("8 DO", b"\\x20")), max_modules=5
)
"""
READ: Final = {
    "TANK": (
        "'Ident_Number' : 18193",
        "'Vendor_Name' : 'Nobody & Sons'",
        "'Model_Name' : 'Tank 3000'",
        "'DPV1_Slave' : True",
        "'500_supp' : True",
        "'12M_supp' : False",
        "'MaxTsdr_500' : 100",
        "'Max_User_Prm_Data_Len' : 20",
        "ExtUserPrmDataConst(0, b'\\x80\\x00\\x00\\x01\\xf4')",
        "ExtUserPrmDataRef(3, 1)",
        "Module('2 octets in, 1 octet out', b'\\x11 ', fields={'Preset' : True",
    ),
    "RACK": (
        "'Ident_Number' : 18194",
        "'Modular_Station' : True",
        "'Max_Module' : 5",
        "Module('8 DI', b'\\x10'",
        "Module('8 DO', b' '",
    ),
}


@pytest.mark.parametrize("name", READ)
def test_its_parser_reads_a_file_of_gsd_write(name: str, tmp_path: Path) -> None:
    assert importlib.util.find_spec("pyprofibus"), MISSING
    (tmp_path / "own.py").write_text(OWN, encoding="utf-8")
    made = [sys.executable, "-m", "dpstack.cli.main", "gsd", "write", f"own.py:{name}", "own.gsd"]
    subprocess.run(made, cwd=tmp_path, timeout=HANG_S, check=True)
    dump = subprocess.run(
        [tool("gsdparser"), "-D", str(tmp_path / "own.gsd")], capture_output=True, text=True, timeout=HANG_S, check=True
    )
    assert [text for text in READ[name] if text not in dump.stdout] == []
    assert dump.stderr == ""
