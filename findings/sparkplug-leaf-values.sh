#!/bin/sh
# leaf-device 2.2.2, a package that publishes a device's metrics as Sparkplug B payloads: values in, values read back from the octets.
# Guess: a metric of type double carries the number that was set, an int32 any integer of 32 bits, and `seq` goes from 255 to 0
# (Sparkplug 3.0.0, 6.4.19: it "MUST have a value between 0 and 255").
# A double is rounded to three decimals as it is set, if it is 0.001 or more: a leak of 0.00149 bar becomes 0.001, while 0.00099
# stays as it is. A negative int32 raises ValueError, since its two's complement is not formed. `seq` goes on with 256. Properties
# have no type (a receiver that goes by the type finds none).
# dpstack's payloads have the whole double, the two's complement, typed properties, and 0 after 255.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install leaf-device==2.2.2 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
from leaf_device.client import LeafDevice
from leaf_device.proto.sparkplug_b_pb2 import Payload

device = LeafDevice(
    {
        "device_id": "drive7",
        "metrics": [
            {"name": "leak", "data_type": "double", "units": "bar"},
            {"name": "speed", "data_type": "int32", "units": "rpm"},
        ],
    }
)
values = {}
for value in (0.00149, 0.00099, 1234.56789):
    device.set_metric_value("leak", value)
    metric = Payload.FromString(device.get_message()).metrics[0]
    values[value] = metric.double_value
    print(f"double {value}: {metric.double_value}")
assert values == {0.00149: 0.001, 0.00099: 0.00099, 1234.56789: 1234.568}, "the behaviour has changed"

unit = dict(zip(metric.properties.keys, metric.properties.values))["unit"]
print(f"unit {unit.string_value!r}, has a type: {unit.HasField('type')}")
assert unit.string_value == "bar" and not unit.HasField("type"), "the behaviour has changed"

try:
    device.set_metric_value("speed", -5)
    seen = "accepted"
except ValueError as error:
    seen = f"ValueError: {error}"
print(f"int32 -5: {seen}")
assert seen == "ValueError: Value out of range: -5", "the behaviour has changed"

numbers = [Payload.FromString(device.get_message()).seq for _ in range(300)]
print(f"seq: {numbers[numbers.index(255) : numbers.index(255) + 3]}")
assert numbers[numbers.index(255) :][:3] == [255, 256, 257], "the behaviour has changed"
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py"
# output seen:
# double 0.00149: 0.001
# double 0.00099: 0.00099
# double 1234.56789: 1234.568
# unit 'bar', has a type: False
# int32 -5: ValueError: Value out of range: -5
# seq: [255, 256, 257]
