"""Texts for the blocks of an extended diagnosis: the standard's, and those of the device's GSD file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from dpstack.dp.pdu.alarm_blocks import Status, full_text, parse_block
from dpstack.dp.pdu.diag_blocks import FIRST_SLOT, Block, ChannelBlock, DeviceBlock, IdentifierBlock
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.errors import PduError
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.text import octets_in_words, readable


def block_texts(diagnosis: Diagnosis, texts: DiagTexts | None = None, *, dpv1: bool = False) -> tuple[str, ...]:
    """One line or more for people for each block that reports something; octets without an explanation stay in hex.

    ``dpv1``: the slave is parameterised for DP-V1, its device related blocks are alarms and status.
    """
    lines = texts_of(diagnosis.blocks, texts, dpv1=dpv1)
    return (*lines, f"not decoded: {diagnosis.ext_rest.hex(' ')}") if diagnosis.ext_rest else lines


def texts_of(blocks: Iterable[Block], texts: DiagTexts | None, *, dpv1: bool, messages: bool = True) -> tuple[str, ...]:
    """Of some blocks of a diagnosis. ``messages`` False: without alarms and status messages."""
    return tuple(line for block in blocks for line in _lines(block, texts, dpv1, messages))


def conspicuous_text(
    diagnosis: Diagnosis, texts: DiagTexts | None = None, *, dpv1: bool = False, exchanging: bool
) -> str:
    """A summary of ``diagnosis`` for people in one line: its conspicuous flags, then its blocks as :func:`block_texts`
    has them, without alarms and status messages (they have lines of their own). Empty if there is nothing."""
    said = texts_of(diagnosis.blocks, texts, dpv1=dpv1, messages=False)
    flags = (
        flag.name if said and flag.name == "ext_diag" else f"{flag.name} ({flag.text})"
        for flag in diagnosis.conspicuous(exchanging=exchanging)
    )
    return "; ".join(filter(None, (", ".join(flags), *said)))


def _device_lines(block: DeviceBlock, texts: DiagTexts | None, dpv1: bool, messages: bool) -> Iterator[str]:
    known = () if texts is None else texts.unit_diag_texts(block.data)
    said = ""
    if dpv1:
        try:
            message = parse_block(block.octets)
        except PduError:  # the alarm handler reports it
            pass
        else:
            said = full_text(message, first_slot_of(texts))
            if isinstance(message, Status) and message.modules and texts is not None and not texts.has_type(block.data):
                known = ()  # the standard says what its bits mean
            elif isinstance(message, Status) and message.pa_words is not None:
                if known:  # the maker says it in more detail
                    said = message.text
                elif texts is not None and texts.pa_extension:
                    from dpstack.dp.pdu.pa_diagnosis import status_words

                    said = f"{message.text}, {status_words(message.data, texts.pa_extension)}"
    if said and messages:
        yield said
    yield from (_explained(own.text, own.help) for own in known)
    if not said and (readable(block.data) if known else any(block.data)):
        yield f"device: {octets_in_words(block.data)}"


def _lines(block: Block, texts: DiagTexts | None, dpv1: bool, messages: bool) -> Iterator[str]:
    first = first_slot_of(texts)
    match block:
        case DeviceBlock():
            yield from _device_lines(block, texts, dpv1, messages)
        case IdentifierBlock():
            if block.modules:
                slots = (_explained(str(first + number), _name(texts, number)) for number in block.modules)
                yield "slots with a diagnosis: " + ", ".join(slots)
        case ChannelBlock(identifier=module, error=error):
            own = None if texts is None else texts.channel_text(error, module)
            text = block.cause if own is None else _explained(own.text or block.cause, own.help)
            yield f"{block.place(_name(texts, module), first)}: {text}"


def first_slot_of(texts: DiagTexts | None) -> int:
    """The slot of the first module: as Modul_Offset of the GSD file says, else 1."""
    return FIRST_SLOT if texts is None else texts.first_slot


def _explained(text: str, more: str) -> str:
    return f"{text} ({more})" if more else text


def _name(texts: DiagTexts | None, module: int) -> str:
    return "" if texts is None else texts.module_name(module)
