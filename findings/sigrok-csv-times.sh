#!/bin/sh
# The times of a logic analyser's samples in the CSV of sigrok-cli 0.7.2 (libsigrok 0.5.2), which has to be installed
# (Debian: apt-get install sigrok-cli=0.7.2-1+b1).
# Guess: with "-O csv:time=true" the first column says when a sample was taken, as VCD of the same session does.
# At 24 MHz a sample counts as 41 whole nanoseconds instead of 41 2/3, and the first one has the number 1: after 1 ms the column
# is 16 us behind. If sigrok-cli converts an imported file (-I binary) in one go, all times are 0.
# A reader has to divide such times by 41 to get samples. With zeros there are no times: convert to .sr or to VCD.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
sigrok-cli --version | grep -q 'libsigrok 0\.5\.2' || { echo "this needs libsigrok 0.5.2" >&2; exit 1; }
# 24 000 samples at 24 MHz: 1 ms; the level changes after each 240 samples, which is 10 us
python3 -c 'import sys; sys.stdout.buffer.write((bytes(240) + b"\1" * 240) * 50)' >"$dir/raw.bin"
import="binary:numchannels=1:samplerate=24000000"
sigrok-cli -I "$import" -i "$dir/raw.bin" -O srzip -o "$dir/bus.sr"
sigrok-cli -i "$dir/bus.sr" -O csv:time=true -o "$dir/session.csv"
sigrok-cli -i "$dir/bus.sr" -O vcd -o "$dir/session.vcd"
sigrok-cli -I "$import" -i "$dir/raw.bin" -O csv:time=true -o "$dir/import.csv"
cat >"$dir/try.py" <<'PY'
import re
import sys
from pathlib import Path

folder = Path(sys.argv[1])


def rows(name):
    return [tuple(map(int, row)) for row in re.findall(r"^(\d+),([01])$", (folder / name).read_text(), re.M)]


session, imported = rows("session.csv"), rows("import.csv")
last = max(n for n in range(1, len(session)) if session[n][1] != session[n - 1][1])
ticks = [int(t) for t in re.findall(r"^#(\d+) [01]", (folder / "session.vcd").read_text(), re.M)]
assert "$timescale 100 ps" in (folder / "session.vcd").read_text()
print(f"VCD: the last change is at {ticks[-1] / 10:.0f} ns")
print(f"CSV of the session: the first sample at {session[0][0]} ns, the last change at {session[last][0]} ns")
print(f"CSV of the import: times {sorted({t for t, _ in imported})} in {len(imported)} rows")
assert ticks[-1] / 10 == 990_000, "the behaviour has changed"
assert (session[0][0], session[last][0]) == (41, 41 * (23_760 + 1)), "the behaviour has changed"
assert {t for t, _ in imported} == {0} and len(imported) == 24_000, "the behaviour has changed"
PY
python3 "$dir/try.py" "$dir"
# output seen:
# VCD: the last change is at 990000 ns
# CSV of the session: the first sample at 41 ns, the last change at 974201 ns
# CSV of the import: times [0] in 24000 rows
