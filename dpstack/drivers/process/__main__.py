"""``python -m dpstack.drivers.process SOCKET MEMORY PARENT``: runs :mod:`dpstack.drivers.process.program`."""

from __future__ import annotations

import gc
import importlib
import sys
from types import ModuleType
from typing import Final

#: modules that others import as a whole: dataclasses, urllib.parse (for pathlib), msgspec, the ports of Linux
_UNUSED: Final = ("inspect", "ipaddress", "textwrap", "glob")


class _Late(ModuleType):
    """A module that is imported with the first use of one of its names."""

    def __getattr__(self, name: str) -> object:
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        vars(self).update(vars(importlib.import_module(self.__name__)))
        return vars(self)[name] if name in vars(self) else super().__getattribute__(name)


def _spare_imports() -> None:
    """Leave out a fifth of the octets of code, which packages import and nothing here uses. msgspec does without
    ``typing_extensions`` if it is not installed."""
    for name in _UNUSED:
        sys.modules.setdefault(name, _Late(name))
    if "typing_extensions" not in sys.modules:
        sys.modules["typing_extensions"] = None  # type: ignore[assignment]  # importing it raises ImportError
        import msgspec  # noqa: F401

        del sys.modules["typing_extensions"]


if __name__ == "__main__":
    gc.disable()  # modules stay: to look for garbage among them takes a tenth of the start
    _spare_imports()
    from dpstack.drivers.process.program import main

    sys.exit(main(sys.argv[1:]))
