"""Diagnoses of real makers (diagnoses/*.toml, made from manuals apart from the code): the quality of each value."""

from __future__ import annotations

import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from gsd_kit import made
from msgspec import structs

from dpstack.api.config.slave import SlaveConfig
from dpstack.api.slave.quality import SlaveQuality, qualified
from dpstack.api.slave.slave import Slave
from dpstack.dp.doubts import doubts_of, standing_after
from dpstack.dp.field_map import FieldMap
from dpstack.dp.master.events import SlaveState
from dpstack.dp.pdu.alarm_blocks import Alarm, parse_block
from dpstack.dp.pdu.diag_blocks import DeviceBlock
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.process_data import Field, field_of, with_status
from dpstack.dp.slave_params import SlaveParams
from dpstack.dp.slot_map import Direction, SlotMap
from dpstack.drivers.snapshots import ImageSnapshot, SlaveSnapshot
from dpstack.errors import PduError
from dpstack.gsd.diag_texts import DiagTexts

ROWS: list[dict[str, Any]] = [
    row
    for path in sorted((Path(__file__).parent / "diagnoses").glob("*.toml"))
    for row in tomllib.loads(path.read_text())["row"]
]


def texts_of(row: dict[str, Any]) -> DiagTexts | None:
    """Of the row's GSD file; its Modul_Offset is ``first_slot``."""
    if "gsd" not in row and row["first_slot"] == 1:
        return None
    lines = row.get("gsd", "#Profibus_DP\nGSD_Revision = 3")
    return DiagTexts(made(f"{lines}\nModul_Offset = {row['first_slot']}\n").device)


def alarms_of(diagnosis: Diagnosis, *, dpv1: bool) -> list[Alarm]:
    found = []
    for block in diagnosis.blocks if dpv1 else ():
        if isinstance(block, DeviceBlock):
            try:
                message = parse_block(block.octets)
            except PduError:
                continue
            found += [message] if isinstance(message, Alarm) else []
    return found


def slave_of(row: dict[str, Any]) -> Slave:
    """A slave in data exchange after these diagnoses, read as a master reads them."""
    dpv1: bool = row["dpv1"]
    setup = SlaveParams(
        address=3,
        name="rack",
        ident=0,
        config=bytes.fromhex(row["config"]),
        user_prm=b"\x80\0\0",
        dpv1=Dpv1() if dpv1 else None,
        texts=texts_of(row),
    )
    standing: tuple[Alarm, ...] = ()
    diagnosis: Diagnosis | None = None
    for octets in row["diagnoses"]:
        diagnosis = Diagnosis.parse(bytes.fromhex(octets))
        assert diagnosis is not None
        if diagnosis.prm_req or diagnosis.not_ready:
            standing = ()  # a new bring-up
        for alarm in alarms_of(diagnosis, dpv1=dpv1):
            standing = standing_after(standing, alarm)
    inputs = bytes.fromhex(row.get("inputs", "")) or bytes(setup.input_len)
    image = ImageSnapshot(inputs, bytes(setup.output_len), True, 9, 5_000_000)
    found = SimpleNamespace(
        setup=setup,
        config=None,
        image=image,
        state=SlaveState.DATA_EXCHANGE,
        ready_now=True,
        fault=None,
        diagnosis=diagnosis,
        inputs_valid=not (diagnosis and diagnosis.stat_diag),
        inputs_age=0.001,
        inputs_limit_ns=10**9,
        snapshot=SlaveSnapshot(SlaveState.DATA_EXCHANGE, None, diagnosis, 0, None, standing, 1, 4_000_000),
    )
    found.process_quality = SlaveQuality(cast(Slave, found))
    return cast(Slave, found)


def declared(
    name: str, place: str, row: dict[str, Any], slots: SlotMap, lengths: tuple[int, int]
) -> tuple[Field, Direction]:
    out = place.startswith("out ")
    what = "outputs" if out else "inputs"
    field = field_of(name, place.removeprefix("out "), lengths[out], what, slots)
    status = row.get("status", {}).get(name)
    if status is not None:
        field = with_status(field, field_of(name, status["at"], lengths[out], what, slots), status["quality"])
    return field, Direction(what.removesuffix("s"))


@pytest.mark.parametrize("row", ROWS, ids=lambda row: str(row["id"]))
def test_each_value_has_the_quality_of_the_table(row: dict[str, Any]) -> None:
    slave = slave_of(row)
    lengths = slave.setup.input_len, slave.setup.output_len
    named = {name: declared(name, place, row, slave.setup.slots, lengths) for name, place in row["values"].items()}
    sides = [
        (one, FieldMap({name: field for name, (field, direction) in named.items() if direction is one}, length))
        for one, length in zip(Direction, lengths, strict=True)
    ]
    slave.config = cast(SlaveConfig, SimpleNamespace(fields=tuple(sides)))
    found = {name: qualified(slave, *one) for name, one in named.items()}
    got = {name: [one.quality.value, one.text] for name, one in found.items()}
    wanted = row["expect"]
    qualities = {name: one[0] for name, one in got.items()}
    assert qualities == {name: one[0] for name, one in wanted.items()}, (got, row["why"])
    for name, (_, words) in wanted.items():
        assert words in got[name][1].lower(), got[name]


def test_a_diagnosis_that_the_bus_process_has_read_and_the_application_has_not_makes_all_uncertain() -> None:
    """Inputs come through shared memory, the diagnosis behind them through a pipe: no value is good in between."""
    row = {"config": "51", "dpv1": False, "first_slot": 1, "diagnoses": ["00 0c 00 02 00 00"]}
    slave = slave_of(row)
    level = field_of("level", "i16@0", 4, "inputs")
    slave.config = cast(SlaveConfig, SimpleNamespace(fields=((Direction.INPUT, FieldMap({"level": level}, 4)),)))
    fake = cast(Any, slave)
    for diagnoses, quality in ((1, "good"), (2, "uncertain"), (1, "good")):
        fake.image = structs.replace(fake.image, diagnoses=diagnoses)
        assert qualified(slave, level, Direction.INPUT).quality.value == quality
    fake.image = structs.replace(fake.image, announced=True)
    found = qualified(slave, level, Direction.INPUT)
    assert (found.quality.value, found.text) == ("uncertain", "diagnosis announced")


@pytest.mark.parametrize(
    ("slave", "prm", "has"), [(1, "80 00 00", True), (1, "00 00 00", False), (0, "80 00 00", False)]
)
def test_module_states_of_a_slave_whose_user_parameters_switch_dpv1_on(slave: int, prm: str, has: bool) -> None:
    """A GSD file with DPV1_Slave and constant user parameters: the slave answers as DP-V1, also if dpv1 is off here."""
    texts = DiagTexts(made(f"#Profibus_DP\nGSD_Revision = 3\nDPV1_Slave = {slave}\n").device)
    setup = SlaveParams(address=3, name="rack", ident=1, config=b"\x51", user_prm=bytes.fromhex(prm), texts=texts)
    assert setup.has_messages is has
    diagnosis = Diagnosis.parse(bytes.fromhex("08 0c 00 02 00 01 42 01 05 82 00 00 03"))
    assert diagnosis is not None
    (doubt,) = doubts_of(setup.slots, diagnosis, texts=texts, dpv1=setup.has_messages)
    assert doubt.text == ("no module: slot 1" if has else "has a diagnosis: slot 1")
