"""Any GSD file, damaged and hostile ones too: a model and diagnostics, no exception, time and memory in proportion to
its size, counted for n and 2 n of each construct. The generator of made-up files: no errors, and the sizes that it
announces."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import gsd_kit
import pytest
from gsd_kit import errors
from hypothesis import given
from hypothesis import strategies as st
from linear_kit import assert_linear

from dpstack.api.gsd_info import gsd_dict
from dpstack.errors import GsdError
from dpstack.gsd import joining
from dpstack.gsd.check import check
from dpstack.gsd.configuration import configure
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.model import GsdFile
from dpstack.gsd.parser import parse_gsd
from dpstack.gsd.prm import Reading
from tools.make_gsd_set import LARGEST, make_file, make_set, sizes

SOUND = [gsd_kit.octets(path.stem) for path in sorted(gsd_kit.FILES.glob("*.gsd"))]
LINES = sorted({line for octets in SOUND for line in octets.splitlines()})


def use(file: GsdFile) -> None:
    """Check, configure and read back, as a user does."""
    check(file)
    DiagTexts(file.device, file.device.modules).unit_diag_texts(bytes(range(20)))
    for module in file.device.modules[:5]:
        with contextlib.suppress(GsdError):
            found = configure(file.device, [module.name])
            for reading in Reading:
                prm = found.user_prm(reading)
                assert prm.read(prm.octets()) == prm.fields


@given(octets=st.binary(max_size=400))
def test_any_octets(octets: bytes) -> None:
    use(parse_gsd(octets))
    use(parse_gsd(b"#Profibus_DP\n" + octets))


@given(lines=st.lists(st.sampled_from(LINES), max_size=40), end=st.sampled_from([b"\n", b"\r\n", b"\r"]))
def test_any_lines_in_any_order(lines: list[bytes], end: bytes) -> None:
    use(parse_gsd(b"#Profibus_DP" + end + end.join(lines)))


@st.composite
def mutations(draw: st.DrawFn) -> bytes:
    """A sound file with one to four injuries."""
    octets = bytearray(draw(st.sampled_from(SOUND)))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(0, len(octets) - 1)))
        end = min(len(octets), at + draw(st.integers(1, 60)))
        match draw(st.sampled_from(["cut", "flip", "delete", "repeat", "insert"])):
            case "cut":
                del octets[at:]
            case "flip" if octets:
                octets[at] ^= 1 << draw(st.integers(0, 7))
            case "delete":
                del octets[at:end]
            case "repeat":
                octets[at:at] = octets[at:end]
            case _:
                octets[at:at] = draw(st.sampled_from([b'"', b"\\\n", b";", b"(", b")", b"=", b"\0", b"EndModule\n"]))
    return bytes(octets)


@given(octets=mutations())
def test_injured_files(octets: bytes) -> None:
    use(parse_gsd(octets))


@pytest.mark.parametrize("name", ["whole", "prm", "unknown", "continuations"])
def test_every_beginning_of_a_file(name: str) -> None:
    octets = gsd_kit.octets(name)
    for end in range(0, len(octets), 7):
        parse_gsd(octets[:end])


HOSTILE = {
    "continuations": b"\\\n",
    "open strings": b'a="x\\\n',
    "blanks": b" " * 50 + b"\n",
    "words": b"a b c d e f g h ",
    "parentheses": b"a(((((((",
    "quotes": b'"',
    "commas": b"Ext_User_Prm_Data_Const(0)=" + b"1," * 100 + b"\n",
    "digits": b"9" * 100,
    "semicolons and backslashes": b'"\\ ; \\ ;',
    "modules": b'Module="x"1\n',
    "blocks": b"PrmText=1\n",
    "carriage returns": b"\r",
    "unknown blocks": b"Q\nEndQ\n",
    "marks": b";#Profibus_DP ",
    "number signs": b"#",
}


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("head", [gsd_kit.HEAD.encode(), b""], ids=["head", "no head"])
def test_work_grows_with_the_size_only(name: str, head: bytes) -> None:
    octets = HOSTILE[name]
    assert_linear(lambda n: lambda: parse_gsd(head + octets * (n // len(octets))), 3000)


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


def test_forty_files_are_read_without_damage() -> None:
    odd = set()
    for number, (name, octets) in enumerate(make_set(40)):
        file = parse_gsd(octets, name)
        assert file.fatal is None
        assert errors(file) == (), name
        assert file.device.ident == 0x1000 + number
        assert all(module.complete for module in file.device.modules)
        assert len(file.device.parameters) == sizes(40, 1)[number].parameters
        odd |= {file.encoding}
    assert odd >= {"ascii", "cp1252", "utf-8-sig"}


def test_the_largest_is_as_large_as_the_largest_known() -> None:
    octets = make_file(0, LARGEST)
    device = parse_gsd(octets).device
    assert len(device.modules) == 1_295
    assert abs(octets.count(b"\n") - 9_372) < 400


def test_the_same_seed_makes_the_same_octets() -> None:
    assert list(make_set(3)) == list(make_set(3))
    assert list(make_set(3)) != list(make_set(3, seed=2))
