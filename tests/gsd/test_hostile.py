"""Damaged and hostile GSD files: a model and diagnostics, no exception, work in proportion to the size."""

from __future__ import annotations

import contextlib

import gsd_kit
import pytest
from hypothesis import given
from hypothesis import strategies as st
from linear_kit import assert_linear

from dpstack.errors import GsdError
from dpstack.gsd.check import check
from dpstack.gsd.configuration import configure
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.model import GsdFile
from dpstack.gsd.parser import parse_gsd
from dpstack.gsd.prm import Reading

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
