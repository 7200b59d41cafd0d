"""A second account on this computer, in processes of its own: it reaches no socket, no memory and no port of ours."""

from __future__ import annotations

import asyncio
import json
import os
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from dpstack.api.control.commands import COMMON
from dpstack.api.control.control_server import ControlServer
from dpstack.drivers.process.shared_image import SIZE, make_memory

#: "nobody" on most systems
MALLORY = 65534
_TRIES = """
import json, os, socket, sys
os.setgroups([]); os.setgid(int(sys.argv[1])); os.setuid(int(sys.argv[1]))
folder, name, pid, memory = sys.argv[2:]
def connect():
    with socket.socket(socket.AF_UNIX) as one:
        one.connect(f"{folder}/{name}")
tries = {
    "list": lambda: os.listdir(folder),
    "connect": connect,
    "unlink": lambda: os.unlink(f"{folder}/{name}"),
    "plant": lambda: os.symlink("/tmp", f"{folder}/other.sock"),
    "descriptors": lambda: os.listdir(f"/proc/{pid}/fd"),
    "memory": lambda: os.open(f"/proc/{pid}/fd/{memory}", os.O_RDWR),
    "environment": lambda: open(f"/proc/{pid}/environ").read(),
    "process memory": lambda: os.open(f"/proc/{pid}/mem", os.O_RDWR),
    "signal": lambda: os.kill(int(pid), 0),
}
done = []
for what, attempt in tries.items():
    try:
        attempt()
        done.append(what)
    except PermissionError:
        pass
print(json.dumps(done))
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="a second account needs root; test_control_trust.py does without")
async def test_another_account_reaches_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    with tempfile.TemporaryDirectory(prefix="dp") as above:
        os.chmod(above, 0o755)
        runtime = Path(above, "run")
        runtime.mkdir(mode=0o711)  # even where the directory above lets everybody through
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
        memory = make_memory()
        try:
            async with ControlServer("sim", "COM9", COMMON, {"status": lambda _: {}}) as server:
                folder = runtime / "dpstack"
                (name,) = (one.name for one in folder.iterdir())
                command = [sys.executable, "-I", "-S", "-c", _TRIES]
                words = [str(MALLORY), str(folder), name, str(os.getpid()), str(memory)]
                tries = await asyncio.create_subprocess_exec(*command, *words, stdout=subprocess.PIPE)
                done, _ = await tries.communicate()
                assert json.loads(done) == []
                assert server.kind == "sim"
                assert sorted(one.name for one in folder.iterdir()) == [name]
        finally:
            os.close(memory)


def test_shared_memory_is_for_its_user_alone() -> None:
    memory = make_memory()
    try:
        info = os.fstat(memory)
        assert (stat.S_IMODE(info.st_mode), info.st_size) == (0o600, SIZE)
        assert not os.get_inheritable(memory)
    finally:
        os.close(memory)
