"""Proof outranks suspicion; a drive that is set to another telegram; one cause in one sentence everywhere."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from api_kit import FAN, HOIST, RAW, bench_of, in_virtual_time, operating
from msgspec import structs

import dpstack
from dpstack.api.config.config import slave_config
from dpstack.cli.terminal.causes import CauseLines
from dpstack.dp.master.bring_ups import BringUp, History, Step
from dpstack.dp.master.events import SlaveFaulted, SlaveState
from dpstack.dp.slave_params import SlaveParams
from dpstack.why.evidence import Evidence, LineCounters, Ring
from dpstack.why.story import Likely, tell

IO = {"name": "io", "address": 8, "gsd": "examples/terminal.gsd", "modules": ["8 DO", "8 DI", "4 AI"]}
PRM_FAULT, CFG_FAULT = "42 05 00 FF 12 34", "06 05 00 FF 12 34"


def causes(refusal: str, real: str, setup: SlaveParams | None = None, **table: Any) -> tuple[Likely, ...]:
    """The causes of a terminal that refuses with ``refusal`` and says to have ``real``; ``table``: keys of the user."""
    config = slave_config(IO | table)
    setup = structs.replace(config.params if setup is None else setup, ident=0x1234)
    steps = (
        Step(1, "Slave_Diag", b"", "DL", bytes.fromhex("02 05 00 FF 12 34"), last_ns=1),
        Step(2, "Set_Prm", b"", "SC", last_ns=2),
        *([Step(3, "Chk_Cfg", setup.config, "SC", last_ns=3)] if refusal == CFG_FAULT else []),
        Step(4, "Slave_Diag", b"", "DL", bytes.fromhex(refusal), last_ns=4),
    )
    evidence = Evidence(
        setup=setup,
        state=SlaveState.FAULT,
        ring=Ring(own=2),
        line=LineCounters(baud=500_000, slot_bits=200),
        history=History((BringUp(steps),), idents=(0x1234,)),
        device=config.device,
        modules=() if config.params.texts is None else config.params.texts.modules,
        expected_prm=slave_config(IO).params.user_prm,
        config=bytes.fromhex(real),
    )
    return tell(evidence).causes


#: octets of the user parameters by place: "Diagnosis" of the head, the high octet of "Delay" of 8 DI (up to 1000)
EDITED = {"none": {}, "head": {3: 0x08}, "module": {6: 0x02}, "impossible": {6: 0xFF}}


@pytest.mark.parametrize("edited", EDITED)
@pytest.mark.parametrize("real", ["20 20 43 43 01 02 03", "10 10 43 43 01 02 03"])
def test_a_module_that_get_cfg_proves_wrong_is_first_whatever_parameters_were_edited(edited: str, real: str) -> None:
    setup = slave_config(IO).params
    octets = bytearray(setup.user_prm)
    for at, octet in EDITED[edited].items():
        octets[at] = octet
    setup = structs.replace(setup, user_prm=bytes(octets))
    first, *others = causes(PRM_FAULT, real, setup)
    assert first.cause == "module_type"
    assert first.confidence > others[0].confidence
    assert causes(PRM_FAULT, setup.config.hex(), setup)[0].cause == "user_parameter"


def test_another_number_of_parameters_is_no_reason_to_doubt_a_proof() -> None:
    setup = structs.replace(slave_config(IO).params, user_prm=b"\x80\0\0\0\0\x01")
    first, second = causes(PRM_FAULT, "20 20 43 43 01 02 03", setup)[:2]
    assert (first.cause, second.cause) == ("module_type", "user_parameter_length")


def test_a_rack_whose_modules_have_no_parameters_is_proved_as_well() -> None:
    """8 DO and 4 AI have none, so only the head's own ones were edited."""
    setup = slave_config(IO | {"modules": ["8 DO", "4 AI"]}).params
    setup = structs.replace(setup, user_prm=b"\x80\0\0\x08\0")
    assert causes(PRM_FAULT, "20 20", setup, modules=["8 DO", "4 AI"])[0].cause == "module_type"


def test_the_sentence_of_a_module_names_the_slot() -> None:
    (likely, *_) = causes(CFG_FAULT, "20 20 43 43 01 02 03")
    assert likely.meaning == "a module of another type is in a slot: slot 2 has 8 DO, the configuration 8 DI"


# --- a drive that is set to another telegram --------------------------------------------------------------------------

PPO3 = 'set telegram = "PPO3", or o30 = 1 and power off and on'


@in_virtual_time
async def test_a_drive_that_is_set_to_another_telegram_is_told_as_that() -> None:
    async with dpstack.open_bus(
        port="virtual", baud=500_000, slaves=[FAN | {"telegram": "PPO1", "simulated": {"o30": 3}}, RAW]
    ) as bus:
        await asyncio.sleep(1.0)
        fan = bus.slave("fan")
        assert fan.fault is not None
        assert fan.fault.text == (
            "refuses the configuration (Cfg_Fault): the drive is set to PPO3 (o30 = 3), the configuration has PPO1; "
            f"Chk_Cfg was f3 71, it has 71: octet 1 differs; {PPO3}"
        )
        for ask in (False, True):
            story = await bus.why("fan", ask=ask)
            assert story.first.cause == "telegram"
            assert story.first.meaning == "the drive is set to PPO3 (o30 = 3), the configuration has PPO1"
            assert story.first.next == PPO3
            assert not {one.cause for one in story.causes} & {"module_missing", "module_type", "module_extra"}


def test_a_drive_whose_setting_is_in_no_manual_names_the_telegram_alone() -> None:
    config = slave_config({"name": "lift", "address": 8, "drive": "ls-s100"})
    found = causes(CFG_FAULT, "61 51", config.params)
    assert found[0].cause == "telegram"
    assert found[0].meaning == "the drive is set to VENDOR 2/2, the configuration has PPO1"
    assert found[0].next == 'set telegram = "VENDOR 2/2", or set the drive to PPO1'
    # identifiers of no telegram, and those of the configuration, are no other telegram
    assert causes(CFG_FAULT, "61 51 10", config.params)[0].cause != "telegram"
    assert causes(CFG_FAULT, "F3 71", config.params)[0].cause != "telegram"
    # a drive may name any telegram before Chk_Cfg, so a refused Set_Prm proves nothing
    refused = causes(PRM_FAULT, "61 51", config.params)
    assert next(one.confidence for one in refused if one.cause == "telegram") <= 0.5


# --- all slaves fall silent at once -----------------------------------------------------------------------------------

OTHER = {**RAW, "name": "other", "address": 4}
#: words that say that somebody answers
SAID = ("thers answer", "undisturbed", "in data exchange: ")


def sentences(story: dpstack.Story) -> list[str]:
    return [text for one in story.causes for text in (*one.speaks_for, *one.against)]


async def after_losses(
    addresses: tuple[int, ...], gap_s: float = 0.0
) -> tuple[dict[int, list[dpstack.Story]], list[str]]:
    """The slaves lose their power: their stories at the moment of each fault, asked and unasked, a second later as
    well; and the notices of `dpstack run`."""
    stories: dict[int, list[dpstack.Story]] = {}
    told: list[str] = []
    asking: list[asyncio.Task[None]] = []
    lines: list[CauseLines] = []

    async def ask(address: int) -> None:
        for ask in (False, True):
            stories.setdefault(address, []).append(await bus.why(address, ask=ask, scan=False))

    def on_event(event: dpstack.Event) -> None:
        told.append(event.text)
        for one in lines:
            one.event(event)
        if isinstance(event, SlaveFaulted) and event.address not in stories:
            asking.append(asyncio.ensure_future(ask(event.address)))

    async with operating(RAW, OTHER, HOIST, baud=93_750, on_event=on_event) as bus:
        lines.append(CauseLines(bus))
        await asyncio.sleep(0.1)
        for address in addresses:
            bench_of(bus).power(address, False)
            await asyncio.sleep(gap_s)
        await asyncio.sleep(2.0)
        await asyncio.gather(*asking)
        for address in addresses:
            await ask(address)
        stories |= {address: [*stories[address], story] for address, story in (await lines[0].stories()).items()}
    return stories, [text for text in told if text.startswith("why: ")]


@in_virtual_time
async def test_nobody_is_said_to_answer_when_all_slaves_fall_silent_at_once() -> None:
    stories, notices = await after_losses((9, 4, 3))
    assert {address: len(found) for address, found in stories.items()} == {9: 5, 4: 5, 3: 5}
    for found in stories.values():
        for story in found:
            assert not [text for text in sentences(story) if any(said in text for said in SAID)]
            assert story.first.cause == "all_silent"
            assert story.first.next.startswith("look at all that the slaves share: the cable")
            assert "All 3 slaves of the configuration are silent at once." in story.first.speaks_for
    # one cause, one sentence
    (notice,) = notices
    assert notice.startswith("why: all 3 slaves: likely all_silent (")
    assert notice.partition("likely ")[2].partition("; ")[0] == stories[9][0].line


@in_virtual_time
async def test_the_others_are_said_to_answer_when_one_slave_falls_silent() -> None:
    stories, notices = await after_losses((9,))
    for story in stories[9]:
        assert story.first.cause == "not_there"
        assert "Others answer at this rate: hoist, other." in story.first.speaks_for
    (notice,) = notices
    assert notice.startswith(f"why: slave 9 (raw): likely {stories[9][0].line}; dpstack why ")


@in_virtual_time
async def test_slaves_that_fall_silent_one_after_the_other_share_no_cause() -> None:
    stories, notices = await after_losses((3, 4, 9), gap_s=3.0)
    causes = {story.first.cause for found in stories.values() for story in found}
    assert causes == {"not_there"}
    assert len(notices) == 3
    assert not [text for story in stories[9] for text in sentences(story) if any(said in text for said in SAID)]
