"""``dpstack device check``: the mistakes of a device file, its examples, its drive in the simulation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from dpstack.cli.terminal import output
from dpstack.devices import finding
from dpstack.devices.examples import run_examples
from dpstack.devices.model import DeviceFile, FileFacts
from dpstack.devices.profiles import profile_of
from dpstack.devices.reader import DeviceFileError
from dpstack.errors import ConfigError, UsageError
from dpstack.profile.drive_profile import DriveProfile
from dpstack.testing.drive_conformance import Outcome, run_checks, run_exchange

#: ident number in the simulation of a drive whose file has none
_IDENT: Final = 0xFFF0
#: set points of the checks in parts of the reference: each way, or for a drive with one direction only
_BOTH_WAYS: Final = (0.5, -0.25)
_ONE_WAY: Final = (0.5, 0.25)
#: seconds to rest, at least
_REST_S: Final = 10.0


def check_file(name: str, telegrams: Sequence[str], *, json: bool) -> int:
    """Exit code 1 if something does not hold. Raises ConfigError if there is no such file."""
    path = place_of(name)
    errors: tuple[ConfigError, ...] = ()
    file = None
    try:
        file = finding.read(path)  # by the path as it was given, for the messages
        profile = profile_of(file) if isinstance(file, DeviceFile) else None
    except DeviceFileError as error:
        errors = error.errors
    except ConfigError as error:
        errors = (error,)  # the Python that it names
    if errors or file is None:
        return _report(path, file, errors, (), (), json=json)
    unknown = [one for one in telegrams if one not in file.telegrams]
    if unknown:
        raise UsageError(f"{file.name} has no telegram {unknown[0]!r}; it has {', '.join(file.telegrams)}")
    results = run_examples(file)
    contradictions = tuple(error for result in results for error in result.errors)
    lines = tuple(result.example.line for result in results)
    chosen = tuple(telegrams or file.own_telegrams or (file.default_telegram,))
    if isinstance(file, DeviceFile) and profile is not None:
        checks = _checks(file, profile, chosen)
    else:
        checks = tuple(run_exchange(str(path.resolve()), one, _made_up(file)) for one in chosen)
    return _report(path, file, contradictions, lines, checks, json=json)


def _checks(file: DeviceFile, profile: DriveProfile, telegrams: Sequence[str]) -> tuple[Outcome, ...]:
    return tuple(
        run_checks(
            profile,
            telegrams,
            nameless=[one for one in telegrams if not _names_faults(file, one)],
            keys=_made_up(file),
            speeds=_speeds(file),
            rest_s=_rest_s(file),
            stops_when_lost=file.simulate.lost != "go_on",
        )
    )


def _made_up(file: FileFacts) -> dict[str, object]:
    """The ident number in the simulation of a device whose file has none."""
    known = file.bus.ident is not None and not file.bus.made_up
    return {} if known or file.gsd is not None else {"ident": _IDENT}


def place_of(name: str) -> Path:
    """The path of a device file by its path or its name. Raises ConfigError."""
    if finding.is_path(name) or Path(name).is_file():
        path = Path(name)
        if not path.is_file():
            raise ConfigError(f"{path}: there is no such file; give the path of a device file")
        return path
    found = finding.path_of(name)
    if found is None:
        raise ConfigError(
            f"no device file is called {name!r}; give the path of one, or a name of `dpstack device list`"
        )
    return found


def _names_faults(file: DeviceFile, telegram: str) -> bool:
    """Whether a fault has a name with this telegram: by a word of it, or over its parameter channel."""
    word, one = file.fault.word, file.telegrams[telegram]
    carried = word in one.inputs or (word in file.derived and file.derived[word].of in one.inputs)
    return carried or (file.fault.parameter is not None and one.spec.channel)


def _speeds(file: DeviceFile) -> tuple[float, float]:
    return _ONE_WAY if any(word.part == "setpoint" and word.low == 0 for word in file.words.values()) else _BOTH_WAYS


def _rest_s(file: DeviceFile) -> float:
    """Twice the longest ramp."""
    ramps = (file.parameters.named(name) for name in (file.simulate.down, file.simulate.quick) if name)
    return max((2 * float(spec.factory) for spec in ramps if spec is not None), default=0.0) + _REST_S


def _report(
    path: Path,
    file: FileFacts | None,
    errors: Sequence[ConfigError],
    examples: Sequence[int],
    checks: Sequence[Outcome],
    *,
    json: bool,
) -> int:
    failed = [one for one in checks if not one.passed]
    sound = not errors and not failed
    if json:
        wrong = {error.line for error in errors} if examples else set()
        output.json_line(
            {
                "file": str(path),
                "name": path.stem if file is None else file.name,
                "title": "" if file is None else file.title,
                "base": "" if file is None else file.base,
                "sound": sound,
                "errors": [_as_dict(error) for error in errors],
                "examples": [{"line": line, "holds": line not in wrong} for line in examples],
                "checks": [
                    {"check": one.check, "telegram": one.telegram, "passed": one.passed, "reason": one.reason}
                    for one in checks
                ],
            }
        )
        return int(not sound)
    for error in errors:
        output.line(str(error), "bold red")
    if file is not None:
        output.line(f"{path}: {file.title}, base {file.base}, telegrams {' '.join(file.telegrams)}")
    if checks:
        holding = len(examples) - len({error.line for error in errors})
        output.line(f"examples: {holding} of {len(examples)} hold" if examples else "examples: it has none")
        rows = [(one.check, one.telegram, one.reason or "passed") for one in checks]
        output.table("in the simulation", ("check", "telegram", "result"), rows)
    found = _count(errors, "error")
    output.line(
        "sound" if sound else f"not sound: {found}" + (f", {_count(failed, 'check')} failed" if checks else ""),
        "green" if sound else "bold red",
    )
    return int(not sound)


def _count(found: Sequence[object], noun: str) -> str:
    return f"{len(found)} {noun}{'s' * (len(found) != 1)}"


def _as_dict(error: ConfigError) -> dict[str, Any]:
    return {"line": error.line, "what": error.what or str(error), "todo": error.todo}
