"""Prm_Structure: all octets behind DPV1_Status become blocks; Fail_Safe in DPV1_Status."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from api_kit import bus_of, serving

import dpstack
from dpstack.api.config.config import parse_config
from dpstack.errors import ConfigError
from dpstack.slave import DpSlave, PrmBlock, SlaveDescription

pytestmark = pytest.mark.virtual_time

HEAD = '[bus]\nport = "virtual"\nbaud = 500000\n[[slave]]\nname = "io"\naddress = 9\n'
PLAIN = 'ident = 1\nconfig = "10"\nuser_prm = "00 00 00 07"\n'
COMMAND = "dpv1 = { blocks = [{ type = 2, specifier = 1 }] }\n"
COMMAND_OCTETS = "08 02 00 01 00 00 00 00"


def sent(keys: str) -> str:
    """The user parameters that Set_Prm carries."""
    return parse_config(HEAD + keys, "plant.toml").slaves[0].params.user_octets(None).hex(" ")


def gsd_of(folder: Path, user_prm: str, *, required: bool) -> Path:
    """A slave with structured parameters, one module."""
    octets = bytes.fromhex(user_prm)
    path = folder / "io.gsd"
    path.write_text(
        "#Profibus_DP\nGSD_Revision = 5\nIdent_Number = 0x0FFE\n500_supp = 1\nMaxTsdr_500 = 100\nDPV1_Slave = 1\n"
        f"C1_Read_Write_supp = 1\nPrm_Block_Structure_supp = 1\nPrm_Block_Structure_req = {int(required)}\n"
        f"Max_User_Prm_Data_Len = 60\n"
        f'Ext_User_Prm_Data_Const(0) = {", ".join(str(one) for one in octets)}\nModule = "in" 0x10\n1\nEndModule\n'
    )
    return path


def test_plain_parameters_become_a_block() -> None:
    assert sent(PLAIN + COMMAND) == f"80 00 08 05 81 00 00 07 {COMMAND_OCTETS}"
    assert sent(PLAIN.replace(" 07", "") + COMMAND) == f"80 00 08 {COMMAND_OCTETS}"


def test_blocks_in_the_parameters_stay() -> None:
    structured = PLAIN.replace("00 07", "08 05 81 00 00 07")
    assert sent(structured + COMMAND) == f"80 00 08 05 81 00 00 07 {COMMAND_OCTETS}"
    assert sent(structured) == "00 00 08 05 81 00 00 07"
    with pytest.raises(ConfigError, match=r"octet 4: parameter block 1 .* Prm_Structure is set: blocks have to follow"):
        sent(PLAIN.replace("00 07", "08 07") + COMMAND)


@pytest.mark.parametrize("rest", ["", " 05 81 00 00 07"])
def test_a_gsd_file_that_requires_the_structure(tmp_path: Path, rest: str) -> None:
    gsd = gsd_of(tmp_path, f"00 00 00{rest}", required=True)
    assert sent(f'gsd = "{gsd}"\nmodules = [1]\n') == f"80 00 08{rest}"


def test_a_gsd_file_that_requires_blocks_and_has_none(tmp_path: Path) -> None:
    gsd = gsd_of(tmp_path, "00 00 00 05 81", required=True)
    with pytest.raises(ConfigError, match="Prm_Block_Structure_req = 1: blocks have to follow DPV1_Status"):
        sent(f'gsd = "{gsd}"\nmodules = [1]\n')


@pytest.mark.parametrize("required", [False, True])
async def test_the_slave_of_the_same_file_accepts_them(tmp_path: Path, required: bool) -> None:
    seen: list[tuple[PrmBlock, ...]] = []

    def judge(blocks: tuple[PrmBlock, ...]) -> None:
        seen.append(blocks)

    gsd = gsd_of(tmp_path, "00 00 00 05 81 00 00 07" if required else "00 00 00 07", required=required)
    slave = dpstack.slave.slave_from_gsd(gsd, lambda outputs, elapsed: bytes(1), [1], on_blocks=judge)
    blocks = [{"type": "prm_cmd", "specifier": 1}]
    table = {"name": "io", "address": 9, "gsd": str(gsd), "modules": [1], "dpv1": {"blocks": blocks}}
    world = dpstack.World()
    async with dpstack.slave.serve_slave(slave, world=world, address=9), bus_of(table, world=world) as bus:
        await bus.ready()
        await bus.slave("io").reparameterise(dpv1={"blocks": blocks, "prm_cmd": True})
        await bus.ready()
    async with bus_of(table) as bus:  # the simulated slave of the port "virtual"
        await bus.ready()
    assert seen[-1] == (PrmBlock(0x81, 0, b"\7"), PrmBlock(2, 0, bytes(4), 1))


def test_a_slave_that_requires_them_refuses_others() -> None:
    description = SlaveDescription(ident=1, configs=(b"\x10",), dpv1=True, prm_blocks_required=True)
    assert description.check_prm(bytes.fromhex("80 00 08 05 81 00 00 07")) is None
    reason = "octet 10 bit 3: Prm_Structure is not set, this device needs structured parameters"
    assert description.check_prm(bytes.fromhex("80 00 00 07")) == reason
    assert description.check_prm(b"") == reason


@pytest.mark.parametrize(
    ("keys", "octets"), [("dpv1 = true\n", "80 00 00"), ("fail_safe = true\ndpv1 = true\n", "c0 00 00")]
)
def test_fail_safe_in_dpv1_status_without_a_gsd_file(keys: str, octets: str) -> None:
    assert sent(PLAIN.replace("00 00 00 07", "40 00 00") + keys) == octets


@pytest.mark.parametrize("wanted", [{"fail_safe": True, "fail_safe_required": True}, {"prm_blocks_required": True}])
async def test_a_slave_that_requires_it_comes_up(wanted: dict[str, Any]) -> None:
    rig = SlaveDescription(ident=1, configs=(b"\x10\x20",), dpv1=True, **wanted)
    async with serving(DpSlave(rig, lambda outputs, elapsed: bytes(1))):
        pass
