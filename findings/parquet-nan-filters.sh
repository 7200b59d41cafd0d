#!/bin/sh
# A column of measured values with a NaN ("no value" of many loggers) in a Parquet file of pyarrow 26.0.1, queried by DuckDB 2.0.1
# straight from the file, and from a table that was filled from the same file.
# Guess: the file and the table give the same rows. NaN is the largest number for DuckDB (its documentation says so), hence it
# is above each limit, the maximum, and found by isnan().
# The table does that. In the file the NaN is there or not, depending on its neighbours: DuckDB skips a row group by its least and
# greatest value, and pyarrow leaves NaN out of them, as the format wants it. Above 2 the NaN is found (2.5 is above 2, so the
# group is read), above 100 it is not; isnan() finds none at all, although the count of rows with isnan() is 1; max() is 2.5 by
# itself and NaN with a FILTER clause that lets all rows through. (DuckDB 1.4.3 finds it by isnan(), and max() is NaN.)
# dpstack writes a null, and no NaN, for a value that is no number.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install duckdb==2.0.1 pyarrow==26.0.1 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import sys

import duckdb
import pyarrow
import pyarrow.parquet

path = sys.argv[1]
pyarrow.parquet.write_table(pyarrow.table({"row": [1, 2, 3], "bar": [1.5, float("nan"), 2.5]}), path)
data = duckdb.connect()
data.execute(f"create table plant as select * from '{path}'")
EXPECTED = {  # of the file, of the table
    "list(row) from {} where bar > 2": ([2, 3], [2, 3]),
    "list(row) from {} where bar > 100": (None, [2]),
    "list(row) from {} where isnan(bar)": (None, [2]),
    "count(*) filter (where isnan(bar)) from {}": (1, 1),
    "max(bar)::varchar from {}": ("2.5", "nan"),
    "(max(bar) filter (where row > 0))::varchar from {}": ("nan", "nan"),
}
found = {}
for query in EXPECTED:
    found[query] = tuple(data.execute("select " + query.format(of)).fetchone()[0] for of in (f"'{path}'", "plant"))
    print(f"{query.format('...')}: file {found[query][0]}, table {found[query][1]}")
assert found == EXPECTED, "the behaviour has changed"
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py" "$dir/plant.parquet"
# output seen:
# list(row) from ... where bar > 2: file [2, 3], table [2, 3]
# list(row) from ... where bar > 100: file None, table [2]
# list(row) from ... where isnan(bar): file None, table [2]
# count(*) filter (where isnan(bar)) from ...: file 1, table 1
# max(bar)::varchar from ...: file 2.5, table nan
# (max(bar) filter (where row > 0))::varchar from ...: file nan, table nan
