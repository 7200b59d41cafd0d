"""The parser of GSD files, and the uses of a file: plain data, configuration, parameters, diagnosis texts, checks."""

from __future__ import annotations

from typing import Final

from dpstack.api.gsd_info import gsd_dict
from dpstack.errors import GsdError
from dpstack.gsd.check import check
from dpstack.gsd.configuration import Configuration, configuration_like, configure
from dpstack.gsd.model import Device
from dpstack.gsd.module_readings import read_modules
from dpstack.gsd.parser import load_gsd, parse_gsd
from dpstack.text import json_text
from tests.fuzz.frame import Target, assert_plain, parsed, words

_MOST_MODULES: Final = 4


def run(octets: bytes) -> None:
    """The octets are a file."""
    file = parse_gsd(octets, "fuzz.gsd")
    assert (parsed(load_gsd, octets, GsdError) is None) == (file.fatal is not None)
    if file.fatal is None:
        check(file)
        assert_plain(json_text(gsd_dict(file)))
        configured = parsed(lambda _: _configure(file.device), b"", GsdError)
        if configured is not None:
            parsed(lambda _: _use(configured), b"", GsdError)


def _configure(device: Device) -> Configuration:
    names = [module.name for module in device.modules[:_MOST_MODULES]]
    return configure(device, names or None)


def _use(configured: Configuration) -> None:
    """Read the octets of Chk_Cfg and of the user parameters back, and write each parameter as it is."""
    device, config = configured.device, configured.config
    read_modules(device, config, 4)
    configured.texts().unit_diag_texts(b"\x81\xff\x01\x00")
    prm = configured.user_prm()
    octets = prm.octets()
    for field in prm.read(octets)[:_MOST_MODULES]:
        assert prm.find(field.key).at == field.at
        parsed(lambda _, field=field: prm.set(field.key, field.value), b"", GsdError)  # type: ignore[misc]
    assert len(prm.octets()) == len(octets)
    prm.contradictions()
    configuration_like(device, config, (configured.inputs, configured.outputs))


def repair(octets: bytes) -> bytes:
    """Let the file begin as a GSD file does."""
    return octets if octets.startswith(b"#Profibus_DP\n") else b"#Profibus_DP\nIdent_Number=1\n" + octets


TARGET = Target(
    run,
    covers=("dpstack.gsd",),
    max_len=300,
    repair=repair,
    words=(*words("gsd"), b'"', b"\\\n", b";", b"\xfc", b"0x", b"-"),
    slow_s=2.0,
)
