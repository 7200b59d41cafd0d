"""Finds the bus in a waveform: channel, polarity and rate, by the rule that recognises a rate on a port
(:mod:`dpstack.fdl.baud_search`)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from dpstack.capture.waveforms.characters import Assembler, Sampler
from dpstack.capture.waveforms.levels import Piece, Waveform
from dpstack.errors import CaptureFileError, UsageError
from dpstack.fdl.baud_search import Evidence
from dpstack.params import T_SYN
from dpstack.text import some_of
from dpstack.units import BAUD_RATES, BITS_PER_CHAR, NS_PER_S, NS_PER_US, baud_text, bits_to_ns

#: samples of a bit at least: an edge lies up to one sample beside its place, and the middle of a bit must be hit after
#: eleven bits at clocks that differ by a little (Saleae and sigrok ask for as many)
LEAST_SAMPLES: Final = 4
#: samples of a bit that the messages recommend
_GOOD_SAMPLES: Final = 8
#: changes of a channel in an excerpt that is looked at
_ENOUGH: Final = 20_000
#: octets of all excerpts together
_MOST_OCTETS: Final = 32 << 20
#: excerpts that are looked at before the search is given up
_MOST_EXCERPTS: Final = 8
#: pulses by which a bit is estimated, and the share of them that a glitch may have spoiled
_PULSES: Final = 3000
_SPOILED: Final = 0.1
#: a rate is near the shortest pulses within this factor
_NEAR: Final = 1.6
_RUN: Final = re.compile(rb"0+|1+")


class Line(NamedTuple):
    """The bus in a waveform. ``others``: channels that carry telegrams, too; ``remark``: a doubt about it, for the
    user."""

    channel: int
    inverted: bool
    baud: int
    others: tuple[str, ...] = ()
    remark: str = ""


class _Excerpt:
    """Some of the pieces of one channel; of those in which nothing changes, one after each in which something does."""

    def __init__(self, channel: int) -> None:
        self.channel = channel
        self.pieces: list[Piece] = []
        self.changes = 0
        self._still = True

    def add(self, piece: Piece) -> int:
        """Keep ``piece``; returns the octets that this takes."""
        changes = piece.levels.count(b"01") + piece.levels.count(b"10")
        still, self._still = self._still, not changes
        self.changes += changes
        if still and not changes and self.pieces:
            return 0
        self.pieces.append(piece)
        return len(piece.levels)

    def pulse(self) -> float:
        """The length in samples of the shortest usual pulses: in traffic nearly half of all are one bit long; 0
        without any."""
        lengths: list[int] = []
        for piece in self.pieces:
            spans = [found.span() for found in _RUN.finditer(piece.levels)][1:-1]  # whole ones
            lengths += [end - begin for begin, end in spans]
            if len(lengths) >= _PULSES:
                break
        lengths.sort()
        return lengths[int(len(lengths) * _SPOILED)] if lengths else 0

    def idle_is_low(self) -> bool:
        """Whether the channel is low most of the time."""
        high = sum(piece.levels.count(b"1") for piece in self.pieces)
        return 2 * high < sum(len(piece.levels) for piece in self.pieces)


class _Score(NamedTuple):
    """Octets of telegrams in an excerpt, read with this channel, polarity and rate; the greatest score is the best."""

    octets: int
    upright: bool
    first: int
    baud: int


class _Reading(NamedTuple):
    """Octets of telegrams with one channel, polarity and rate. ``proven``: they prove the rate; ``clean``: too few for
    that, but nothing is against it: the last ones make whole telegrams, and no character is damaged."""

    octets: int
    proven: bool
    clean: bool


def find_line(waveform: Waveform, baud: int = 0, channel: str = "") -> Line:
    """The bus in ``waveform``. ``baud``: its rate, 0: find it; ``channel``: the name or number of its channel, empty:
    find it. Raises CaptureFileError, UsageError for a channel that the file does not have."""
    channels = range(len(waveform.channels)) if not channel else (_number_of(waveform, channel),)
    if baud and waveform.stated and waveform.rate < LEAST_SAMPLES * baud:
        raise _too_slow(waveform, waveform.rate / baud, f"at {baud_text(baud)}")
    last: list[_Excerpt] = []
    for excerpts in _excerpts(waveform, channels):
        last = excerpts or last
        if (line := _best(waveform, excerpts, baud)) is not None:
            return line
    if not last:
        names = some_of([waveform.channels[number] for number in channels], 8)
        raise waveform.wrong(
            f"no level ever changes ({names}); is the receiver's output connected, was the bus running?"
        )
    few = _best(waveform, last, baud, few=True)
    if few is None:
        return _given(waveform, last, baud, bool(channel))
    doubt = "" if baud else f": {baud_text(few.baud)} is likely, but not proven"
    return few._replace(remark=f"few telegrams{doubt}")


def _best(waveform: Waveform, excerpts: Sequence[_Excerpt], baud: int, *, few: bool = False) -> Line | None:
    """The line with the most octets of telegrams, None without any. ``few``: also of telegrams that prove no rate."""
    scores = [score for excerpt in excerpts if (score := _read(waveform, excerpt, baud, few)) is not None]
    if not scores:
        return None
    best = max(scores)
    others = tuple(waveform.channels[-one.first] for one in scores if one is not best)
    return Line(-best.first, not best.upright, best.baud, others)


def _number_of(waveform: Waveform, channel: str) -> int:
    if channel in waveform.channels:
        return waveform.channels.index(channel)
    raise UsageError(f"{waveform.name}: no channel {channel!r}; its channels: {some_of(waveform.channels, 16)}")


def _excerpts(waveform: Waveform, channels: Sequence[int]) -> Iterator[list[_Excerpt]]:
    """Excerpts of the channels in which something changes, one after the other through the file."""
    count = octets = 0
    excerpts = {channel: _Excerpt(channel) for channel in channels}
    failure: CaptureFileError | None = None
    try:
        for piece in waveform.pieces(channels):
            excerpt = excerpts[piece.channel]
            octets += excerpt.add(piece)
            if excerpt.changes >= _ENOUGH or octets >= _MOST_OCTETS:
                yield [one for one in excerpts.values() if one.changes]
                count += 1
                if count == _MOST_EXCERPTS:
                    return
                octets = 0
                excerpts = {channel: _Excerpt(channel) for channel in channels}
    except CaptureFileError as error:
        failure = error
    yield [one for one in excerpts.values() if one.changes]
    if failure is not None:
        raise failure


def _read(waveform: Waveform, excerpt: _Excerpt, baud: int, few: bool) -> _Score | None:
    """The best reading of ``excerpt``, None if it has no telegrams that prove a rate (``few``: that fit one)."""
    pulse = excerpt.pulse()
    possible = (
        [rate for rate in BAUD_RATES if not waveform.stated or LEAST_SAMPLES * rate <= waveform.rate]
        if not baud
        else [baud]
    )
    near = [rate for rate in possible if pulse and 1 / _NEAR < pulse * rate / waveform.rate < _NEAR]
    for rates in (near,) if few else (near, [rate for rate in possible if rate not in near]):
        found = [
            _Score(reading.octets, upright, -excerpt.channel, rate)
            for rate in rates
            for upright in (True, False)
            if (reading := _telegrams(waveform, excerpt, rate, upright)).proven or (few and reading.clean)
        ]
        if found:
            return max(found)
    return None


def _telegrams(waveform: Waveform, excerpt: _Excerpt, baud: int, upright: bool) -> _Reading:
    """The telegrams of ``excerpt`` at ``baud``."""
    sampler = Sampler(waveform.rate, baud, inverted=not upright)
    evidence = Evidence(bits_to_ns(T_SYN + BITS_PER_CHAR, baud))  # times are those of the ends of characters
    assembler = Assembler(baud)
    proven, octets = False, 0
    for _, start, levels in excerpt.pieces:
        characters = sampler.add(start, levels)
        for character in () if proven else characters:
            evidence.wake(character.at_ns)
            evidence.receive(bytes((character.octet,)), character.at_ns)
            if evidence.confidence is not None:
                proven = True
                break
        octets += sum(len(one.octets) for one in assembler.add(characters) if not one.damage)
    octets += sum(len(one.octets) for one in assembler.close() if not one.damage)
    damaged = assembler.parity_errors or assembler.framing_errors
    return _Reading(octets, proven, evidence.nearly_recognised and not evidence.unassigned and not damaged)


def _given(waveform: Waveform, excerpts: list[_Excerpt], baud: int, chosen: bool) -> Line:
    """Nothing was found: the line that the user named with channel and rate, if they are not against all reason."""
    busiest = max(excerpts, key=lambda one: one.changes)
    name, pulse = waveform.channels[busiest.channel], busiest.pulse()
    about = pulse and waveform.rate / pulse
    seen = f"the shortest pulses of {name!r} are {_length(pulse, waveform.rate)} long"
    if baud and (chosen or len(excerpts) == 1):
        fits = pulse and 1 / _NEAR < pulse * baud / waveform.rate < _NEAR
        hint = "" if fits else f"; {seen}: that is about {_about(about)}"
        remark = f"no telegram of PROFIBUS at {baud_text(baud)}{hint}"
        return Line(busiest.channel, busiest.idle_is_low(), baud, remark=remark)
    samples = pulse / waveform.rate * _sampled(waveform)
    if 0 < samples < LEAST_SAMPLES:
        raise _too_slow(waveform, samples, f"in the shortest pulses of {name!r}")
    least = waveform.rate // LEAST_SAMPLES
    slow = f" (rates above {baud_text(least)} need more samples)" if least < BAUD_RATES[-1] and waveform.stated else ""
    raise waveform.wrong(
        f"no telegram of PROFIBUS on {some_of([repr(waveform.channels[one.channel]) for one in excerpts], 8)}{slow}; "
        f"{seen}: about {_about(about)}; to see the characters all the same name --channel and --baud"
    )


def _sampled(waveform: Waveform) -> float:
    """Samples/s of the analyser, as far as the file shows them."""
    return NS_PER_S / waveform.period_ns if waveform.period_ns else waveform.rate


def _too_slow(waveform: Waveform, samples: float, where: str) -> CaptureFileError:
    sampled = _sampled(waveform)
    return waveform.wrong(
        f"{rate_text(sampled)} are {samples_text(samples)} {where}, at least {LEAST_SAMPLES} are needed; "
        f"record with {rate_text(_GOOD_SAMPLES * sampled / samples)} or more"
    )


def rate_text(rate: float) -> str:
    """A rate of samples as people write it: ``24 MS/s``."""
    return f"{rate / 1e6:.4g} MS/s" if rate >= 1e6 else f"{rate / 1e3:.4g} kS/s"


def samples_text(samples: float) -> str:
    """The samples of a bit: ``8.33 samples a bit``."""
    number = f"{samples:.3g}" if samples < 1000 else f"{samples:.0f}"
    return f"{number} sample{'s' * (number != '1')} a bit"


def _length(samples: float, rate: int) -> str:
    return f"{samples * NS_PER_S / rate / NS_PER_US:.3g} us"


def _about(baud: float) -> str:
    near = [rate for rate in BAUD_RATES if 1 / 1.1 < baud / rate < 1.1]
    return baud_text(near[0]) if near else f"{baud_text(round(float(f'{baud:.3g}')))}, no rate of PROFIBUS"
