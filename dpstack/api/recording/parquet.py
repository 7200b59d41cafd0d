"""A recording in CSV made into a Parquet file, by a process of its own."""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

from dpstack.errors import UsageError
from dpstack.record.columns import NOTE, TIME, Column, T
from dpstack.record.reader import Recording, pyarrow_with_parquet
from dpstack.text import json_text

#: octets of CSV that become one row group
_BLOCK: Final = 4 << 20


def convert(journal: Path, target: Path) -> str | None:
    """Make ``target`` of the recording ``journal`` and remove that. Waits for the process that does it.

    Returns None, or why it could not be made: ``journal`` is unchanged then, and an existing ``target``, too.
    """
    command = [sys.executable, "-P", "-m", "dpstack.api.recording.parquet", str(journal), str(target)]
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, start_new_session=True)
    except OSError as error:
        return f"cannot be made ({error.strerror or error})"
    if done.returncode:
        lines = done.stderr.strip().splitlines()
        return lines[-1] if lines else f"cannot be made (exit code {done.returncode})"
    return None


def write_parquet(journal: Path, target: Path) -> None:
    """Raises UsageError, OSError, and the exceptions of pyarrow."""
    pyarrow = pyarrow_with_parquet()
    recording = Recording(journal)
    columns = list(recording.columns.values())
    schema = pyarrow.schema(
        [
            (TIME, pyarrow.timestamp("ms", tz="UTC")),
            (T, pyarrow.float64()),
            *((column.name, _type_of(pyarrow, column)) for column in columns),
            (NOTE, pyarrow.string()),
        ],
        metadata={"recording": json_text({"recording": recording.about})},
    )
    part = target.parent / f".{secrets.token_hex(8)}.tmp"
    try:
        with pyarrow.parquet.ParquetWriter(str(part), schema, compression="zstd") as writer:
            for batch in _batches(pyarrow, journal, schema):
                writer.write_batch(batch)
        with part.open("rb") as file:
            os.fsync(file.fileno())
        os.link(part, target)  # never over a file that is there
    finally:
        part.unlink(missing_ok=True)
    journal.unlink()


def _type_of(pyarrow: Any, column: Column) -> Any:
    if column.type == "bool":
        return pyarrow.bool_()
    if column.type != "number":
        return pyarrow.string()
    whole = column.at[:1] in ("u", "i") and isinstance(column.scale, int) and isinstance(column.offset, int)
    return pyarrow.int64() if whole and not column.at.startswith("u64") else pyarrow.float64()


def _batches(pyarrow: Any, journal: Path, schema: Any) -> Any:
    """The rows of ``journal`` in record batches."""
    options = pyarrow.csv
    reader = options.open_csv(
        str(journal),
        read_options=options.ReadOptions(use_threads=False, block_size=_BLOCK, column_names=schema.names, skip_rows=1),
        parse_options=options.ParseOptions(invalid_row_handler=lambda row: "skip"),
        convert_options=options.ConvertOptions(
            column_types=schema, strings_can_be_null=True, quoted_strings_can_be_null=False, null_values=[""]
        ),
    )
    for batch in reader:
        yield pyarrow.RecordBatch.from_arrays(batch.columns, schema=schema)


def main(arguments: list[str]) -> int:
    journal, target = map(Path, arguments)
    try:
        os.nice(10)
        write_parquet(journal, target)
    except FileExistsError:
        print("there is a file of that name", file=sys.stderr)
        return 1
    except (UsageError, OSError, ValueError) as error:
        print(f"cannot be made ({error})", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
