"""Plugins, those of this project and the examples of the book, touch no private name of the core."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import re
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

import dpstack
import dpstack_drives

ROOT = Path(__file__).parents[2]
#: pages whose blocks of Python are plugins
PAGES = ("docs/how-to/drive-plugin.md", "docs/reference/drives.md", "docs/how-to/test-a-drive-plugin.md")


def _modules() -> list[str]:
    packages = [dpstack_drives, _example()]
    return [one.name for package in packages for one in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")]


def _example() -> ModuleType:
    folder = str(ROOT / "examples" / "thirdparty_drive")
    sys.path.insert(0, folder)
    try:
        return importlib.import_module("acme_drive")
    finally:
        sys.path.remove(folder)


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__")


def _used(tree: ast.AST) -> set[str]:
    """The private names of ``self``, and the private methods, in a class."""
    found = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute) and _is_of_self(node)}
    return {
        name for name in found | {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
        if _is_private(name)
    }  # fmt: skip


def _is_of_self(node: ast.Attribute) -> bool:
    return isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")


def _class_names(kind: type) -> set[str]:
    return _used(ast.parse(textwrap.dedent(inspect.getsource(kind))))


def _touched(tree: ast.Module, classes: dict[str, type]) -> Iterator[str]:
    own = {name for node in ast.walk(tree) if isinstance(node, ast.ClassDef) for name in _used(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == dpstack.__name__:
            yield from (f"{node.module}.{alias.name}" for alias in node.names if _is_private(alias.name))
        if isinstance(node, ast.Attribute) and _is_private(node.attr) and not _is_of_self(node):
            yield from [ast.unparse(node)] if node.attr not in own | {"_replace", "_asdict"} else []
        if isinstance(node, ast.ClassDef):
            for base in classes[node.name].__mro__ if node.name in classes else ():
                if base.__module__.partition(".")[0] == dpstack.__name__:
                    yield from (f"{node.name}.{name} of {base.__name__}" for name in _used(node) & _class_names(base))


@pytest.mark.parametrize("name", _modules())
def test_a_plugin_touches_no_private_name_of_the_core(name: str) -> None:
    module = importlib.import_module(name)
    classes = {key: kind for key, kind in vars(module).items() if inspect.isclass(kind) and kind.__module__ == name}
    assert list(_touched(ast.parse(inspect.getsource(module)), classes)) == []


def test_the_plugins_in_the_book_touch_no_private_name_of_the_core() -> None:
    core = {name for kind in _core_classes() for name in _class_names(kind)}
    blocks = [
        block
        for page in PAGES
        for block in re.findall(r"^```python\n(.*?)^```", (ROOT / page).read_text(), re.M | re.S)
    ]
    assert blocks
    for block in blocks:
        tree = ast.parse(block)
        assert list(_touched(tree, {})) == []
        assert not core & {name for node in ast.walk(tree) if isinstance(node, ast.ClassDef) for name in _used(node)}


def _core_classes() -> Iterator[type]:
    from dpstack.profile.channel.pkw import PkwChannel
    from dpstack.profile.master.mapped_core import MappedCore
    from dpstack.profile.simulator.device import DriveDevice

    for kind in (MappedCore, DriveDevice, PkwChannel):
        yield from (base for base in kind.__mro__ if base.__module__.partition(".")[0] == dpstack.__name__)


def test_the_rule_sees_a_private_name() -> None:
    from dpstack.profile.master.core import DriveCore

    text = """
    from dpstack.profile.master.core import _near, DriveCore
    class Acme(DriveCore):
        def received(self):
            self._dirty = self._own = True
            self._build()
            self.records._queue
    """
    made = type("Acme", (DriveCore,), {})
    found = list(_touched(ast.parse(textwrap.dedent(text)), {"Acme": made}))
    assert found == ["dpstack.profile.master.core._near", "Acme._build of DriveCore", "self.records._queue"]
