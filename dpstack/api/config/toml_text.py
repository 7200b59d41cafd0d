"""Writing TOML: the little that skeletons and tables need."""

from __future__ import annotations

import json

from dpstack.errors import ConfigError
from dpstack.text import is_plain, long_escape


def quoted(text: str) -> str:
    """A TOML string; what is not plain stands as its escape. Raises ConfigError for what TOML cannot hold."""
    if any("\ud800" <= letter <= "\udfff" for letter in text):
        raise ConfigError(f"{text!r} is no Unicode text, as a TOML file must be; rename it")
    written = json.dumps(text, ensure_ascii=False)
    return "".join(letter if is_plain(letter) else long_escape(letter) for letter in written)
