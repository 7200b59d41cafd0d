#!/bin/sh
# A Sparkplug B payload with an Int32 of -5 and an Int64 of -5, read by four Python packages: tahutils 0.1.11, mqtt-spb-wrapper
# 2.1.2, esio-spb-builder 0.1.0 and pysparkplug 0.6.1.
# Guess: whoever knows the data type gives -5. The fields of the payload are unsigned (uint32, uint64), so that signed types stand
# in them as two's complement: tahutils itself writes them so.
# mqtt-spb-wrapper and pysparkplug give -5. tahutils and esio-spb-builder hand on the unsigned field, 4294967291 and
# 18446744073709551611, though the data type stands beside it (both return it with the value). A torque or a current of the other
# direction becomes a huge number, in tahutils also on the way from its own writer to its own reader.
# dpstack writes two's complement, and reads commands by their type.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
for package in tahutils==0.1.11 mqtt-spb-wrapper==2.1.2 esio-spb-builder==0.1.0 pysparkplug==0.6.1; do
    python3 -m venv "$dir/${package%%=*}"
    "$dir/${package%%=*}/bin/pip" --quiet --disable-pip-version-check install "$package" >/dev/null 2>&1
done
cat >"$dir/try.py" <<'PY'
import sys


def varint(number):
    octets = bytearray()
    while number > 0x7F:
        octets.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes((*octets, number))


def field(number, content):  # a number, or octets with their length
    if isinstance(content, int):
        return varint(number << 3) + varint(content)
    return varint(number << 3 | 2) + varint(len(content)) + content


def metric(name, datatype, value_field, value):
    return field(2, field(1, name) + field(3, 1_700_000_000_000) + field(4, datatype) + field(value_field, value))


metrics = metric(b"torque", 3, 10, 2**32 - 5) + metric(b"position", 4, 11, 2**64 - 5)  # Int32, Int64
payload = field(1, 1_700_000_000_000) + metrics + field(3, 1)


def tahutils():
    from tahutils import parse

    return {one.name: one.value for one in parse.parse_payload_to_metric_list(parse.payload_from_string(payload))}


def mqtt_spb_wrapper():
    from mqtt_spb_wrapper import SpbPayloadParser

    return {one["name"]: one["value"] for one in SpbPayloadParser(payload).payload["metrics"]}


def esio_spb_builder():
    from esio_spb_builder.packets.builders import PacketDecoder

    return {one["name"]: one["value"] for one in PacketDecoder.decode(payload)["metrics"]}


def pysparkplug():
    from pysparkplug import NData

    return {one.name: one.value for one in NData.decode(payload).metrics}


seen = globals()[sys.argv[1].replace("-", "_")]()
print(f"{sys.argv[1]}: {seen}")
is_right = sys.argv[1] in ("mqtt-spb-wrapper", "pysparkplug")
expected = (-5, -5) if is_right else (4294967291, 18446744073709551611)
assert (seen["torque"], seen["position"]) == expected, "the behaviour has changed"
PY
for package in tahutils mqtt-spb-wrapper esio-spb-builder pysparkplug; do
    "$dir/$package/bin/python" "$dir/try.py" "$package"
done
# output seen:
# tahutils: {'torque': 4294967291, 'position': 18446744073709551611}
# mqtt-spb-wrapper: {'torque': -5, 'position': -5}
# esio-spb-builder: {'torque': 4294967291, 'position': 18446744073709551611}
# pysparkplug: {'torque': -5, 'position': -5}
