#!/bin/sh
# A folder of Parquet files in partitions segment=line-01, segment=line-77 and segment=007, as plants name their lines, read by Dask
# 2026.8.0 (pandas 3.1.1, pyarrow 26.0.1).
# Guess: where one name is no number, all are texts, as pyarrow, pandas, DuckDB 2.0.1 and polars 2.1.0 take them; or it is an error.
# The rows of 007 have no segment at all (NaN), without a word, and groupby() leaves them out: half of the retries is gone. Dask
# reads each file by itself: 007 alone is the number 7 for pyarrow, and 7 is none of the categories line-01, line-77, 007. A folder
# segment=0x10 is lost in the same way; segment=3 stays, because the number 3 is written as its name is.
# With the types of the folders given, nothing is lost; so does dpstack's page on many captures, where a segment is called 007.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install \
    'dask[dataframe]==2026.8.0' duckdb==2.0.1 pandas==3.1.1 polars==2.1.0 pyarrow==26.0.1 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import os
import sys

import dask.dataframe
import duckdb
import pandas
import polars
import pyarrow
import pyarrow.dataset
import pyarrow.parquet

os.chdir(sys.argv[1])
for segment, retries in (("line-01", 1), ("line-77", 2), ("007", 3)):
    os.makedirs(f"archive/segment={segment}")
    pyarrow.parquet.write_table(pyarrow.table({"retries": [retries]}), f"archive/segment={segment}/a.parquet")
files = "archive/**/*.parquet"
typed = {"partitioning": {"flavor": "hive", "schema": pyarrow.schema([("segment", pyarrow.string())])}}


def summed(frame):
    groups = frame.groupby("segment", observed=True)["retries"].sum()
    return {str(name): int(number) for name, number in (groups.compute() if hasattr(groups, "compute") else groups).items()}


found = {
    "pyarrow": summed(pyarrow.dataset.dataset("archive", partitioning="hive").to_table().to_pandas()),
    "pandas": summed(pandas.read_parquet("archive")),
    "duckdb": dict(duckdb.sql(f"SELECT segment, retries FROM read_parquet('{files}', hive_partitioning = true)").fetchall()),
    "polars": dict(polars.scan_parquet(files, hive_partitioning=True).select("segment", "retries").collect().rows()),
    "dask": summed(dask.dataframe.read_parquet("archive")),
    "dask with types": summed(dask.dataframe.read_parquet("archive", dataset=typed)),
}
for reader, sums in found.items():
    print(f"{reader}: {dict(sorted(sums.items()))}")
right = {"line-01": 1, "line-77": 2, "007": 3}
assert found.pop("dask") == {"line-01": 1, "line-77": 2}, "the behaviour has changed"
assert all(sums == right for sums in found.values()), "the behaviour has changed"
names = dask.dataframe.read_parquet("archive").compute()["segment"]
print(f"dask, rows without a segment: {int(names.isna().sum())} of {len(names)}")
assert names.isna().sum() == 1, "the behaviour has changed"
PY
"$dir/env/bin/python" "$dir/try.py" "$dir"
# output seen:
# pyarrow: {'007': 3, 'line-01': 1, 'line-77': 2}
# pandas: {'007': 3, 'line-01': 1, 'line-77': 2}
# duckdb: {'007': 3, 'line-01': 1, 'line-77': 2}
# polars: {'007': 3, 'line-01': 1, 'line-77': 2}
# dask: {'line-01': 1, 'line-77': 2}
# dask with types: {'007': 3, 'line-01': 1, 'line-77': 2}
# dask, rows without a segment: 1 of 3
