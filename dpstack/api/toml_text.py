"""Writing TOML: the little that skeletons and tables need."""

from __future__ import annotations

import json


def quoted(text: str) -> str:
    """A TOML string: JSON's escapes are TOML's too, but DEL is a character that TOML does not take as it is."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
