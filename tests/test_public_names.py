"""The public names: each documented, each signature as in the snapshot, nothing internal among them."""

from __future__ import annotations

import importlib
import inspect
import re
from enum import IntEnum

import pytest
from api_kit import in_virtual_time
from public_names import SNAPSHOT, lines

import dpstack
from dpstack.slave import DpSlave, SlaveDescription, serve_slave
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


def test_numbers_with_names_print_their_names() -> None:
    """Enums whose values are numbers of a standard; in calculations and with a format they are the numbers."""
    for namespace in NAMESPACES:
        module = importlib.import_module(namespace)
        for kind in (getattr(module, name) for name in module.__all__):
            if isinstance(kind, type) and issubclass(kind, IntEnum):
                assert [str(member) for member in kind] == [f"{kind.__name__}.{member.name}" for member in kind]
    assert f"{dpstack.Mode.OPERATE} {dpstack.Mode.OPERATE:02X} {dpstack.Mode.OPERATE + 0}" == "Mode.OPERATE C0 192"


@in_virtual_time
async def test_objects_say_what_they_are() -> None:
    description = SlaveDescription.simple(0x4711, inputs=1, outputs=1, name="tank")
    tank = DpSlave(description, lambda outputs, _: outputs)
    world = dpstack.World()
    async with (
        serve_slave(tank, world=world, address=9) as server,
        dpstack.open_bus(world=world, baud=500_000, slaves=[description.table(9)]) as bus,
    ):
        assert repr(bus).startswith("<Bus virtual 500 kbit/s clear, ")
        await bus.operate()
        await bus.ready()
        assert repr(bus) == "<Bus virtual 500 kbit/s operate, 1 of 1 slaves>"
        assert (repr(bus.slave(9)), repr(tank)) == ("<Slave 9 'tank' data_exchange>", "<DpSlave 'tank' 0x4711>")
        assert repr(server) == "<SlaveServer 9 'tank' data_exchange>"
        assert re.fullmatch(r"<World at 0\.\d{6} s, 2 stations>", repr(world))
