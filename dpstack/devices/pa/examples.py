"""The examples of a PA device's file: octets received and their values, set points and their octets."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Final

from dpstack.devices.model import Example
from dpstack.devices.pa.model import PaFile
from dpstack.devices.pa.profile import profile_of_pa
from dpstack.dp.process_data import Field, field_of
from dpstack.errors import ConfigError
from dpstack.profile.drive_profile import DeviceProfile
from dpstack.units import NS_PER_MS

#: time between two calls of the core
_ROTATION_NS: Final = 10 * NS_PER_MS
_SET: Final = "set"


def pa_mistakes(file: PaFile, example: Example) -> Iterator[str]:
    """The contradictions of an example to ``file``, one text each; none if it holds. Raises DpError, OSError."""
    profile = profile_of_pa(file)
    telegram = profile.telegram(example.telegram)
    for key in ("state", "fault", "warning", "speed", "parameter"):
        if getattr(example, key):
            yield f"a PA device has no {key}; leave it out"
    assert profile.settle is not None
    profile, options, _ = profile.settle(profile, telegram.name, example.options, b"", {})
    fields = _fields(profile, telegram.name)
    inputs = bytes(telegram.inputs) if example.inputs is None else example.inputs
    if len(inputs) != telegram.inputs:
        yield f"inputs has {len(inputs)} octets, {telegram.name} has {telegram.inputs}"
        return
    for name, wanted in example.values.items():
        if name not in fields:
            yield f"no value is called {name!r}; it has {', '.join(fields)}"
            continue
        found = fields[name].get(inputs)
        if isinstance(found, bytes) or not math.isclose(found, wanted, rel_tol=1e-6, abs_tol=1e-6):
            yield f"inputs {inputs.hex(' ').upper()}: {name} is {found!r}, not {wanted!r}"
    for order, octets in example.outputs.items():
        sent = _sent(profile, telegram.name, options, order)
        yield from (
            f"{order}: it sends {sent.hex(' ').upper()}, not {one.hex(' ').upper()}" for one in octets if one != sent
        )


def _fields(profile: DeviceProfile, telegram: str) -> dict[str, Field]:
    assert profile.fields is not None
    length = profile.telegram(telegram).inputs
    return {
        name: field_of(name, str(given["at"] if isinstance(given, Mapping) else given), length, "inputs")
        for name, given in profile.fields(telegram)[0].items()
    }


def _sent(profile: DeviceProfile, telegram: str, options: Mapping[str, object], order: str) -> bytes:
    """The outputs after orders such as ``set valve 50, set valve_rcas_in 20``."""
    core = profile.core("example", telegram, options)
    now = _ROTATION_NS
    core.cyclic(b"", now)
    for one in order.split(","):
        words = one.split()
        try:
            verb, name, value = words
            if verb != _SET:
                raise ValueError
            values = [{"name": name, "value": float(value)}]
        except ValueError:
            raise ConfigError(f"{one.strip()!r}: write set, a name and a number, set valve 50 for instance") from None
        core.command(_SET, {"values": values}, 1, now)
    for event in core.take_events():
        if event.get("type") == "result" and not event.get("ok"):
            raise ConfigError(f"{order}: {event.get('text')}")
    return core.cyclic(b"", now + _ROTATION_NS)
