"""Any GSD file takes time and memory in proportion to its size: counted for n and 2 n of each construct."""

from __future__ import annotations

from collections.abc import Callable

import gsd_kit
import pytest
from linear_kit import assert_linear

from dpstack.api.gsd_info import gsd_dict
from dpstack.errors import GsdError
from dpstack.gsd import joining
from dpstack.gsd.check import check
from dpstack.gsd.configuration import configure
from dpstack.gsd.parser import parse_gsd

PARAMETER = 'ExtUserPrmData=1 "p"\nUnsigned8 0 0-9\nEndExtUserPrmData\nMax_User_Prm_Data_Len=10\n'
MODULE = "Ext_Module_Prm_Data_Len=1\nExt_User_Prm_Data_Const(0)=1\nExt_User_Prm_Data_Ref(0)=1\nEndModule\n"


def each(n: int, text: Callable[[int], str]) -> str:
    return "".join(map(text, range(n)))


#: what stands in the file, n times
FILES: dict[str, Callable[[int], str]] = {
    "slots": lambda n: "SlotDefinition\n" + each(n, lambda i: f'Slot({i})="x" 1 1,2\n') + "EndSlotDefinition\n",
    "the same slot": lambda n: "SlotDefinition\n" + 'Slot(1)="x" 1 1,2\n' * n + "EndSlotDefinition\n",
    "slot definitions": lambda n: 'SlotDefinition\nSlot(1)="x" 1 1,2\nEndSlotDefinition\n' * n,
    "allowed in a slot": lambda n: f'SlotDefinition\nSlot(1)="x" 1 {"1," * n}1\nEndSlotDefinition\n',
    "modules": lambda n: each(n, lambda i: f'Module="m{i}" 0x10\n{i}\nEndModule\n'),
    "modules with parameters": lambda n: (
        PARAMETER + "Ext_User_Prm_Data_Ref(3)=1\n" * n + each(n, lambda i: f'Module="m{i}" 0x10\n{i}\n{MODULE}')
    ),
    "identifiers": lambda n: f'Module="m" {",".join(["0x10"] * n)}\nEndModule\n',
    "references": lambda n: PARAMETER + "Ext_User_Prm_Data_Const(0)=0,0,0\n" + "Ext_User_Prm_Data_Ref(3)=1\n" * n,
    "references of a module": lambda n: (
        PARAMETER + 'Module="m" 0x10\n' + "Ext_User_Prm_Data_Const(0)=1\nExt_User_Prm_Data_Ref(0)=1\n" * n + MODULE
    ),
    "parameters": lambda n: each(n, lambda i: f'ExtUserPrmData={i} "p"\nUnsigned8 0 0-9\nEndExtUserPrmData\n'),
    "the same parameter": lambda n: PARAMETER * n,
    "texts": lambda n: "PrmText=1\n" + each(n, lambda i: f'Text({i})="t"\n') + "EndPrmText\n",
    "allowed values": lambda n: f'ExtUserPrmData=1 "p"\nUnsigned8 0 {"0," * n}0\nEndExtUserPrmData\n',
    "diagnosis bits": lambda n: each(n, lambda i: f'Unit_Diag_Bit({i})="x"\n'),
    "diagnosis areas": lambda n: 'Unit_Diag_Area=0-7\nValue(1)="x"\nUnit_Diag_Area_End\n' * n,
    "diagnosis types": lambda n: 'UnitDiagType=1\nX_Unit_Diag_Bit(1)="x"\nEndUnitDiagType\n' * n,
    "settings": lambda n: each(n, lambda i: f"S{i}=1\n"),
    "unknown statements": lambda n: each(n, lambda i: f"S{i}(1)=1\n"),
    "unknown blocks": lambda n: each(n, lambda i: f"Q{i}\nEndQ{i}\n"),
    "blocks that never end": lambda n: "PrmText=1\n" * n,
    "remarks in a list": lambda n: "User_Prm_Data=\\\n" + "; x\n" * n,
    "continued strings": lambda n: 'a="x\\\n' * n,
    "families": lambda n: "Slave_Family=3" + "@x" * n + "\n",
}


@pytest.mark.parametrize("name", FILES)
def test_twice_the_file_takes_twice_the_steps(name: str) -> None:
    def work_of(n: int) -> Callable[[], object]:
        octets = (gsd_kit.HEAD + "Modular_Station=1\n" + FILES[name](n)).encode()

        def work() -> object:
            file = parse_gsd(octets)
            return check(file), gsd_dict(file)

        return work

    assert_linear(work_of, 100)


def test_texts_that_many_parameters_share_have_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A program that shows all texts of all parameters shows their product."""
    monkeypatch.setattr(joining, "MAX_TEXTS", 25)
    texts = FILES["texts"](10)
    parameters = FILES["parameters"](4).replace("EndExt", "Prm_Text_Ref=1\nEndExt")
    file = parse_gsd((gsd_kit.HEAD + texts + parameters).encode())
    assert [len(parameter.texts) for parameter in file.device.parameters.values()] == [10, 10, 0, 0]
    (told,) = [d.message for d in file.diagnostics if "texts" in d.message]
    assert told == "more than 25 texts of parameters: from here on they have none"


def test_more_modules_than_slots_are_refused_before_they_are_looked_up() -> None:
    device = parse_gsd((gsd_kit.HEAD + FILES["modules"](3)).encode()).device
    with pytest.raises(GsdError, match="256 modules are named; no device has more than 255 slots: take out some"):
        configure(device, ["no such module"] * 256)
