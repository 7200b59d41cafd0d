#!/bin/sh
# Availability of an entity of MQTT by two parts of one message, in Home Assistant 2024.3.3 (the newest for Python 3.11, which
# this needs, or 3.12). 2026.11.0 does the same.
# Guess: with availability_mode "all" each entry of the list counts, also if two entries read two members of one topic.
# The entries are kept by their topic: of two with the same topic the last one alone counts. The value whose quality is "bad"
# stays available here, since the second entry only looks whether the slave is there.
# dpstack gives each entity one entry for a topic, with a template that judges everything.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
pip="$dir/env/bin/pip --quiet --disable-pip-version-check"
$pip install uv==0.13.8 >/dev/null 2>&1
# the package brings the tests' harness of Home Assistant, and pins it
"$dir/env/bin/uv" pip install --quiet --python "$dir/env/bin/python" \
    pytest-homeassistant-custom-component==0.13.109 paho-mqtt==1.6.1 janus==1.0.0 >/dev/null 2>&1
cat >"$dir/test_it.py" <<'PY'
import json
from unittest import mock

import pytest
from pytest_homeassistant_custom_component.common import async_fire_mqtt_message


def entry(member, available, not_available):
    template = "{{ value_json.%s }}" % member
    return {
        "topic": "tank/level",
        "value_template": template,
        "payload_available": available,
        "payload_not_available": not_available,
    }


CONFIG = {
    "name": "level",
    "unique_id": "level-1",
    "state_topic": "tank/level",
    "value_template": "{{ value_json.value }}",
    "availability_mode": "all",
    "availability": [entry("quality", "good", "bad"), entry("slave", "there", "gone")],
}


@pytest.fixture
def no_file():
    with mock.patch("homeassistant.config.load_yaml_config_file", return_value={}):
        yield


async def test_availability(no_file, hass, mqtt_mock_entry):
    await mqtt_mock_entry()
    async_fire_mqtt_message(hass, "homeassistant/sensor/level/config", json.dumps(CONFIG))
    await hass.async_block_till_done()
    seen = []
    for quality, slave in (("good", "there"), ("bad", "there"), ("good", "gone")):
        sent = {"value": 5, "quality": quality, "slave": slave}
        async_fire_mqtt_message(hass, "tank/level", json.dumps(sent))
        await hass.async_block_till_done()
        seen.append(hass.states.get("sensor.level").state)
        print(f"SEEN quality {quality}, slave {slave}: {seen[-1]}")
    assert seen == ["5", "5", "unavailable"], "the behaviour has changed"
PY
cd "$dir"
if ! timeout 120 "$dir/env/bin/python" -m pytest -q -s -p no:cacheprovider --asyncio-mode=auto test_it.py >out 2>&1; then
    tail -n 20 out >&2
    exit 1
fi
sed -n 's/^.*SEEN //p' out
# output seen:
# quality good, slave there: 5
# quality bad, slave there: 5
# quality good, slave gone: unavailable
