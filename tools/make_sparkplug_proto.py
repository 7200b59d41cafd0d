"""Compiles dpstack/bridge/mqtt/sparkplug.proto to ``sparkplug_pb2.py`` and ``sparkplug_pb2.pyi`` beside it.

``python -m tools.make_sparkplug_proto``. The compiler is that of grpcio-tools (extra ``check``); a test holds the files
to it.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
SOURCE: Final = ROOT / "dpstack" / "bridge" / "mqtt" / "sparkplug.proto"
MADE: Final = ("sparkplug_pb2.py", "sparkplug_pb2.pyi")


def made() -> dict[str, str]:
    """The compiled files by name. The path of the source inside the project becomes part of them."""
    inside = SOURCE.relative_to(ROOT)
    with tempfile.TemporaryDirectory() as folder:
        # in a process of its own: the compiler leaves state in the one that calls it
        subprocess.run(
            [
                sys.executable,
                "-m",
                "grpc_tools.protoc",
                "--proto_path=.",
                f"--python_out={folder}",
                f"--pyi_out={folder}",
                str(inside),
            ],
            cwd=ROOT,
            check=True,
        )
        return {name: (Path(folder) / inside.parent / name).read_text(encoding="utf-8") for name in MADE}


def main() -> None:
    for name, text in made().items():
        (SOURCE.parent / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
