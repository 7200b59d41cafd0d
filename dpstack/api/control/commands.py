"""Tables of the commands that running programs accept over the control socket; ``ParsedCommand``: a parsed command."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from dpstack.errors import UsageError
from dpstack.text import did_you_mean, nearest

#: for each name in a usage: the keyword argument that it becomes, and the parser of its text
Arguments = Mapping[str, tuple[str, Callable[[str], object]]]


class ParsedCommand(NamedTuple):
    """A parsed order to a drive or to the records of a slave.

    ``texts``: its arguments for the control socket; ``values``: the keyword arguments of the method that carries it
    out.
    """

    word: str
    texts: Sequence[str]
    values: Mapping[str, Any]


class Spec(NamedTuple):
    """A command. ``usage`` names its arguments: ``NAME``, ``[NAME]`` is optional, ``NAME...`` one or more."""

    name: str
    usage: str
    text: str
    example: str

    def check(self, args: Sequence[str]) -> None:
        """Raises UsageError when ``args`` are too few or too many."""
        names = self.usage.split()
        least = sum(not name.startswith("[") for name in names)
        if len(args) < least or (len(args) > len(names) and not self.usage.endswith("...")):
            example = f"{self.name} {self.example}".rstrip()
            raise UsageError(f"{self.name} takes {self.usage or 'no arguments'}, for instance: {example}")

    def order(self, args: Sequence[str], known: Arguments, options: Mapping[str, Any] | None = None) -> ParsedCommand:
        """The order with ``args``, parsed by the table ``known``, and ``options``. Raises UsageError."""
        self.check(args)
        names = [name.strip("[]") for name in self.usage.split()]
        parsers = [(known[name], text) for name, text in zip(names, args, strict=False) if name in known]
        values = {key: parse(text) for (key, parse), text in parsers}
        texts = [f"{key}={value}".lower() for key, value in (options or {}).items()]
        return ParsedCommand(self.name, (*args, *texts), {**values, **(options or {})})

    def as_dict(self) -> dict[str, str]:
        return {"command": self.name, "args": self.usage, "text": self.text, "example": self.example}


COMMON: Final = (
    Spec("help", "", "what this program knows", ""),
    Spec("status", "", "what it is doing at this moment", ""),
)
#: a stream of items without end, which `dpstack ctl` refuses
TAP: Final = Spec("tap", "", "the octets on its line, for `dpstack capture` and `dpstack monitor`", "")
#: likewise, for the live screen and the page
LIVE: Final = Spec("live", "[SECONDS]", "plant, snapshots every SECONDS (0.1), events", "0.5")
SLAVES: Final = (
    Spec("trip", "SLAVE CODE", "a fault of the simulated drive or encoder, by its code or name", "3 F2100"),
    Spec("warn", "SLAVE MASK", "its warning word in hex, 0 clears it", "3 0080"),
    Spec("turn", "SLAVE RPM", "turns the shaft of a simulated encoder", "5 60"),
    Spec("process", "SLAVE VALUE [NAME]", "what a simulated process device measures, in bar, degC, m, m3/h", "5 1.2"),
    Spec(
        "simulate", "SLAVE VALUE [STATUS] [BLOCK]", "its SIMULATE: a value and a status in hex, or off", "5 7.5 60 ai1"
    ),
    Spec("fail-safe", "SLAVE on|off", "its blocks go to fail-safe, as FSAFE_TYPE says", "5 on"),
    Spec("sensor-failure", "SLAVE on|off", "the sensor of a simulated process device breaks", "5 on"),
    Spec("maintenance", "SLAVE DEGREE", "its need of maintenance: required, demanded, alarm, off", "5 required"),
    Spec("function-check", "SLAVE on|off", "somebody works at it", "5 on"),
    Spec("out-of-service", "SLAVE on|off", "its function blocks are out of service", "5 on"),
    Spec("local-operation", "SLAVE on|off", "somebody operates it on site; a valve stays where it is", "6 on"),
    Spec("jam", "SLAVE on|off", "its valve cannot move", "6 on"),
    Spec("write-protect", "SLAVE on|off", "its switch for write protection", "5 on"),
    Spec("slow", "SLAVE SECONDS", "time that it takes for each Read or Write, 0 ends it", "5 2"),
    Spec("load", "SLAVE TORQUE", "load torque against the motion, of the rated torque", "3 0.6"),
    Spec("release", "SLAVE on|off", "its hardware release inputs", "3 off"),
    Spec("contact", "SLAVE CONTACT on|off", "a contact or terminal of a simulated drive", "3 S2 on"),
    Spec("set-point", "SLAVE HZ", "the internal set point of a drive that has one", "3 12.5"),
    Spec("acknowledge", "SLAVE", "acknowledges its fault at the keypad of the drive; ends alarms of an encoder", "3"),
    Spec("jog", "SLAVE forward|reverse|off", "the jog terminals of a drive that has them", "6 forward"),
    Spec("mains", "SLAVE on|off", "the inverter's power under an option with 24 V of its own", "3 off"),
    Spec("link", "SLAVE on|off", "the link between a drive's operator and its inverter", "5 off"),
    Spec(
        "parameter-error", "SLAVE ERROR [TIMES]", "the next accesses to its parameters end with this error", "4 104 3"
    ),
    Spec("input", "SLAVE [SLOT] HEX", "inputs of a simulated slave, or of one module", "8 01FF"),
    Spec("set", "SLAVE.FIELD=VALUE...", "named inputs of simulated slaves, and no other bits", "8.level=1200"),
    Spec("mirror", "SLAVE", "its inputs are its outputs again", "8"),
    Spec("wire-break", "SLAVE SLOT CHANNEL on|off", "the wire of an analogue input of it", "io 3 0 on"),
    Spec(
        "hart",
        "SLAVE SLOT CHANNEL FAULT [VALUE]",
        "a HART channel of it: slow, busy, delayed, damaged, garbled, silent, denied; status HEX; well",
        "io 2 0 busy 3",
    ),
    Spec("pull", "SLAVE SLOT", "takes a module out of it", "io 2"),
    Spec("plug", "SLAVE SLOT [MODULE]", "puts it in again, or another one", "io 2"),
    Spec("parameter", "SLAVE SLOT HEX", "parameters of a module, changed at the device", "io 1 03"),
    Spec("fault", "SLAVE KIND [KEY=VALUE]...", "a fault as in a scenario", "3 late_answers by_ms=20 for=3s"),
    Spec("normal", "SLAVE", "ends the faults of it that `fault` began", "3"),
    Spec("silence", "SLAVE [TIME]", "deaf and mute for a time, else until resume", "3 2s"),
    Spec("resume", "SLAVE", "ends a silence", "3"),
    Spec("power-off", "SLAVE", "switches the slave off", "3"),
    Spec("power-on", "SLAVE", "switches it on again; a drive keeps its EEPROM", "3"),
)
SEGMENT: Final = (
    Spec("noise", "RATE", "probability of a damaged bit from now on, 0 up to 1", "1e-4"),
    Spec("silence", "STATION [TIME]", "cuts a station off for a time, else until resume", "0 2s"),
    Spec("resume", "STATION", "connects it again", "0"),
    Spec("stats", "", "octets of each station, damaged octets", ""),
)
#: first argument of an order that is refused if it cannot reach the slave at this moment
NOW: Final = "now"
#: last argument of a question that the run answers from its own knowledge: no telegram is sent for it
UNASKED: Final = "unasked"
RUN: Final = (
    Spec("outputs", f"[{NOW}] SLAVE=HEX...", "output octets of slaves without a drive plugin", "9=00FF"),
    Spec("set", f"[{NOW}] SLAVE.FIELD=VALUE...", "named outputs, and no other bits", "8.limit=on 8.level=1200"),
    Spec("operate", "", "outputs go out", ""),
    Spec("clear", "", "inputs are read, outputs are zero", ""),
    Spec("stop", "", "ends the run in order: safe values, Clear", ""),
    Spec("drive", f"[{NOW}] NAME ORDER [ARG]...", "gives a drive orders, as `dpstack drive` does", "hoist speed 0.5"),
    Spec("order", "SLAVE ORDER [NAME=VALUE]...", "gives a device that is no drive an order", "5 preset value=1000"),
    Spec("acyclic", "SLAVE ORDER [ARG]...", "records of a slave, as `dpstack acyclic` does", "8 read 1 47"),
    Spec("class2", "SLAVE ORDER [ARG]...", "the same over a class 2 connection (MS2)", "8 read 1 47"),
    Spec(
        "diag",
        f"ADDRESS [{UNASKED}]",
        "diagnosis, configuration, inputs and outputs of any station, read as class 2",
        "8",
    ),
    Spec("fdl", "SERVICE ADDRESS [HEX] [NAME=VALUE]...", "an FDL service, as `dpstack fdl` does", "srd 9 01 dsap=20"),
    Spec("ppi", "ADDRESS ORDER [ARG]...", "an order to an S7-200, as `dpstack ppi` does", "2 read VW100 M0.3"),
    Spec("stats", "", "counters and rotation times up to now", ""),
    Spec(
        "rounds", "AFTER VALUE...", "values of each round after a round, for the oscilloscope of the page", "0 8.level"
    ),
    Spec("why", f"SLAVE [{UNASKED}]", "why a slave is not in data exchange, as `dpstack why` does", "valves"),
    Spec("refused", "ORIGIN ORDER REASON", "notes an order that a page has refused itself", "page operate unconfirmed"),
    Spec(
        "scan",
        f"[{UNASKED}]",
        "the live list 0..126 beside data exchange, with the identifier octets of each slave",
        "",
    ),
)

#: commands by kind of program; a ``run`` on the port "virtual" also has SLAVES
KINDS: Final = {"run": (*COMMON, TAP, LIVE, *RUN), "sim": (*COMMON, TAP, *SLAVES), "segment": (*COMMON, TAP, *SEGMENT)}


def find_word(word: str, known: Sequence[Spec], who: str = "a drive") -> Spec:
    """The order ``word`` of ``known``. Raises UsageError with the most similar word, or all; ``who``: its subject."""
    names = [spec.name for spec in known]
    if word in names:
        return known[names.index(word)]
    near = nearest(word.lower().replace("-", "_"), names, 0.6)
    hint = f"did you mean {near}?" if near else f"it knows {', '.join(names)}"
    raise UsageError(f"{who} does not know {word!r}; {hint}")


def find(kind: str, specs: Iterable[Spec], name: str) -> Spec:
    """The command ``name``. Raises UsageError with the most similar command, or the kind of program that has it."""
    known = {spec.name: spec for spec in specs}
    if name in known:
        return known[name]
    who = [other for other, theirs in KINDS.items() if any(spec.name == name for spec in theirs)]
    if who:
        raise UsageError(f"{name} is a command of `dpstack {who[0]}`, this is a {kind}; it knows: {', '.join(known)}")
    hint = did_you_mean(name.lower(), known, f"it knows: {', '.join(known)}")
    raise UsageError(f"unknown command {name!r}; {hint}")
