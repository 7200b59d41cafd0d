"""Objects in modules of the user, by ``module:name``: functions of simulated slaves, slaves of one's own.

Loading a module runs it: callers do that only on the user's word.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

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
