"""``dpstack import``: the file, its remarks on standard error and in JSON, bad input, refused masters."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_kit import Cli
from step7_kit import CPU, HEAD, PLANT, SUBNET, SYSTEM, address, gsd_folder, section

from dpstack.api.config.config import load_config


@pytest.fixture
def export(tmp_path: Path) -> Path:
    path = tmp_path / "plant.cfg"
    path.write_bytes(PLANT.encode("cp1252"))
    gsd_folder(tmp_path / "gsd")
    return path


def test_into_a_new_file_with_remarks_on_standard_error(export: Path, tmp_path: Path, cli: Cli) -> None:
    plant = tmp_path / "plant.toml"
    out, err = cli("import", str(export), "--gsd", str(tmp_path / "gsd"), "--out", str(plant))
    assert out.splitlines() == [
        f"{plant}: 3 slaves, 10 names, 5 remarks",
        "read only: the PLC is their master; `dpstack run` of this file would join its token ring and look",
    ]
    assert err.splitlines()[1].startswith(f"dpstack: {export}:83: names that a configuration cannot have")
    assert len(err.splitlines()) == 5
    text = plant.read_text()
    for line in err.splitlines():
        assert f"#   {line.removeprefix(f'dpstack: {export}:').strip()}" in text.splitlines()
    assert [slave.name for slave in load_config(plant).slaves] == ["Hauptschrank", "Halle 2", "Tor"]
    assert "give the name of a new file" in cli.err("import", str(export), "--out", str(plant))
    assert plant.read_text() == text


def test_to_standard_output_and_as_json(export: Path, cli: Cli) -> None:
    text = cli.out("import", str(export))
    assert 'NA_INT = "bool@8.3"' in text
    found = cli.json("import", str(export))
    assert found["toml"] == text
    assert {key: found[key] for key in ("station", "step7", "encoding", "cut", "system", "plc", "baud", "address")} == {
        "station": "Mischerei",
        "step7": "V5.6 + SP2",
        "encoding": "cp1252",
        "cut": False,
        "system": 1,
        "plc": 2,
        "baud": 1_500_000,
        "address": 3,
    }
    assert found["slaves"][2] == {
        "address": 14,
        "name": "Tor",
        "source": "ident number, identifier octets and user parameters as in the export; no GSD file",
        "names": 1,
        "active": True,
        "refuse_master": "F modules (PROFIsafe) in slot 1: dpstack is no F-host",
    }
    assert [remark["line"] for remark in found["remarks"]][:2] == [0, 83]


def test_a_file_that_was_cut_is_imported_and_ends_with_1(export: Path, cli: Cli) -> None:
    export.write_bytes(PLANT[: PLANT.index('"Tor_zu"')].encode("cp1252"))
    out, err = cli("import", str(export), code=1)
    assert 'NA_INT = "bool@8.3"' in out
    assert [line for line in err.splitlines() if "it was cut" in line] == [
        f"dpstack: {export}:124: the file ends within this section: it was cut; what stands behind is missing, export "
        "it again"
    ]


@pytest.mark.parametrize(
    ("octets", "why"),
    [
        (bytes(range(256)), "is binary, not the text of a STEP 7 export"),
        (b"[bus]\n", "has no section of a STEP 7 export"),
        (HEAD.encode() + SUBNET.encode(), "has no DP master system (DPSUBSYSTEM)"),
    ],
)
def test_what_is_no_export_is_one_line(export: Path, cli: Cli, octets: bytes, why: str) -> None:
    export.write_bytes(octets)
    err = cli.err("import", str(export), "--out", str(export.parent / "new.toml"))
    assert err.startswith(f"dpstack: {export}: {why}")
    assert err.count("\n") == 1
    assert not (export.parent / "new.toml").exists()


def test_missing_files_and_folders_are_one_line(export: Path, tmp_path: Path, cli: Cli) -> None:
    assert cli.err("import", str(tmp_path / "none.cfg")) == (
        f"dpstack: {tmp_path / 'none.cfg'}: No such file or directory; give the hardware export of STEP 7 (.cfg)\n"
    )
    assert "this is no folder" in cli.err("import", str(export), "--gsd", str(tmp_path / "none"))


def test_500_slaves(export: Path, cli: Cli) -> None:
    parts = [HEAD, SUBNET, CPU, SYSTEM]
    for number in range(3, 503):
        head = f"DPSUBSYSTEM 1, DPADDRESS {number}"
        parts.append(section(f'{head}, "A.GSD", "s{number}"', 'PNO_IDENT_NO "1"'))
        parts.append(section(f'{head}, SLOT 1, "DI", "8DE"', 'SLAVE_CFG_DATA "01 00 10"', *address("IN", number, 1)))
    export.write_text("".join(parts), newline="")
    found = cli.json("import", str(export))
    assert sum(slave["active"] for slave in found["slaves"]) == 123
    assert len(found["slaves"]) == 500
    assert [remark["text"] for remark in found["remarks"]] == [
        "377 slaves have addresses above 125 (126 to 502), which PROFIBUS does not have: they stand as comments"
    ]
    assert found["address"] == 1  # all others have a station; 0 is a programming device's


def test_bus_parameters_that_do_not_fit_the_slaves_are_left_out(export: Path, cli: Cli) -> None:
    export.write_bytes(PLANT.replace('PROFIBUS_TSL "300"', 'PROFIBUS_TSL "40"').encode("cp1252"))
    found = cli.json("import", str(export))
    assert "t_sl" not in found["toml"].split("[[slave]]")[0].split("\n[bus]\n")[1]
    assert any("its bus parameters are left out" in remark["text"] for remark in found["remarks"])


def test_run_drive_and_acyclic_refuse_slaves_with_f_modules(export: Path, tmp_path: Path, cli: Cli) -> None:
    plant = tmp_path / "plant.toml"
    cli("import", str(export), "--out", str(plant))
    text = plant.read_text().replace("read_only = true", 'port = "virtual"')
    plant.write_text(text)
    why = "must not be brought up by dpstack: F modules (PROFIsafe) in slot 1: dpstack is no F-host; listen (monitor)"
    err = cli.err("run", str(plant), "--seconds", "1")
    assert "slave 12 (Halle 2) (and 1 more slave) must not be brought up by dpstack: its identifier octets" in err
    assert f"{plant}: slave 14 (Tor) {why}" in cli.err("acyclic", str(plant), "Tor", "read", "1", "2")
    assert cli.out("plan", str(plant)).count("dpstack will not be its master (refuse_master)") == 2
    assert "100" in cli.out("plan", str(plant), "--simulate", "0.1", "--json")
