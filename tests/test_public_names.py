"""The public names: each documented, each signature as in the snapshot, nothing internal among them."""

from __future__ import annotations

import importlib
import inspect
import re

import pytest
from public_names import SNAPSHOT, lines

import dpstack
from tools.make_reference_docs import NAMESPACES

WRITER = "python tests/kits/public_names.py"


def test_every_signature_is_as_it_was() -> None:
    """A name that has become public stays. A change of the snapshot is a change for users: the CHANGELOG has it."""
    assert "\n".join(lines()) + "\n" == SNAPSHOT.read_text(encoding="utf-8"), f"run {WRITER}"


@pytest.mark.parametrize("namespace", NAMESPACES)
def test_each_public_class_and_function_has_a_docstring(namespace: str) -> None:
    module = importlib.import_module(namespace)
    assert module.__doc__
    assert sorted(set(module.__all__)) == sorted(module.__all__)
    bare = [
        name
        for name in module.__all__
        if (inspect.isclass(thing := getattr(module, name)) or inspect.isfunction(thing))
        and (not thing.__doc__ or re.match(rf"{name}\(", thing.__doc__))  # that of a dataclass without one
    ]
    assert bare == []


def test_a_bus_shows_its_users_what_they_need() -> None:
    """All public names of a bus are documented, and none is internal."""
    bus = dpstack.open_bus(port="virtual", baud=500_000)
    shown = [name for name in dir(bus) if not name.startswith("_")]
    assert not {"core", "runtime", "view", "parts", "command", "order", "publish", "services"} & set(shown)
    assert set(shown) <= set(vars(dpstack.Bus)) | {"class2"}


def test_a_name_that_is_in_a_namespace_says_so() -> None:
    with pytest.raises(AttributeError, match=r"'dpstack' has no attribute 'DpSlave': it is dpstack\.slave\.DpSlave$"):
        _ = dpstack.DpSlave  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match=r"'dpstack' has no attribute 'Buss'$"):
        _ = dpstack.Buss  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match=r"'dpstack\.gsd' has no attribute 'Lexer'$"):
        _ = dpstack.gsd.Lexer  # type: ignore[attr-defined]
