"""Device files, from their octets to both ends of the drive and its examples; each mistake is one plain line."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path
from typing import Final

from dpstack.devices import finding
from dpstack.devices.examples import run_examples
from dpstack.devices.model import DeviceFile, FileFacts
from dpstack.devices.pa.model import PaFile
from dpstack.devices.pa.profile import profile_of_pa
from dpstack.devices.profiles import fields_of, profile_of
from dpstack.devices.reader import DeviceFileError
from dpstack.errors import ConfigError
from dpstack.units import NS_PER_MS
from tests.fuzz.frame import Target, assert_plain, parsed, words


@cache
def _path() -> Path:
    return Path(tempfile.mkdtemp(), "fuzz.toml")


def run(octets: bytes) -> None:
    """The octets are a file."""
    path = _path()
    path.write_bytes(octets)
    try:
        file = finding.read(path)
    except DeviceFileError as error:
        for one in error.errors:
            assert_plain(str(one))
            assert "\n" not in str(one)
            assert one.line is not None
            assert one.todo
        return
    parsed(lambda _: _use(file), b"", ConfigError)


def _use(file: FileFacts) -> None:
    """Both ends of each telegram, as a bus and a simulation have them, then the examples."""
    if isinstance(file, DeviceFile):
        _drive(file)
    elif isinstance(file, PaFile):
        _process_device(file)
    else:
        finding.made(file)
    for result in run_examples(file):
        for error in result.errors:
            assert_plain(str(error))


def _process_device(file: PaFile) -> None:
    profile = profile_of_pa(file)
    for name, spec in profile.telegrams.items():
        core, device = profile.core("fuzz", name), profile.device(name)
        device.enter(spec.config, NS_PER_MS)
        outputs = core.cyclic(b"", NS_PER_MS)
        assert outputs == bytes(spec.outputs)
        assert len(device.exchange(outputs, NS_PER_MS)) == spec.inputs
        found = profile.telegrams_of(spec.config)
        assert found[0].config == spec.config


def _drive(file: DeviceFile) -> None:
    profile = profile_of(file)
    for name, spec in profile.telegrams.items():
        fields_of(file, name)
        core = profile.core("fuzz", name)
        device = profile.simulated(name, {}, {})
        now = NS_PER_MS
        device.enter(spec.config, now)
        device.operate(now)
        inputs = bytes(spec.input_octets)
        core.command("start", {}, 1, now)
        for _ in range(5):
            now += 10 * NS_PER_MS
            inputs = device.exchange(core.cyclic(inputs, now), now)
            assert len(inputs) == spec.input_octets
        core.read_inputs(b"\xff" * spec.input_octets, None)
        assert_plain(core.status().state)
    profile.describe(3)


#: a file that every input begins with, mostly
_BEGIN: Final = b'format=1\nname="fuzz"\nbase="profidrive"\n'


def repair(octets: bytes) -> bytes:
    """Let the file begin as a device file does."""
    return octets if octets.startswith(b"format=1\n") else _BEGIN + octets


TARGET = Target(
    run,
    covers=("dpstack.devices",),
    max_len=400,
    repair=repair,
    words=words("device_file"),
    slow_s=4.0,
)
