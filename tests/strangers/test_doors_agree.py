"""One plant, read at the same time through ten doors: API, ctl, recording, MQTT, templates of Home Assistant, EPICS,
OPC UA, metrics, page, screen.

A simulated rack on ptys stands still with a broken wire, an exceeded limit and a good value; each door is read until it
agrees, in a bounded number of looks. The table of docs/reference/quality.md says what each door carries.
"""

from __future__ import annotations

import csv
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from far_ends import HANG_S, free_port
from plant_files import plant_file
from programs import Starter

from tests.strangers.browser_kit import Browser
from tests.strangers.mosquitto_kit import Mosquitto
from tests.strangers.stranger_kit import environment, npm_folder
from tests.strangers.test_epics_clients import VERSIONS, Tools
from tests.strangers.test_live_screen import Terminal
from tests.strangers.test_node_opcua import VERSION

pytestmark = pytest.mark.strangers

HERE: Final = Path(__file__).parent
ROOT: Final = HERE.parent.parent
#: looks at one door, and the pause between two
_LOOKS: Final = 20
_PAUSE_S: Final = 0.5
GSD: Final = (ROOT / "examples" / "terminal.gsd").read_text(encoding="utf-8")
RACK: Final[dict[str, Any]] = {
    "name": "rack",
    "address": 5,
    "ident": 0x0B12,
    "config": "10 51 51 20",
    "watchdog_ms": 5000,
    "inputs": {
        "door": "slot 1 channel 3 bool",
        "level": {"at": "slot 2 channel 0 i16", "scale": 0.1, "unit": "%"},
        "flow": {"at": "slot 2 channel 1 i16", "scale": 0.1, "unit": "bar"},
        "heat": {"at": "slot 3 channel 0 i16", "scale": 0.1, "unit": "C"},
    },
    "outputs": {"valve": "slot 4 channel 0 bool"},
}
BREAK: Final = "line break: slot 2, input channel 0"
LIMIT: Final = "upper limit exceeded: slot 3, input channel 0"
#: name: number, quality, reason
PLANT: Final[dict[str, tuple[float | bool, str, str]]] = {
    "door": (True, "good", ""),
    "level": (3276.7, "bad", BREAK),
    "flow": (12.3, "good", ""),
    "heat": (45.6, "uncertain", LIMIT),
    "valve": (False, "good", ""),
}
#: status and severity of EPICS
ALARMS: Final = {"good": ("NO_ALARM", "NO_ALARM"), "bad": ("READ", "INVALID"), "uncertain": ("HWLIMIT", "MINOR")}
#: reads pairs of template and payload as JSON, and renders them with Jinja, which Home Assistant does
RENDER: Final = """
import json, sys
from jinja2 import Environment
made = Environment()
pairs = json.load(sys.stdin)
print(json.dumps([made.from_string(text).render(value_json=json.loads(payload)) for text, payload in pairs]))
"""
#: as a reader gets it who sees no quality beside it
PLAIN: Final = {name: None if quality == "bad" else number for name, (number, quality, _) in PLANT.items()}


@pytest.fixture(scope="module")
def node_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = npm_folder(tmp_path_factory.mktemp("npm"), f"node-opcua-client@{VERSION}")
    shutil.copy(HERE / "node_opcua_read.js", made)
    return made


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the programs of EPICS base, with a Python that has Jinja."""
    return environment(tmp_path_factory.mktemp("epics"), VERSIONS[0], "jinja2==3.1.6").parent


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Starter]:
    folder = tmp_path / "programs"
    folder.mkdir()
    starter = Starter(folder)
    yield starter
    starter.close()


@pytest.fixture
def mosquitto(tmp_path: Path) -> Iterator[Mosquitto]:
    broker = Mosquitto(tmp_path)
    yield broker
    broker.kill()


@pytest.fixture
def terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Terminal]:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("LC_ALL", "C.UTF-8")
    found = Terminal(tmp_path, width=120, height=40)
    yield found
    found.kill()


def agrees(door: str, look: Callable[[], Any], wanted: Any) -> str:
    """Look at a door until it agrees. Returns the difference; empty if it agrees."""
    found: Any = None
    for _ in range(_LOOKS):
        try:
            found = look()
        except (OSError, ValueError, KeyError, IndexError, StopIteration, subprocess.SubprocessError) as error:
            found = error
        if found == wanted:
            return ""
        time.sleep(_PAUSE_S)
    return f"{door}: {found!r}\nwanted: {wanted!r}"


def test_the_same_plant_through_ten_doors(
    start: Starter, terminal: Terminal, mosquitto: Mosquitto, node_folder: Path, programs: Path, browser: Browser,
    tmp_path: Path,
) -> None:  # fmt: skip
    bus, opcua, metrics, epics = tmp_path / "bus", free_port(), free_port(), free_port()
    tables: dict[str, dict[str, Any]] = {
        "mqtt": {"url": f"mqtt://127.0.0.1:{mosquitto.port}", "group": "g", "node": "n", "format": "json",
                 "interval_ms": 100, "discovery": "homeassistant"},
        "opcua": {"listen": f"127.0.0.1:{opcua}", "anonymous": "read"},
        "epics": {"prefix": "P:", "listen": f"127.0.0.1:{epics}"},
        "metrics": {"listen": f"127.0.0.1:{metrics}", "values": True},
    }  # fmt: skip
    config = plant_file(tmp_path, RACK, port=str(bus / "0"), baud=500_000, gap=0, max_retry=7, tables=tables)
    start("segment", "--dir", str(bus), "--stations", "2", "--json").wait_for("ports")
    sim = start("sim", str(config), "--port", str(bus / "1"))
    sim.wait_for("simulating")
    api, record = tmp_path / "api.json", tmp_path / "rack.csv"
    script = shlex.join([sys.executable, str(HERE / "run_with_reader.py"), str(api), "run", str(config)])
    terminal.type(f"{script} --record {record} --quality")
    assert not agrees("the run", lambda: len(json.loads(api.read_text())), len(PLANT)), terminal.history()
    differences: list[str] = []

    def door(name: str, look: Callable[[], Any], wanted: Any) -> None:
        differences.append(agrees(name, look, wanted))

    def ctl(port: str, *words: str) -> str:
        done = start("ctl", str(bus / port), *words)
        assert done.end() == 0, done.err
        return done.out

    ctl("1", "set", "rack.level=3276.7", "rack.flow=12.3", "rack.heat=45.6", "rack.door=on")
    ctl("1", "fault", "rack", "diagnosis", "what=slot 2 channel 0 line break")
    ctl("1", "fault", "rack", "diagnosis", "what=slot 3 channel 0 upper limit exceeded")

    differences.append(
        agrees("API", lambda: json.loads(api.read_text()), {name: list(one) for name, one in PLANT.items()})
    )

    def of_ctl() -> Any:
        slave = json.loads(ctl("0", "status", "--json"))["result"]["slaves"]["5"]
        qualities = slave.get("qualities") or {}
        return {
            name: (
                slave["fields"][name],
                *((one["quality"], one["text"]) if (one := qualities.get(name)) else ("good", "")),
            )
            for name in PLANT
        }

    door("ctl", of_ctl, PLANT)

    def of_recording() -> Any:
        with record.open(encoding="utf-8") as file:
            *_, row = csv.DictReader(line for line in file if line.endswith("\n"))
        found = {key.partition(" [")[0].removeprefix("rack."): value for key, value in row.items()}
        return {name: (json.loads(found[name]), found[f"{name} quality"]) for name in PLANT}

    door("recording", of_recording, {name: one[:2] for name, one in PLANT.items()})

    def kept(count: int, *topics: str) -> dict[str, Any]:
        """Payloads that the broker keeps, by topic."""
        asked = [word for topic in topics for word in ("-t", topic)]
        words = mosquitto.clients("mosquitto_sub", "-v", "-C", str(count), "-W", "10", *asked)
        done = subprocess.run(words, capture_output=True, text=True, timeout=HANG_S, check=True)
        return {
            topic: json.loads(payload) for topic, _, payload in (x.partition(" ") for x in done.stdout.splitlines())
        }

    def of_mqtt() -> Any:
        found = kept(2, "dpstack/g/n/slave/rack/inputs", "dpstack/g/n/slave/rack/outputs")
        values = {name: value for payload in found.values() for name, value in payload.items()}
        return {name: (values[name]["value"], values[name]["quality"], values[name]["reason"]) for name in PLANT}

    door("MQTT", of_mqtt, {name: (PLAIN[name], *one[1:]) for name, one in PLANT.items()})

    def of_house() -> Any:
        """The templates of the discovery messages, as Jinja renders them: state, or None if unavailable; attributes."""
        places = {name: f"slave__5__{'output' if name == 'valve' else 'input'}__{name}" for name in PLANT}
        configs = kept(5, *(f"homeassistant/+/dpstack__g__n/{place}/config" for place in places.values()))
        by_place = {topic.split("/")[3]: config for topic, config in configs.items()}
        shown: list[tuple[str, Any]] = []
        for place in places.values():
            config = by_place[place]
            online, quality = config["availability"]
            values = kept(2, online["topic"], quality["topic"])
            assert values[online["topic"]] is True
            payload = json.dumps(values[quality["topic"]])
            keys = config["value_template"], config["json_attributes_template"], quality["value_template"]
            shown += [(template, payload) for template in keys]
        words = [str(programs / "python"), "-c", RENDER]
        done = subprocess.run(
            words, input=json.dumps(shown), capture_output=True, text=True, check=True, timeout=HANG_S
        )
        rendered = iter(json.loads(done.stdout))
        found = {}
        for name, place in places.items():
            state, about, is_there = next(rendered), json.loads(next(rendered)), next(rendered)
            on = by_place[place].get("payload_on")
            value = state == on if on is not None else float(state) if is_there == "true" else None
            found[name] = (value if is_there == "true" else None, about["quality"], about["reason"])
        return found

    door("Home Assistant", of_house, {name: (PLAIN[name], *one[1:]) for name, one in PLANT.items()})

    def of_epics() -> Any:
        tools = Tools(programs, epics)
        names = {name: f"P:rack:{'out' if name == 'valve' else 'in'}:{name}" for name in PLANT}
        found = {}
        for name, line in zip(PLANT, tools("caget", "-a", *names.values()).splitlines(), strict=True):
            _, _, _, value, *alarm = line.split()
            reason = tools("caget", "-S", "-t", f"{names[name]}.AMSG$")
            found[name] = (json.loads(value), tuple(alarm or ("NO_ALARM", "NO_ALARM")), reason)
        return found

    door(
        "EPICS", of_epics,
        {name: (number, ALARMS[quality], text) for name, (number, quality, text) in PLANT.items()},
    )  # fmt: skip

    def of_opcua() -> Any:
        nodes = {name: f"slave/5/{'output' if name == 'valve' else 'input'}/{name}" for name in PLANT}
        done = subprocess.run(
            ["node", "node_opcua_read.js", f"opc.tcp://127.0.0.1:{opcua}", *nodes.values()],
            cwd=node_folder, env=os.environ | {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)},
            capture_output=True, text=True, timeout=HANG_S, check=True,
        )  # fmt: skip
        found = json.loads(done.stdout)
        return {name: tuple(found[node]) for name, node in nodes.items()}

    codes = {"good": "Good", "bad": "BadSensorFailure", "uncertain": "UncertainEngineeringUnitsExceeded"}
    door("OPC UA", of_opcua, {name: (number, codes[quality], text) for name, (number, quality, text) in PLANT.items()})

    def of_metrics() -> Any:
        with urllib.request.urlopen(f"http://127.0.0.1:{metrics}/metrics", timeout=HANG_S) as answer:
            text = answer.read().decode()
        values = dict.fromkeys(PLANT)
        for labels, number in re.findall(r"^dpstack_slave_value\{([^}]*)\} (\S+)$", text, re.MULTILINE):
            name = re.search(r'value="([^"]*)"', labels)
            assert name is not None
            values[name[1]] = float(number)
        return values

    differences.append(
        agrees("metrics", of_metrics, {name: None if one is None else float(one) for name, one in PLAIN.items()})
    )

    web = start("web", str(config), "--json", "--listen", "127.0.0.1:0")
    web.wait_for('"listening"')
    browser.open(str(next(line["url"] for line in web.lines if line["event"] == "listening")))
    browser.sees("Live", "#live")
    browser.sees("line break", "body")
    browser.sees("3276.7", "body")

    def of_page() -> Any:
        text = browser.text("body")
        return [
            one in text for one in ("line break", "upper limit exceeded", "3276.7", "45.6", "12.3", "level", "heat")
        ]

    door("page", of_page, [True] * 7)
    screen = terminal.until("line break", "level", "3276.7", "heat", "45.6", "12.3")
    assert "upper limit" in screen
    terminal.keys("q")
    assert not any(differences), "\n".join(differences)
