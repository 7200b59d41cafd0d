"""``make strangers``: installs the programs of others that tests need, runs those tests, and says what is missing.

Debian packages come through apt-get, as root or with sudo where it asks for no password; Python packages through pip:
the extra ``strangers`` of pyproject.toml. A test whose program is missing fails. The exit code is 1 where a program is
missing or a test failed.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

ROOT: Final = Path(__file__).resolve().parent.parent
#: programs, and the Debian package of each
PROGRAMS: Final[Mapping[str, str]] = {
    "tshark": "tshark",
    "capinfos": "wireshark-common",
    "editcap": "wireshark-common",
    "mergecap": "wireshark-common",
    "chromium": "chromium",
    "chromedriver": "chromium-driver",
    "sigrok-cli": "sigrok-cli",
    "cc": "gcc",
    "lua5.4": "lua5.4",
    "pdfinfo": "poppler-utils",
    "pdftotext": "poppler-utils",
    "tmux": "tmux",
    "bash": "bash",
    "zsh": "zsh",
    "fish": "fish",
    "systemd-analyze": "systemd",
    "mosquitto": "mosquitto",
    "prometheus": "prometheus",
    "promtool": "prometheus",
    "mosquitto_sub": "mosquitto-clients",
    "mosquitto_pub": "mosquitto-clients",
    "openssl": "openssl",
    "node": "nodejs",
    "npm": "npm",
    "qemu-system-x86_64": "qemu-system-x86",
}
#: Python packages of the extra ``strangers`` whose module has another name
MODULES: Final[Mapping[str, str]] = {"ipython": "IPython", "python-pcapng": "pcapng"}
#: folders of programs that are not in the PATH of every user: mosquitto
_MORE_PATH: Final = ("/usr/sbin", "/sbin")
#: the only one that the tests with the kernel's own drivers need; its kernel they fetch themselves
_KERNEL: Final = "qemu-system-x86_64"
_APT_S: Final = 600
_PIP_S: Final = 300


def missing_programs() -> dict[str, str]:
    """Programs that are not there, with the Debian package of each."""
    return {name: package for name, package in PROGRAMS.items() if shutil.which(name) is None}


def python_packages() -> dict[str, str]:
    """The requirements of the extra ``strangers``, and the module by which each is found. An extra of dpstack among
    them (``dpstack[parquet,plot]``) stands for its own requirements."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras: Mapping[str, Sequence[str]] = project["optional-dependencies"]

    def requirements(extra: str) -> Iterable[str]:
        for requirement in extras[extra]:
            own = re.fullmatch(rf"{project['name']}\[([\w,-]+)\]", requirement)
            if own is None:
                yield requirement
            else:
                for name in own[1].split(","):
                    yield from requirements(name)

    found = {}
    for requirement in requirements("strangers"):
        name = re.split(r"[^\w.-]", requirement)[0]
        found[requirement] = MODULES.get(name, name.replace("-", "_"))
    return found


def missing_python() -> list[str]:
    """The requirements whose module is not there. A folder ``build`` beside the project is no package of this name."""
    importlib.invalidate_caches()
    found = {module: importlib.util.find_spec(module) for module in python_packages().values()}
    return [
        requirement
        for requirement, module in python_packages().items()
        if (spec := found[module]) is None or spec.origin is None
    ]


def apt_get() -> list[str] | None:
    """The command that installs Debian packages; None where there is none, or no right to use it."""
    if shutil.which("apt-get") is None:
        return None
    if os.geteuid() == 0:
        return ["apt-get"]
    if shutil.which("sudo") and _runs(["sudo", "-n", "true"], 10):
        return ["sudo", "-n", "env", "DEBIAN_FRONTEND=noninteractive", "apt-get"]
    return None


def install_debian(packages: Iterable[str]) -> None:
    """Install ``packages`` where that is possible."""
    names = sorted(set(packages))
    command = apt_get()
    if not names or command is None:
        return
    print(f"strangers: installing {', '.join(names)} with apt-get", flush=True)
    install = [*command, "install", "-y", "-qq", "--no-install-recommends", *names]
    if not _runs(install, _APT_S):  # its list of packages may be old, or empty
        _runs([*command, "update", "-qq"], _APT_S)
        if not _runs(install, _APT_S):
            for name in names:  # one that this computer cannot have costs no other
                _runs([*install[: -len(names)], name], _APT_S)


def install_python(requirements: Sequence[str]) -> None:
    """Install ``requirements`` into the environment of this interpreter where that is possible."""
    if requirements:
        print(f"strangers: installing {', '.join(requirements)} with pip", flush=True)
        _runs([sys.executable, "-m", "pip", "install", "-q", "--disable-pip-version-check", *requirements], _PIP_S)


def _runs(command: Sequence[str], seconds: float) -> bool:
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=environment, timeout=seconds, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        print(f"strangers: {command[0]}: {error}", file=sys.stderr)
        return False
    return done.returncode == 0


def missing_lines() -> list[str]:
    """One line for each program or Python package that is missing: its name and how to install it."""
    lines = [
        f"missing: {name}: install it with: sudo apt-get install {package}"
        for name, package in missing_programs().items()
    ]
    lines += [
        f"missing: {requirement}: install it with: {sys.executable} -m pip install '{requirement}'"
        for requirement in missing_python()
    ]
    return lines


def run_tests(arguments: Sequence[str], *, kernel: bool = False) -> tuple[int, list[str], int]:
    """Run the tests with programs of others; ``kernel``: all of those with the kernel's own drivers, and no other.

    Returns pytest's exit code, the tests that failed, how many ran.
    """
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "strangers.xml"
        which = "strangers" if kernel else "strangers and not kernel"
        command = [sys.executable, "-m", "pytest", "-m", which, f"--junitxml={result}"]
        command += arguments or ["tests/strangers/kernel" if kernel else "tests/strangers"]
        code = subprocess.run(command, cwd=ROOT, check=False).returncode
        return (code, *counted(result.read_text(encoding="utf-8") if result.exists() else "<none/>"))


def counted(xml: str) -> tuple[list[str], int]:
    """The tests that failed, and how many ran, of pytest's result in JUnit form. A skipped test counts as failed."""
    cases = list(ElementTree.fromstring(xml).iter("testcase"))
    failed = [
        f"{case.get('classname')}::{case.get('name')}"
        for case in cases
        if any(child.tag in ("failure", "error", "skipped") for child in case)
    ]
    return failed, len(cases)


def main(arguments: Sequence[str]) -> int:
    """``arguments``: of pytest, in place of tests/strangers; ``--kernel`` before them for those with the kernel."""
    kernel = "--kernel" in arguments
    arguments = [one for one in arguments if one != "--kernel"]
    path = os.environ.get("PATH", os.defpath).split(os.pathsep)
    os.environ["PATH"] = os.pathsep.join([*path, *(one for one in _MORE_PATH if one not in path)])
    if kernel:
        install_debian(package for name, package in missing_programs().items() if name == _KERNEL)
    else:
        install_debian(missing_programs().values())
        install_python(missing_python())
    code, failed, ran = run_tests(arguments, kernel=kernel)
    missing = [line for line in missing_lines() if not kernel or f" {_KERNEL}:" in line]
    for name in failed:
        print(f"failed: {name}")
    for line in missing:
        print(line)
    print(f"strangers: {ran} ran, {len(failed)} failed, {len(missing)} missing", flush=True)
    return 1 if code or failed or missing or not ran else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
