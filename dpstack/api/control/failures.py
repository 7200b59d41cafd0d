"""What failed at a drive, over the control socket: the error of the program as the same error of its client."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dpstack.errors import DpError, DriveError, DriveFault, DriveTimeout, ParameterError

_KINDS: Final = {kind.__name__: kind for kind in (DriveFault, DriveTimeout, DriveError)}


def told(error: DpError) -> dict[str, object]:
    """What an answer tells beside the text; nothing of what is no drive's."""
    if isinstance(error, ParameterError):
        return {"kind": ParameterError.__name__, "drive": error.drive, "number": error.number}
    return {"kind": type(error).__name__, "drive": error.drive} if isinstance(error, DriveError) else {}


def drive_error(answer: Mapping[str, object], text: str) -> DriveError | None:
    """The error that an answer tells of; None where it is no drive's."""
    kind, drive, number = answer.get("kind"), answer.get("drive"), answer.get("number")
    if not isinstance(drive, str):
        return None
    if kind == ParameterError.__name__ and isinstance(number, int):
        return ParameterError(drive, number, text)
    return _KINDS.get(str(kind), DriveError)(drive, text)
