"""A device file of an encoder as a profile: its scaling by the user parameters, and its named values."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Final, NamedTuple

from dpstack.devices.encoder_core import EncoderCore, counter_of
from dpstack.devices.encoder_device import EncoderDevice
from dpstack.devices.encoder_reader import PARAMETER, PLACE
from dpstack.devices.model import EncoderFile, WordSpec
from dpstack.devices.profiles import facts_of, field_of_word
from dpstack.profile.drive_profile import DeviceProfile, OptionSpec
from dpstack.profile.model.drive_type import Options

_MOST: Final = 1 << 32
_TURN: Final = "counts_per_turn"
_RANGE: Final = "range"
_SCALING: Final = {
    _TURN: OptionSpec(default=0.0, low=0, high=_MOST, text="counts per turn; 0: by the user parameters"),
    _RANGE: OptionSpec(default=0.0, low=0, high=_MOST, text="counts of the whole range; 0: by the user parameters"),
}
_SHOWN: Final = {
    "backwards": OptionSpec(default=False, text="shown in the other direction"),
    "signed": OptionSpec(default=False, text="the upper half of the range is shown as negative"),
}
_SIMULATED: Final = {
    "rpm": OptionSpec(default=0.0, low=-100_000, high=100_000, text="its speed from the beginning"),
    "start": OptionSpec(default=0.0, low=0, high=_MOST, text="its position at the beginning, in counts"),
}


class UserPrm(NamedTuple):
    """The user parameters of a slave: ``octets``, and the values by name if it has a GSD file."""

    octets: bytes = b""
    values: Mapping[str, int] = {}

    def find(self, way: int | str) -> int | None:
        """The number by one of the ways of ``counts_per_turn`` (:class:`dpstack.devices.keys.PositionKeys`)."""
        if isinstance(way, int):
            return way
        if way.startswith(PARAMETER):
            name = way.removeprefix(PARAMETER).strip().lower()
            high, low = (self.values.get(f"{name} ({half})") for half in ("high", "low"))
            return self.values.get(name) if high is None or low is None else high << 16 | low
        place = PLACE.fullmatch(way)
        assert place is not None
        length, at = int(place[1]) // 8, int(place[2])
        own = self.octets[at : at + length]
        return int.from_bytes(own, "big") if len(own) == length else None


def profile_of_encoder(file: EncoderFile) -> DeviceProfile:
    """The encoder that ``file`` describes; :attr:`Profile.settle` adds what its user parameters say."""
    return DeviceProfile(
        **facts_of(file),
        reference_hz=0.0,
        core_factory=partial(EncoderCore, file),
        device_factory=partial(EncoderDevice, file),
        core_options={**_SCALING, **_SHOWN, **file.options},
        device_options={**_SCALING, **_SIMULATED, **file.device_options},
        settle=partial(settle, file),
        alarms=file.alarms,
        warnings=file.warnings,
    )


def settle(
    file: EncoderFile,
    profile: DeviceProfile,
    telegram: str,
    given: Mapping[str, object],
    octets: bytes,
    values: Mapping[str, int],
) -> tuple[DeviceProfile, dict[str, object], tuple[str, ...]]:
    """The profile with its named values, the options with the scaling that the user parameters give, and remarks.

    ``given``: the options of the plant file, which have priority. Raises ConfigError for wrong options.
    """
    options = profile.checked_options(given)
    prm = UserPrm(octets, {name.strip().lower(): value for name, value in values.items()})
    differs = [
        f"{name} = {found}"
        for name, wanted in file.only_if.items()
        if (found := prm.find(PARAMETER + name)) not in (None, wanted)
    ]
    scaling: dict[str, object] = {}
    for key, ways in ((_TURN, file.counts_per_turn), (_RANGE, file.range)):
        found = next((number for way in ways if (number := prm.find(way))), None)
        if not options[key] and found is not None and not differs:
            scaling[key] = float(found)
    options = profile.checked_options({**given, **scaling})
    notes = []
    if not options[_TURN]:
        why = f" ({', '.join(differs)})" if differs else ""
        notes.append(
            f"its user parameters do not say how many counts a turn has{why}: it has a position, and neither turns nor "
            "degrees; give options = { counts_per_turn = ..., range = ... }"
        )
    limit = counter_of(file, telegram, {**options, _RANGE: 0.0}).range
    if (whole := int(float(options[_RANGE]))) > limit:
        notes.append(f"range = {whole} is more than the {limit} counts that its position can have in {telegram}")
    counter = counter_of(file, telegram, options)
    turn = float(options[_TURN])
    inputs = _inputs(file, telegram, options, prm)
    counters = {
        "position": (counter, 0),
        "turns": (counter, 0),
        "degrees": (counter, int(turn) if turn.is_integer() else turn),
    }
    settled = dataclasses.replace(
        profile,
        fields=lambda _: (inputs, {}),
        counters={name: one for name, one in counters.items() if name in inputs},
    )
    return settled, {**given, **scaling}, tuple(notes)


def _inputs(file: EncoderFile, telegram: str, options: Options, prm: UserPrm) -> dict[str, object]:
    """The named values of the inputs as a plant file writes them."""
    found: dict[str, object] = {}
    at = 0
    for name in file.telegrams[telegram].inputs:
        word = None if isinstance(name, int) else file.words[name]
        if word is not None:
            match word.part:
                case "position":
                    found |= _position(word, at, options)
                case "velocity":
                    scale, unit = velocity_of(file, prm)
                    sign = -1 if options["backwards"] and word.signed else 1
                    found["velocity"] = {"at": f"{word.type}@{at}", "scale": sign * scale, "unit": unit}
                case _:
                    found[word.name] = field_of_word(word, at)
            for bit, number in word.bits.items():
                found[f"{word.part or word.name}_{bit}"] = f"bool@{at + word.octets - 1 - number // 8}.{number % 8}"
        at += 2 if word is None else word.octets
    return found


def _position(word: WordSpec, at: int, options: Options) -> dict[str, object]:
    place = f"{'i' if options['signed'] else 'u'}{word.width or 8 * word.octets}@{at}"
    found: dict[str, object] = {"position": place}
    if turn := float(options[_TURN]):
        found["turns"] = {"at": place, "scale": 1 / turn, "unit": "turns"}
        found["degrees"] = {"at": place, "scale": 360 / turn, "unit": "deg"}
    return found


def velocity_of(file: EncoderFile, prm: UserPrm) -> tuple[float, str]:
    """The value of one count of the velocity, and its unit."""
    chosen = prm.find(PARAMETER + file.velocity_by) if file.velocity_by else None
    return file.velocity if chosen is None else file.velocities.get(chosen, file.velocity)
