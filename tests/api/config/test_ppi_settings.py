"""The key ``ppi`` of the plant file: S7-200 CPUs and their named values."""

from __future__ import annotations

import pytest

from dpstack.api.config.config import parse_config
from dpstack.errors import ConfigError, UsageError

BUS = '[bus]\nport = "virtual"\nbaud = 187500\n'
ENTRY = '{ address = 2, name = "press", values = { level = "VW100", on = "M0.3", timer = "T37", flow = "AIW4" } }'


def test_values_lie_one_behind_the_other() -> None:
    text = (
        'ppi = [{ address = 2, values = { level = "VW100", on = "M0.3", speed = { at = "VD8:real", unit = "m/s" }, '
        'time = "T37", parts = "C5", raw = "VB0[3]", cool = { at = "VW2:int", scale = 0.1 } }, '
        'allow_commands = ["on"], poll_ms = 250 }]\n'
    )
    (cpu,) = parse_config(text + BUS).ppi
    assert (cpu.address, cpu.name, cpu.poll_ms) == (2, "cpu2", 250)
    places = {name: (one.field.type, one.field.octet, one.field.length) for name, one in cpu.values.items()}
    assert places == {
        "level": ("u16", 0, 2),
        "on": ("bool", 2, 1),
        "speed": ("f32", 3, 4),
        "time": ("u32", 7, 4),
        "parts": ("u16", 11, 2),
        "raw": ("bytes", 13, 3),
        "cool": ("i16", 16, 2),
    }
    assert list(cpu.output_fields) == ["on"]
    assert list(cpu.input_fields) == ["level", "speed", "time", "parts", "raw", "cool"]
    assert cpu.input_fields.length == 18
    assert cpu.values["cool"].field.spec == "VW2:int"
    assert cpu.values["cool"].plain(-1.5) == -15
    assert cpu.values["time"].plain(9) == 9


@pytest.mark.parametrize(
    "text",
    [
        f"ppi = [{ENTRY}]\n{BUS}",
        f"{BUS}ppi = [{ENTRY}]\n",
        f'{BUS}[[slave]]\naddress = 9\nident = 1\nconfig = "20"\nppi = [{ENTRY}]\n',
        BUS + '[[ppi]]\naddress = 2\nname = "press"\nvalues = { level = "VW100" }\n',
    ],
)
def test_the_list_may_stand_anywhere(text: str) -> None:
    config = parse_config(text)
    assert [cpu.name for cpu in config.ppi] == ["press"]
    assert config.bus.address == 0  # left out: not that of a CPU as delivered


def test_a_plant_without_ppi_keeps_its_address() -> None:
    assert parse_config(BUS).bus.address == 2


@pytest.mark.parametrize(
    ("entries", "line", "message"),
    [
        ('{ address = 2, values = { level = "DB1.DBW0" } }', 1, "level: 'DB1.DBW0' is no address of an S7-200"),
        ("{ address = 2, values = { level = { scale = 2 } } }", 1, "no at; add the address of the value"),
        ('{ address = 2, values = { on = { at = "M0.1", scale = 2 } } }', 1, "on: bool has no scale"),
        ('{ address = 2, values = { "1 a" = "VW0" } }', 1, "'1 a' is no name for a field"),
        ("{ address = 2, values = {} }", 1, "0 values; 1 to 400 are possible; name at least one"),
        ("{ address = 2 }", 1, "no values; name at least one"),
        ('{ values = { a = "VW0" } }', 1, "no address; add the station address"),
        ('{ address = 2, name = "7", values = { a = "VW0" } }', 1, "looks like an address"),
        ('{ address = 126, values = { a = "VW0" } }', 1, "address = 126 is outside 0..125"),
        ('{ address = 2, valeus = { a = "VW0" } }', 1, "unknown key 'valeus'; did you mean 'values'"),
        ('{ address = 2, values = { a = "VW0" }, poll_ms = 1 }', 1, "poll_ms = 1 is outside"),
        (f"{ENTRY}, {ENTRY}", 1, "the CPU press and the CPU press both have address 2; write all values of one CPU"),
        (
            '{ address = 0, values = { a = "VW0" } }',
            1,
            "the CPU cpu0 has address 0, which is the master's own; give one of",
        ),
        ('{ address = 8, values = { a = "VW0" } }', 1, "slave lamp and the CPU cpu8 both have address 8; give one of"),
        ('{ address = 2, name = "lamp", values = { a = "VW0" } }', 1, "stations at address 8 and 2 are both called"),
        (f'{ENTRY[:-1]}, allow_commands = ["levle"] }}', 1, "no value is called 'levle'; did you mean level"),
        (f'{ENTRY[:-1]}, allow_commands = ["timer"] }}', 1, "timer is a timer, which only the CPU itself sets"),
        (f'{ENTRY[:-1]}, allow_commands = ["flow"] }}', 1, "flow is an analogue input"),
        ('"VW0"', 1, "is no list of tables; write ppi ="),
    ],
)
def test_errors_name_the_line_and_the_remedy(entries: str, line: int, message: str) -> None:
    text = f'ppi = [{entries}]\n{BUS}[[slave]]\naddress = 8\nname = "lamp"\nident = 1\nconfig = "20"\n'
    with pytest.raises(ConfigError, match=message) as raised:
        parse_config(text, "plant.toml")
    assert str(raised.value).startswith(f"plant.toml:{line}: ")


def test_an_unknown_value_names_the_nearest() -> None:
    (cpu,) = parse_config(f"ppi = [{ENTRY}]\n{BUS}").ppi
    with pytest.raises(UsageError, match=r"CPU 2 \(press\): no value is called 'levels'; did you mean level"):
        cpu.value("levels")
