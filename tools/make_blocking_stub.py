"""Writes ``dpstack/blocking/__init__.pyi``, the types of the blocking names, from the asynchronous classes.

    python -m tools.make_blocking_stub            the stub
    python -m tools.make_blocking_stub --check    ends with 1 where the stub is not what the classes say

The signatures are those of the proxies. Names in their annotations are imported from the modules that define them; the
names of proxy classes stand for these.
"""

from __future__ import annotations

import ast
import builtins
import functools
import inspect
import subprocess
import sys
import typing
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any, Final

import dpstack.blocking
from dpstack.blocking.proxies import Items, Proxy, asynchronous_class, blocking_signature
from tools import syntax

TARGET: Final = Path(dpstack.blocking.__file__ or "").with_suffix(".pyi")
_HEAD: Final = """# Made by tools/make_blocking_stub.py from the asynchronous classes; do not edit.
"""
_ITEMS: Final = """
class Items(Iterator[_T_co]):
    def __iter__(self) -> Self: ...
    def __next__(self) -> _T_co: ...
    def close(self) -> None: ...
"""


class Imports(ast.NodeTransformer):
    """The imports of the stub. Of two things with one name the second gets the name of its module before its own."""

    def __init__(self) -> None:
        #: the stub's names by module and name
        self.names: dict[tuple[str, str], str] = {}
        self._module = ""

    def written(self, text: str, module: str) -> str:
        """The annotation ``text``, which stands in ``module``, as the stub has it; its names are imported."""
        self._module = module
        return ast.unparse(self.visit(ast.parse(text, mode="eval")))

    def visit_Name(self, node: ast.Name) -> ast.Name:
        if hasattr(builtins, node.id) or node.id in dpstack.blocking.__all__:
            return node
        return ast.Name(self.local(node.id, origin(node.id, self._module)))

    def local(self, name: str, module: str) -> str:
        """The stub's name for ``name`` of ``module``."""
        if (module, name) not in self.names:
            taken = name in self.names.values()
            self.names[module, name] = f"{module.rpartition('.')[2]}_{name}" if taken else name
        return self.names[module, name]

    def __str__(self) -> str:
        lines = (
            f"from {module} import {name}" + (f" as {local}" if local != name else "")
            for (module, name), local in self.names.items()
        )
        return "\n".join(lines)


@functools.cache
def statements(module: str) -> tuple[ast.stmt, ...]:
    return tuple(syntax.statements(ast.parse(inspect.getsource(import_module(module)))))


def origin(name: str, module: str) -> str:
    """The module that defines ``name``, which ``module`` defines or imports."""
    value = getattr(import_module(module), name, None)
    if isinstance(value, type) and value.__name__ == name and value.__module__.startswith("dpstack"):
        return value.__module__
    for node in statements(module):
        if isinstance(node, ast.ImportFrom) and any((alias.asname or alias.name) == name for alias in node.names):
            place = node.module or ""
            return origin(name, place) if place.startswith("dpstack") else place
    return module


def public(kind: type[Proxy]) -> Iterator[tuple[str, Any]]:
    """The members of a proxy class in the order of their definition."""
    for name, member in vars(kind).items():
        if not name.startswith("_") or (name.startswith("__") and isinstance(member, FunctionType)):
            yield name, member


class Stub:
    def __init__(self) -> None:
        self.imports = Imports()
        for name in ("Self", "TypeVar"):
            self.imports.local(name, "typing")
        self.imports.local("Iterator", "collections.abc")

    def __str__(self) -> str:
        names = sorted(dpstack.blocking.__all__)
        kinds = [kind for kind in vars(dpstack.blocking).values() if isinstance(kind, type) and issubclass(kind, Proxy)]
        classes = "\n".join(self._class(kind) for kind in kinds if kind is not Items)
        functions = "\n".join(
            "".join(self._function(getattr(dpstack.blocking, name), "")) for name in names if name[0].islower()
        )
        listed = "".join(f'    "{name}",\n' for name in names)
        head = f'__all__ = [\n{listed}]\n\n_T_co = TypeVar("_T_co", covariant=True)\n'
        return "\n".join([_HEAD, str(self.imports), head, _ITEMS, classes, functions])

    def _class(self, kind: type[Proxy]) -> str:
        target = asynchronous_class(kind)
        lines = [f"class {kind.__name__}{self._bases(kind, target)}:"]
        for name, member in public(kind):
            if name in ("__enter__", "__exit__"):
                continue
            if name == "__iter__":
                lines.append(f"    def __iter__(self) -> {self._returned(target.__iter__)}: ...")
            elif isinstance(member, property):
                lines += self._property(name, member, target)
            elif isinstance(member, FunctionType):
                lines += self._function(member, "    ")
        if "__enter__" in vars(kind):
            entered = self._returned(target.__aenter__)
            trace = "kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None"
            self.imports.local("TracebackType", "types")
            lines += [f"    def __enter__(self) -> {entered}: ...", f"    def __exit__(self, {trace}) -> None: ..."]
        return "\n".join([*lines, "" if lines[1:] else "    ...\n"])

    def _bases(self, kind: type[Proxy], target: Any) -> str:
        if not issubclass(kind, Items):
            bases = [base.__name__ for base in kind.__bases__ if base is not Proxy]
            return f"({', '.join(bases)})" if bases else ""
        written = next(node for node in statements(target.__module__) if _is_class(node, target.__name__)).bases[0]
        text = ast.unparse(written).replace("AsyncIterator", "Items")
        return f"({self.imports.written(text, target.__module__)})"

    def _returned(self, function: Callable[..., object]) -> str:
        return self.imports.written(blocking_signature(function).return_annotation, function.__module__)

    def _property(self, name: str, made: property, target: Any) -> Iterator[str]:
        source = getattr(target, name, None)
        if isinstance(source, property):
            assert source.fget is not None
            text = self._returned(source.fget)
        else:
            owner = next(base for base in target.__mro__ if name in inspect.get_annotations(base))
            text = self.imports.written(inspect.get_annotations(owner)[name], owner.__module__)
        yield "    @property"
        yield f"    def {name}(self) -> {text}: ..."
        if made.fset is not None:
            assert isinstance(source, property)
            assert source.fset is not None
            value = list(inspect.signature(source.fset).parameters.values())[1]
            yield f"    @{name}.setter"
            annotation = self.imports.written(value.annotation, source.fset.__module__)
            yield f"    def {name}(self, {value.name}: {annotation}) -> None: ..."

    def _function(self, made: Any, indent: str) -> Iterator[str]:
        """One ``def``, or one for each overload."""
        source = made.__wrapped__
        overloads = typing.get_overloads(source)
        for one in overloads or [source]:
            signature = blocking_signature(one)
            if overloads:
                self.imports.local("overload", "typing")
                yield f"{indent}@overload"
            yield f"{indent}def {made.__name__}{self._written(signature, source.__module__)}: ..."
        yield from [""] * (not indent)

    def _written(self, signature: inspect.Signature, module: str) -> str:
        parameters = []
        for parameter in signature.parameters.values():
            if parameter.annotation is not parameter.empty:
                parameter = parameter.replace(annotation=_Written(self.imports.written(parameter.annotation, module)))
            if parameter.default is not parameter.empty:
                plain = type(parameter.default) in (bool, int, float, str, bytes, type(None))
                parameter = parameter.replace(default=_Written(repr(parameter.default) if plain else "..."))
            parameters.append(parameter)
        returns = self.imports.written(signature.return_annotation, module)
        return str(signature.replace(parameters=parameters, return_annotation=_Written(returns)))


class _Written:
    """A text that ``str(signature)`` has without quotation marks."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return self._text


def _is_class(node: ast.stmt, name: str) -> typing.TypeGuard[ast.ClassDef]:
    return isinstance(node, ast.ClassDef) and node.name == name


def stub() -> str:
    """The text of the stub, formatted."""
    text = str(Stub())
    for command in (["check", "--quiet", "--fix", "--exit-zero", "--select", "I"], ["format"]):
        ruff = [sys.executable, "-m", "ruff", *command, "--stdin-filename", str(TARGET), "-"]
        text = subprocess.run(ruff, input=text, capture_output=True, text=True, check=True).stdout
    return text


def main() -> None:
    text = stub()
    if "--check" not in sys.argv:
        TARGET.write_text(text, encoding="utf-8")
    elif TARGET.read_text(encoding="utf-8") != text:
        sys.exit(f"{TARGET} is not what the classes say: run python -m tools.make_blocking_stub")


if __name__ == "__main__":
    main()
