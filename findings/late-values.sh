#!/bin/sh
# A column of numbers that is empty in the first rows of a CSV file, or null in those of JSON lines, as in a log of a device
# that is switched on later: polars 1.36.1, DuckDB 1.4.3, pandas 3.0.0 and pyarrow 22.0.0.
# Guess: an empty cell says nothing about the type, so the numbers that come later are numbers, or the reader reports an error.
# polars looks at 100 rows: after that a CSV column is text, the greatest of 9.5 and 10.5 is "9.5" and the mean is None, without
# a word; JSON lines raise ComputeError. DuckDB looks at 20480 rows: then the greatest is "9.5", too, and in JSON lines
# `level > 10` finds no row. pandas and pyarrow read 10.5 in each case.
# (With the column `quality` beside it; without a text column DuckDB gets the JSON lines right.)
# dpstack writes such columns while a slave is off, on purpose: no old number is repeated. Its page on recordings gives the
# readers the type (schema_overrides) or has them look at all rows (sample_size = -1), which this script tries as well.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install \
    polars==1.36.1 duckdb==1.4.3 pandas==3.0.0 pyarrow==22.0.0 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import json
import os
import tempfile

import duckdb
import pandas
import polars
import pyarrow.compute
import pyarrow.csv
import pyarrow.json

os.chdir(tempfile.mkdtemp())
NUMBER = {"level": polars.Float64}
READERS = {
    "polars csv": lambda: polars.read_csv("log.csv")["level"].max(),
    "polars csv mean": lambda: polars.read_csv("log.csv")["level"].mean(),
    "polars csv with a type": lambda: polars.read_csv("log.csv", schema_overrides=NUMBER)["level"].max(),
    "polars jsonl": lambda: polars.read_ndjson("log.jsonl")["level"].max(),
    "polars jsonl with a type": lambda: polars.read_ndjson("log.jsonl", schema_overrides=NUMBER)["level"].max(),
    "duckdb csv": lambda: ask("SELECT max(level) FROM read_csv('log.csv')"),
    "duckdb csv, all rows": lambda: ask("SELECT max(level) FROM read_csv('log.csv', sample_size = -1)"),
    "duckdb jsonl": lambda: ask("SELECT max(level) FROM read_json('log.jsonl')"),
    "duckdb jsonl, rows above 10": lambda: ask("SELECT count(*) FROM read_json('log.jsonl') WHERE level > 10"),
    "duckdb jsonl, all rows": lambda: ask("SELECT max(level) FROM read_json('log.jsonl', sample_size = -1)"),
    "pandas csv": lambda: float(pandas.read_csv("log.csv")["level"].max()),
    "pandas jsonl": lambda: float(pandas.read_json("log.jsonl", lines=True)["level"].max()),
    "pyarrow csv": lambda: pyarrow.compute.max(pyarrow.csv.read_csv("log.csv")["level"]).as_py(),
    "pyarrow jsonl": lambda: pyarrow.compute.max(pyarrow.json.read_json("log.jsonl")["level"]).as_py(),
}
#: results after so many rows without a number; the others are 10.5
UNEXPECTED = {
    50: {"duckdb jsonl, rows above 10": 1, "polars csv mean": 10.0},
    200: {
        "polars csv": "9.5",
        "polars csv mean": None,
        "polars jsonl": "ComputeError",
        "duckdb jsonl, rows above 10": 1,
    },
    30_000: {
        "polars csv": "9.5",
        "polars csv mean": None,
        "polars jsonl": "ComputeError",
        "duckdb csv": "9.5",
        "duckdb jsonl": "9.5",
        "duckdb jsonl, rows above 10": 0,
    },
}


def quality(level):
    return "stale" if level is None else "good"


def ask(query):
    return duckdb.sql(query).fetchall()[0][0]


def result(read):
    try:
        return read()
    except Exception as error:
        return type(error).__name__


changed = False
for empty, unexpected in UNEXPECTED.items():
    levels = [None] * empty + [9.5, 10.5]
    with open("log.csv", "w") as file:
        file.write("t,level,quality\n")
        file.writelines(f"{t},{'' if x is None else x},{quality(x)}\n" for t, x in enumerate(levels))
    with open("log.jsonl", "w") as file:
        rows = ({"t": t, "level": x, "quality": quality(x)} for t, x in enumerate(levels))
        file.writelines(json.dumps(row) + "\n" for row in rows)
    print(f"{empty} rows without a number, then 9.5 and 10.5:")
    for name, read in READERS.items():
        found = result(read)
        print(f"  {name:28} {found!r}")
        changed = changed or found != unexpected.get(name, 10.5)
assert not changed, "the behaviour has changed"
PY
timeout 180 "$dir/env/bin/python" "$dir/try.py"
# output seen after 30000 rows (after 50 all is 10.5; after 200 DuckDB is right):
#   polars csv                   '9.5'
#   polars csv mean              None
#   polars csv with a type       10.5
#   polars jsonl                 'ComputeError'
#   polars jsonl with a type     10.5
#   duckdb csv                   '9.5'
#   duckdb csv, all rows         10.5
#   duckdb jsonl                 '9.5'
#   duckdb jsonl, rows above 10  0
#   duckdb jsonl, all rows       10.5
#   pandas csv                   10.5
#   pandas jsonl                 10.5
#   pyarrow csv                  10.5
#   pyarrow jsonl                10.5
