#!/bin/sh
# A folder of Parquet files in partitions hour=10 to hour=23, to which hour=07 is added, read by DuckDB 2.0.1 and pyarrow 26.0.1
# with the types that they infer themselves.
# Guess: an hour is a number for both, with or without a zero before it, and another hour changes no type.
# For pyarrow it is. For DuckDB the column is BIGINT until the zero comes, and VARCHAR from then on: a query that ran yesterday
# (hour + 1) ends with a BinderException today. With hour=7 it stays BIGINT.
# dpstack names the folder hour=7, and its page gives DuckDB the types (hive_types).
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install duckdb==2.0.1 pyarrow==26.0.1 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import pathlib
import sys

import duckdb
import pyarrow
import pyarrow.dataset
import pyarrow.parquet


def add(folder, hour):
    place = folder / f"hour={hour}"
    place.mkdir(parents=True)
    pyarrow.parquet.write_table(pyarrow.table({"row": [1]}), place / "a.parquet")


def types(folder):
    files = f"read_parquet('{folder}/**/*.parquet')"
    duck = duckdb.sql(f"select any_value(typeof(hour)) from {files}").fetchall()[0][0]
    try:
        following = str(duckdb.sql(f"select max(hour + 1) from {files}").fetchall()[0][0])
    except duckdb.Error as error:
        following = type(error).__name__
    arrow = pyarrow.dataset.dataset(folder, format="parquet", partitioning="hive").schema.field("hour").type
    return duck, following, str(arrow)


found = []
for early in ("07", "7"):
    folder = pathlib.Path(sys.argv[1]) / f"with-{early}"
    for hour in (10, 23):
        add(folder, hour)
    before = types(folder)
    add(folder, early)
    found.append((before, types(folder)))
    print(f"DuckDB, max(hour + 1), pyarrow: {before}; with hour={early}: {types(folder)}")
number, text = ("BIGINT", "24", "int32"), ("VARCHAR", "BinderException", "int32")
assert found == [(number, text), (number, number)], "the behaviour has changed"
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py" "$dir"
# output seen:
# DuckDB, max(hour + 1), pyarrow: ('BIGINT', '24', 'int32'); with hour=07: ('VARCHAR', 'BinderException', 'int32')
# DuckDB, max(hour + 1), pyarrow: ('BIGINT', '24', 'int32'); with hour=7: ('BIGINT', '24', 'int32')
