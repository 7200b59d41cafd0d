"""Home Assistant as a program of its own, with a Python that is new enough for it, driven over its HTTP API.

Its newest releases need a newer Python than Debian stable has. That of Debian's testing suite is unpacked into a folder
with the C library that it needs, and runs from there by its own loader; nothing of it is installed.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path
from typing import Any, Final

from far_ends import eventually, free_port

#: the newest on 2026-11-28
VERSION: Final = "2026.11.0"
#: it would fetch these itself, in these versions: its frontend, without which it starts in its recovery mode, and the
#: needs of its integration of MQTT
_MORE: Final = ("home-assistant-frontend==20261028.4", "paho-mqtt==2.1.0", "aiohasupervisor==0.8.1")
#: resolves for another Python than the one that runs it
_UV: Final = "uv==0.13.8"
_PYTHON: Final = "3.14"
#: the patch release that the release needs at least
_LEAST: Final = "3.14.2"
_SUITE: Final = "forky"
_APT_S: Final = 120.0
_START_S: Final = 60.0
_CLIENT: Final = "http://127.0.0.1/"
_SETTINGS: Final = """
homeassistant:
  name: House
http:
  server_host: 127.0.0.1
  server_port: {port}
api:
logger:
  default: warning
"""


def _run(*words: str | Path, seconds: float = _APT_S, **more: Any) -> str:
    done = subprocess.run(words, check=False, capture_output=True, text=True, timeout=seconds, **more)
    assert done.returncode == 0, f"{words[0]} ended with {done.returncode}: {done.stderr[-2000:]}"
    return str(done.stdout)


def _mirror() -> str:
    """The mirror of Debian that this computer uses."""
    lines = _run("apt-get", "indextargets", "--format", "$(REPO_URI) $(ORIGIN) $(CODENAME)", "Created-By: Packages")
    for uri, origin, suite in (line.rsplit(" ", 2) for line in lines.splitlines()):
        if origin == "Debian" and "-" not in suite:  # neither -updates nor -security
            return uri
    raise AssertionError("no repository of Debian is configured")


def _unpack_python(folder: Path) -> list[str | Path]:
    """The command of a Python of :data:`_SUITE`, unpacked below ``folder``."""
    state = folder / "apt"
    for name in ("lists/partial", "cache/archives/partial"):
        (state / name).mkdir(parents=True)
    (state / "status").touch()
    keys = "/usr/share/keyrings/debian-archive-keyring.gpg"
    (state / "sources.list").write_text(f"deb [signed-by={keys}] {_mirror()} {_SUITE} main\n")
    (state / "apt.conf").write_text(
        f'Dir::Etc::SourceList "{state}/sources.list";\nDir::Etc::SourceParts "/dev/null";\n'
        f'Dir::State::Lists "{state}/lists";\nDir::State::status "{state}/status";\nDir::Cache "{state}/cache";\n'
        'APT::Sandbox::User "root";\nAcquire::Languages "none";\nAPT::Install-Recommends "false";\n'
    )
    alone = os.environ | {"APT_CONFIG": str(state / "apt.conf")}
    _run("apt-get", "update", "-qq", env=alone)
    _run("apt-get", "install", "-y", "-qq", "--download-only", f"python{_PYTHON}", env=alone)
    root = folder / "root"
    for package in sorted((state / "cache" / "archives").glob("*.deb")):
        _run("dpkg", "-x", package, root)
    libraries = next(root.glob("usr/lib/*-linux-gnu"))
    loader = next(libraries.glob("ld-linux*.so.*"))
    python = root / "usr" / "bin" / f"python{_PYTHON}"
    return [loader, "--library-path", libraries, "--argv0", python, python]


def install(folder: Path) -> tuple[list[str | Path], dict[str, str]]:
    """The command of a Python that has Home Assistant, and its environment."""
    python = _unpack_python(folder)
    version = _run(*python, "-c", "import platform; print(platform.python_version())").strip()
    assert tuple(map(int, version.split("."))) >= tuple(map(int, _LEAST.split("."))), version
    alone = ("--quiet", "--disable-pip-version-check", "--no-deps", "--target", folder / "uv")
    _run(sys.executable, "-m", "pip", "install", *alone, _UV)
    uv = folder / "uv" / "bin" / "uv"
    words = ["--python-version", version, "--python-platform", "x86_64-manylinux_2_40", "--quiet"]
    _run(uv, "pip", "install", *words, "--target", folder / "site", f"homeassistant=={VERSION}", *_MORE, seconds=300)
    return python, os.environ | {"PYTHONPATH": str(folder / "site"), "PYTHONDONTWRITEBYTECODE": "1"}


class House:
    """A new Home Assistant whose owner has made a user, and has added MQTT with ``broker_port``."""

    def __init__(self, folder: Path, broker_port: int) -> None:
        self._folder = folder
        self.python, self.environment = install(folder)
        self._port = free_port()
        self._token = ""
        self.log = folder / "homeassistant.log"
        config = folder / "config"
        config.mkdir()
        (config / "configuration.yaml").write_text(_SETTINGS.format(port=self._port))
        self._program: subprocess.Popen[bytes] | None = None
        try:
            self.start()
            self._settle_in(broker_port)
        except BaseException:
            self.end()
            raise

    def _settle_in(self, broker_port: int) -> None:
        user = {"client_id": _CLIENT, "name": "Owner", "username": "owner", "password": "house", "language": "en"}
        code = self.call("onboarding/users", user)["auth_code"]
        asked = urllib.parse.urlencode({"grant_type": "authorization_code", "code": code, "client_id": _CLIENT})
        self._token = self._open("auth/token", asked.encode())["access_token"]
        flow = self.call("config/config_entries/flow", {"handler": "mqtt"})
        # as the page sends it: nothing of the folded part was changed
        folded = {"set_client_cert": False, "set_ca_cert": "off"}
        settings = {"broker": "127.0.0.1", "port": broker_port, "other_settings": folded}
        made = self.call(f"config/config_entries/flow/{flow['flow_id']}", settings)
        assert made["type"] == "create_entry", made

    def start(self) -> None:
        with self.log.open("ab") as log:
            self._program = subprocess.Popen(
                [*self.python, "-m", "homeassistant", "-c", self._folder / "config", "--skip-pip"],
                stdout=log,
                stderr=log,
                env=self.environment,
            )
        eventually(self._answers, "Home Assistant answers", _START_S)

    def _answers(self) -> bool:
        assert self._program is not None
        assert self._program.poll() is None, self.log.read_text(errors="replace")[-3000:]
        try:
            self._open("api/onboarding")
        except OSError:
            return False
        return True

    def reload(self) -> None:
        """MQTT ends and begins again: it has no entities, connects, and sends its birth message."""
        (entry,) = self.call("config/config_entries/entry?domain=mqtt")
        self.call(f"config/config_entries/entry/{entry['entry_id']}/reload", {})

    def end(self) -> None:
        assert self._program is not None
        self._program.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):  # on a busy computer
            self._program.wait(30)
        self._program.kill()
        self._program.wait(30)

    def _open(self, path: str, body: bytes | None = None, kind: str = "application/x-www-form-urlencoded") -> Any:
        heads = {"Content-Type": kind} | ({"Authorization": f"Bearer {self._token}"} if self._token else {})
        request = urllib.request.Request(f"http://127.0.0.1:{self._port}/{path}", body, heads)
        try:
            with urllib.request.urlopen(request, timeout=30) as answer:
                text = answer.read().decode()
        except urllib.error.HTTPError as error:
            raise AssertionError(f"{path}: {error.code} {error.read().decode(errors='replace')}") from None
        return json.loads(text) if answer.headers.get_content_type() == "application/json" else text

    def call(self, path: str, body: object = None) -> Any:
        """The answer of the API."""
        octets = None if body is None else json.dumps(body).encode()
        return self._open(f"api/{path}", octets, "application/json")

    def states(self) -> dict[str, dict[str, Any]]:
        """State and attributes of all entities, by their id."""
        return {one["entity_id"]: one for one in self.call("states")}

    def entities(self) -> dict[str, dict[str, Any]]:
        """Those that the integration of MQTT has made."""
        mine = json.loads(self.template("{{ integration_entities('mqtt') | tojson }}"))
        return {id_: one for id_, one in self.states().items() if id_ in mine}

    def template(self, text: str) -> str:
        return str(self.call("template", {"template": text}))

    def service(self, name: str, entity: str, **data: object) -> None:
        """An action of the owner."""
        self.call(f"services/{name.replace('.', '/')}", {"entity_id": entity, **data})

    def complaints(self) -> list[str]:
        """Lines of its log about MQTT."""
        lines = self.log.read_text(errors="replace").splitlines()
        return [line for line in lines if "mqtt" in line.lower() or "template" in line.lower()]
