"""The public attributes of a class with a line about each, read from its source.

The line is the docstring of a property, the ``#:`` comment above or behind an attribute, or the string below it (Sphinx
reads the same). An attribute without any gets the sentence of the class docstring that names it.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

from tools.syntax import statements

#: folders whose classes are looked at
_ROOMS: Final = tuple(f"{Path(__file__).resolve().parents[1] / room}/" for room in ("dpstack", "drives", "tests"))
_PROPERTIES: Final = {"property", "cached_property", "functools.cached_property"}
_CONSTRUCTORS: Final = {"__init__", "__post_init__"}
_BUILT_IN: Final = {"bytes", "float", "int", "str"}
_COMMENT: Final = re.compile(r"\s*#: ?(.*)")
_BEHIND: Final = re.compile(r"\s#: ?(.*)")
_SENTENCE: Final = re.compile(r"(?<=[.;]) (?=[A-Z`])")
_NAME: Final = r"``{}``(?:\s\([^)]*\))?"


class Attribute(NamedTuple):
    name: str
    #: as written in the source; "" if it has none
    annotation: str
    #: "" if the source has none
    line: str


@cache
def _parsed(path: str) -> tuple[ast.Module, list[str]]:
    text = Path(path).read_text(encoding="utf-8")
    return ast.parse(text), text.splitlines()


def _source(kind: type) -> tuple[ast.ClassDef, list[str]] | None:
    """The definition of ``kind`` and the lines of its module; None for a class that no source of ours defines."""
    file = getattr(inspect.getmodule(kind), "__file__", None) or ""
    if not file.startswith(_ROOMS):
        return None
    tree, lines = _parsed(file)
    found = (node for node in statements(tree) if isinstance(node, ast.ClassDef) and node.name == kind.__name__)
    definition = next(found, None)
    return None if definition is None else (definition, lines)


def _comment(body: list[ast.stmt], place: int, lines: list[str]) -> str:
    """The line about the attribute that ``body[place]`` defines, or ""."""
    statement = body[place]
    above: list[str] = []
    for number in range(statement.lineno - 2, -1, -1):
        match = _COMMENT.fullmatch(lines[number])
        if match is None:
            break
        above.insert(0, match[1])
    behind = _BEHIND.search(lines[(statement.end_lineno or statement.lineno) - 1])
    following = body[place + 1] if place + 1 < len(body) else None
    below = following.value if isinstance(following, ast.Expr) else None
    if above:
        return " ".join(above)
    if behind is not None:
        return behind[1]
    return below.value if isinstance(below, ast.Constant) and isinstance(below.value, str) else ""


def _targets(statement: ast.stmt) -> list[ast.expr]:
    found = [statement.target] if isinstance(statement, ast.AnnAssign) else getattr(statement, "targets", [])
    return [part for target in found for part in (target.elts if isinstance(target, ast.Tuple) else [target])]


def _annotation(statement: ast.stmt, parameters: Mapping[str, str]) -> str:
    """The annotation of an assignment, or the type that its value shows."""
    if isinstance(statement, ast.AnnAssign):
        text = ast.unparse(statement.annotation)
        inner = re.fullmatch(r"(?:Final|ClassVar)\[(.*)\]", text)
        return inner[1] if inner is not None else "" if text == "Final" else text
    return _type_of(getattr(statement, "value", None), parameters)


def _type_of(value: ast.expr | None, parameters: Mapping[str, str]) -> str:
    """The type of a value as far as its expression shows it, else ""."""
    match value:
        case ast.Name(id=name):
            return parameters.get(name, "")
        case ast.Constant(value=constant) if constant is not None:
            return type(constant).__name__
        case ast.JoinedStr():
            return "str"
        case ast.Attribute(value=ast.Name(id=kind), attr=member) if member.isupper():
            return kind
        case ast.Call(func=ast.Name(id=kind)) if kind[:1].isupper() or kind in _BUILT_IN:
            return kind
        case ast.Call(func=ast.Subscript() as kind):
            return ast.unparse(kind)
    return ""


def _assigned(function: ast.FunctionDef, lines: list[str]) -> Iterator[Attribute]:
    """The attributes that a constructor gives its object."""
    arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    parameters = {one.arg: ast.unparse(one.annotation) for one in arguments if one.annotation is not None}
    for node in ast.walk(function):
        body: object = getattr(node, "body", None)
        if not isinstance(body, list):
            continue
        for place, statement in enumerate(body):
            for target in _targets(statement):
                if (
                    isinstance(target, ast.Attribute)
                    and isinstance(target.value, ast.Name)
                    and target.value.id == "self"
                ):
                    yield Attribute(target.attr, _annotation(statement, parameters), _comment(body, place, lines))


def _own(definition: ast.ClassDef, lines: list[str]) -> Iterator[Attribute]:
    for place, statement in enumerate(definition.body):
        if isinstance(statement, ast.FunctionDef) and statement.name in _CONSTRUCTORS:
            yield from _assigned(statement, lines)
        elif isinstance(statement, ast.FunctionDef):
            if _PROPERTIES & {ast.unparse(one) for one in statement.decorator_list}:
                returns = "" if statement.returns is None else ast.unparse(statement.returns)
                yield Attribute(statement.name, returns, ast.get_docstring(statement) or "")
        else:
            for target in _targets(statement):
                if isinstance(target, ast.Name):
                    line = _comment(definition.body, place, lines)
                    yield Attribute(target.id, _annotation(statement, {}), line)


def in_docstring(name: str, docstring: str) -> str:
    """The sentence of ``docstring`` about ``name``: what follows ``name``: at its beginning, or the whole one."""
    sentences = _SENTENCE.split(" ".join(docstring.split()))
    head = re.compile(
        rf"(?:{_NAME.format('[^`]+')}(?:, | and ))*{_NAME.format(name)}(?:(?:, | and ){_NAME.format('[^`]+')})*: "
    )
    for sentence in sentences:
        match = head.match(sentence)
        if match is not None:
            return sentence[match.end() :].rstrip(".;")
    return next((one.rstrip(".;") for one in sentences if f"``{name}``" in one), "")


def _described(kind: type) -> dict[str, Attribute]:
    """The public attributes that ``kind`` itself defines."""
    source = _source(kind)
    if source is None:
        return {}
    docstring = ast.get_docstring(source[0]) or ""
    found: dict[str, Attribute] = {}
    for name, annotation, line in _own(*source):
        if not name.startswith("_") and not (name in found and found[name].line):
            found[name] = Attribute(name, annotation, line or in_docstring(name, docstring))
    return found


def attributes(kind: type, left_out: Iterable[type] = ()) -> list[Attribute]:
    """The public attributes of ``kind`` in the order of the source, with those of its base classes of the project.

    Those that a class of ``left_out`` defines are missing, unless ``kind`` says something else about them.
    """
    found: dict[str, Attribute] = {}
    elsewhere: dict[str, Attribute] = {}
    for base in reversed(kind.__mro__):
        for name, one in _described(base).items():
            before = found.get(name) or elsewhere.get(name, Attribute(name, "", ""))
            whole = Attribute(name, one.annotation or before.annotation, one.line or before.line)
            if base in left_out:
                elsewhere[name] = whole
                found.pop(name, None)
            elif name not in elsewhere or elsewhere[name].line != whole.line:
                found[name] = whole
    return list(found.values())
