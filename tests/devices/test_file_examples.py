"""The examples of device files: octets of manuals with their meaning hold, and each contradiction is an error with the
example's line, what came out and what the file says."""

from __future__ import annotations

from pathlib import Path

import pytest

from dpstack.devices import finding
from dpstack.devices.examples import run_examples

#: words of PROFIdrive as SINAMICS's lists print them
DRIVE = """\
format = 1
name = "d"
base = "profidrive"
[telegrams]
353 = { pkw = true, out = ["control", "setpoint"], in = ["status", "speed"] }
[telegrams.354]
pkw = true
out = ["control", "setpoint", "limit", 7]
in = ["status", "speed", "load", "warning", "fault", "flags"]
[words]
limit = { type = "n2", neutral = 100, low = 0, high = 100 }
load = { full = 0x4000, of = 25, unit = "A" }
flags = { bits = { line = 1, motor = 15 } }
[derived]
phase = { of = "flags", shift = 4, mask = 0xF, when = 0x0002 }
[control]
bits = { mop_up = 13 }
[orders]
jog_on = { set = ["mop_up"] }
[fault]
texts = { 7011 = "F07011 motor overtemperature" }
[warning]
texts = { 0 = "A501 current limit" }
[parameters]
p1120 = { number = 1120, type = "f32", unit = "s", factory = 10 }
"""
#: the line of an [[example]] below it
LINE = DRIVE.count("\n") + 1


def run(tmp_path: Path, example: str) -> list[str]:
    path = tmp_path / "d.toml"
    path.write_text(f"{DRIVE}[[example]]\n{example}")
    (result,) = run_examples(finding.read(path))
    assert all(error.line == LINE and str(error).startswith(f"{path}:{LINE}: [[example]]: ") for error in result.errors)
    return [error.what.removeprefix("[[example]]: ") for error in result.errors]


IN = "telegram = '354'\ninputs = "
HOLDING = [
    'telegram = "353"\ninputs = "EB31 0000"\nstate = "ready_to_switch_on"\nfault = ""\nwarning = ""\nspeed = 0',
    # the channel in front may be there
    'telegram = "353"\ninputs = "0000 0000 0000 0000 EB37 2000"\nstate = "running"\nspeed = 0.5',
    # OFF1 was sent: the same status word is that of a drive that ramps down
    'telegram = "353"\ninputs = "EB37 2000"\nafter = "047E 0000"\nstate = "stopping"\nspeed = 0.5',
    f'{IN}"EBB8 E000 1000 0001 1B63 8032"\nstate = "fault"\nfault = "F07011"\nwarning = "A501 current limit"\n'
    "speed = -0.5\nvalues = { load = 6.25, flags_line = true, flags_motor = true, phase = 3, status_warning = true }",
    f'{IN}"EB38 0000 0000 0004 1B63 0030"\nfault = 7011\nwarning = 2\nvalues = {{ phase = 0, flags = 0x30 }}',
    f'{IN}"EB31 0000 0000 0000 0000 0000"\noutputs = {{ start = "047F 0000 4000 0007", stop = "047E 0000 4000 0007", '
    '"speed -0.5" = "047E E000 4000 0007", "start, speed 0.5" = "047F 2000 4000 0007", coast = "047C 0000 4000 0007", '
    '"start, set limit 50" = "047F 0000 2000 0007", jog_on = "247E 0000 4000 0007" }',
    f'{IN}"EB38 0000 0000 0000 1B63 0000"\n'
    'outputs = { acknowledge = ["0480 0000 4000 0007", "0400 0000 4000 0007"] }',
    # without inputs: the simulated drive answers
    'telegram = "353"\n'
    'outputs = { start = "047F 0000", acknowledge = ["0480 0000", "047E 0000"], quick_stop = "047A 0000" }',
    'parameter = "read p1120"\nrequest = "1460 0000 0000 0000"\nanswer = "2460 0000 4120 0000"\nvalue = 10',
    'parameter = "read 1120"\nanswer = "2460 0000 4048 F5C3"\nvalue = 3.14',
    'parameter = "write p1120 2.5"\nrequest = "3460 0000 4020 0000"\nanswer = "2460 0000 4020 0000"',
    'parameter = "write p1120 2.5"\nrequest = "3460 0000 4020 0000"',
]


@pytest.mark.parametrize("example", HOLDING)
def test_octets_of_a_manual_hold(example: str, tmp_path: Path) -> None:
    assert run(tmp_path, example) == []


CONTRADICTING = [
    (
        'telegram = "353"\ninputs = "EB31 0000"\nstate = "running"',
        ["inputs EB31 0000 mean the state ready_to_switch_on, not running"],
    ),
    (
        'telegram = "353"\ninputs = "EB37 2000"\nspeed = 0.25\nstate = "ready"',
        ["inputs EB37 2000 mean the state running, not ready", "inputs EB37 2000 mean the speed 0.5, not 0.25"],
    ),
    (
        f'{IN}"EB38 0000 0000 0001 1B63 0000"\nfault = ""\nwarning = ""',
        [
            "inputs EB38 0000 0000 0001 1B63 0000 mean the fault F07011 motor overtemperature, not none",
            "inputs EB38 0000 0000 0001 1B63 0000 mean the warning A501 current limit, not none",
        ],
    ),
    (
        f'{IN}"EB38 0000 0000 0000 1B63 0000"\nfault = "F30001"',
        ["inputs EB38 0000 0000 0000 1B63 0000 mean the fault F07011 motor overtemperature, not F30001"],
    ),
    (
        f'{IN}"EB38 0000 0000 0000 1B63 0000"\nfault = 3',
        ["inputs EB38 0000 0000 0000 1B63 0000 mean the fault 7011 (F07011 motor overtemperature), not 3"],
    ),
    ('telegram = "353"\ninputs = "EB38 0000"\nfault = 3', ["telegram 353 has no word with the fault"]),
    (
        f'{IN}"EB31 0000 1000 0000 0000 0002"\nvalues = {{ load = 7, flags_line = false }}',
        [
            "inputs EB31 0000 1000 0000 0000 0002 mean load = 6.25, not 7",
            "inputs EB31 0000 1000 0000 0000 0002 mean flags_line = true, not false",
        ],
    ),
    (
        f'{IN}"EB31 0000 1000 0000 0000 0002"\nvalues = {{ power = 7 }}',
        ["telegram 354 has no value 'power'"],
    ),
    ('telegram = "353"\ninputs = "EB31"', ["inputs EB31 have 2 octets, telegram 353 has 4"]),
    ('telegram = "9"\ninputs = "EB31"', ["d has no telegram '9'"]),
    ('options = { what = 1 }\ninputs = "EB31 0000"', ["drive example (d): there is no option 'what'"]),
    (
        'telegram = "353"\ninputs = "EB31 0000"\noutputs = { start = "047E 0000" }',
        ["'start' sends 047F 0000, not 047E 0000"],
    ),
    (
        'telegram = "353"\noutputs = { acknowledge = ["047E 0000", "0480 0000"] }',
        ["'acknowledge' sends 0480 0000, then 0400 0000, then 047E 0000, not 047E 0000, then 0480 0000"],
    ),
    (
        'telegram = "353"\ninputs = "EB38 0000"\noutputs = { start = "047F 0000" }',
        ["'start' sends 047E 0000, not 047F 0000 (fault "],
    ),
    (
        'telegram = "353"\noutputs = { "speed 3" = "047E 7FFF" }',
        ["'speed 3' sends nothing, not 047E 7FFF (setpoint 3 is outside -2..1.99"],
    ),
    (
        'telegram = "353"\noutputs = { "jog" = "047E 7FFF" }',
        ["'jog' sends nothing, not 047E 7FFF (d has no order 'jog'"],
    ),
    ('telegram = "353"\noutputs = { "speed x" = "047E 7FFF" }', ["'speed x': 'x' is no number"]),
    ('telegram = "353"\noutputs = { "set limit" = "047E 7FFF" }', ["'set limit' is no order"]),
    (
        'parameter = "read p1120"\nrequest = "1461 0000 0000 0000"\nanswer = "2460 0000 4120 0000"',
        ["'read p1120' sends 1460 0000 0000 0000, not 1461 0000 0000 0000"],
    ),
    ('parameter = "read p1120"\nanswer = "2460 0000 4120 0000"\nvalue = 5', ["'read p1120' gives 10, not 5"]),
    (
        'parameter = "read p1120"\nanswer = "7460 0000 0000 0011"\nvalue = 5',
        ["the answer 7460 0000 0000 0011 to 'read p1120' gives no value (parameter p1120 (p1120): error 17"],
    ),
    ('parameter = "read p1120"\nrequest = "1460"', ["the request 1460 has 2 octets"]),
    ('parameter = "erase p1120"\nrequest = "1460 0000 0000 0000"', ["'erase p1120' is no order"]),
    (
        'parameter = "read p9"\nrequest = "1460 0000 0000 0000"',
        ["'read p9' sends nothing, not 1460 0000 0000 0000 (no parameter "],
    ),
    (
        'telegram = "1"\nparameter = "read p1120"\nrequest = "1460 0000 0000 0000"',
        ["telegram 1 has no parameter channel"],
    ),
]


@pytest.mark.parametrize(("example", "said"), CONTRADICTING)
def test_a_contradiction_says_what_came_out_and_what_the_file_says(
    example: str, said: list[str], tmp_path: Path
) -> None:
    found = run(tmp_path, example)
    assert [one[: len(beginning)] for one, beginning in zip(found, said, strict=True)] == said


@pytest.mark.parametrize("path", finding.files().values(), ids=lambda path: path.stem)
def test_the_examples_of_every_file_hold(path: Path) -> None:
    assert [str(error) for result in run_examples(finding.file_at(path)) for error in result.errors] == []
