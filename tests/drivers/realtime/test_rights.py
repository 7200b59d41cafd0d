"""Real-time rights: taken where permitted, else a line that says what is missing. In processes of their own."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from dpstack.drivers.realtime import rights
from dpstack.drivers.realtime.rights import MEMORY, PRIORITY, Rights, become_real_time

SCRIPT = """
import ctypes, json, os, platform, resource, struct, sys
from dpstack.drivers.realtime import rights
as_nobody, priority = int(sys.argv[1]), int(sys.argv[2])
if priority >= 0:
    resource.setrlimit(resource.RLIMIT_RTPRIO, (priority, priority))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (8 << 20, 8 << 20))
if as_nobody and os.geteuid() == 0:
    os.setuid(65534)
notices = rights.become_real_time()
child = os.fork()
if not child:
    os._exit(os.sched_getscheduler(0))
status = open("/proc/self/status").read()
number = {"x86_64": 315, "aarch64": 275, "riscv64": 275}.get(platform.machine())  # sched_getattr(2)
of_process = ctypes.create_string_buffer(48)
if number is None or ctypes.CDLL(None).syscall(number, 0, of_process, 48, 0):
    slice_ns = 0
else:  # sched_runtime: since Linux 6.12 the slice of an ordinary process, before that 0
    (slice_ns,) = struct.unpack_from("Q", of_process, 24)
print(json.dumps({
    "notices": notices,
    "fifo": os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO,
    "priority": os.sched_getparam(0).sched_priority,
    "locked": "VmLck:\\t       0 kB" not in status,
    "slice_ns": slice_ns,
    "slack": ctypes.CDLL(None).prctl(30, 0, 0, 0, 0),
    "of_child": os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]),
}))
"""


def ask(as_nobody: bool, priority: int) -> dict[str, Any]:
    root = Path(__file__).parents[3]
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(int(as_nobody)), str(priority)],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=True,
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_without_rights_each_refusal_names_a_remedy() -> None:
    found = ask(as_nobody=True, priority=0)
    notices = found["notices"]
    assert [notice.split(":")[0] for notice in notices] == [
        "no real-time priority is allowed (RLIMIT_RTPRIO 0)",
        "only 8192 KiB may be locked in memory (RLIMIT_MEMLOCK)",
    ]
    for notice in notices:
        assert "`dpstack doctor --fix`" in notice
        assert "--cap-add SYS_NICE" in notice
    assert not found["fifo"]
    assert not found["locked"]


def test_without_rights_too_an_ordinary_process_has_the_shortest_slice() -> None:
    """A kernel before 6.12 knows no slices of processes and tells 0."""
    assert ask(as_nobody=True, priority=0)["slice_ns"] in {0, 100_000}


def test_a_priority_within_the_limit_is_taken() -> None:
    hard = resource.getrlimit(resource.RLIMIT_RTPRIO)[1]
    most = 10 if hard == resource.RLIM_INFINITY else min(10, hard)  # nobody may go beyond the hard one
    found = ask(as_nobody=True, priority=most)
    assert found["fifo"] == bool(most)
    assert found["priority"] == most


def test_each_right_is_taken_or_its_refusal_reported() -> None:
    found = ask(as_nobody=False, priority=-1)
    notices = " ".join(found["notices"])
    assert found["fifo"] or "real-time priority" in notices
    assert found["locked"] or "memory" in notices
    assert found["fifo"] or found["slack"] == 1
    assert found["of_child"] == os.SCHED_OTHER  # it is not handed down


@pytest.mark.parametrize(
    ("rights", "priority", "memory"),
    [
        (Rights(False, 0, 0), True, True),
        (Rights(False, 1, MEMORY), False, False),
        (Rights(False, None, None), False, False),
        (Rights(False, 99, MEMORY - 1), False, True),
        (Rights(True, 0, 0), False, False),
    ],
)
def test_rights(rights: Rights, priority: bool, memory: bool) -> None:
    assert bool(rights.no_priority()) == priority
    assert bool(rights.no_memory()) == memory


def test_a_container_may_have_taken_roots_rights_away(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    status = tmp_path / "status"
    monkeypatch.setattr(rights, "_STATUS", status)
    for capabilities, privileged in (
        ("000001ffffffffff", True),
        ("00000000a80425fb", False),
        ("0000000000804000", True),
    ):
        status.write_text(f"Name:\tpython\nCapEff:\t{capabilities}\n")
        assert rights.is_privileged() is privileged
    status.unlink()
    assert rights.is_privileged() is (os.geteuid() == 0)


@pytest.mark.parametrize(("limit", "taken"), [(10, 10), (99, PRIORITY), (None, PRIORITY)])
def test_no_more_priority_than_the_limit_allows(monkeypatch: pytest.MonkeyPatch, limit: int | None, taken: int) -> None:
    asked: list[int] = []
    monkeypatch.setattr(rights, "rights", lambda: Rights(False, limit, None))
    monkeypatch.setattr(os, "sched_setscheduler", lambda _pid, _policy, param: asked.append(param.sched_priority))
    assert rights.set_priority() == ""
    assert asked == [taken]


def test_refusals_of_the_system_in_spite_of_the_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_args: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(rights, "rights", lambda: Rights(False, 50, None))
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    notice = rights.set_priority()
    assert f"SCHED_FIFO {PRIORITY} is refused (Operation not permitted) although the limits allow it" in notice


def test_in_front_of_a_pty_it_is_preferred_and_stays_an_ordinary_process(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int, int]] = []
    monkeypatch.setattr(os, "setpriority", lambda *given: asked.append(given))
    monkeypatch.setattr(rights, "set_priority", lambda: "not to be asked for")
    monkeypatch.setattr(rights, "lock_memory", lambda: "")
    monkeypatch.setattr(rights, "exact_timers", lambda: "")
    sliced: list[bool] = []
    monkeypatch.setattr(rights, "shorten_slice", lambda: sliced.append(True))
    assert become_real_time(pty=True) == []
    assert asked == [(os.PRIO_PROCESS, 0, -20)]
    assert sliced == [True]
    monkeypatch.setattr(rights, "is_real_time", lambda: True)
    assert become_real_time(pty=True) == []
    assert sliced == [True]  # a real-time process has no slice, and would become an ordinary one

    def refuse(*_args: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "setpriority", refuse)
    (notice,) = become_real_time(pty=True)
    assert "no niceness of -20 ([Errno 13] Permission denied)" in notice
    assert "`dpstack doctor --fix`" in notice
