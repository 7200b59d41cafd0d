"""Tables of the faces that publish a plant, one for each face; docs/explanation/bridge.md says what a face is."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Final

from msgspec import Struct

from dpstack.api.config.table import Key, Source, Table, keys_of


def read_names(table: Table, name: str, _: Key) -> object:
    """Reader of a list of texts, such as ``allow_commands``."""
    value = table.raw(name)
    if not isinstance(value, list) or not all(isinstance(one, str) for one in value):
        table.fail(name, f"{name} = {value!r} is no list of texts", 'write for instance ["valves.lamp", "hoist.*"]')
    return tuple(value)


class FaceConfig(Struct, frozen=True, kw_only=True):
    """Base class of the tables."""


#: the class of each table by its name, which is that of its face
FACES: Final[dict[str, type[FaceConfig]]] = {}


def read_face(source: Source, name: str, data: object) -> FaceConfig:
    """The table ``name``. Raises ConfigError, also for a name that no face has."""
    if name not in FACES:
        known = ["bus", "slave", *FACES]
        near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.5)
        faces = "".join(f", [{face}]" for face in FACES)
        todo = f"did you mean {near[0]!r}?" if near else f"a configuration has [bus], [[slave]]{faces}"
        raise source.error((name,), f"unknown table or key {name!r}", todo)
    table = Table(source, (name,), data, f"[{name}]")
    return FACES[name](**table.read(keys_of(FACES[name])))


def read_faces(source: Source, tables: Mapping[str, object]) -> dict[str, FaceConfig]:
    """The tables of all faces, by name. Raises ConfigError."""
    return {name: read_face(source, name, data) for name, data in tables.items()}
