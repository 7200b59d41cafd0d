"""Configurations: the meaning of every key, and one line with file, line, problem and remedy for each mistake."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.config.config import Config, load_config, make_config, parse_config
from dpstack.drivers.line.asyncio_runtime import AsyncioRuntime
from dpstack.drivers.line.echo import Echo
from dpstack.errors import ConfigError
from dpstack.units import NS_PER_US

TERMINAL = Path(__file__).resolve().parents[3] / "examples" / "terminal.gsd"
BUS = '[bus]\nport = "/dev/ttyX"\nbaud = 500000\n'
RAW = '[[slave]]\nname = "raw"\naddress = 9\nident = 0x1234\nconfig = "20 10"\n'
DRIVE = '[[slave]]\nname = "hoist"\naddress = 3\ndrive = "demag-dedrive"\n'


def parse(text: str) -> Config:
    return parse_config(text, "plant.toml")


def test_the_documented_keys() -> None:
    config = parse(
        """
[bus]
port = "/dev/ttyUSB0"
baud = 500000
address = 1
driver = "asyncio"
t_sl = 400
max_retry = 3
gap = 0
hsa = 20
t_tr = 50000
host_slack_ms = 12.5
extra_idle_bits = 10
echo = "auto"
auto_clear = false
read_only = false

[[slave]]
name = "hoist"
address = 3
drive = "demag-dedrive"
telegram = "PPO3"
watchdog_ms = 250
groups = [2, 1]
reference_hz = 87
dpv1 = false

[[slave]]
name = "raw"
address = 9
ident = 0x1234
config = "20, 10"
user_prm = "0x01 02"
safe = "ff"
every = 2
min_slave_interval = 20
fail_safe = true
watchdog_ms = 0
"""
    )
    bus = config.bus
    assert (bus.port, bus.baud, bus.address, bus.driver) == ("/dev/ttyUSB0", 500_000, 1, "asyncio")
    assert (bus.t_sl, bus.max_retry, bus.gap, bus.hsa, bus.t_tr) == (400, 3, 0, 20, 50_000)
    assert (bus.host_slack_ms, bus.extra_idle_bits) == (12.5, 10)
    hoist, raw = config.slave_params
    assert (hoist.ident, hoist.config, hoist.user_prm) == (0x0696, b"\x71", bytes(16))
    assert (hoist.watchdog_ms, hoist.groups, hoist.fail_safe, hoist.max_tsdr[500_000]) == (250, (1, 2), True, 100)
    assert hoist.on_loss
    assert (raw.ident, raw.config, raw.user_prm) == (0x1234, b"\x20\x10", b"\x01\x02")
    assert (raw.safe, raw.every, raw.fail_safe, raw.watchdog_ms) == (b"\xff", 2, True, 0)
    assert raw.min_slave_interval_ns == 2000 * NS_PER_US
    params = config.params()
    assert (params.t_sl, params.t_tr, params.gap, params.hsa, params.max_retry) == (400, 50_000, 0, 20, 3)
    assert params.extra_idle == 10


def test_defaults() -> None:
    config = parse(BUS + RAW)
    assert config.bus.address == 2
    (slave,) = config.slave_params
    assert slave.watchdog_ms is None
    assert slave.every == 1
    assert config.params().t_sl == 200


def test_t_sl_widens_to_the_slowest_slave() -> None:
    assert parse(BUS + DRIVE).params(45_450).t_sl == 640  # the table's
    assert parse(BUS + DRIVE).params(9600).max_tsdr == 60


def test_ident_asked_for_and_made_up() -> None:
    fan = '[[slave]]\naddress = 4\ndrive = "fuji-frenic"\n'
    (asked,) = parse(BUS + fan + 'ident = "ask"\n').slave_params
    assert asked.ident is None
    config = parse(BUS + fan)
    assert config.slave_params[0].ident == 0xDD04
    assert config.slaves[0].name == "slave4"
    assert any("made up" in note for note in config.slaves[0].notes)
    (given_one,) = parse(BUS + fan + "ident = 0x0ABC\n").slaves
    assert given_one.params.ident == 0x0ABC
    assert not any("ident number" in note for note in given_one.notes)


#: texts without a sound [bus] table, or with tables in conflict: the beginning of the one line of each
BAD: list[tuple[str, str]] = [
    ("", "1: no [bus] table; add [bus] with port and baud"),
    (BUS + "[[slaves]]\n", "4: unknown table or key 'slaves'; did you mean 'slave'?"),
    (BUS + "[slave]\naddress = 3\n", "4: [slave] must be [[slave]]; write two brackets: there may be"),
    ("bus = 3\n", "1: [bus] must be a table; write [bus] on a line of its own"),
    ("[bus\n", "1: not valid TOML at column 5: Expected ']' at the end of a table declaration; correct"),
    ("[bus]\nport = 'a", "2: not valid TOML"),
    (BUS + RAW + RAW, "11: slave raw and slave raw both have address 9; give one of them another address"),
    (
        BUS + RAW + RAW.replace("= 9", "= 8"),
        "10: the stations at address 9 and 8 are both called 'raw'; give each a name of its own",
    ),
    (BUS + RAW.replace("= 9", "= 2"), "6: slave raw has address 2, which is the master's own; give one of"),
    (BUS + RAW + 'name = ""\n', "9: not valid TOML"),
    (BUS + RAW.replace('"raw"', '" "'), "5: [[slave]] 1: name is empty; give it a value or leave it out"),
    (BUS + RAW.replace('"raw"', '"r\\u001bw"'), "5: [[slave]] 1: name = 'r\\x1bw' holds a control char"),
    (BUS + RAW + 'user_prm = "' + "00" * 238 + '"\n', "4: [[slave]] raw: slave 9 (raw): 238 octets of user"),
    (BUS + DRIVE.replace("dedrive", "dedriv"), "7: [[slave]] hoist: no drive is called 'demag-dedriv'; did"),
    (BUS.replace("500000", "500001"), "3: [bus]: 500001 is no PROFIBUS rate; nearest is 500000; known: 9600"),
    (BUS.replace("500000", "-1"), "3: [bus]: -1 is no PROFIBUS rate; nearest is 9600; "),
    (BUS.replace("500000", '"fast"'), "3: [bus]: baud = 'fast' is a text; it must be an integer"),
    (BUS.replace("ttyX", "tty\\u0000X"), "2: [bus]: port = '/dev/tty\\x00X' holds a control character; "),
    (BUS.replace('"/dev/ttyX"', '""'), "2: [bus]: port is empty; give it a value or leave it out"),
    (BUS.replace('"/dev/ttyX"', "7"), "2: [bus]: port = 7 is an integer; it must be a text in quotes"),
]
#: a further line of [bus]
BAD_IN_BUS = {
    "adress = 3": "unknown key 'adress'; did you mean 'address'?",
    "hsa = 1": "address 2 lies above hsa 1; no other master would ever find it",
    'echo = "on"': "echo = 'on'; it must be \"auto\", true or false",
    "rs485 = 1": "rs485 = 1 is an integer; it must be true or false",
    'driver = "fast"': 'unknown driver \'fast\'; it must be "auto", "asyncio" or',
    "cycle_ms = 0": "cycle_ms = 0 is no time; give milliseconds, or leave it out",
    "cycle_ms = 1e-7": "cycle_ms = 1e-07 is no time; give milliseconds, or leave it",
    "cycle_ms = inf": "cycle_ms = inf is outside 0..60000; correct it or leave it out",
    "cycle_ms = true": "cycle_ms = True is true/false; it must be a number",
    "cpu = -1": "cpu = -1 is outside 0..8191; 0 is the first processor",
    "cpu = []": "cpu = []; give the number of a processor, 0 for the first one, or a list of them",
    'cpu = "0-3"': "cpu = '0-3'; give the number of a processor, 0 for the first one, or a list of them",
    "cpu = true": "cpu = True; give the number of a processor, 0 for the first one, or a list of them",
    "cpu = [1, 9000]": "cpu = [1, 9000]; give the number of a processor",
    "other_masters = -1": "other_masters = -1 is outside 0..125; how many there are",
    "other_masters = [2.5, -1]": "other_masters holds -1; give the bus rotation time",
    "other_masters = [true]": "other_masters holds True; give the bus rotation time",
    'other_masters = "two"': "other_masters = 'two' is a text; it must be an integer",
    "host_slack_ms = nan": "host_slack_ms = nan is outside 0..10000; correct it",
}
#: a further line of the slave "raw"
BAD_IN_RAW = {
    "watchdog = 3": "unknown key 'watchdog'; did you mean 'watchdog_ms'?",
    "zzz = 3": "unknown key 'zzz'; known keys: name, address",
    'telegram = "PPO1"': "telegram without drive; add drive, or leave",
    'safe = "00 00"': "safe has 2 octets; the configuration has 1 octets",
    "groups = [9]": "groups holds 9, outside 1..8; correct it or leave it",
    "groups = 1": "groups = 1 is an integer; it must be a list of integers",
    "watchdog_ms = 650251": "watchdog_ms = 650251 is outside 0..650250; 0 is off; leave it out for the plan's",
    "fail_safe = 1": "fail_safe = 1 is an integer; it must be true or false",
    "modules = []": "modules without gsd; name the GSD file, or leave",
    "parameters = {}": "parameters without gsd; name the GSD file, or",
    "dpv1 = true": "dpv1 needs user parameters that begin with the three",
}
#: a further line of the drive "hoist"
BAD_IN_DRIVE = {
    'telegram = "PPO9"': "demag-dedrive has no telegram 'PPO9'; it has",
    'config = "71"': "config beside drive; leave config out",
    "reference_hz = 0": "reference_hz = 0 is outside 0.001..1e+06;",
    "reference_rpm = 1500": "drive hoist (demag-dedrive): there is no option 'reference_rpm'; ",
}
#: a line of the slave "raw" that is left out or replaced, and the line that the message names
CHANGED: list[tuple[str, str, int, str]] = [
    ("address = 9\n", "", 4, "no address; add its station address, 0..125"),
    ("ident = 0x1234\n", "", 4, "no ident; add ident = 0x1234"),
    ('config = "20 10"\n', "", 4, "neither drive nor config; name a drive"),
    ("= 9", "= 126", 6, "address = 126 is outside 0..125; stations"),
    ("= 9", '= "9"', 6, "address = '9' is a text; it must be an integer"),
    ("= 9", "= true", 6, "address = True is true/false; it must be an"),
    ("= 9", "= 9.0", 6, "address = 9.0 is a decimal number; it must be an"),
    ("0x1234", '"x"', 7, "ident = 'x'; give a number like 0x0696, or"),
    ("0x1234", "0x12345", 7, "ident = 74565 is outside 0..65535; an ident"),
    ("20 10", "2x", 8, "config = '2x' is no hex ('x' is no hex digit);"),
    ("20 10", "201", 8, "config = '201' is no hex (an odd number of"),
    ("20 10", "C0", 8, "config: identifier octet 0 (0xc0) announces a"),
    ("20 10", "", 8, "config has 0 octets; 1..244 are possible"),
    ('"20 10"', "[32, 256]", 8, "config holds 256, which is no octet;"),
    ('"20 10"', "32", 8, "config = 32 is an integer; it must be octets"),
    ("config =", 'gsd = "x.gsd"\nconfig =', 9, "config beside gsd; leave config out, or gsd"),
]
BAD += [(f"{BUS}{line}\n", f"4: [bus]: {message}") for line, message in BAD_IN_BUS.items()]
BAD += [(f"{BUS}{RAW}{line}\n", f"9: [[slave]] raw: {message}") for line, message in BAD_IN_RAW.items()]
BAD += [(f"{BUS}{DRIVE}{line}\n", f"8: [[slave]] hoist: {message}") for line, message in BAD_IN_DRIVE.items()]
BAD += [(BUS + RAW.replace(old, new), f"{line}: [[slave]] raw: {message}") for old, new, line, message in CHANGED]


def test_the_cycle_and_the_other_masters() -> None:
    free = parse(BUS).bus
    assert (free.cycle_ms, free.cycle_ns, free.other_masters) == (None, 0, 0)
    fixed = parse(BUS + "cycle_ms = 2.5\nother_masters = 2\n").bus
    assert (fixed.cycle_ms, fixed.cycle_ns, fixed.other_masters) == (2.5, 2_500_000, 2)
    config = parse(BUS + "cycle_ms = 4\nother_masters = [2.5, 4]\n")
    assert (config.bus.cycle_ns, config.bus.other_masters) == (4_000_000, (2.5, 4.0))
    assert config.with_bus(address=5).bus.other_masters == (2.5, 4.0)


def test_a_byte_order_mark_is_no_error(tmp_path: Path) -> None:
    """Some editors begin a file with one."""
    path = tmp_path / "plant.toml"
    path.write_text(BUS + RAW, encoding="utf-8-sig")
    assert load_config(path).slaves[0].name == "raw"


@pytest.mark.parametrize(("text", "message"), BAD)
def test_bad_input_gets_one_line_with_problem_and_remedy(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse(text)
    assert str(caught.value).startswith(f"plant.toml:{message}")
    assert "\n" not in str(caught.value)
    assert "; " in str(caught.value)


def test_impossible_bus_parameters_name_the_line() -> None:
    with pytest.raises(ConfigError, match=r"^plant.toml:5: \[bus\]: bus parameters at 500 kbit/s: t_sl = 50 is less"):
        parse(BUS + "hsa = 30\nt_sl = 50\n").params()


def test_port_and_baud_may_be_missing_until_they_are_needed() -> None:
    config = parse("[bus]\naddress = 2\n" + RAW)
    assert len(config.slave_params) == 1
    with pytest.raises(ConfigError, match=r"^plant.toml:1: \[bus\]: no port; add port ="):
        _ = config.port
    with pytest.raises(ConfigError, match=r"^plant.toml:1: \[bus\]: no baud; add for instance"):
        _ = config.baud
    other = config.with_bus(port="virtual", baud=9600, address=None)
    assert other.virtual
    assert other.baud == 9600


def test_arguments_override_and_are_checked() -> None:
    config = parse(BUS + RAW)
    assert config.with_bus() is config
    assert config.with_bus(address=7).bus.address == 7
    with pytest.raises(ConfigError, match="is no PROFIBUS rate"):
        config.with_bus(baud=300)
    with pytest.raises(ConfigError, match="the master's own"):
        config.with_bus(address=9)


def test_initial_outputs() -> None:
    config = parse(BUS + RAW + DRIVE)
    (raw, _hoist) = config.with_outputs({9: b"\x5a"}).slaves
    assert raw.params.initial == b"\x5a"
    with pytest.raises(ConfigError, match="2 octets given; it has 1 octet "):
        config.with_outputs({9: b"\x5a\x5a"})
    with pytest.raises(ConfigError, match="no slave has it; configured: 3, 9"):
        config.with_outputs({7: b""})


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nosuch.toml: there is no such file; "):
        load_config(tmp_path / "nosuch.toml")
    (tmp_path / "motor.toml").write_text("")
    with pytest.raises(ConfigError, match=r"motr.toml: there is no such file; did you mean .*motor.toml\?$"):
        load_config(tmp_path / "motr.toml")
    with pytest.raises(ConfigError, match=r": is a directory; "):
        load_config(tmp_path)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r": is not UTF-8 text \(octet 0\); save it as UTF-8"):
        load_config(binary)
    good = tmp_path / "good.toml"
    good.write_text(BUS + RAW, encoding="utf-8")
    assert load_config(good).slaves[0].name == "raw"


def test_from_a_program() -> None:
    table: dict[str, object] = {"name": "raw", "address": 9, "ident": 0x1234, "config": bytes.fromhex("20 10")}
    config = make_config("virtual", 500_000, 2, [table], bus={"gap": 0})
    assert config.virtual
    assert config.bus.gap == 0
    with pytest.raises(ConfigError, match=r"^open_bus: slave raw: unknown key 'adres'; did you mean 'address'\?"):
        make_config("virtual", 500_000, 2, [table | {"adres": 1}])
    with pytest.raises(ConfigError, match=r"^open_bus: bus: unknown key 'gapp'; did you mean 'gap'\?"):
        make_config("virtual", 500_000, bus={"gapp": 0})


def one_line_or_nothing(read: Callable[[], object]) -> None:
    refusal = ""
    try:
        read()
    except ConfigError as error:
        refusal = str(error)
    assert "\n" not in refusal


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused_in_one_line(text: str) -> None:
    one_line_or_nothing(lambda: parse(text))


@given(
    st.dictionaries(
        st.sampled_from(["name", "address", "ident", "config", "user_prm", "safe", "groups", "every", "watchdog_ms"]),
        st.one_of(st.integers(), st.text(max_size=8), st.booleans(), st.floats(), st.lists(st.integers(), max_size=3)),
    )
)
def test_any_table_is_read_or_refused_in_one_line(table: dict[str, object]) -> None:
    one_line_or_nothing(lambda: make_config("virtual", 500_000, 2, [table]))


def test_the_event_character_is_off_unless_asked_for() -> None:
    text = '[bus]\nport = "/dev/ttyUSB0"\nbaud = 500000\n'
    assert parse_config(text).bus.event_char is False
    assert parse_config(text + "event_char = true").with_bus(address=5).bus.event_char is True
    with pytest.raises(ConfigError, match=r"plant.toml:4: .*event_char.* true or false"):
        parse_config(text + "event_char = 1", "plant.toml")


@pytest.mark.parametrize(("text", "echo"), [("", None), ('"auto"', None), ("true", True), ("false", False)])
def test_echo_is_found_out_unless_the_key_says_it(text: str, echo: bool | None) -> None:
    config = parse_config(BUS + 'driver = "asyncio"\n' + (f"echo = {text}\n" if text else ""))
    assert config.bus.echo is echo
    assert config.with_bus(address=5).bus.echo is echo  # checking the bus again keeps "auto"
    runtime = core_of(dpstack.open_bus(config)).runtime
    assert isinstance(runtime, AsyncioRuntime)
    assert runtime.echo is {None: Echo.AUTO, True: Echo.ON, False: Echo.OFF}[echo]


def test_a_rate_that_is_found_by_listening() -> None:
    config = parse_config(BUS.replace("500000", '"auto"'), "plant.toml")
    assert config.bus.baud == "auto"
    with pytest.raises(ConfigError, match=r"plant.toml:3: \[bus\]: baud \"auto\" is found when the bus is opened;"):
        _ = config.baud
    assert config.with_bus(baud=19_200).baud == 19_200
    assert config.with_bus(address=7).bus.baud == "auto"


def test_a_program_may_give_tuples_where_a_file_has_lists() -> None:
    slave = {"address": 5, "gsd": str(TERMINAL), "modules": ("8 DO", "8 DI"), "groups": (1, 2)}
    lists = {key: list(value) if isinstance(value, tuple) else value for key, value in slave.items()}
    made = [dpstack.open_bus(port="virtual", baud=500_000, slaves=(one,)).slave(5).setup for one in (slave, lists)]
    assert made[0] == made[1]
    assert (made[0].config, made[0].groups) == (b"\x20\x10", (1, 2))
