"""The blocks of an extended diagnosis in words: the standard's, and those of the device's GSD file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from dpstack.dp.diagnosis import Diagnosis
from dpstack.dp.ext_diagnosis import ChannelBlock, DeviceBlock, IdentifierBlock


class DiagTexts(Protocol):
    """The texts of one kind of device (its GSD file has them). Neither raises, whatever a slave sends."""

    def unit_diag_texts(self, octets: bytes) -> tuple[str, ...]:
        """What the device related block says: ``octets`` without its header, bit 0 of the first octet is bit 0."""

    def channel_text(self, error_type: int) -> str | None:
        """A maker's own channel error (16..31), None where the file has no text for it."""


def block_texts(diagnosis: Diagnosis, texts: DiagTexts | None = None) -> tuple[str, ...]:
    """One line or more for people for each block with something to say; what nobody can explain stays in hex."""
    return tuple(_lines(diagnosis, texts))


def _lines(diagnosis: Diagnosis, texts: DiagTexts | None) -> Iterator[str]:
    for block in diagnosis.blocks:
        match block:
            case DeviceBlock():
                known = texts.unit_diag_texts(block.data) if texts is not None else ()
                if known:
                    yield from known
                elif any(block.data):
                    yield f"device: {block.data.hex(' ')}"
            case IdentifierBlock():
                if block.modules:
                    yield "modules with a diagnosis: " + ", ".join(map(str, block.modules))
            case ChannelBlock():
                own = texts.channel_text(block.error) if texts is not None else None
                yield f"{block.place}: {own or block.cause}"
    if diagnosis.ext_rest:
        yield f"not decoded: {diagnosis.ext_rest.hex(' ')}"
