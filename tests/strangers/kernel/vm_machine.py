"""The machine: QEMU with the kernel of Debian, and an initramfs of busybox, udev, this Python and dpstack.

Its time counts instructions (``-icount``), so that the load of this computer changes nothing. The packages (90 MB) are
fetched once with ``apt-get download`` and kept in the user's cache; no right of root is needed for them.
"""

from __future__ import annotations

import compileall
import json
import lzma
import os
import platform
import re
import shutil
import site
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pytest
from vm_archive import Archive

from tests.strangers.stranger_kit import program

HERE: Final = Path(__file__).resolve().parent
ROOT: Final = HERE.parents[2]
CACHE: Final = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "dpstack-kernel"
_APT_S: Final = 300
#: a machine beside other work; it takes two minutes otherwise
_HANGS_S: Final = 1200
#: in the order in which they are loaded
MODULES: Final = (
    "usb-common",
    "usbcore",
    "usbip-core",
    "vhci-hcd",
    "usbserial",
    "ftdi_sio",
    "cp210x",
    "ch341",
    "pl2303",
    "cdc-acm",
)
#: packages of Python that dpstack imports for the commands of the jobs
_PACKAGES: Final = ("construct", "msgspec", "serial", "serial_asyncio", "rich", "typing_extensions.py")
#: parts of Python's library that no job imports: the machine has them to unpack
_NOT_NEEDED: Final = (
    *("test", "tests", "idlelib", "tkinter", "ensurepip", "lib2to3", "site-packages", "turtledemo", "pydoc_data"),
    *("distutils", "sqlite3", "unittest", "xmlrpc", "wsgiref", "dbm", "curses", "venv", "zoneinfo", "pydoc.py"),
    *("turtle.py", "doctest.py", "lib-dynload"),
)
_NO_EXTENSION: Final = re.compile(r"_(tkinter|sqlite3|curses|curses_panel|dbm|gdbm|test\w*|xxtest\w*|codecs_\w+)\.|xx")
_INIT: Final = """#!/bin/sh
export PATH=/bin:/usr/bin HOME=/root TERM=dumb PYTHONPATH=/app:/job PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1
/bin/busybox --install -s /bin
mount -t proc p /proc; mount -t sysfs s /sys; mount -t devtmpfs d /dev
mkdir -p /dev/pts /dev/shm /run/udev /tmp /root; chmod 1777 /tmp
mount -t devpts p /dev/pts; mount -t tmpfs t /dev/shm
ip link set lo up
for m in MODULES; do insmod /mod/$m.ko || echo insmod $m failed; done
/bin/systemd-udevd --daemon 2>/dev/null
printf '{"row": "machine", "up_s": %s, "linux": "%s %s"}\\n' "$(cut -d' ' -f1 /proc/uptime)" "$(uname -r)" \\
  "$(uname -v | sed 's/.*Debian/Debian/')"
cd /tmp; sh /job/start.sh
echo '{"row": "end"}'
poweroff -f
"""


class CannotBootError(Exception):
    """The machine, or its kernel, cannot be had on this computer."""


@dataclass(frozen=True)
class Result:
    """What one boot printed."""

    rows: list[dict[str, Any]]
    text: str

    def of(self, kind: str) -> list[dict[str, Any]]:
        return [row for row in self.rows if row["row"] == kind]

    @property
    def linux(self) -> str:
        return str(self.of("machine")[0]["linux"])


def _run(command: Sequence[str | Path], folder: Path | None = None) -> str:
    done = subprocess.run(
        list(map(str, command)), cwd=folder, capture_output=True, text=True, timeout=_APT_S, check=False
    )
    if done.returncode:
        raise CannotBootError(f"{' '.join(map(str, command))}: {(done.stderr or done.stdout).strip()[-300:]}")
    return done.stdout


def packages() -> Path:
    """The folder with the unpacked packages, from the cache; fetched where it is not there. Raises CannotBootError."""
    kept = CACHE / "packages"
    if (kept / "complete").exists():
        return kept
    if shutil.which("apt-get") is None or shutil.which("dpkg-deb") is None:
        raise CannotBootError("Debian's kernel comes through apt-get and dpkg-deb: take a Debian system")
    if platform.machine() != "x86_64":
        raise CannotBootError("the machine runs this computer's Python: it needs x86-64")
    told = _run(["apt-cache", "depends", "linux-image-amd64"])
    kernel = re.search(r"Depends: (linux-image-\S+)", told)
    if kernel is None:
        raise CannotBootError("apt-cache knows no linux-image-amd64: sudo apt-get update")
    CACHE.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=CACHE) as made:
        folder = Path(made)
        _run(["apt-get", "download", kernel[1], "busybox-static", "udev"], folder)
        for package in folder.glob("*.deb"):
            _run(["dpkg-deb", "-x", package, folder / "root"])
            package.unlink()
        (folder / "complete").write_text(kernel[1] + "\n")
        shutil.rmtree(kept, ignore_errors=True)
        folder.rename(kept)
        folder.mkdir()  # for the end of the context
    return kept


def _libraries(binaries: Iterable[Path]) -> dict[str, Path]:
    """Shared libraries of ``binaries``: the path in the machine, and the file."""
    text = subprocess.run(["ldd", *map(str, binaries)], capture_output=True, text=True, check=False).stdout
    found = re.findall(r"(?:=> )?(/\S+) \(0x", text)
    return {name: Path(os.path.realpath(name)) for name in found}


def _add_libraries(archive: Archive, binaries: Iterable[Path]) -> None:
    """The shared libraries of ``binaries``, without their symbols where ``strip`` is there."""
    for name, path in _libraries(binaries).items():
        if not archive.has(name):
            with tempfile.NamedTemporaryFile() as small:
                stripped = (
                    shutil.which("strip")
                    and not subprocess.run(
                        ["strip", "--strip-unneeded", "-o", small.name, path], stderr=subprocess.DEVNULL, check=False
                    ).returncode
                )
                archive.data(name, (Path(small.name) if stripped else path).read_bytes(), executable=True)


def _base(archive: Archive, root: Path) -> None:
    for folder in ("proc", "sys", "dev", "tmp", "run", "root", "etc", "var/log", "usr/bin"):
        archive.folder(folder)
    archive.character_device("dev/console", 5, 1)
    archive.file(root / "bin/busybox", "bin/busybox")
    archive.link("bin/sh", "busybox")
    for name in MODULES:
        found = [path for path in root.glob(f"**/kernel/**/{name}.ko*") if path.suffix in (".ko", ".xz")]
        if not found:
            raise CannotBootError(f"the kernel has no module {name}")
        octets = found[0].read_bytes()
        archive.data(f"mod/{name}.ko", lzma.decompress(octets) if found[0].suffix == ".xz" else octets)
    udev = root / "bin/udevadm"
    archive.file(udev, "bin/udevadm")
    archive.link("bin/systemd-udevd", "udevadm")
    _add_libraries(archive, [udev])
    for path in sorted((root / "lib/udev").rglob("*")):
        if path.is_file() and not path.is_symlink() and "hwdb" not in path.name:
            archive.file(path, f"lib/udev/{path.relative_to(root / 'lib/udev')}")
    archive.data("etc/passwd", b"root:x:0:0:root:/root:/bin/sh\nuser:x:1000:1000::/tmp:/bin/sh\n")
    archive.data("etc/group", b"root:x:0:\ntty:x:5:\ndialout:x:20:\nuser:x:1000:\n")
    archive.data("bin/getent", b'#!/bin/sh\ngrep "^$2:" /etc/$1\n', executable=True)
    archive.data("init", _INIT.replace("MODULES", " ".join(MODULES)).encode(), executable=True)


def _add_python(archive: Archive, source: Path, name: str, leave_out: Sequence[str] = ()) -> None:
    """``source`` (a file or a package) with its modules compiled, so that the machine need not do it."""
    with tempfile.TemporaryDirectory() as made:
        copy = Path(made) / source.name
        if source.is_dir():
            shutil.copytree(source, copy, ignore=shutil.ignore_patterns("__pycache__", "config-*", *leave_out))
        else:
            shutil.copy(source, copy)
        compileall.compile_dir(made, quiet=2, legacy=True, ddir="")
        for path in sorted(Path(made).rglob("*")):
            if path.is_file() and not (path.suffix == ".py" and path.with_suffix(".pyc").exists()):
                archive.file(path, f"{name}/{path.relative_to(copy) if source.is_dir() else path.name}")


def _python(archive: Archive) -> None:
    interpreter = Path(os.path.realpath(sys.executable))
    library = Path(sysconfig.get_paths()["stdlib"])
    archive.file(interpreter, "usr/bin/python3")
    extensions = [path for path in (library / "lib-dynload").glob("*.so") if not _NO_EXTENSION.match(path.name)]
    at = f"usr/lib/{library.name}"
    _add_python(archive, library, at, _NOT_NEEDED)
    for path in extensions:
        archive.file(path, f"{at}/lib-dynload/{path.name}")
    packages = Path(sysconfig.get_paths()["purelib"])
    for name in _PACKAGES:
        _add_python(archive, packages / name, f"app/{name}" if (packages / name).is_dir() else "app")
    more = [path for name in _PACKAGES for path in (packages / name).rglob("*.so")]
    _add_libraries(archive, [interpreter, *extensions, *more])
    for info in packages.glob("*.dist-info"):
        if re.match(r"(dpstack|construct|msgspec|pyserial|rich)", info.name):
            for file in info.glob("*"):
                if file.is_file():
                    archive.file(file, f"app/{info.name}/{file.name}")


def _kept(name: str, fill: Any) -> Path:
    """The archive ``name`` of the cache; made with ``fill`` where it is not there."""
    path = CACHE / f"{name}.cpio"
    if not path.exists():
        for old in CACHE.glob(f"{name.partition('-')[0]}-*.cpio"):
            old.unlink()
        archive = Archive()
        fill(archive)
        with tempfile.NamedTemporaryFile(dir=CACHE, delete=False) as made:
            archive.write(made)
        os.rename(made.name, path)
    return path


def _tag() -> str:
    """Changes with the interpreter, with the packages that go into the machine, and with this file."""
    import hashlib

    words = [sys.version, site.__file__, Path(__file__).read_text(encoding="utf-8")]
    packages = Path(sysconfig.get_paths()["purelib"])
    words += sorted(info.name for info in packages.glob("*.dist-info"))
    return hashlib.sha256("\n".join(words).encode()).hexdigest()[:12]


def boot(*jobs: str, icount: bool = True) -> Result:
    """Boot the machine and run ``jobs`` (files of this folder, with arguments) in it, one after the other. Fails the
    test where it cannot boot. ``icount`` False: real time, two processors.
    """
    qemu = program("qemu-system-x86_64")
    try:
        root = packages() / "root"
        tag = _tag()
        parts = [_kept(f"base-{tag}", lambda archive: _base(archive, root)), _kept(f"python-{tag}", _python)]
    except CannotBootError as error:
        pytest.fail(f"the machine is missing: {error}", pytrace=False)
    own = Archive()
    for name in ("dpstack", "drives"):
        _add_python(own, ROOT / name, f"app/{name}", ("page",))
    _add_python(own, HERE, "job", [path.name for path in HERE.glob("test_*")])
    _add_python(own, ROOT / "tests/kits/plant_files.py", "job")
    lines = [f'python3 -m {job} || echo \'{{"row": "failed"}}\'\n' for job in jobs]
    own.data("job/start.sh", "".join(lines).encode())
    (kernel,) = root.glob("boot/vmlinuz-*")
    with tempfile.NamedTemporaryFile(dir=CACHE) as initrd:
        for part in parts:
            with part.open("rb") as file:
                shutil.copyfileobj(file, initrd)
        own.write(initrd)
        initrd.flush()
        words = [qemu, "-accel", "tcg", "-cpu", "max", "-m", "768", "-display", "none", "-monitor", "none"]
        words += ["-no-reboot", "-nic", "none", "-kernel", str(kernel), "-initrd", initrd.name]
        words += ["-serial", "stdio", "-serial", "null"]  # the second one is /dev/ttyS1
        words += ["-icount", "shift=0,sleep=off"] if icount else ["-smp", "2"]
        append = "console=ttyS0 quiet panic=-1 nokaslr mitigations=off tsc=reliable loglevel=3"
        try:
            done = subprocess.run(
                [*words, "-append", append],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                timeout=_HANGS_S,
                check=False,
            )
            text = done.stdout.decode("utf-8", "replace")
        except subprocess.TimeoutExpired as error:
            text = (error.stdout or b"").decode("utf-8", "replace")
            pytest.fail(f"the machine did not end within {_HANGS_S} s: {text[-3000:]}", pytrace=False)
    rows = [json.loads(line) for line in text.splitlines() if line.startswith('{"row"')]
    if not rows or rows[-1]["row"] != "end" or any(row["row"] == "failed" for row in rows):
        said = "\n".join(line for line in text.splitlines() if not line.startswith('{"row"'))
        pytest.fail(f"a job failed: {said[-3000:]}", pytrace=False)
    return Result(rows, text)
