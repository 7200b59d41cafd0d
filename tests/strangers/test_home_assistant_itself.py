"""The discovery messages as Home Assistant takes them: entities, quality, orders, slaves that leave, hostile names.

One Home Assistant and one broker serve all tests of this file; each test has an edge node of its own.
"""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import pytest
from far_ends import eventually
from plant_files import plant_file

from dpstack.bridge.homeassistant.words import known_units
from dpstack.bridge.mqtt.broker import Broker
from dpstack.bridge.mqtt.json_node import JsonNode
from dpstack.bridge.mqtt.plant_node import NodeSetup
from tests.strangers.homeassistant_kit import VERSION, House
from tests.strangers.mosquitto_kit import Mosquitto, Plant

pytestmark = pytest.mark.strangers

ROOT: Final = Path(__file__).resolve().parents[2]
PAGE: Final = (ROOT / "docs" / "how-to" / "home-assistant.md").read_text(encoding="utf-8")
#: the configuration of the page
BLOCK: Final = PAGE.split("```toml\n")[1].split("```")[0]
#: reads pairs of unit and device class as JSON, and says which of them sensors and numbers do not permit
CLASSES: Final = """
import json, sys
from homeassistant.components.number import const as number
from homeassistant.components.sensor import const as sensor
for unit, name, state in json.load(sys.stdin):
    for one in (sensor.DEVICE_CLASS_UNITS[sensor.SensorDeviceClass(name)],
                number.DEVICE_CLASS_UNITS[number.NumberDeviceClass(name)]):
        if unit not in {str(x) for x in one}:
            print("unit", unit, name)
    if state not in {str(x) for x in sensor.DEVICE_CLASS_STATE_CLASSES[sensor.SensorDeviceClass(name)]}:
        print("state class", name, state)
"""


@pytest.fixture(scope="module")
def house_broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mosquitto]:
    made = Mosquitto(tmp_path_factory.mktemp("broker"))
    yield made
    made.kill()


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory, house_broker: Mosquitto) -> Iterator[House]:
    folder = tmp_path_factory.mktemp("house")
    made = House(folder, house_broker.port)
    yield made
    made.end()
    for name in ("site", "root", "uv", "apt"):  # a gigabyte
        shutil.rmtree(folder / name)


def soon(condition: Callable[[], object], what: Callable[[], object]) -> None:
    eventually(condition, lambda: str(what()), 30.0)


def state(house: House, entity: str) -> Any:
    return house.states().get(entity, {}).get("state")


def until_state(house: House, entity: str, wanted: str) -> dict[str, Any]:
    """The attributes of the entity once its state is ``wanted``."""
    soon(lambda: state(house, entity) == wanted, lambda: (entity, wanted, house.states().get(entity)))
    return dict(house.states()[entity]["attributes"])


def test_units_device_classes_and_state_classes_are_those_of_home_assistant(house: House) -> None:
    made = subprocess.run(
        [*house.python, "-c", CLASSES],
        input=json.dumps(known_units()),
        capture_output=True,
        text=True,
        check=True,
        env=house.environment,
        timeout=60,
    )
    assert made.stdout == ""


def config_of(folder: Path, broker: Mosquitto, *, without: str = "", **mqtt: object) -> Path:
    """The configuration of the page at this broker, quicker. ``without``: a slave that it does not have; ``mqtt``: keys
    that are others."""
    tables = tomllib.loads(BLOCK)
    tables["mqtt"] |= {"url": f"mqtt://127.0.0.1:{broker.port}", "interval_ms": 50, **mqtt}
    slaves = [one for one in tables["slave"] if one["name"] != without]
    return plant_file(folder, *slaves, tables={"mqtt": tables["mqtt"]}, **tables["bus"])


@contextmanager
def running(config: Path) -> Iterator[subprocess.Popen[bytes]]:
    environment = os.environ | {"XDG_STATE_HOME": str(config.parent), "XDG_RUNTIME_DIR": str(config.parent)}
    run = subprocess.Popen(
        [sys.executable, "-m", "dpstack", "run", config, "--json"], env=environment, stdout=subprocess.DEVNULL
    )
    try:
        yield run
    finally:
        run.terminate()
        run.wait(20)


def test_an_owner_sees_the_plant_and_moves_it(house: House, house_broker: Mosquitto, tmp_path: Path) -> None:
    with running(config_of(tmp_path, house_broker)) as run:
        flow = until_state(house, "sensor.boiler_flow", "0.0")
        assert {key: flow[key] for key in ("unit_of_measurement", "device_class", "state_class", "quality")} == {
            "unit_of_measurement": "°C",
            "device_class": "temperature",
            "state_class": "measurement",
            "quality": "good",
        }
        assert state(house, "binary_sensor.boiler_online") == "on"
        assert house.template("{{ device_attr('sensor.pump_speed', 'name') }}") == "pump"
        above = "{{ device_attr(device_attr('sensor.pump_speed', 'via_device_id'), 'name') }}"
        assert house.template(above) == "PROFIBUS cellar"
        until_state(house, "switch.boiler_valve", "off")
        house.service("switch.turn_on", "switch.boiler_valve")
        until_state(house, "switch.boiler_valve", "on")
        house.service("number.set_value", "number.boiler_level", value=77)
        until_state(house, "number.boiler_level", "77")
        house.service("button.press", "button.pump_start")
        house.service("number.set_value", "number.pump_setpoint", value=50)
        until_state(house, "binary_sensor.pump_running", "on")
        soon(lambda: 49 < float(state(house, "sensor.pump_speed")) < 51, lambda: state(house, "sensor.pump_speed"))
        house.service("button.press", "button.pump_stop")
        until_state(house, "binary_sensor.pump_running", "off")
        # the broker holds an order back for longer than command_max_age_s
        house_broker.kill(signal.SIGSTOP)
        house.service("switch.turn_off", "switch.boiler_valve")
        time.sleep(2.5)
        house_broker.kill(signal.SIGCONT)
        reason = until_state(house, "sensor.profibus_cellar_last_order", "boiler.valve: refused")["reason"]
        assert "s old by the clock of this computer; 2 s are allowed" in reason
        assert state(house, "switch.boiler_valve") == "on"
        run.kill()
        until_state(house, "switch.boiler_valve", "unavailable")
        until_state(house, "binary_sensor.profibus_cellar_online", "off")
    # another configuration: no drive, and a valve that nobody may switch
    with running(config_of(tmp_path, house_broker, without="pump", allow_commands=[])):
        soon(lambda: "switch.boiler_valve" not in house.entities(), lambda: house.entities().keys())
        until_state(house, "binary_sensor.boiler_valve", "off")
        soon(lambda: not any("pump" in one for one in house.entities()), lambda: house.entities().keys())
        assert house.template("{{ device_id('pump') }}") == "None"
    assert house.complaints() == []


class JsonPlant(Plant):
    """A plant in the hands of the test, published as plain JSON to Home Assistant."""

    def __init__(self, folder: Path, broker: Mosquitto, node: str) -> None:
        super().__init__(
            folder,
            Broker(url=f"mqtt://127.0.0.1:{broker.port}"),
            setup=NodeSetup("tests", node, interval_s=0.05, discovery_prefix="homeassistant"),
            make_node=JsonNode,
        )


async def shown(house: House, entity: str, wanted: str) -> dict[str, Any]:
    return await asyncio.to_thread(until_state, house, entity, wanted)


async def test_quality_is_availability(house: House, house_broker: Mosquitto, tmp_path: Path) -> None:
    plant = JsonPlant(tmp_path, house_broker, "quality")
    plant.plant["slaves"]["8"]["name"] = plant.values["8"]["name"] = "tank"
    slave = plant.values["8"]
    # 1.234 and 0.0000015 in four octets
    singles = {"flow": 1.2339999675750732, "leak": 1.5e-6}
    plant.plant["slaves"]["8"]["inputs"] += [{"name": name, "type": "f32", "at": "f32@8"} for name in singles]
    slave["fields"] |= singles
    async with plant.running():
        assert (await shown(house, "sensor.tank_level", "12.5"))["quality"] == "good"
        await shown(house, "sensor.tank_flow", "1.234")
        await shown(house, "sensor.tank_leak", "1.5e-06")
        text = "upper limit value exceeded: slot 2"
        slave["qualities"] = {"level": {"quality": "uncertain", "reason": "channel_limit", "text": text}}
        slave["fields"]["level"] = 13.5
        attributes = await shown(house, "sensor.tank_level", "13.5")
        assert (attributes["quality"], attributes["reason"]) == ("uncertain", text)
        slave["qualities"] = {"level": {"quality": "bad", "reason": "channel_fault", "text": "line break: slot 3"}}
        await shown(house, "sensor.tank_level", "unavailable")
        assert await asyncio.to_thread(state, house, "sensor.tank_count") == "-3"
        slave["qualities"] = {}
        await shown(house, "sensor.tank_level", "13.5")
        slave["state"] = "offline"
        await shown(house, "sensor.tank_level", "unavailable")
        await shown(house, "binary_sensor.tank_lamp", "unavailable")
        await shown(house, "binary_sensor.tank_online", "off")
        await shown(house, "sensor.tank_state", "offline")
        # the last value is stale, and does not come back without the slave
        assert await asyncio.to_thread(state, house, "sensor.tank_level") == "unavailable"
    assert house.complaints() == []


NASTY: Final = {
    "quotes": 'it\'s "{{ 7 * 7 }}"',
    "ends": "'] }}{{ states('sensor.x') }}{% raw %}",
    "escapes": "a\\u0027 %} \\",
    "long": "W" * 120,
    "wide": "测" * 120,
    "signs": "/+#\u202e<script>alert(1)</script>",
}


async def test_hostile_names_are_texts(house: House, house_broker: Mosquitto, tmp_path: Path) -> None:
    plant = JsonPlant(tmp_path, house_broker, "names {{ 7 * 7 }} '\"")
    inputs = [{"name": name, "type": "i8", "at": f"i8@{n}"} for n, name in enumerate(NASTY.values())]
    about = {"vendor": "{{ 7 * 7 }}", "model": "'] }}"}
    plant.plant["slaves"] = {"9": {"name": "n'] }}{{ 7 * 7 }}", "watchdog_ms": 0, "inputs": inputs, **about}}
    fields = dict(zip(NASTY.values(), range(10, 20), strict=False))
    plant.values = {"9": {**plant.values["8"], "fields": fields}}

    def found() -> dict[str, str]:
        ours = [one for one in house.entities().values() if one["state"] in map(str, fields.values())]
        return {one["attributes"]["friendly_name"]: one["state"] for one in ours}

    async with plant.running():
        await asyncio.to_thread(soon, lambda: len(found()) == len(NASTY), found)
        device = "n'] }}{{ 7 * 7 }}"
        names = {name.removeprefix(f"{device} "): value for name, value in found().items()}
        assert names['it\'s "{{ 7 * 7 }}"'] == "10"
        assert names["'] }}{{ states('sensor.x') }}{% raw %}"] == "11"
        assert sorted(names.values()) == [str(one) for one in fields.values()]
        assert not any("49" in name for name in names)
    assert house.complaints() == []


async def test_the_birth_message_of_home_assistant_brings_all_of_it_again(
    house: House, house_broker: Mosquitto, tmp_path: Path
) -> None:
    plant = JsonPlant(tmp_path, house_broker, "again")
    plant.plant["slaves"] = {"8": plant.plant["slaves"]["8"] | {"name": "kettle"}}
    plant.values = {"8": plant.values["8"]}
    async with plant.running():
        await shown(house, "sensor.kettle_level", "12.5")
        words = house_broker.clients("mosquitto_sub", "-t", "homeassistant/#", "--remove-retained", "-W", "1")
        await asyncio.to_thread(subprocess.run, words, stdout=subprocess.DEVNULL, timeout=20)
        await asyncio.to_thread(soon, lambda: "sensor.kettle_level" not in house.states(), lambda: "it is still there")
        await asyncio.to_thread(house.reload)
        await shown(house, "sensor.kettle_level", "12.5")
    assert house.complaints() == []


def test_the_page_says_which_release_has_judged() -> None:
    assert f"Home Assistant {VERSION}" in PAGE
