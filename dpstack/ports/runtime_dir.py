"""The user's runtime directory: where sockets and links of running programs live, for this user alone."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

from dpstack.errors import PortError


def runtime_path(name: str) -> Path:
    """``name`` in the user's runtime directory, else in the temporary one with the user's id. Makes nothing."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and Path(runtime).is_dir():
        return Path(runtime) / name
    return Path(tempfile.gettempdir()) / f"{name}-{os.getuid()}"


def own_directory(path: Path) -> bool:
    """Make ``path`` with mode 0700, or check that it is a directory of ours. True when it was made.

    Raises PortError where it is somebody else's, OSError where it cannot be made.
    """
    try:
        path.mkdir(mode=0o700, parents=True)
    except FileExistsError:
        info = os.lstat(path)
        if stat.S_ISLNK(info.st_mode) or not stat.S_ISDIR(info.st_mode) or info.st_uid != os.geteuid():
            raise PortError(f"{path} is no directory of yours") from None
        return False
    return True
