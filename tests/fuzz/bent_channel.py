"""One end of the channel to a bus process, for targets that lie at the other: framed messages and the shared memory."""

from __future__ import annotations

import os
import struct
import zlib
from typing import Any, Final

import msgspec

from dpstack.drivers.process.shared_image import SIZE
from tests.fuzz.bent_json import text_of
from tests.fuzz.frame import Cutter

#: the head of a message
LENGTH: Final = struct.Struct(">I")


def framed(message: Any) -> bytes:
    """``message`` as JSON behind its length."""
    octets = text_of(message).encode()
    return LENGTH.pack(len(octets)) + octets


def make_memory() -> int:
    """Memory as the driver makes it, but its pages come when they are used: it is made for every input."""
    fd = os.memfd_create("fuzz", os.MFD_CLOEXEC)
    os.ftruncate(fd, SIZE)
    return fd


def write_entry(area: Any, value: Any, head: int, script: Cutter) -> None:
    """Write the next entry of ``area`` past its checks, with the right check sum.

    It is ``value`` in MessagePack where bit 2 of ``head`` is set, else octets of the input; its length is right where
    bit 3 is set. Nothing is written where MessagePack has no such value.
    """
    try:
        octets = msgspec.msgpack.encode(_keyed(value)) if head & 4 else script.take(script.octet())
    except (TypeError, ValueError, OverflowError, UnicodeError):
        return
    number = area._words[0] + 1
    place = number % 4
    area._words[1 + 2 * place] = len(octets) if head & 8 else script.word() << 4
    area._words[2 + 2 * place] = zlib.crc32(octets, number & 0xFFFF_FFFF)
    at = area._at + place * area._limit
    area._memory[at : at + len(octets)] = octets
    area._words[0] = number


def _keyed(value: Any) -> Any:
    """Keys of digits as numbers, which MessagePack has; texts stand for octets."""
    if isinstance(value, dict):
        return {
            int(key) if isinstance(key, str) and key.isascii() and key.isdigit() else key: _keyed(one)
            for key, one in value.items()
        }
    if isinstance(value, list):
        return [_keyed(one) for one in value]
    return value.encode() if value == "x" else value
