"""Session files of sigrok (``.sr``): a zip archive with ``metadata`` and the samples in ``logic-1-1`` ...

Source: libsigrok, session_file.c and output/srzip.c: a sample has ``unitsize`` octets, bit n is the channel ``probe``
n + 1; only channels that were switched on have a name.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import IO, BinaryIO, Final
from zipfile import BadZipFile, ZipFile

from dpstack.capture.waveforms.levels import MOST_CHANNELS, MOST_RATE, PIECE, Piece, Waveform, parse_rate
from dpstack.text import some_of

#: octets of the archive's small files
_MOST_TEXT: Final = 1 << 20
_BITS: Final = tuple(bytes(48 + (octet >> bit & 1) for octet in range(256)) for bit in range(8))
#: methods of compression that sigrok uses: stored, deflated
_METHODS: Final = (0, 8)
#: for a damaged archive, and an encrypted one
_ERRORS: Final = (
    BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    NotImplementedError,
    RuntimeError,
    ValueError,
    OSError,
)


class SessionFile(Waveform):
    """Raises CaptureFileError if it is no session file."""

    def __init__(self, file: BinaryIO, name: str) -> None:
        super().__init__(file, name)
        with self._archive():
            self._zip = ZipFile(file)
        names = set(self._zip.namelist())
        if not {"metadata", "version"} <= names:
            saleae = "; export the channels as CSV" if "meta.json" in names else ""
            raise self.wrong(f"a zip archive, but no session file of sigrok{saleae}")
        version = self._text("version").strip()
        if version not in ("1", "2"):
            raise self.wrong(f"session file of version {version[:20]!r}; versions 1 and 2 are known here")
        self._describe(_device(self._text("metadata")), names)

    def _describe(self, device: dict[str, str], names: set[str]) -> None:
        probes = {int(key[5:]): text for key, text in device.items() if re.fullmatch(r"probe\d{1,4}", key)}
        capture = device.get("capturefile", "")
        if not capture or not probes:
            what = "analog channels only; record a digital channel" if "analog1" in device else "no channels"
            raise self.wrong(f"the session has {what}")
        unit = device.get("unitsize", "1")
        self._unit = int(unit) if re.fullmatch(r"\d{1,3}", unit) else 0
        self.rate = parse_rate(device.get("samplerate", ""))
        if not 0 < self.rate <= MOST_RATE:
            raise self.wrong(f"samplerate {device.get('samplerate', '')!r}: a rate up to 1 GHz is needed")
        self._bits = tuple(sorted(number - 1 for number in probes))
        if self._bits[0] < 0 or not 0 <= self._bits[-1] < 8 * self._unit or len(probes) > MOST_CHANNELS:
            raise self.wrong(f"unitsize {unit!r} does not hold channel {self._bits[-1] + 1}")
        self.channels = tuple(probes[bit + 1] for bit in self._bits)
        if device.get("total analog", "0") != "0":
            self.remarks.append("analog channels are ignored")
        pattern = re.compile(re.escape(capture) + r"(?:-(\d{1,9}))?")
        chunks = sorted((int(found[1] or 0), found[0]) for name in names if (found := pattern.fullmatch(name)))
        self._chunks = [name for _, name in chunks]
        numbers = [number for number, _ in chunks]
        if not chunks:
            raise self.wrong("the session has no samples; record again")
        if numbers != [0] and numbers != list(range(1, len(numbers) + 1)):
            raise self.wrong(f"parts of the samples are missing: there are {some_of(self._chunks)}")

    def pieces(self, channels: Sequence[int]) -> Iterator[Piece]:
        unit, start, rest = self._unit, 0, b""
        places = [(channel, *divmod(self._bits[channel], 8)) for channel in channels]
        for chunk in self._chunks:
            entry = self._entry(chunk)
            while octets := self._read(entry, PIECE * unit):
                samples = rest + octets
                whole = len(samples) // unit
                rest = samples[whole * unit :]
                for channel, place, bit in places:
                    yield Piece(channel, start, samples[place : whole * unit : unit].translate(_BITS[bit]))
                start += whole

    @contextmanager
    def _archive(self) -> Iterator[None]:
        try:
            yield
        except _ERRORS as error:
            why = f" ({error})" if str(error) else ""
            raise self.wrong(f"the zip archive is damaged{why}; copy it again, or save it again with sigrok") from None

    def _entry(self, name: str) -> IO[bytes]:
        with self._archive():
            if self._zip.getinfo(name).compress_type not in _METHODS:
                raise NotImplementedError("unknown compression")
            return self._zip.open(name)

    def _read(self, entry: IO[bytes], size: int) -> bytes:
        with self._archive():
            return entry.read(size)

    def _text(self, name: str) -> str:
        with self._entry(name) as entry:
            return self._read(entry, _MOST_TEXT).decode(errors="replace")


def _device(text: str) -> dict[str, str]:
    """The keys of the first device in ``metadata``."""
    found: dict[str, str] = {}
    inside = False
    for line in text.splitlines():
        if line.startswith("["):
            if found:
                break
            inside = line.startswith("[device ")
        elif inside:
            key, _, value = line.partition("=")
            found[key.strip()] = value.strip()
    return found
