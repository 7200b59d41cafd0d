"""``make strangers`` installs through apt-get where it may, and names each program that is missing."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tools import strangers

APT = """#!/bin/sh
echo "$@" >> {log}
case "$*" in
*install*) {install} ;;
esac
"""


def _program(folder: Path, name: str, text: str = "#!/bin/sh\n") -> None:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    path.chmod(0o755)


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that is the whole PATH."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(strangers, "_MORE_PATH", ())
    return folder


def test_missing_programs_are_installed_by_the_names_of_their_packages(path: Path, tmp_path: Path) -> None:
    for name in strangers.PROGRAMS.keys() - {"tshark"}:
        _program(path, name)
    log = tmp_path / "log"
    _program(path, "apt-get", APT.format(log=log, install=f"/bin/cp {path}/chromium {path}/tshark"))
    assert strangers.missing_programs() == {"tshark": "tshark"}
    strangers.install_debian(strangers.missing_programs().values())
    assert strangers.missing_programs() == {}
    assert log.read_text(encoding="utf-8") == "install -y -qq --no-install-recommends tshark\n"


def test_a_list_of_packages_that_is_old_is_updated_once(path: Path, tmp_path: Path) -> None:
    log = tmp_path / "log"
    _program(path, "apt-get", APT.format(log=log, install="exit 100"))
    strangers.install_debian(["tshark", "tshark", "chromium"])
    asked = log.read_text(encoding="utf-8").splitlines()
    assert [line.split()[0] for line in asked[:3]] == ["install", "update", "install"]
    # a package that is not there keeps no other away
    assert [line.split()[-2:] for line in asked[3:]] == [
        ["--no-install-recommends", "chromium"],
        ["--no-install-recommends", "tshark"],
    ]
    lines = strangers.missing_lines()
    assert "missing: tshark: install it with: sudo apt-get install tshark" in lines
    assert "missing: capinfos: install it with: sudo apt-get install wireshark-common" in lines


def test_without_rights_nothing_is_tried(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "log"
    _program(path, "apt-get", APT.format(log=log, install="exit 0"))
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    strangers.install_debian(["tshark"])  # no sudo at all
    _program(path, "sudo", "#!/bin/sh\nexit 1\n")  # sudo wants a password
    strangers.install_debian(["tshark"])
    assert not log.exists()
    _program(path, "sudo", '#!/bin/sh\ncase "$*" in\n*install*) ' + f'echo "$@" >> {log} ;;\nesac\n')
    strangers.install_debian(["tshark"])
    assert "apt-get install" in log.read_text(encoding="utf-8")


def test_python_packages_are_those_of_the_extra() -> None:
    modules = strangers.python_packages()
    assert {"pyprofibus", "scapy", "pcapng", "pyarrow", "matplotlib"} <= set(modules.values())
    assert not any(requirement.startswith("dpstack") for requirement in modules)


def test_a_skipped_test_counts_as_failed() -> None:
    xml = """<testsuites><testsuite><testcase classname="a" name="one"/><testcase classname="a" name="two">
      <failure message="x"/></testcase><testcase classname="a" name="three"><skipped/></testcase>
      </testsuite></testsuites>"""
    assert strangers.counted(xml) == (["a::two", "a::three"], 3)
    assert strangers.counted("<none/>") == ([], 0)


def test_the_last_lines_name_what_is_missing_and_the_exit_code_is_1(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(strangers, "missing_python", list)
    results = iter([(0, [], 3), (0, [], 3), (0, [], 3), (1, ["a::two"], 3), (5, [], 0)])
    monkeypatch.setattr(strangers, "run_tests", lambda _arguments, *, kernel: next(results))
    assert strangers.main([]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert "missing: chromium: install it with: sudo apt-get install chromium" in lines
    assert lines[-1] == f"strangers: 3 ran, 0 failed, {len(strangers.PROGRAMS)} missing"
    other = path.parent / "sbin"
    other.mkdir()
    for name in strangers.PROGRAMS:
        _program(other if name == "mosquitto" else path, name)
    assert strangers.main([]) == 1
    monkeypatch.setattr(strangers, "_MORE_PATH", (str(other),))  # the PATH of a user may be without it
    assert strangers.main([]) == 0
    assert strangers.main([]) == 1
    assert capsys.readouterr().out.splitlines()[-2:] == ["failed: a::two", "strangers: 3 ran, 1 failed, 0 missing"]
    assert strangers.main([]) == 1  # no test ran


def test_tests_with_the_kernel_need_qemu_alone(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(strangers, "missing_python", lambda: ["scapy>=2.5"])
    ran: list[tuple[list[str], bool]] = []

    def run_tests(arguments: list[str], *, kernel: bool) -> tuple[int, list[str], int]:
        ran.append((arguments, kernel))
        return 0, [], 3

    monkeypatch.setattr(strangers, "run_tests", run_tests)
    assert strangers.main(["--kernel"]) == 1
    missing = "missing: qemu-system-x86_64: install it with: sudo apt-get install qemu-system-x86"
    assert capsys.readouterr().out.splitlines()[-2:] == [missing, "strangers: 3 ran, 0 failed, 1 missing"]
    _program(path, "qemu-system-x86_64")
    assert strangers.main(["--kernel", "tests/one"]) == 0
    assert ran == [([], True), (["tests/one"], True)]
