"""Bad device files: every mistake with its line and a remedy; nothing is opened, loaded or run for them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from gsd_kit import PROFIDRIVE

from dpstack.devices import finding
from dpstack.devices.profiles import profile_of
from dpstack.devices.reader import DeviceFileError
from dpstack.errors import ConfigError

HEAD = 'format = 1\nname = "d"\nbase = "profidrive"\n'
BITS = 'format = 1\nname = "d"\nbase = "bits"\n'
OWN = '[telegrams]\n9 = { out = ["control", "setpoint"], in = ["status", "speed"] }\n'
STATES = "[status]\nstates = { running = [15, 7], ready = [15, 1] }\n"
WORDS = '[words]\nsetpoint = { type = "n2" }\nspeed = { type = "n2" }\n'
RUN = "[control]\nrun = { ready = 3, running = 3 }\n"


def errors(path: Path) -> list[str]:
    """The mistakes as people see them, without the path in front."""
    with pytest.raises(DeviceFileError) as caught:
        finding.read(path)
    found = caught.value.errors
    assert all(one.line is not None and one.what and one.todo for one in found)
    assert [one.line for one in found] == sorted(one.line or 0 for one in found)
    assert caught.value.line == found[0].line
    return [str(one).removeprefix(f"{path}:") for one in found]


def written(folder: Path, text: str) -> Path:
    path = folder / "d.toml"
    path.write_text(text, encoding="utf-8")
    return path


#: texts of files, and the beginnings of the messages about them
BAD: list[tuple[str, list[str]]] = [
    # the file
    ("", ["1: the file: no format; write format = 1", "1: the file: no name; give the", "1: the file: no base; write"]),
    ("format = 1\nname = \n", ["2: "]),
    ('format = 2\nname = "d"\n', ["1: the file: format = 2 is outside 1..1; this dpstack reads format = 1"]),
    (
        'format = 1\nname = "e"\nbase = "profidrive"\n',
        ["2: the file: name = 'e', but the file is d.toml; give both the"],
    ),
    (f"{HEAD}baud = 9600\n{OWN}", ["4: the file: unknown key 'baud'; did you mean "]),
    (BITS + STATES + RUN, ["1: the file: no telegram; add [telegrams] with 1 = "]),
    (f'format = 1\nname = "d"\n{OWN}', ["1: the file: no base; write base = ", "4: the file: "]),
    (f"{HEAD}words = 3\n{OWN}", ["4: the file: words "]),
    (f"{HEAD}example = 3\n{OWN}", ["4: the file: example is no array of tables; write [[example]]"]),
    # words named twice
    (
        f'{HEAD}[telegrams]\n9 = {{ out = ["control", "setpoint", "a", "a"], in = ["status", "speed"] }}\n'
        "[words]\na = {}\n",
        ["5: the file: telegrams: 9: out names 'a' twice; give each word a name of its own"],
    ),
    (f"{HEAD}{OWN}[words]\na = {{}}\na = {{}}\n", ["8: "]),
    (
        f'{HEAD}[telegrams]\n9 = {{ out = ["control", "setpoint"], in = ["status", "speed", "n"] }}\n'
        '[words]\nn = { type = "n2", as = "speed" }\n',
        ["5: the file: telegrams: 9: in: 'speed' and 'n' are both the speed; leave one out, or give it another part"],
    ),
    (f"{HEAD}{OWN}[derived]\nspeed = {{ of = 'status' }}\n", ["7: the file: derived: speed: 'speed' is a word and a"]),
    (
        f"{HEAD}{OWN}[control]\nbits = {{ a = 11, b = 11 }}\n",
        ["7: the file: control: bits: a and b are both bit 11; give each bit one name"],
    ),
    (
        f"{HEAD}{OWN}[parameters]\np1 = {{ number = 7 }}\np2 = {{ number = 7 }}\n",
        ["8: the file: parameters: p2: p2 (p2) is declared twice, also as p1; take one of them out"],
    ),
    # telegrams
    (
        f'{HEAD}[telegrams]\n9 = {{ out = ["control", "setpoint", "torq"], in = ["speed"] }}\n',
        ["5: the file: telegrams: 9: out: 'torq' is no word of this file; did you mean 'torque'?"],
    ),
    (
        f'{HEAD}[telegrams]\n9 = {{ out = ["control", "setpoint"], in = ["speed"] }}\n',
        ["5: the file: telegrams: 9: in begins with 'speed'; the first word must be 'status'"],
    ),
    (
        f'{HEAD}[telegrams]\n9 = {{ out = ["control", 70000], in = ["status"] }}\n',
        ["5: the file: telegrams: 9: out holds 70000; a word is a name or a constant of 0..65535"],
    ),
    (
        f'{HEAD}[telegrams]\n9 = {{ out = ["control"], in = ["status", "speed"], config = "F3 71" }}\n',
        ["5: the file: telegrams: 9: telegram 9 has 4 octets of inputs and 2 of outputs, its identifiers F3 71"],
    ),
    (f"{HEAD}[telegrams]\n70000 = {{ out = ['control'], in = ['status'] }}\n", ["5: the file: telegrams: 70000: tele"]),
    (
        f"{HEAD}[telegrams]\n9 = {{ out = ['control'{', 0' * 122}], in = ['status'] }}\n",
        ["5: the file: telegrams: 9: telegram 9 has more than the 244 octets of a frame; take words out"],
    ),
    (
        f"{HEAD}[telegrams]\n9 = {{ out = ['control'{', 0' * 64}], in = ['status'] }}\n",
        ["5: the file: telegrams: 9: more than 64 words one way; give config, or modules of a GSD file"],
    ),
    (f'{HEAD}telegram = "8"\n{OWN}', ["4: the file: no telegram '8'; it has 1, 2, 3, "]),
    # scales and limits
    (f"{HEAD}{OWN}[words]\na = {{ of = 0 }}\n", ["7: the file: words: a: of = 0: a scale of zero or no number"]),
    (f"{HEAD}{OWN}[words]\na = {{ full = 0 }}\n", ["7: the file: words: a: full = 0 is outside 1..2147483647"]),
    (
        f"{HEAD}{OWN}[words]\na = {{ full = 9, of = 'p9' }}\n",
        ["7: the file: words: a: of = 'p9' is no parameter of this"],
    ),
    (f"{HEAD}{OWN}[words]\na = {{ low = 5, high = 1 }}\n", ["7: the file: words: a: low = 5 is above high = 1"]),
    (f"{HEAD}{OWN}[words]\na = {{ neutral = -1 }}\n", ["7: the file: words: a: neutral: a -1 is outside 0..65535"]),
    (
        f"{HEAD}{OWN}[words]\nspeed = {{ type = 'n4' }}\n",
        ["7: the file: words: speed: speed has 16 bits in telegrams of"],
    ),
    (
        f"{HEAD}{OWN}[parameters]\np1 = {{ number = 7, per_unit = 0 }}\n",
        ["7: the file: parameters: p1: per_unit = 0: a scale of zero; give the counts that make 1"],
    ),
    (
        f"{HEAD}{OWN}[reference]\nrpm = 0\n",
        ["7: the file: reference: rpm = 0; give a number above 0, or the name of a"],
    ),
    (f"{HEAD}{OWN}[reference]\nrpm = nan\n", ["7: the file: reference: rpm = nan; give a number above 0, or the name"]),
    (
        f"{HEAD}{OWN}[options]\na = {{ default = 3, high = 2 }}\n",
        ["7: the file: options: a: default = 3.0 is none of i"],
    ),
    (f"{HEAD}{OWN}[bus]\nrates = [12345]\n", ["7: the file: bus: 12345 bit/s is no rate of PROFIBUS; they are 9600, "]),
    (f"{HEAD}{OWN}[bus]\nuser_prm = '{'00' * 238}'\n", ["7: the file: bus: more than the 237 octets of a Set_Prm"]),
    # states
    (
        f"{BITS}{OWN}{RUN}[status]\nstates = {{ ready = [1, 1], running = [2, 2] }}\n{WORDS}",
        ["8: the file: a status word can match both "],
    ),
    (
        f"{BITS}{OWN}{RUN}[status]\nstates = {{ ready = [1, 3], running = [2, 2] }}\n{WORDS}",
        ["8: the file: state ready: value 0x0003 has bits outside mask 0x0001; "],
    ),
    (
        f"{BITS}{OWN}{RUN}[status]\nstates = {{ idle = [1, 1] }}\n{WORDS}",
        ["9: the file: status: states: 'idle' is no state; it m"],
    ),
    (
        f"{BITS}{OWN}{RUN}[status]\nstates = {{ fault = [8, 8] }}\n{WORDS}",
        ["8: the file: states: running and a state below it a"],
    ),
    (
        f"{BITS}{OWN}{STATES}{WORDS}",
        ["1: the file: no word leads to running; write run = { ready = 0x..., running = 0x... }"],
    ),
    (f"{BITS}{OWN}{RUN}[status]\nstates = {{}}\n{WORDS}", ["8: the file: no states; add states = { running = [mask"]),
    # names of other things
    (
        f"{HEAD}{OWN}[orders]\njog = {{ set = ['jog'] }}\n",
        ["7: the file: orders: jog: 'jog' is no bit of the control word"],
    ),
    (
        f"{HEAD}{OWN}[settings]\np1 = {{ equals = 3 }}\n",
        ["7: the file: settings: p1: 'p1' is no parameter of this file"],
    ),
    (
        f"{HEAD}{OWN}[parameters]\np1 = {{ number = 7, high = 2 }}\n[settings]\np1 = {{ equals = 3 }}\n",
        ["9: the file: settings: p1: p1 (p1): 3 is outside 0..2; give a value that it can have"],
    ),
    (
        f"{HEAD}{OWN}[parameters]\np1 = {{ number = 7 }}\n[settings]\np1 = {{ equals = '{{x}}' }}\n",
        ["9: the file: settings: p1: equals = '{x}' is no option; write a number or one of {telegram}"],
    ),
    (
        f"{HEAD}{OWN}[simulate]\nramps = {{ up = 'p1' }}\n",
        ["7: the file: simulate: ramps: up = 'p1' is no parameter of"],
    ),
    (f"{HEAD}{OWN}[simulate]\nlost = 70000\n", ["7: the file: simulate: lost = 70000 is no number of a fault"]),
    (f"{HEAD}{OWN}[channel]\ndialect = 'french'\n", ["7: the file: channel: unknown dialect 'french'; it must be "]),
    # texts that are formats
    (f"{HEAD}{OWN}[fault]\nunknown = '{{:999999999}}'\n", ["7: the file: fault: unknown = '{:999999999}' has another"]),
    (
        f"{HEAD}{OWN}[fault]\nunknown = '{{0.__class__}}'\n",
        ["7: the file: fault: unknown = '{0.__class__}' has another"],
    ),
    (f"{HEAD}{OWN}[fault]\ntexts = 'faults.csv'\n", ["7: the file: fault: texts: faults.csv cannot be read (No such"]),
    (f"{HEAD}{OWN}[fault]\ntexts = {{ a = 'b' }}\n", ["7: the file: fault: 'a' is no number; write each text behind"]),
    (
        f"{HEAD}{OWN}[fault]\ntexts = {{ 99999999999 = 'b' }}\n",
        ["7: the file: fault: '99999999999' is beyond every word"],
    ),
    # examples
    (f"{HEAD}{OWN}[[example]]\nstate = 'running'\n", ["6: [[example]] 1: it has no octets; give inputs, outputs, or"]),
    (
        f"{HEAD}{OWN}[[example]]\ninputs = 'EB3'\n",
        ["7: [[example]] 1: inputs = 'EB3' is no hex (an odd number of digi"],
    ),
    (
        f"{HEAD}{OWN}[[example]]\ninputs = 'EB31'\nfault = true\n",
        ["8: [[example]] 1: fault = True; give a text or a number"],
    ),
    # several at once, in the order of their lines
    (
        f"{HEAD}gsd = 'n.gsd'\n[words]\na = {{ of = 0 }}\n"
        "[telegrams]\n9 = { out = ['control', 'b'], in = ['status'] }\n",
        [
            "4: the file: gsd: n.gsd cannot be read (No such file or directory); give the path of the maker's GSD file",
            "6: the file: words: a: of = 0: a scale of zero or no number; give the value at full",
            "8: the file: telegrams: 9: out: 'b' is no word of this file; declare it in [words]",
        ],
    ),
]


@pytest.mark.parametrize(("text", "said"), BAD)
def test_a_mistake_has_its_line_and_a_remedy(text: str, said: list[str], tmp_path: Path) -> None:
    found = errors(written(tmp_path, text))
    assert [one[: len(beginning)] for one, beginning in zip(found, said, strict=True)] == said


def test_contents_that_are_no_text(tmp_path: Path) -> None:
    path = tmp_path / "d.toml"
    path.write_bytes(HEAD.encode() + b"# \xff\n")
    assert errors(path) == ["4: the file is no UTF-8 text; save it as UTF-8"]
    path.write_bytes(b"#" * 10_000_000)
    assert errors(path) == ["1: the file has more than 1 MB; a device file has some kB"]


def test_a_pipe_is_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    os.mkfifo(tmp_path / "pipe.gsd")
    with pytest.raises(DeviceFileError, match=r"pipe.toml cannot be read \(no ordinary file\)"):
        finding.read(tmp_path / "pipe.toml")
    (found,) = errors(written(tmp_path, f"{HEAD}gsd = 'pipe.gsd'\n{OWN}"))
    assert (
        found == "4: the file: gsd: pipe.gsd cannot be read (no ordinary file); give the path of the maker's GSD file"
    )
    (found,) = errors(written(tmp_path, f"{HEAD}{OWN}[fault]\ntexts = 'pipe.gsd'\n"))
    assert found.startswith("7: the file: fault: texts: pipe.gsd cannot be read (no ordinary file); ")


# --- bases ------------------------------------------------------------------------------------------------------------
def test_bases_that_are_not_there_or_go_in_a_circle(tmp_path: Path) -> None:
    path = written(tmp_path, 'format = 1\nname = "d"\nbase = "./e.toml"\n')
    assert errors(path) == [
        "3: base = './e.toml': there is no such file; it must be bits, drivecom, encoder, pa, profidrive "
        "or a device file"
    ]
    (tmp_path / "e.toml").write_text('format = 1\nname = "e"\nbase = "./d.toml"\n')
    circle = ["3: the bases stand on one another in a circle: d.toml; take a base of dpstack"]
    assert errors(path) == circle
    written(tmp_path, 'format = 1\nname = "d"\nbase = "d.toml"\n')
    assert errors(path) == circle
    written(tmp_path, 'format = 1\nname = "d"\nbase = 3\n')
    assert errors(path)[0].startswith("3: base = 3 is no name; ")


def test_a_chain_of_bases_has_an_end(tmp_path: Path) -> None:
    for number in range(20):
        (tmp_path / f"b{number}.toml").write_text(f'format = 1\nname = "b{number}"\nbase = "./b{number + 1}.toml"\n')
    (found,) = errors(written(tmp_path, 'format = 1\nname = "d"\nbase = "./b0.toml"\n'))
    assert found.startswith("3: the bases stand on one another in a circle")


# --- the GSD file -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("telegram", "said"),
    [
        (
            '9 = { modules = "6 PZD", out = ["control", "setpoint"], in = ["status", "speed"] }',
            "6: the file: telegrams: 9: telegram 9 has 4 octets of inputs and 4 of outputs, its identifiers F5 have",
        ),
        (
            '9 = { modules = "7 PZD", out = ["control"], in = ["status"] }',
            "6: the file: telegrams: 9: telegram 9: there is",
        ),
        (
            f'9 = {{ modules = {["6 PZD"] * 3}, out = ["control"], in = ["status"] }}',
            "6: the file: telegrams: 9: telegram 9: ",  # the device has two slots
        ),
        (
            '9 = { out = ["control", "setpoint", 0, 0, 0, 0, 0], in = ["status", "speed"] }',
            "6: the file: telegrams: 9: telegram 9: no single module has 4 octets of inputs and 14 of outputs",
        ),
        (
            '9 = { config = "F4 F0", out = ["control", 0, 0, 0, 0, 0], in = ["status", 0, 0, 0, 0, 0] }',
            "6: the file: telegrams: 9: telegram 9: config F4 F0 is in no module of the GSD file",
        ),
    ],
)
def test_telegrams_that_the_gsd_file_does_not_have(telegram: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "n.gsd").write_text(PROFIDRIVE)
    (found,) = errors(written(tmp_path, f"{HEAD}gsd = 'n.gsd'\n[telegrams]\n{telegram}\n"))
    assert found[: len(said)] == said


def test_a_gsd_file_brings_ident_number_and_identifiers(tmp_path: Path) -> None:
    (tmp_path / "n.gsd").write_text(PROFIDRIVE)
    own = 'own = { out = ["control", "setpoint", 0, 0, 0, 0], in = ["status", "speed", 0, 0, 0, 0] }'
    (tmp_path / "n.gsd").write_text(PROFIDRIVE.replace("0xF3,0xF1", "0xF3").replace("0xF5", "0xF6"))
    file = finding.drive_file_at(written(tmp_path, f"{HEAD}gsd = 'n.gsd'\n[telegrams]\n{own}\n"))
    assert file.telegrams["own"].spec.config == bytes.fromhex("C3 C5 C5 FD 01 60")
    profile = profile_of(file)
    assert (profile.ident, profile.ident_made_up) == (0x0FFD, False)


def test_a_gsd_file_that_is_damaged(tmp_path: Path) -> None:
    (tmp_path / "n.gsd").write_bytes(b"\x00\x01")
    (found,) = errors(written(tmp_path, f"{HEAD}gsd = 'n.gsd'\n{OWN}"))
    assert found.startswith("4: the file: ")


# --- code -------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "named",
    ["os:system", "os.system", "./evil.py", "evil", "evil:CORE", "/tmp/evil.py:CORE", "acme_drive:DRIVE"],
)
def test_a_device_file_names_no_code_but_what_a_package_has_registered(
    named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither a module, nor a path, nor an entry point of another kind; nothing of it is imported."""
    (tmp_path / "evil.py").write_text("raise SystemExit('imported')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    path = written(tmp_path, f'{HEAD}python = "{named}"\n{OWN}')
    with pytest.raises(ConfigError, match="no installed package has registered it") as caught:
        profile_of(finding.drive_file_at(path))
    assert "install it" in str(caught.value)


def test_a_configuration_names_no_code_by_a_device_file(tmp_path: Path) -> None:
    from dpstack.api.config.config import parse_config

    (tmp_path / "evil.py").write_text("raise SystemExit('imported')\n")
    for drive in ("./evil.py", "evil:CORE", "os:system"):
        with pytest.raises(ConfigError):
            parse_config(
                f'[bus]\nport = "virtual"\nbaud = 500000\n[[slave]]\nname = "a"\naddress = 3\ndrive = "{drive}"\n'
            )
