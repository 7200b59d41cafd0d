#!/bin/sh
# `--help` of a program with argparse (Python 3.11 to 3.13) into a pipe whose reader has gone, as `| head` leaves it.
# Guess: the exit code is the same whether Python buffers its output or not (PYTHONUNBUFFERED, as containers set it).
# Buffered, Python writes at its end, remarks "Exception ignored" and ends with 120. Unbuffered, argparse itself meets the
# error, drops it and ends with 0, as if somebody had read the help.
# A program that promises an exit code for lost output has to write its help by its own means.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
cat >"$dir/try.py" <<'PY'
import os
import subprocess
import sys

program = "import argparse; argparse.ArgumentParser(prog='tool').parse_args(['--help'])"
codes = []
for unbuffered in ("", "1"):
    reading, writing = os.pipe()
    os.close(reading)
    env = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
    done = subprocess.run([sys.executable, "-c", program], stdout=writing, stderr=subprocess.PIPE, env=env, check=False)
    os.close(writing)
    print("unbuffered:" if unbuffered else "buffered:", done.returncode, done.stderr.decode().partition(":")[0])
    codes.append(done.returncode)
assert codes == [120, 0], "the behaviour has changed"
PY
python3 "$dir/try.py"
# output seen:
# buffered: 120 Exception ignored in
# unbuffered: 0
