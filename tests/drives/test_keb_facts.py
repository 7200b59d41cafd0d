"""KEB: telegrams and GSD facts, names and indexes, what the profile says (docs/reference/drives/keb-f5.md)."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.errors import ConfigError
from dpstack.gsd.check import check
from dpstack.gsd.identifiers import io_lengths
from dpstack.gsd.parser import load_gsd
from dpstack.profile import DriveProfile
from dpstack_drives.demag import DRIVE as DEMAG
from dpstack_drives.keb import DRIVE
from dpstack_drives.keb import table as t
from dpstack_drives.ls import DRIVE as LS
from tests.drives.keb_kit import device


def test_k2_gsd_facts() -> None:
    assert DRIVE.ident == 0x05EB
    assert DRIVE.ident_made_up
    assert DRIVE.user_prm == b""
    assert DRIVE.min_slave_interval_ns == 100_000
    assert len(DRIVE.baud_rates) == 9
    assert 45_450 not in DRIVE.baud_rates
    assert [DRIVE.max_tsdr[baud] for baud in sorted(DRIVE.baud_rates)] == [60, 60, 60, 60, 100, 150, 250, 450, 800]


@pytest.mark.parametrize(
    ("name", "config", "outputs", "inputs"),
    [
        ("PCH+4/4", "B7 A3 93", 12, 12),
        ("PCH+8/8", "B7 A7 97", 16, 16),
        ("4/4", "A3 93", 4, 4),
        ("pch+2/8", "B7 A1 97", 10, 16),
        ("1/8", "A0 97", 1, 8),
        ("0/4", "93", 0, 4),
        ("6/0", "A5", 6, 0),
        ("PCH", "B7", 8, 8),
        ("PCH+0/4", "B7 93", 8, 12),
        ("8+8/8", "A7 A7 97", 16, 8),
        ("8/8+4", "A7 97 93", 8, 12),
        ("PCH+4/6 inputs-first", "B7 95 A3", 12, 14),
        ("8+2/8+4 own-gsd", "A7 A1 97 93", 10, 12),
        ("PCH+8+8/8+8 OWN-GSD", "B7 A7 A7 97 97", 24, 24),
    ],
)
def test_k2_telegrams_are_made_from_their_names(name: str, config: str, outputs: int, inputs: int) -> None:
    spec = DRIVE.telegram(name)
    assert spec.config.hex(" ").upper() == config
    assert io_lengths(spec.config) == (inputs, outputs)
    assert (spec.output_octets, spec.input_octets) == (outputs, inputs)
    assert spec.made_up == ("own-gsd" in name.lower())
    assert DRIVE.telegrams_of(spec.config) == (spec,)
    core, device = DRIVE.core("it", name), DRIVE.device(name)
    assert core.safe_outputs == bytes(outputs)
    assert device.check_cfg(spec.config) is None
    device.enter(spec.config, 0)
    assert len(device.exchange(core.cyclic(bytes(inputs), 1), 2)) == inputs


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("PPO1", "'PPO1' is no telegram of keb-f5; write"),
        ("4", "is no telegram"),
        ("PCH+", "is no telegram"),
        ("9/4", "modules have 1..8 octets"),
        ("4+0/4", "modules have 1..8 octets"),
        ("0/0", "it has no modules"),
        ("8+8+8/0", "at most 16 octets of process data"),
        ("4/4 upside-down", "is no telegram"),
        (
            "8+2/8+4",
            "4 modules, the printed GSD (V2.2) allows 3; if a newer GSD of yours does, name it '8+2/8+4 own-gsd'",
        ),
        ("PCH+8+1/0", "more than 16 octets one way"),
    ],
)
def test_k2_what_cannot_be_a_telegram(name: str, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        DRIVE.telegram(name)
    assert says in str(caught.value)


@given(st.booleans(), st.lists(st.integers(1, 8), max_size=2), st.lists(st.integers(1, 8), max_size=2), st.booleans())
def test_k2_every_combination_by_name_and_by_identifiers(
    channel: bool, outputs: list[int], inputs: list[int], first: bool
) -> None:
    """The identifier octets are made here, by the modules of the printed GSD."""
    out, into = bytes(0xA0 + n - 1 for n in outputs), bytes(0x90 + n - 1 for n in inputs)
    config = (b"\xb7" if channel else b"") + (into + out if first else out + into)
    if not config:
        return
    (spec,) = DRIVE.telegrams_of(config)
    assert spec.config == config
    assert DRIVE.telegram(spec.name) == spec
    assert (spec.inputs, spec.outputs, spec.channel) == (sum(inputs), sum(outputs), channel)
    beyond = len(config) > 3 or max(sum(inputs), sum(outputs)) + 8 * channel > 16
    assert spec.made_up == beyond


@pytest.mark.parametrize("config", ["", "F3 71", "A3 B7 93", "A3 93 A3", "B7 B7", "A8", "98 A0"])
def test_k2_other_identifiers_are_refused(config: str) -> None:
    octets = bytes.fromhex(config)
    assert DRIVE.telegrams_of(octets) == ()
    assert DRIVE.device().check_cfg(octets) is not None


def test_k12_four_modules_only_when_asked() -> None:
    """The printed GSD has three; the simulated drive has more when that is its telegram."""
    config = bytes.fromhex("A7 A1 97 93")
    assert "printed GSD" in str(DRIVE.device().check_cfg(config))
    assert DRIVE.device("8+2/8+4 own-gsd").check_cfg(config) is None


@pytest.mark.parametrize(
    ("name", "index"),
    [("oP.3", 0x2303), ("op03", 0x2303), ("sy.50", 0x2032), ("ru 12", 0x220C), ("oP.59", 0x233B), ("LE.00", 0x2D00)],
)
def test_k6_names_of_known_groups(name: str, index: int) -> None:
    assert t.index_of(name) == index


def test_k6_the_forms_of_the_manual() -> None:
    """2F13 is cS.19, 2227 ru.39, 230A oP.10 (Process Data Assignment)."""
    assert [t.name_of(index) for index in (0x2F13, 0x2227, 0x230A, 0x6000)] == [
        "cS.19 (2F13h)",
        "ru.39 (2227h)",
        "oP.10 (230Ah)",
        "6000h",
    ]
    assert t.index_of("Pn.06") is None
    assert t.index_of("oP.256") is None
    assert t.index_of("412") is None


def test_k8_the_recipe_is_shown() -> None:
    text = " ".join(DRIVE.notes)
    for part in ("ud.01 = 440", "Fr.01 = -4", "Fr.02 = 5", "oP.00 = 5", "oP.01 = 9", "di.01 = 1", "di.02 = 1", "F5-C"):
        assert part in text


def test_k10_what_happens_when_the_master_stops() -> None:
    assert "Pn.06" in DRIVE.on_loss
    assert "Pn.05" in DRIVE.on_loss


def test_our_gsd_file_of_the_ls_s100_tells_what_is_made_up() -> None:
    """Its manual has ident number, rates and the number of modules; the rest stands for the simulated drive."""
    octets = (resources.files("dpstack_drives.ls") / "ls-s100.gsd").read_bytes()
    assert b"is not the vendor's file" in octets
    assert b"made up" in octets
    file = load_gsd(octets, "ls-s100.gsd")
    assert (file.diagnostics, check(file)) == ((), ())
    device = file.device
    assert device.ident == LS.ident == 0x0A6C
    assert str(LS.gsd).endswith("ls/ls-s100.gsd")
    assert tuple(speed.baud for speed in device.speeds) == LS.baud_rates
    assert (device.max_module, device.max_input_len, device.max_output_len, device.max_data_len) == (2, 28, 28, 56)
    fixed = [module.config for module in device.modules[:7]]
    assert fixed == [LS.telegram(name).config for name in ("PPO1", "PPO2", "PPO3", "PPO4", "PPO5", "PPO6", "ST1")]
    vendor = b"".join(module.config for module in device.modules[7:])
    assert vendor.hex() == "6061626364656667" + "5051525354555657"
    assert device.prm.consts == () or b"".join(const.octets for const in device.prm.consts) == LS.user_prm


@pytest.mark.parametrize(("drive", "modules"), [(DRIVE, 17), (DEMAG, 4)])
def test_our_gsd_files_have_the_facts_of_the_profile(drive: DriveProfile, modules: int) -> None:
    assert drive.gsd is not None
    package, _, name = drive.gsd.rpartition(":")  # of a device file: its path
    octets = (resources.files(package) / name if package else Path(name)).read_bytes()
    assert b"is not the vendor's file" in octets or b"is not KEB's file" in octets
    file = load_gsd(octets, name)
    assert (file.diagnostics, check(file)) == ((), ())
    device = file.device
    assert device.ident == drive.ident
    assert {speed.baud: speed.max_tsdr for speed in device.speeds} == drive.max_tsdr
    assert (device.min_slave_interval or 0) * 100_000 == drive.min_slave_interval_ns
    assert (device.fail_safe, device.max_diag_data_len) == (drive.fail_safe, 6)
    assert len(device.modules) == modules
    configs = [module.config for module in device.modules]
    sizes = (device.max_module, device.max_input_len, device.max_output_len, device.max_data_len)
    if drive is DEMAG:
        assert sizes == (24, 48, 48, 96)
        assert configs == [spec.config for spec in drive.telegrams.values()]
        assert b"".join(const.octets for const in device.prm.consts) == drive.user_prm
    else:
        assert sizes == (3, 16, 16, 32)
        assert b"".join(configs).hex() == "b7" + "a0a1a2a3a4a5a6a7" + "9091929394959697"
        assert device.user_prm_data_len == 0


def test_the_simulated_drive_knows_its_trips_and_has_no_warnings() -> None:
    drive = device()
    assert drive.fault_code("e.BUS") == drive.fault_code("18") == 18
    with pytest.raises(ValueError, match=r"known \(made up\): E\.OP \(1\)"):
        drive.trip("F2100")
    with pytest.raises(ValueError, match="no warning on the bus"):
        drive.warn(1)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"control_bits": "run"}, "control_bits: 'run' is no bit"),
        ({"control_bits": "run=16"}, "'run=16' is no bit"),
        ({"status_bits": "run=1 fault=1"}, "a second time"),
        ({"map_inputs": "2033 2035 2200"}, "map_inputs: 6 octets, the telegram has 4"),
        ({"map_inputs": "zz.top"}, "neither an index in hex nor a parameter"),
        ({"map_outputs": "2032@0"}, "2032 has no set"),
        ({"map_outputs": "oP.27"}, "cannot be process output data"),
        ({"block2_inputs": "5FE0"}, "not two indexes in hex"),
        ({"direction": "left"}, "direction must be 'bit' or 'sign'"),
        ({"rpm_per_cnt": 1}, "did you mean rpm_per_count"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, object], says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        DRIVE.core("hoist", "PCH+4/4", options)
    assert says in str(caught.value)
