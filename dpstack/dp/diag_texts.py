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

    def unit_diag_helps(self, octets: bytes) -> tuple[str, ...]:
        """What helps, for each of :meth:`unit_diag_texts`; empty where nothing is said."""

    def channel_text(self, error_type: int, module: int | None = None) -> str | None:
        """A maker's own channel error (16..31) of the ``module``, None where the file has no text for it."""

    def channel_help(self, error_type: int, module: int | None = None) -> str | None:
        """What helps against it."""

    def module_name(self, module: int) -> str:
        """The name of a module by its place in the configuration, from 0; empty where there is none."""


def block_texts(diagnosis: Diagnosis, texts: DiagTexts | None = None) -> tuple[str, ...]:
    """One line or more for people for each block with something to say; what nobody can explain stays in hex."""
    return tuple(_lines(diagnosis, texts))


def _lines(diagnosis: Diagnosis, texts: DiagTexts | None) -> Iterator[str]:
    for block in diagnosis.blocks:
        match block:
            case DeviceBlock():
                known = () if texts is None else texts.unit_diag_texts(block.data)
                if texts is not None and known:
                    yield from map(_explained, known, texts.unit_diag_helps(block.data))
                elif any(block.data):
                    yield f"device: {block.data.hex(' ')}"
            case IdentifierBlock():
                if block.modules:
                    modules = (_explained(str(number), _name(texts, number)) for number in block.modules)
                    yield "modules with a diagnosis: " + ", ".join(modules)
            case ChannelBlock(identifier=module, error=error):
                own = None if texts is None else texts.channel_text(error, module)
                remedy = None if texts is None or own is None else texts.channel_help(error, module)
                yield f"{block.place(_name(texts, module))}: {_explained(own or block.cause, remedy)}"
    if diagnosis.ext_rest:
        yield f"not decoded: {diagnosis.ext_rest.hex(' ')}"


def _explained(text: str, more: str | None) -> str:
    return f"{text} ({more})" if more else text


def _name(texts: DiagTexts | None, module: int) -> str:
    return "" if texts is None else texts.module_name(module)
