"""``dpstack pa``: a process device of PROFIBUS PA."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from dpstack.api.config.config import Config, load_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.control.client import checked
from dpstack.api.control.record_orders import PA, parse_order
from dpstack.api.lists.list_file import ListComparison
from dpstack.api.pa.orders import (
    ANSWERS,
    COMPARE,
    DUMP,
    READ,
    SHOW,
    WORDS,
    WRITE,
    action_of,
    checked_order,
    timeout_argument,
)
from dpstack.api.pa.pa_list import GROUPS, IDENTITY, PaDifference, PaEntry, PaList, compared
from dpstack.cli import options
from dpstack.cli.commands import on_bus
from dpstack.cli.commands.acyclic import RecordOrder, add_master_options, master_of
from dpstack.cli.commands.lists import show_dump
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import UsageError
from dpstack.text import some_of

#: characters of the first column of an overview, and those before the second one
_WIDTH: Final = 20
_HANG: Final = _WIDTH + 3
#: colour of a value by its quality
_COLOURS: Final = {"bad": "red", "uncertain": "yellow", "stale": "yellow"}


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "example: dpstack pa plant.toml tank\n"
        "         dpstack pa plant.toml tank read ai1.pv_scale\n"
        "         dpstack pa plant.toml tank write tb1.lower_range 0\n"
        "         dpstack pa plant.toml tank dump tank.toml\n"
        "         dpstack pa plant.toml tank compare tank2 --class 2\n\norders:\n"
        + "\n".join(f"  {f'{word.name} {word.usage}':20} {word.text}" for word in WORDS)
    )
    parser.value("config", "CONFIG", "configuration file")
    parser.value("slave", "NAME", "the slave, by its name or address there")
    parser.value("order", "ORDER", "read, write ..., see below; without it: show", nargs="?", default=SHOW)
    parser.value("args", "ARG", "what belongs to it", nargs="*", default=[])
    parser.flag("--all", "compare: measured values and the maker's octets, too")
    parser.flag("--yes", "write: a reset, or a calibration that moves the valve")
    parser.value("--timeout", "S", "for each Read and Write, if the device answers slowly", type=options.seconds)
    add_master_options(parser)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if the device does not answer, refuses, or differs from the list."""
    config = load_config(args.config).with_bus(port=args.port, baud=args.baud)
    slave = on_bus.slave_of(config, args.slave)
    word, *rest = checked_order(args.order, args.args)
    if args.all and word != COMPARE:
        raise UsageError(f"--all is for {COMPARE}: leave it out")
    if args.yes and word != WRITE:
        raise UsageError(f"--yes is for {WRITE}: leave it out")
    action = action_of(rest[0]) if word == WRITE else None
    if action is not None and not args.yes:
        raise UsageError(f"{rest[0]} was not written: {action}; if the plant allows it, write it with --yes")
    asks = _Asks(config, args)
    match word:
        case "dump":
            return _dump(asks, slave, rest)
        case "compare":
            return _compare(asks, slave, rest[0])
        case "write":
            rest = [rest[0], " ".join(rest[1:])]
    answer = asks(slave, word, *rest)
    if args.json:
        output.json_line(_for_json(answer))
    else:
        _SHOW[word](answer)
    return 0


class _Asks:
    """Asks the devices of the configuration as the options say."""

    def __init__(self, config: Config, args: argparse.Namespace) -> None:
        self.config = config
        self.args = args

    def __call__(self, slave: SlaveConfig, *order: str) -> Mapping[str, Any]:
        """The answer of the device. Raises DpError."""
        args = self.args
        master = master_of(args, slave)
        parsed = parse_order(PA, (*order, *timeout_argument(args.timeout)), class2=master == 2, who="dpstack pa")
        word = f"{order[0]} of {slave.name}"
        answer = RecordOrder(self.config, slave, parsed, word, master, args.address).answer()
        checked(answer, ANSWERS[order[0]], self.config.port, PA)
        return answer


def _who(answer: Mapping[str, Any]) -> str:
    return f"slave {answer['address']} ({answer['slave']})"


def _for_json(answer: Mapping[str, Any]) -> dict[str, Any]:
    """The answer with the order as typed; the list of an overview has the key ``blocks``."""
    plain = {**answer, "order": answer["asked"]}
    del plain["asked"]
    if plain["order"] == SHOW:
        plain["blocks"] = plain.pop("parameters")
    return plain


# --- show, read, write ----------------------------------------------------------------------------------------------


def _show(answer: Mapping[str, Any]) -> None:
    identity, diagnosis = answer["identity"], answer["diagnosis"]
    name = " ".join(part for part in (identity["maker"], identity["device"]) if part)
    output.line(f"{_who(answer)}: {name or 'a PA device'}")
    rows = [(title, text) for title, text in _identity_rows(answer) if text]
    for title, text in rows:
        _row(title, text)
    texts = [*diagnosis["texts"], *diagnosis["extension_texts"]]
    category = diagnosis["category"]
    state = "; ".join(texts) or "nothing to report"
    _row("diagnosis", state, "yellow" if category else "")
    for block in answer["parameters"]:
        _show_block(block)
    for remark in answer["remarks"]:
        output.line(f"remark: {remark}", "yellow")


def _row(title: str, text: str, style: str = "") -> None:
    output.line(f"  {title:{_WIDTH}} {text}", style, _HANG)


def _identity_rows(answer: Mapping[str, Any]) -> list[tuple[str, str]]:
    identity, directory = answer["identity"], answer["directory"]
    where = "without a directory" if directory is None else f"directory in slot {directory}"
    return [
        ("tag", identity["tag"]),
        ("serial number", identity["serial"]),
        ("revisions", ", ".join(_revisions(identity))),
        ("profile", f"{identity['profile']}, {where}" if identity["profile"] else where),
        ("ident number", identity["ident_selector"]),
        ("descriptor", identity["descriptor"]),
        ("message", identity["message"]),
        ("installed", identity["installed"]),
        ("write protection", answer["write_protection"]),
    ]


def _revisions(identity: Mapping[str, str]) -> list[str]:
    return [f"{what} {identity[what]}" for what in ("software", "hardware") if identity[what]]


#: parameters that the head of an overview shows
_IN_HEAD: Final = frozenset(
    {
        "software_revision",
        "hardware_revision",
        "device_man_id",
        "device_id",
        "device_ser_num",
        "diagnosis",
        "diagnosis_extension",
        "descriptor",
        "device_message",
        "device_instal_date",
        "write_locking",
        "ident_number_selector",
        "hw_write_protection",
    }
)


def _show_block(block: Mapping[str, Any]) -> None:
    tag = f", tag {block['tag'].strip()}" if block["tag"].strip() else ""
    output.line(f"{block['name']}: {block['kind']}, slot {block['slot']} index {block['index']}{tag}", "bold", 2)
    mode, target = block["mode"], block["target_mode"]
    if mode:
        wanted = "" if not target or mode.startswith(f"{target} ") else f", wanted {target}"
        _row("mode", f"{mode}{wanted}")
    if block["alarms"]:
        _row("alarms", block["alarms"], "" if block["alarms"] == "none" else "yellow")
    for one in block["values"]:
        name = one["name"].partition(".")[2]
        if name not in _IN_HEAD:
            _row(name, one["text"], _COLOURS.get(one.get("quality", ""), ""))


def _show_read(answer: Mapping[str, Any]) -> None:
    found = answer["parameters"]
    if len(found) == 1 and found[0]["name"].lower() != answer["name"].lower().strip() + ".":
        one = found[0]
        output.line(
            f"{_who(answer)}: {one['name']} = {_text(one)} ({one['type']}, slot {one['slot']} index {one['index']})",
            _COLOURS.get(one.get("quality", ""), ""),
        )
        return
    rows = [(one["name"], one["index"], one["type"], _text(one), _access(one)) for one in found]
    title = f"{_who(answer)}: {len(found)} parameters of {answer['name']}"
    output.table(title, ("name", "index", "type", "value", ""), rows)


def _access(one: Mapping[str, Any]) -> str:
    return {"r": "ro", "rm": "MAN, O/S"}.get(one["access"], "")


def _text(one: Mapping[str, Any]) -> str:
    return f"cannot be read: {one['unreadable']}" if "unreadable" in one else str(one["text"])


def _show_written(answer: Mapping[str, Any]) -> None:
    output.line(f"{_who(answer)}: {answer['text']}")


_SHOW: Final = {SHOW: _show, READ: _show_read, WRITE: _show_written}


# --- dump, compare --------------------------------------------------------------------------------------------------


def _dump(asks: _Asks, slave: SlaveConfig, rest: Sequence[str]) -> int:
    if not rest:
        answer = asks(slave, DUMP)
        if asks.args.json:
            output.json_line(_for_json(answer))
            return 0
        found = PaList.of_answer(answer)
        rows = [(one.name, one.type, one.shown, one.group) for one in found.parameters]
        output.table(f"{_who(answer)}: {len(rows)} parameters", ("name", "type", "value", "group"), rows)
        _warn(answer)
        return 0
    with PaList.file(rest[0], slave.name) as file:
        answer = asks(slave, DUMP)
        found = PaList.of_answer(answer)
        found.keep(file)
    head = {**_head(answer, DUMP), "file": rest[0], "remarks": answer["remarks"]}
    show_dump(_who(answer), found, head, [one.for_json() for one in found.unreadable], json=asks.args.json)
    if not asks.args.json:
        _warn(answer)
    return 0


def _head(answer: Mapping[str, Any], word: str) -> dict[str, Any]:
    return {"order": word} | {key: answer[key] for key in ("slave", "address", "through", "maker", "device", "serial")}


def _warn(answer: Mapping[str, Any]) -> None:
    for remark in answer["remarks"]:
        output.warn(f"{_who(answer)}: {remark}")


def _compare(asks: _Asks, slave: SlaveConfig, other: str) -> int:
    neighbour = None if Path(other).exists() else asks.config.find(other)
    if neighbour is not None and neighbour.address == slave.address:
        raise UsageError(f"{other} is the device itself: name another slave, or a file")
    if neighbour is None:
        saved, words = PaList.load(other), ("file", slave.name)
    else:
        saved, words = PaList.of_answer(_answered(asks, asks(neighbour, DUMP))), (neighbour.name, slave.name)
    answer = _answered(asks, asks(slave, DUMP))
    found = compared(PaList.of_answer(answer), saved, everything=asks.args.all)
    if asks.args.json:
        output.json_line(_comparison_json(found, {**_head(answer, COMPARE), "with": other}))
    else:
        _show_comparison(found, _who(answer), other, words)
    return int(any(one.group != IDENTITY for one in found.differences))


def _answered(asks: _Asks, answer: Mapping[str, Any]) -> Mapping[str, Any]:
    if not asks.args.json:
        _warn(answer)
    return answer


def _comparison_json(found: ListComparison[PaDifference, PaEntry], head: Mapping[str, Any]) -> dict[str, Any]:
    differences = [
        {
            "name": one.saved.name,
            "group": one.group,
            "with": one.saved.for_json(),
            "device": one.found.for_json(),
            "elements": list(one.elements),
        }
        for one in found.differences
    ]
    skipped = [{"name": one.name, "reason": why} for one, why in found.skipped]
    return {**head, "same": found.same, "differences": differences, "skipped": skipped}


def _show_comparison(
    found: ListComparison[PaDifference, PaEntry], who: str, other: str, words: tuple[str, str]
) -> None:
    for group in GROUPS:
        listed = [one for one in found.differences if one.group == group]
        if listed:
            output.line(f"{group}:", "bold")
        for one in listed:
            output.line(f"  {one.line(*words)}", "" if group == IDENTITY else "yellow", 4)
    for why in dict.fromkeys(why for _, why in found.skipped):
        labels = some_of([one.name for one, reason in found.skipped if reason == why])
        output.line(f"not compared: {labels}: {why}")
    count = len(found.differences)
    output.line(f"{who}: {found.same} parameters are as in {other}, {count} differ{'s' if count == 1 else ''}")
