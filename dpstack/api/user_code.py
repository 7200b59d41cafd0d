"""Objects in modules of the user, by ``module:name``: functions of simulated slaves, slaves of one's own.

Loading a module runs it: callers do that only on the user's word.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.errors import ConfigError


def load_object(name: str, folder: Path, what: str) -> object:
    """The object ``module:name``; Python looks for modules in ``folder`` first, from now on.

    ``what``: the kind of object, for messages. Raises ConfigError.
    """
    module_name, _, path = name.partition(":")
    beside = str(folder.absolute())
    if beside not in sys.path:
        sys.path.insert(0, beside)
    try:
        found: object = importlib.import_module(module_name)
    except Exception as error:  # whatever the module does while it is loaded
        raise ConfigError(
            f"{name!r} cannot be loaded ({type(error).__name__}: {error}); correct the module, or name another one"
        ) from None
    for part in path.split("."):
        try:
            found = getattr(found, part)
        except AttributeError:
            raise ConfigError(f"{module_name} has no {what} {path!r}; correct the name") from None
    return found


def load_description(name: str) -> SlaveDescription:
    """The description of the slave ``module:name`` or ``file.py:name``: a SlaveDescription, a DpSlave, or a class or
    function without arguments that makes one. Raises ConfigError.
    """
    module, colon, path = name.rpartition(":")
    if not (colon and module and path):
        raise ConfigError(f"{name!r} names no slave; write MODULE:NAME, for instance tank:TYPE")
    folder = Path()
    if module.endswith(".py"):
        folder, module = Path(module).parent, Path(module).stem
    found = load_object(f"{module}:{path}", folder, "description")
    described = _description_of(found)
    if described is None and callable(found):
        try:
            described = _description_of(found())
        except Exception as error:  # whatever the user's class does
            raise ConfigError(
                f"{name}: it cannot be made without arguments ({type(error).__name__}: {error}); name its description"
            ) from None
    if described is None:
        raise ConfigError(f"{name} is a {type(found).__name__}; name a SlaveDescription or a DpSlave")
    return described


def _description_of(found: object) -> SlaveDescription | None:
    described = found if isinstance(found, SlaveDescription) else getattr(found, "description", None)
    return described if isinstance(described, SlaveDescription) else None
