"""Modules that packages import as a whole and a program of ours seldom uses: imported with their first use.

For processes of our own only, which are the bus process and the commands: an application's modules are its own.
"""

from __future__ import annotations

import importlib
import os
import sys
from types import ModuleType
from typing import Final

#: modules that others import as a whole: dataclasses, urllib.parse (for pathlib), msgspec, the ports of Linux
_UNUSED: Final = ("inspect", "ipaddress", "textwrap", "glob", "msgspec.inspect")


class _Late(ModuleType):
    """A module that is imported with the first use of one of its names."""

    def __getattr__(self, name: str) -> object:
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        vars(self).update(vars(importlib.import_module(self.__name__)))
        return vars(self)[name] if name in vars(self) else super().__getattribute__(name)


def spare_imports() -> None:
    """Leave out a fifth of the octets of code, which packages import and nothing here uses, and load msgspec.

    msgspec does without ``typing_extensions`` if it is not installed. Of ``platform`` the module uuid, which msgspec
    imports, needs one function only.
    """
    for name in _UNUSED:
        sys.modules.setdefault(name, _Late(name))
    if "platform" not in sys.modules and sys.platform == "linux":
        sys.modules["platform"] = late = _Late("platform")
        vars(late)["system"] = lambda: os.uname().sysname
    if "typing_extensions" not in sys.modules:
        sys.modules["typing_extensions"] = None  # type: ignore[assignment]  # importing it raises ImportError
        import msgspec  # noqa: F401

        del sys.modules["typing_extensions"]
