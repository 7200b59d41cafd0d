#!/bin/sh
# The state of a number of MQTT beyond its "max", in Home Assistant 2024.3.3 (the newest for Python 3.11, which this needs, or
# 3.12). 2026.11.0 does the same.
# Guess: min and max restrict what the owner may set; a value that the device reports is shown, whatever it is.
# A reported value outside is dropped with a line in the log: the number stays available, and shows the value of before.
# dpstack gives a number the whole range of its type, so that no value of the plant can be outside.
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


CONFIG = {
    "name": "level",
    "unique_id": "level-1",
    "state_topic": "tank/level",
    "command_topic": "tank/level/set",
    "min": 0,
    "max": 100,
}


@pytest.fixture
def no_file():
    with mock.patch("homeassistant.config.load_yaml_config_file", return_value={}):
        yield


async def test_range(no_file, hass, mqtt_mock_entry):
    await mqtt_mock_entry()
    async_fire_mqtt_message(hass, "homeassistant/number/level/config", json.dumps(CONFIG))
    await hass.async_block_till_done()
    seen = []
    for level in (50, 150, 60):
        async_fire_mqtt_message(hass, "tank/level", str(level))
        await hass.async_block_till_done()
        seen.append(hass.states.get("number.level").state)
        print(f"SEEN the device reports {level}, the number shows {seen[-1]}")
    assert seen == ["50", "50", "60"], "the behaviour has changed"
PY
cd "$dir"
if ! timeout 120 "$dir/env/bin/python" -m pytest -q -s -p no:cacheprovider --asyncio-mode=auto test_it.py >out 2>&1; then
    tail -n 20 out >&2
    exit 1
fi
sed -n 's/^.*SEEN //p' out
# output seen:
# the device reports 50, the number shows 50
# the device reports 150, the number shows 50
# the device reports 60, the number shows 60
