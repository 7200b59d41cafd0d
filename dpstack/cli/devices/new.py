"""``dpstack device new``: a first device file from a GSD file, by questions on a terminal, by options elsewhere."""

from __future__ import annotations

import os
import re
import sys
from argparse import Namespace
from pathlib import Path
from typing import Final

from dpstack.api.config.device_draft import (
    PROFIDRIVE,
    TelegramDraft,
    check_words,
    draft_text,
    single_modules,
    telegram_of,
)
from dpstack.api.config.gsd_choice import base_name
from dpstack.api.files import AtomicFile
from dpstack.api.gsd_info import read_gsd
from dpstack.cli.terminal import output
from dpstack.cli.terminal.questions import Questions, say
from dpstack.devices.finding import DRIVE_BASES, ENDING
from dpstack.errors import UsageError
from dpstack.gsd.configuration import find_module
from dpstack.gsd.model import Device

_ALL: Final = "all"


def new_file(args: Namespace) -> int:
    """Write the file, or print it without ``-o``. Raises ConfigError, UsageError."""
    if not os.path.isfile(args.gsd):
        raise UsageError(f"{args.gsd}: there is no such GSD file; give the path of the maker's GSD file")
    device = read_gsd(args.gsd).device
    target = None if args.target is None else Path(args.target)
    folder = Path() if target is None else target.parent
    gsd = os.path.relpath(Path(args.gsd).resolve(), folder.resolve())
    asks = Questions("device new", "file") if sys.stdin.isatty() else None
    if asks is not None:
        say(f"{device.vendor} {device.model}")
    title = _title(args.title or f"{device.vendor} {device.model}".strip() or Path(gsd).stem)
    name = _name(args.name or (base_name(device.model) if target is None else target.stem))
    if args.name is None and target is None and asks is not None:
        name = asks.ask(f"name [{name}]: ", _name, name)
    if target is not None and target.name != name + ENDING:
        raise UsageError(f"{target}: the file of {name} must be called {name}{ENDING}")
    single = single_modules(device)
    base = args.base or _base(single, asks)
    telegrams = _telegrams(device, args, single, base, asks)
    text = draft_text(device, gsd, name, title, base, telegrams)
    if target is None:
        output.toml(text)
        return 0
    with AtomicFile(target) as file:
        file.keep(text.encode("utf-8"))
    say(f"{target}: written, telegrams {' '.join(one.name for one in telegrams)}; next: dpstack device check {target}")
    return 0


def _title(answer: str) -> str:
    return "".join(letter for letter in answer if letter.isprintable())


def _name(answer: str) -> str:
    if not re.fullmatch(r"\w[\w.-]*", answer):
        raise UsageError(f"{answer!r} is no name; write letters, digits and - , for instance g120")
    return answer


def _base(single: list[TelegramDraft], asks: Questions | None) -> str:
    default = PROFIDRIVE if any(one.known for one in single) else "bits"

    def read(answer: str) -> str:
        if answer not in DRIVE_BASES:
            raise UsageError(f"{answer!r} is no base; it must be {', '.join(DRIVE_BASES)}")
        return answer

    return default if asks is None else asks.ask(f"base, {', '.join(DRIVE_BASES)} [{default}]: ", read, default)


def _telegrams(
    device: Device, args: Namespace, single: list[TelegramDraft], base: str, asks: Questions | None
) -> list[TelegramDraft]:
    """The telegrams of the file, at least one, each with its words."""
    if args.modules:
        chosen = [_telegram(device, row, single) for row in args.modules]
    else:
        known = [one for one in single if one.known and base == PROFIDRIVE]
        chosen = known or (single if len(single) == 1 else [])
        if asks is not None and len(single) > 1:
            chosen = _ask_telegrams(asks, single, known)
        if not chosen:
            names = "; ".join(one.modules[-1].name for one in single[:8]) or "none alone"
            raise UsageError(f"no standard telegram is in this GSD file: name modules by --modules; they are {names}")
    doubles = [one.name for one in chosen if sum(one.name == other.name for other in chosen) > 1]
    if doubles:
        raise UsageError(f"two rows of modules make telegram {doubles[0]}; name each once")
    own = [one for one in chosen if not (one.known and base == PROFIDRIVE)]
    if (args.out or args.inputs) and len(own) != 1:
        raise UsageError("--out and --in are for one telegram that no standard has; name its modules by --modules")
    for one in own:
        if asks is not None and not (args.out or args.inputs):
            say(one.text)
            one.out = _ask_words(asks, one, one.out, outputs=True)
            one.in_ = _ask_words(asks, one, one.in_, outputs=False)
        else:
            one.out = check_words(one, args.out or one.out, outputs=True)
            one.in_ = check_words(one, args.inputs or one.in_, outputs=False)
    return chosen


def _telegram(device: Device, row: list[str], single: list[TelegramDraft]) -> TelegramDraft:
    """The telegram of a row of modules, or of the one module that makes the telegram of this name."""
    named = [one for one in single if [one.name] == row]
    return named[0] if named else telegram_of(device, [find_module(device, name) for name in row])


def _ask_telegrams(asks: Questions, single: list[TelegramDraft], known: list[TelegramDraft]) -> list[TelegramDraft]:
    for number, one in enumerate(single, 1):
        say(f"{number:>4}  {one.text}" + (f"  (telegram {one.name} of PROFIdrive)" if one.known else ""))
    default = " ".join(str(single.index(one) + 1) for one in known)

    def read(answer: str) -> list[TelegramDraft]:
        if answer == _ALL:
            return list(single)
        numbers = answer.replace(",", " ").split()
        if not numbers or not all(one.isdecimal() and 1 <= int(one) <= len(single) for one in numbers):
            raise UsageError(f"numbers of 1..{len(single)} with blanks between, or {_ALL}; type them")
        return [single[int(one) - 1] for one in dict.fromkeys(numbers)]

    return asks.ask(f"telegrams, by number{f' [{default}]' if default else ''}: ", read, default or None)


def _ask_words(asks: Questions, one: TelegramDraft, default: list[str], *, outputs: bool) -> list[str]:
    way = "to the drive" if outputs else "from the drive"
    shown = " ".join(default)
    prompt = f"words {way}, in their order, 0 for one that is not used [{shown}]: "
    return asks.ask(prompt, lambda answer: check_words(one, answer.split(), outputs=outputs), shown)
