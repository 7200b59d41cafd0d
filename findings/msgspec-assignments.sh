#!/bin/sh
# Assignments to a field of a msgspec Struct (0.22.0), CPython 3.11 and later.
# Guess: a Struct has slots, so that an assignment costs as much as with any class with __slots__.
# Reading does. An assignment is not specialised by the interpreter, because the metaclass sets its own tp_setattro: it stays
# the general STORE_ATTR and takes about twice as long, while that of a dataclass with slots becomes STORE_ATTR_SLOT.
# Counters that are raised for every telegram are cheaper in a class with slots, or as local numbers that are stored once.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install msgspec==0.22.0 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import dis
import sys
import timeit
from dataclasses import dataclass

import msgspec


class Counters(msgspec.Struct):
    telegrams: int = 0


@dataclass(slots=True)
class Plain:
    telegrams: int = 0


def opcodes(kind):
    counted = kind()

    def count():
        counted.telegrams = 1
        return counted.telegrams

    for _ in range(1000):
        count()
    took = min(timeit.repeat(count, number=100_000, repeat=5)) * 10_000
    names = [each.opname for each in dis.get_instructions(count, adaptive=True) if "_ATTR" in each.opname]
    print(f"{kind.__name__}: {', '.join(names)}; {took:.0f} ns a call", flush=True)
    return names


print(f"Python {sys.version.split()[0]}, msgspec {msgspec.__version__}")
struct, plain = opcodes(Counters), opcodes(Plain)
assert plain == ["STORE_ATTR_SLOT", "LOAD_ATTR_SLOT"], plain
assert struct[1] == "LOAD_ATTR_SLOT" and "SLOT" not in struct[0], struct
PY
"$dir/env/bin/python" "$dir/try.py"
