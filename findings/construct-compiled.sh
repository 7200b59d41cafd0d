#!/bin/sh
# construct 2.10.70: a declaration and its compiled form (`.compile()`, some ten times quicker) on the same octets.
# Guess: the compiled form gives the same values and the same errors, only sooner.
# Index counts in an Array, and is None in the compiled one. Peek behind the end is None, and raises when compiled.
# A RepeatUntil with a function of one's own cannot be compiled (SyntaxError), with `obj_` it can. What is wrong raises
# struct.error, KeyError or IndexError instead of a ConstructError, so that `except ConstructError` misses it; and data that end
# too early are no error at all for Bytes, Prefixed and Padded (not run here).
# dpstack uses construct's declarations as they are, and as the oracle of its own codec; it compiles none of them.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install construct==2.10.70 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import struct
import warnings

from construct import Array, Byte, ConstructError, Enum, Index, Int16ub, Peek, RepeatUntil, Struct, obj_

warnings.simplefilter("ignore")  # "compilation is experimental"


def result(of, data):
    try:
        return of(data)
    except Exception as error:
        return f"raises {type(error).__name__}, a ConstructError: {isinstance(error, ConstructError)}"


slots = Array(3, Struct("slot" / Index, "octet" / Byte))
ahead = Struct("next" / Peek(Int16ub), "octet" / Byte)
state = Enum(Byte, wait_prm=1, wait_cfg=2)
seen = {
    "Index": [[one.slot for one in form.parse(b"abc")] for form in (slots, slots.compile())],
    "Peek": [result(lambda data: form.parse(data).next, b"\x05") for form in (ahead, ahead.compile())],
    "unknown name": [result(form.build, "data_exch") for form in (state, state.compile())],
    "RepeatUntil": [
        result(lambda test: list(RepeatUntil(test, Byte).compile().parse(b"\x05\x00")), test)
        for test in (obj_ == 0, lambda octet, octets, context: octet == 0)
    ],
}
for name, (first, second) in seen.items():
    print(f"{name}: {first} | {second}")
assert seen == {
    "Index": [[0, 1, 2], [None, None, None]],
    "Peek": [None, "raises error, a ConstructError: False"],
    "unknown name": ["raises MappingError, a ConstructError: True", "raises error, a ConstructError: False"],
    "RepeatUntil": [[5, 0], "raises SyntaxError, a ConstructError: False"],
}, "the behaviour has changed"
assert struct.error.__name__ == "error"
PY
"$dir/env/bin/python" "$dir/try.py"
# output seen (declaration | compiled):
# Index: [0, 1, 2] | [None, None, None]
# Peek: None | raises error, a ConstructError: False
# unknown name: raises MappingError, a ConstructError: True | raises error, a ConstructError: False
# RepeatUntil: [5, 0] | raises SyntaxError, a ConstructError: False
