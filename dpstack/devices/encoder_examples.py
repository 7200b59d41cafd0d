"""The examples of an encoder's device file: octets received and their values, orders and the octets that they send."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Final

from dpstack.devices.encoder import profile_of_encoder
from dpstack.devices.model import EncoderFile, Example
from dpstack.dp.counter import counted
from dpstack.dp.process_data import Field, field_of, with_scale
from dpstack.errors import ConfigError
from dpstack.gsd.configuration import configure
from dpstack.gsd.parser import load_gsd
from dpstack.profile.drive_profile import DeviceProfile
from dpstack.units import NS_PER_MS

#: time between two calls of the core, and calls after which an order has sent its octets
_ROTATION_NS: Final = 10 * NS_PER_MS
_CALLS: Final = 10


def encoder_mistakes(file: EncoderFile, example: Example) -> Iterator[str]:
    """The contradictions of an example to ``file``, one text each; none if it holds. Raises DpError, OSError."""
    profile, telegram, options = _settled(file, example)
    for key in ("state", "fault", "warning", "speed", "parameter"):
        if getattr(example, key):
            yield f"an encoder has no {key}; leave it out"
    fields = _fields(profile, telegram)
    length = file.telegrams[telegram].spec.input_octets
    inputs = bytes(length) if example.inputs is None else example.inputs
    if len(inputs) != length:
        yield f"inputs has {len(inputs)} octets, telegram {telegram} has {length}"
        return
    for name, wanted in example.values.items():
        if name not in fields:
            yield f"no value is called {name!r}; it has {', '.join(fields)}"
            continue
        found = fields[name].get(inputs)
        if isinstance(found, bytes) or not math.isclose(found, wanted, abs_tol=1e-6):
            yield f"inputs {inputs.hex(' ').upper()}: {name} is {found!r}, not {wanted!r}"
    for order, octets in example.outputs.items():
        sent = _sent(profile, telegram, options, order, bytes(length))
        said = ", ".join(one.hex(" ").upper() for one in sent)
        yield from (f"{order}: it sends {said}, not {one.hex(' ').upper()}" for one in octets if one not in sent)


def _settled(file: EncoderFile, example: Example) -> tuple[DeviceProfile, str, Mapping[str, object]]:
    profile = profile_of_encoder(file)
    telegram = profile.telegram(example.telegram).name
    octets, values = file.bus.user_prm, {}
    if file.gsd is not None:
        device = load_gsd(file.gsd.read_bytes(), file.gsd.name).device
        prm = configure(device, file.telegrams[telegram].modules).user_prm()
        octets, values = prm.octets(), {field.parameter.name: field.value for field in prm.fields}
    assert profile.settle is not None
    profile, options, _ = profile.settle(profile, telegram, example.options, octets, values)
    return profile, telegram, options


def _fields(profile: DeviceProfile, telegram: str) -> dict[str, Field]:
    assert profile.fields is not None
    found = {}
    length = profile.telegram(telegram).input_octets
    for name, given in profile.fields(telegram)[0].items():
        keys: dict[str, float | str] = {**given} if isinstance(given, Mapping) else {"at": str(given)}
        one = with_scale(field_of(name, str(keys.pop("at")), length, "inputs"), keys)
        found[name] = counted(one, *profile.counters[name]) if name in profile.counters else one
    return found


def _sent(
    profile: DeviceProfile, telegram: str, options: Mapping[str, object], order: str, inputs: bytes
) -> list[bytes]:
    """The different outputs during an order such as ``preset 1000``."""
    core = profile.core("example", telegram, options)
    op, _, value = order.partition(" ")
    try:
        args = {"value": int(value)} if value else {}
    except ValueError:
        raise ConfigError(f"{order!r}: write an order and a number, preset 1000 for instance") from None
    now = _ROTATION_NS
    core.cyclic(inputs, now)
    core.command(op, args, 1, now)
    sent = []
    for _ in range(_CALLS):
        now += _ROTATION_NS
        sent.append(core.cyclic(inputs, now))
    for event in core.take_events():
        if event.get("type") == "result" and not event.get("ok") and event.get("error") == "usage":
            raise ConfigError(f"{order}: {event.get('text')}")
    return list(dict.fromkeys(sent))
