"""Mutants of the source files: made by mutmut's operators, each with its place in the file."""

from __future__ import annotations

import ast
import difflib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import libcst
from libcst.metadata import MetadataWrapper, PositionProvider
from mutmut.configuration import config
from mutmut.mutation.file_mutation import NEVER_MUTATE_FUNCTION_NAMES, MutationVisitor, deep_replace
from mutmut.mutation.mutators import mutation_operators
from mutmut.mutation.pragma_handling import get_ignored_lines

ROOT: Final = Path(__file__).resolve().parents[2]
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True, slots=True)
class Place:
    """A line of a file, in the terms of Python's ast: what stands there and what it belongs to."""

    #: first and last line of the statement, without the body of a compound one
    first: int
    last: int
    #: qualified name of the outermost function, or of the class, or "" at the level of the module
    qualname: str
    #: line of the outermost function (of its first decorator), 0 outside of functions and in their first lines
    function_line: int
    #: names that a statement outside of functions defines
    names: tuple[str, ...]
    #: names at the level of the module through which a test sees it: it is part of their values
    through: tuple[str, ...] = ()
    #: first and last line of the body of the outermost function, 0 and 0 outside of functions
    body: tuple[int, int] = (0, 0)


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change of one file."""

    path: str
    number: int
    place: Place
    before: str
    after: str

    @property
    def room(self) -> str:
        return self.path.split("/")[1]

    @property
    def function(self) -> str:
        module = self.path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
        return f"{module}.{self.place.qualname}".rstrip(".")

    def diff(self) -> list[str]:
        """The lines that differ, without context."""
        lines = difflib.unified_diff(self.before.splitlines(), self.after.splitlines(), n=0, lineterm="")
        return [line for line in list(lines)[2:] if not line.startswith("@@")]


class SourceFile:
    """A source file and its mutants."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.before = (ROOT / path).read_text(encoding="utf-8")
        wrapper = MetadataWrapper(libcst.parse_module(self.before))
        self._module: Any = wrapper.module
        self._positions: Any = wrapper.resolve(PositionProvider)
        visitor: Any = MutationVisitor(mutation_operators, get_ignored_lines(path, self.before, wrapper))
        skip: Callable[[Any], bool] = visitor._skip_node_and_children

        def skip_node(node: Any) -> bool:
            # mutmut leaves out decorated functions, because it copies functions; nothing is copied here
            if isinstance(node, libcst.FunctionDef):
                return node.name.value in NEVER_MUTATE_FUNCTION_NAMES
            return skip(node)

        visitor._skip_node_and_children = skip_node
        wrapper.visit(visitor)
        self._mutations: Sequence[Any] = visitor.mutations

    def __len__(self) -> int:
        return len(self._mutations)

    def mutant(self, number: int) -> Mutant:
        """The mutant of that number, from 0."""
        mutation = self._mutations[number]
        after: str = deep_replace(self._module, mutation.original_node, mutation.mutated_node).code
        position = self._positions.get(mutation.original_node)
        line = position.start.line if position else _first_difference(self.before, after)
        place = self.place(line)
        name = place.qualname.split(".")[0] or next(iter(place.names), "")
        return Mutant(self.path, number, replace(place, through=self.seen_through(name)), self.before, after)

    def seen_through(self, name: str) -> tuple[str, ...]:
        """The names at the level of the module whose statements name ``name``, and those that name them, and so on."""
        found, new = {name}, {name}
        while new:
            new = {one for one, named in self._named_by.items() if named & new} - found
            found |= new
        return tuple(sorted(found))

    @cached_property
    def _named_by(self) -> dict[str, set[str]]:
        """Name at the level of the module -> the names in its statement (of a class or a function: in all of it)."""
        named: dict[str, set[str]] = {}
        for statement in self._tree.body:
            names = {node.id for node in ast.walk(statement) if isinstance(node, ast.Name)}
            for target in [ast.Name(statement.name)] if isinstance(statement, Function) else _targets(statement):
                if isinstance(target, ast.Name):
                    named.setdefault(target.id, set()).update(names - {target.id})
        return named

    @cached_property
    def _tree(self) -> ast.Module:
        return ast.parse(self.before)

    def place(self, line: int) -> Place:
        """The text at ``line``, from 1."""
        within: list[ast.stmt] = []
        body: Sequence[ast.stmt] = self._tree.body
        while True:
            for statement in body:
                if _first_line(statement) <= line <= (statement.end_lineno or 0):
                    within.append(statement)
                    break
            else:
                break
            body = list(_children(within[-1]))
        if not within:
            return Place(line, line, "", 0, ())
        inner = within[-1]
        children = [_first_line(child) for child in _children(inner)]
        last = min([start - 1 for start in children if start > line], default=inner.end_lineno or line)
        first = max([child.end_lineno or 0 for child in _children(inner) if (child.end_lineno or 0) < line], default=0)
        first = max(first + 1, _first_line(inner))
        path: list[str] = []
        for statement in within:
            if isinstance(statement, ast.ClassDef):
                path.append(statement.name)
            elif isinstance(statement, Function):
                qualname = ".".join((*path, statement.name))
                if line < _first_line(statement.body[0]):  # decorators, defaults of arguments
                    return Place(first, last, qualname, 0, (statement.name,))
                whole = (statement.body[0].lineno, statement.end_lineno or line)
                return Place(first, last, qualname, _first_line(statement), (), body=whole)
        names = {
            node.id if isinstance(node, ast.Name) else node.attr
            for target in _targets(inner)
            for node in ast.walk(target)
            if isinstance(node, ast.Name | ast.Attribute)
        }
        names.update(path[-1:])  # a value in a class is seen through the class, too
        return Place(first, last, ".".join(path), 0, tuple(sorted(names)))


def source_paths(rooms: Sequence[str]) -> list[str]:
    """The files of the rooms, by mutmut's configuration in pyproject.toml."""
    paths = [path for path in config().source_paths if path.name in rooms]
    return sorted(str(file) for path in paths for file in Path(path).rglob("*.py") if config().should_mutate(file))


def _first_line(statement: ast.stmt) -> int:
    decorators: list[ast.expr] = getattr(statement, "decorator_list", [])
    return min([decorator.lineno for decorator in decorators], default=statement.lineno)


def _children(statement: ast.stmt) -> Iterator[ast.stmt]:
    """The statements directly within a compound statement."""
    for node in ast.iter_child_nodes(statement):
        if isinstance(node, ast.stmt):
            yield node
        elif isinstance(node, ast.ExceptHandler | ast.match_case):
            yield from node.body


def _targets(statement: ast.stmt) -> Sequence[ast.AST]:
    if isinstance(statement, ast.Assign):
        return statement.targets
    if isinstance(statement, ast.AnnAssign | ast.AugAssign):
        return [statement.target]
    return [ast.Name(statement.name)] if isinstance(statement, ast.ClassDef) else []


def _first_difference(before: str, after: str) -> int:
    pairs = zip(before.splitlines(), after.splitlines(), strict=False)
    return next((line for line, (old, new) in enumerate(pairs, 1) if old != new), 1)
