#!/bin/sh
# One point for InfluxDB made by its client for JavaScript (@influxdata/influxdb-client 1.35.0) and by the one for Python (influxdb-client
# 1.50.0), and read back by line-protocol-parser 2.0.1. Needs Node 20 with npm.
# Guess: both escape or refuse what a tag cannot hold, and an integer given as a BigInt or as a text of digits is written whole.
# A tag that ends in a backslash (a folder): JavaScript writes the line as it is, where "\," is no end of the tag, so that the whole line
# is invalid; Python puts a blank behind it, and "C:\" is stored as "C: ". intField() goes through a double and parseInt():
# 2^53 + 1 becomes 2^53, also of a BigInt, and "1e3" becomes 1; uintField() of the same client writes 2^53 + 1 and refuses "1e3".
# Counters of telegrams should go by uintField(), or as numbers below 2^53. dpstack writes no line protocol.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install influxdb-client==1.50.0 line-protocol-parser==2.0.1 >/dev/null 2>&1
(cd "$dir" && npm install --silent --no-audit --no-fund --ignore-scripts @influxdata/influxdb-client@1.35.0 >/dev/null 2>&1)
cat >"$dir/try.js" <<'JS'
const { Point } = require("@influxdata/influxdb-client");
const line = (set) => {
  try {
    return set(new Point("plant")).timestamp("").toLineProtocol();
  } catch (error) {
    return "refused";
  }
};
console.log(
  JSON.stringify({
    tag: line((point) => point.tag("folder", "C:\\").tag("unit", "bar").intField("n", 1)),
    int: [9007199254740993n, "9007199254740993", "1e3"].map((n) => line((point) => point.intField("n", n))),
    uint: [9007199254740993n, "9007199254740993", "1e3"].map((n) => line((point) => point.uintField("n", n))),
  }),
);
JS
cat >"$dir/try.py" <<'PY'
import json
import subprocess
import sys

from influxdb_client import Point
from line_protocol_parser import LineFormatError, parse_line


def tags(line):
    try:
        return parse_line(line)["tags"]
    except LineFormatError:
        return "invalid"


js = json.loads(subprocess.run(["node", sys.argv[1]], check=True, capture_output=True).stdout)
python = Point("plant").tag("folder", "C:\\").tag("unit", "bar").field("n", 1).to_line_protocol()
print(f"JavaScript: {js['tag']} -> {tags(js['tag'])}")
print(f"Python: {python} -> {tags(python)}")
print(f"intField: {js['int']}")
print(f"uintField: {js['uint']}")
assert js["tag"] == "plant,folder=C:\\,unit=bar n=1i" and tags(js["tag"]) == "invalid", "the behaviour has changed"
assert tags(python) == {"folder": "C: ", "unit": "bar"}, "the behaviour has changed"
assert js["int"] == ["plant n=9007199254740992i", "plant n=9007199254740992i", "plant n=1i"], "the behaviour has changed"
assert js["uint"] == ["plant n=9007199254740993u", "plant n=9007199254740993u", "refused"], "the behaviour has changed"
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py" "$dir/try.js"
# output seen:
# JavaScript: plant,folder=C:\,unit=bar n=1i -> invalid
# Python: plant,folder=C:\ ,unit=bar n=1i -> {'unit': 'bar', 'folder': 'C: '}
# intField: ['plant n=9007199254740992i', 'plant n=9007199254740992i', 'plant n=1i']
# uintField: ['plant n=9007199254740993u', 'plant n=9007199254740993u', 'refused']
