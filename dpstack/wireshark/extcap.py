"""PROFIBUS ports for Wireshark, the program that Wireshark starts (extcap): lists them and captures from them.

``dpstack wireshark install`` copies this file into a folder of the user, where it stands alone: it imports nothing of
dpstack. Wireshark runs it each time it looks for interfaces, so the list has to be there at once. To capture, it starts
``dpstack capture``, which never sends.

Source: extcap(4) of Wireshark (options, and the lines printed to standard output).
"""

import contextlib
import glob
import importlib.util
import json
import os
import re
import socket
import stat
import struct
import sys
import tempfile
import time
from collections.abc import Iterator
from typing import Any

#: the folder that holds the package dpstack, for an interpreter that does not find it; the installation fills it in
STACK = ""
#: before the name of the port in the name of an interface
PREFIX = "dpstack:"
VERSION = "1.0"
#: link type USER0
_DLT = 147
_RATES = (9600, 19200, 31250, 45450, 93750, 187500, 500000, 1500000, 3000000, 6000000, 12000000)
#: limit of each answer of a program, in s; the list must not wait for one that is stopped
_PATIENCE_S = 0.3
_LONGEST_ANSWER = 1 << 20
#: signs that cannot stand in a line for Wireshark
_BAD = re.compile(r"[^ -z|~]")
#: Linux: struct ucred of a socket's peer
_PEERCRED = getattr(socket, "SO_PEERCRED", None)
#: Linux: a UART of the kernel's table without hardware behind it has type 0
_SYSFS = "/sys/class/tty"


# --- ports ---
def interfaces() -> list[tuple[str, str]]:
    """(port, text) of each program of the user that has a tap, then of each serial port that none of them holds."""
    found = {}
    held = set()
    for program in _programs():
        port = str(program.get("name") or program.get("port"))
        held.add(os.path.realpath(str(program.get("port"))))
        found[port] = f"PROFIBUS: {program.get('kind')} on {port}"
    for port, text in _serial_ports():
        if os.path.realpath(port) not in held:
            found.setdefault(port, text)
    return [(port, _BAD.sub("?", text)) for port, text in found.items() if not _BAD.search(port)]


def _serial_ports() -> Iterator[tuple[str, str]]:
    lasting = {os.path.realpath(link): os.path.basename(link) for link in sorted(glob.glob("/dev/serial/by-id/*"))}
    ports = sorted(glob.glob("/dev/cu.*")) if sys.platform == "darwin" else sorted(_linux_ports())
    for port in ports:
        name = lasting.get(port)
        yield port, f"PROFIBUS: serial port {port}" + (f" ({name})" if name else "")


def _linux_ports() -> Iterator[str]:
    for folder in glob.glob(f"{_SYSFS}/*"):
        port = f"/dev/{os.path.basename(folder)}"
        if os.path.exists(f"{folder}/device") and _text(f"{folder}/type") != "0" and os.path.exists(port):
            yield port


def _text(path: str) -> str:
    try:
        with open(path, encoding="ascii", errors="replace") as file:
            return file.read().strip()
    except OSError:
        return ""


# --- running programs: as dpstack.api.control has it ---
def _programs() -> Iterator[dict[str, Any]]:
    """``help`` of each program of the user; sockets in a folder that others may write to are left alone."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and os.path.isdir(runtime):
        folder = os.path.join(os.path.abspath(runtime), "dpstack")
    elif hasattr(os, "geteuid"):
        folder = os.path.join(tempfile.gettempdir(), f"dpstack-{os.geteuid()}")
    else:
        return
    try:
        info = os.lstat(folder)
        names = sorted(os.listdir(folder))
    except OSError:
        return
    if not stat.S_ISDIR(info.st_mode) or info.st_uid != os.geteuid() or info.st_mode & 0o022:
        return
    for name in names:
        path = os.path.join(folder, name)
        if name.endswith(".sock") and not os.path.islink(path):
            with contextlib.suppress(OSError, ValueError, RecursionError):
                answer = _help(path)
                commands = {one.get("command") for one in answer["commands"]}
                if "tap" in commands:
                    yield answer


def _help(path: str) -> dict[str, Any]:
    """The answer of the program behind a socket. Raises OSError, ValueError if none exists."""
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(_PATIENCE_S)
        connection.connect(path)
        if _PEERCRED is not None:
            peer = struct.unpack("iII", connection.getsockopt(socket.SOL_SOCKET, _PEERCRED, 12))[1]
            if peer not in (os.geteuid(), 0):
                raise ValueError(peer)
        end = time.monotonic() + _PATIENCE_S
        request = {"command": "help", "args": [], "until_ns": int(end * 1e9)}
        connection.sendall(json.dumps(request).encode() + b"\n")
        octets = b""
        while not octets.endswith(b"\n"):
            connection.settimeout(max(end - time.monotonic(), 0.001))
            more = connection.recv(65536)
            octets += more
            if not more or len(octets) > _LONGEST_ANSWER:
                raise ValueError(path)
    result = json.loads(octets).get("result")
    if not isinstance(result, dict) or not isinstance(result.get("commands"), list):
        raise ValueError(path)
    return result


# --- what Wireshark asks ---
def print_interfaces() -> None:
    print(f"extcap {{version={VERSION}}}{{display=PROFIBUS by dpstack}}")
    for port, text in interfaces():
        print(f"interface {{value={PREFIX}{port}}}{{display={text}}}")


def print_link_types() -> None:
    print(f"dlt {{number={_DLT}}}{{name=USER0}}{{display=PROFIBUS}}")


def print_options() -> None:
    tip = "of a serial port; a program that holds the port knows it"
    print(f"arg {{number=0}}{{call=--baud}}{{display=Baud rate}}{{tooltip={tip}}}{{type=selector}}{{default=auto}}")
    print("value {arg=0}{value=auto}{display=found by listening}{default=true}")
    for rate in _RATES:
        print(f"value {{arg=0}}{{value={rate}}}{{display={rate / 1000:g} kbit/s}}{{default=false}}")


def capture(port: str, baud: str, fifo: str) -> int:
    """Run ``dpstack capture`` into ``fifo`` until Wireshark ends the capture, which is no error. Returns the exit code;
    if capture fails, its last line is for Wireshark."""
    import select
    import signal
    import subprocess

    try:
        file = os.open(fifo, os.O_WRONLY)
    except OSError as error:
        return complain(f"{fifo}: {error.strerror or error}")
    environment = dict(os.environ)
    if importlib.util.find_spec("dpstack") is None:
        environment["PYTHONPATH"] = STACK
        if not STACK or not os.path.isdir(os.path.join(STACK, "dpstack")):
            return complain(f"dpstack is not there any more for {sys.executable}: `dpstack wireshark install` again")
    program = ["-P", "-m", "dpstack.cli.main", "capture", "--port", port, "--baud", baud, "--write", "-"]
    child = subprocess.Popen(
        [sys.executable, *program], stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.PIPE, env=environment
    )
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: child.terminate())
    last = b""
    for line in child.stderr or ():
        last = line
    code = child.wait()
    reader = select.poll()
    reader.register(file, select.POLLERR)
    if code <= 0 or reader.poll(0):  # a signal, or Wireshark has closed its end
        return 0
    print(last.decode(errors="replace").rstrip(), file=sys.stderr)
    return code


def complain(text: str) -> int:
    """One line, which Wireshark shows. Returns the exit code of wrong use."""
    print(f"dpstack: {text}", file=sys.stderr)
    return 2


def main(arguments: list[str]) -> int:
    """Answer one call of Wireshark. Returns the exit code."""
    given = _options(arguments)
    port = given.get("--extcap-interface", "").removeprefix(PREFIX)
    if "--extcap-interfaces" in given:
        print_interfaces()
    elif "--extcap-dlts" in given:
        print_link_types()
    elif "--extcap-config" in given:
        print_options()
    elif given.get("--extcap-capture-filter"):
        if "--capture" in given:  # Wireshark waits until somebody opens it
            os.close(os.open(given.get("--fifo", ""), os.O_WRONLY))
        return complain("there are no capture filters for PROFIBUS: leave it empty, use a display filter")
    elif "--capture" in given and given.get("--fifo") and port:
        return capture(port, given.get("--baud") or "auto", given["--fifo"])
    elif "--extcap-interface" not in given:
        return complain("this program is for Wireshark; `dpstack capture` is the one for people")
    return 0


def _options(arguments: list[str]) -> dict[str, str]:
    """``--name``, ``--name value`` and ``--name=value`` by name; those that are not known here are allowed."""
    given = {}
    waiting = iter(arguments)
    with_value = ("--extcap-interface", "--extcap-capture-filter", "--extcap-version", "--fifo", "--baud")
    for one in waiting:
        name, has_value, value = one.partition("=")
        given[name] = value if has_value else next(waiting, "") if name in with_value else ""
    return given


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
