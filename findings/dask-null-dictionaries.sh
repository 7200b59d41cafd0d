#!/bin/sh
# A folder of two Parquet files of pyarrow 26.0.1 with a dictionary-encoded column of texts, which is null in all rows of the one
# file: most hours of a bus have no error. Read by pyarrow itself, by DuckDB 2.0.1, pandas 3.1.1 and Dask 2026.8.0.
# Guess: whoever reads such columns reads both files; the Arrow type dictionary(int32, string) is the thrifty choice for texts that
# repeat.
# All but Dask do. It reads each file as a category of its own, the one without a value as a category of objects, and cannot join
# it with the category of strings of the other: TypeError in compute(), after the types were inferred without a remark. The same column
# declared as a string is read; Parquet keeps it dictionary-encoded all the same.
# dpstack writes its texts dictionary-encoded, without the Arrow type (store_schema=False).
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install \
    'dask[dataframe]==2026.8.0' duckdb==2.0.1 pandas==3.1.1 pyarrow==26.0.1 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import pathlib
import sys

import dask.dataframe
import duckdb
import pandas
import pyarrow
import pyarrow.parquet


def read(of):
    return {
        "pyarrow": lambda: pyarrow.parquet.read_table(of)["error"].to_pylist(),
        "DuckDB": lambda: [row[0] for row in duckdb.sql(f"select error from '{of}/*.parquet'").fetchall()],
        "pandas": lambda: pandas.read_parquet(of)["error"].tolist(),
        "Dask": lambda: dask.dataframe.read_parquet(of)["error"].compute().fillna("").tolist(),
    }


dictionary = pyarrow.dictionary(pyarrow.int32(), pyarrow.string())
found = {}
for kind in (dictionary, pyarrow.string()):
    folder = pathlib.Path(sys.argv[1]) / str(kind)[:6]
    folder.mkdir()
    for name, values in (("hour7", ["wrong check sequence", None]), ("hour8", [None, None])):
        column = pyarrow.array(values, pyarrow.string()).cast(kind)
        pyarrow.parquet.write_table(pyarrow.table({"error": column}), folder / f"{name}.parquet")
    for reader, of in read(str(folder)).items():
        try:
            values = of()
            result = f"{values.count('wrong check sequence')} text in {len(values)} rows"
        except TypeError as error:
            result = f"TypeError: {error}"
        found[reader, str(kind)[:6]] = result
        print(f"{reader}, {str(kind)[:6]}: {result}")
whole = "1 text in 4 rows"
expected = dict.fromkeys(found, whole) | {("Dask", "dictio"): "TypeError: dtype of categories must be the same"}
assert found == expected, "the behaviour has changed"
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py" "$dir"
# output seen:
# pyarrow, dictio: 1 text in 4 rows
# DuckDB, dictio: 1 text in 4 rows
# pandas, dictio: 1 text in 4 rows
# Dask, dictio: TypeError: dtype of categories must be the same
# pyarrow, string: 1 text in 4 rows
# DuckDB, string: 1 text in 4 rows
# pandas, string: 1 text in 4 rows
# Dask, string: 1 text in 4 rows
