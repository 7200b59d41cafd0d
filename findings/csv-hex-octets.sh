#!/bin/sh
# Octets as hex in a CSV column, as data loggers of field buses write them, in pandas 3.0.0, polars 1.36.1, pyarrow 22.0.0
# and DuckDB 1.4.3.
# Guess: bare hex (1e05) is dangerous because it looks like a float, and 0x in front makes every reader keep the text.
# Bare hex becomes a number in three readers and stays text in DuckDB; behind 0x it is the other way round: pandas and polars
# keep the text, pyarrow and DuckDB read a hexadecimal integer, so that 0x0005 and 0x05 become the same 5. Quotes change
# nothing for three of them. A letter that belongs to no number (x1e05) stays text in all four.
# dpstack writes octets of recordings as x1e05.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install \
    pandas==3.0.0 polars==1.36.1 pyarrow==22.0.0 duckdb==1.4.3 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import os
import tempfile

import duckdb
import pandas
import polars
import pyarrow.csv

READERS = {
    "pandas": lambda path: pandas.read_csv(path)["code"].tolist(),
    "polars": lambda path: polars.read_csv(path)["code"].to_list(),
    "pyarrow": lambda path: pyarrow.csv.read_csv(path)["code"].to_pylist(),
    "duckdb": lambda path: [row[0] for row in duckdb.read_csv(path).fetchall()],
}
OCTETS = ("1e05", "0005")
NUMBERS, WHOLE = [100000.0, 5.0], [7685, 5]
EXPECTED = {
    "{}": {"pandas": NUMBERS, "polars": NUMBERS, "pyarrow": NUMBERS, "duckdb": ["1e05", "0005"]},
    '"{}"': {"pandas": NUMBERS, "polars": NUMBERS, "pyarrow": NUMBERS, "duckdb": ["1e05", "0005"]},
    "0x{}": {"pandas": ["0x1e05", "0x0005"], "polars": ["0x1e05", "0x0005"], "pyarrow": WHOLE, "duckdb": WHOLE},
    "x{}": dict.fromkeys(READERS, ["x1e05", "x0005"]),
}
changed = False
for form, expected in EXPECTED.items():
    path = os.path.join(tempfile.mkdtemp(), "log.csv")
    with open(path, "w") as file:
        file.write("code\n" + "".join(form.format(octets) + "\n" for octets in OCTETS))
    for name, read in READERS.items():
        found = read(path)
        print(f"{form.format('1e05'):8} {name:8} {found}")
        changed = changed or found != expected[name]
assert not changed, "the behaviour has changed"
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py"
# output seen:
# 1e05     pandas   [100000.0, 5.0]
# 1e05     polars   [100000.0, 5.0]
# 1e05     pyarrow  [100000.0, 5.0]
# 1e05     duckdb   ['1e05', '0005']
# "1e05"   pandas   [100000.0, 5.0]
# "1e05"   polars   [100000.0, 5.0]
# "1e05"   pyarrow  [100000.0, 5.0]
# "1e05"   duckdb   ['1e05', '0005']
# 0x1e05   pandas   ['0x1e05', '0x0005']
# 0x1e05   polars   ['0x1e05', '0x0005']
# 0x1e05   pyarrow  [7685, 5]
# 0x1e05   duckdb   [7685, 5]
# x1e05    pandas   ['x1e05', 'x0005']
# x1e05    polars   ['x1e05', 'x0005']
# x1e05    pyarrow  ['x1e05', 'x0005']
# x1e05    duckdb   ['x1e05', 'x0005']
