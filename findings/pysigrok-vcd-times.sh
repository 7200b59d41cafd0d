#!/bin/sh
# A session of sigrok (.sr, a zip archive) of 1 ms at four sample rates, made into VCD by pysigrok 0.4.2 with its plug-in
# pysigrok-format-vcd 0.1.1 (and pyserial 3.5, which it imports and does not ask for).
# Guess: "$timescale" times the numbers of the changes is the time, whatever the rate is, as sigrok-cli does it.
# It writes the numbers of the samples, and the right unit, 100 ns, at 10 MHz only. At each other rate the unit is 1 fs: a level
# of 10 us at 24 MHz lasts 240 fs, and a reader finds bits of a rate of terahertz. At 1 MHz, too.
# The numbers, divided by the sample rate of the session, are seconds; the VCD file does not have that rate. dpstack reads .sr itself.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install \
    pysigrok==0.4.2 pysigrok-format-vcd==0.1.1 pyserial==3.5 >/dev/null 2>&1
cat >"$dir/session.py" <<'PY'
import sys
import zipfile

name, megahertz = sys.argv[1], int(sys.argv[2])
level = bytes(10 * megahertz)  # 10 us
samples = (level + level.replace(b"\0", b"\1")) * 50
about = f"[global]\nsigrok version=0.5.2\n\n[device 1]\ncapturefile=logic-1\ntotal probes=1\nsamplerate={megahertz} MHz\n"
with zipfile.ZipFile(name, "w") as session:
    session.writestr("version", "2")
    session.writestr("metadata", about + "total analog=0\nprobe1=RXD\nunitsize=1\n")
    session.writestr("logic-1-1", samples)
PY
cat >"$dir/try.py" <<'PY'
import re
import sys
from pathlib import Path

megahertz, text = int(sys.argv[2]), Path(sys.argv[1]).read_text()
unit = re.search(r"\$timescale (.*?) \$end", text)[1]
first = int(re.findall(r"^#(\d+)$", text, re.M)[1])
print(f"{megahertz} MHz: timescale {unit}, the level changes at {first} (right: after 10 us)")
assert (unit, first) == ("100 ns" if megahertz == 10 else "1 fs", 10 * megahertz), "the behaviour has changed"
PY
for rate in 1 10 12 24; do
    "$dir/env/bin/python" "$dir/session.py" "$dir/bus.sr" "$rate"
    "$dir/env/bin/pysigrok-cli" -i "$dir/bus.sr" -O vcd -o "$dir/bus.vcd"
    "$dir/env/bin/python" "$dir/try.py" "$dir/bus.vcd" "$rate"
done
# output seen:
# 1 MHz: timescale 1 fs, the level changes at 10 (right: after 10 us)
# 10 MHz: timescale 100 ns, the level changes at 100 (right: after 10 us)
# 12 MHz: timescale 1 fs, the level changes at 120 (right: after 10 us)
# 24 MHz: timescale 1 fs, the level changes at 240 (right: after 10 us)
