"""User parameters: literal octets for both readings, setting by name, and back."""

from __future__ import annotations

import pytest
from gsd_kit import device, made
from hypothesis import given
from hypothesis import strategies as st

from dpstack.errors import GsdError
from dpstack.gsd.check import check
from dpstack.gsd.model import PrmKind, PrmType
from dpstack.gsd.prm import Reading, UserPrm, read_bits, write_bits

D = device("prm")
AI, LIMIT, PLAIN, TOO_LONG = D.modules


def prm(reading: Reading = Reading.REFS) -> UserPrm:
    return UserPrm(D, [AI, PLAIN, LIMIT], reading)


def test_defaults_over_the_constants() -> None:
    # device: C0, zero-filled, FF with bit 3 cleared and bits 4..6 = 5: 1101 0111; module 1: 0F with bits 4..6 = 5;
    # -2 big-endian; module 2 has none; module 3: 70000, then 9
    assert prm().octets().hex(" ") == "c0 00 00 d7 11 5f ff fe 00 00 00 00 01 11 70 09"


def test_the_constants_alone() -> None:
    assert prm(Reading.CONST).octets().hex(" ") == "c0 00 00 ff 11 0f 00 05 00 00 00 00 00 00 00 00"


def test_contradictions_of_defaults_and_constants() -> None:
    assert [c.text for c in prm().contradictions()] == [
        "0/Diagnosis@3.3: its default is 0 (off), the constant octets say 1 (on)",
        "0/Range@3.4: its default is 5 (4..20 mA), the constant octets say 7",
        "1/Range@0.4: its default is 5 (4..20 mA), the constant octets say 0 (10 V)",
        "1/Offset@1: its default is -2, the constant octets say 5",
        "3/Limit@0: its default is 70000, the constant octets say 0",
        "3/Serial@4: its default is 9, the constant octets say 0",
    ]


@pytest.mark.parametrize("reading", list(Reading))
def test_a_value_set_by_name_counts_in_both_readings(reading: Reading) -> None:
    p = prm(reading)
    before = p.octets()
    p.set("Diagnosis", "ON")
    p.set("1/Range", "10 V")
    p.set("offset", -100)
    p.set("3/limit@0", "0x10")
    after = p.octets()
    assert after[3] == before[3] | 0x08
    assert after[5] == 0x0F  # bits 4..6 cleared, the others kept
    assert after[6:8] == b"\xff\x9c"
    assert after[11:15] == b"\x00\x00\x00\x10"


def test_octets_back_to_names() -> None:
    octets = bytes.fromhex("c0 00 00 d7 11 5f ff fe 00 00 00 00 01 11 70 09")
    assert [(f.key, f.value, f.text) for f in prm().read(octets)] == [
        ("0/Diagnosis@3.3", 0, "off"),
        ("0/Range@3.4", 5, "4..20 mA"),
        ("1/Range@0.4", 5, "4..20 mA"),
        ("1/Offset@1", -2, "-2"),
        ("3/Limit@0", 70000, "70000"),
        ("3/Serial@4", 9, "9"),
    ]
    with pytest.raises(GsdError, match="15 octets of user parameters; this configuration has 16"):
        prm().read(octets[:-1])


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("Diagnose", 1, "there is no parameter 'Diagnose'; nearest are 'Diagnosis'"),
        ("Colour", 1, "there is no parameter 'Colour'; known are 'Diagnosis', 'Range', 'Offset', 'Limit', 'Serial'"),
        ("Range", 5, "'Range' may be 2 parameters; write one of '0/Range@3.4', '1/Range@0.4'"),
        ("Diagnosis", "onn", "'Diagnosis' has no value 'onn'; did you mean 'on'? known: 'off', 'on'"),
        ("Diagnosis", 2, "'Diagnosis' = 2 is not allowed; allowed are 0..1"),
        ("1/Range", 3, "'Range' = 3 is not allowed; allowed are 0, 5"),
        ("Offset", 101, "'Offset' = 101 is not allowed; allowed are -100..100"),
        ("Offset", "much", "'Offset' = 'much' is no number; allowed are -100..100"),
        ("Serial", 1, "parameter 3/Serial@4 may not be changed (Changeable = 0); leave it out"),
    ],
)
def test_refused(key: str, value: int | str, message: str) -> None:
    p = prm()
    before = p.octets()
    with pytest.raises(GsdError) as caught:
        p.set(key, value)
    assert str(caught.value) == message
    assert p.octets() == before


def test_a_reference_beyond_the_modules_length_is_left_out() -> None:
    assert UserPrm(D, [TOO_LONG]).octets()[5:] == b"\0"


def test_user_prm_data_counts_only_where_nothing_else_is() -> None:
    old = UserPrm(device("prm_old"), [])
    assert (old.octets(), old.fields) == (b"\x00\x0a\xff", ())
    mixed = made("User_Prm_Data_Len = 1\nUser_Prm_Data = 5\nMax_User_Prm_Data_Len = 3\n")
    assert UserPrm(mixed.device).octets() == b""


def test_too_many_octets() -> None:
    short = made(
        "Max_User_Prm_Data_Len = 3\nExt_User_Prm_Data_Const(0) = 1,2\n"
        'Module = "m" 0x10\nExt_Module_Prm_Data_Len = 2\nEndModule\n'
    ).device
    with pytest.raises(GsdError, match="4 octets of user parameters, Max_User_Prm_Data_Len of the device is 3"):
        UserPrm(short, short.modules)
    big = made('Module = "m" 0x10\nExt_Module_Prm_Data_Len = 200\nEndModule\n').device
    with pytest.raises(GsdError, match="400 octets of user parameters; a Set_Prm carries 237"):
        UserPrm(big, big.modules * 2)


def test_check_names_the_contradictions() -> None:
    file = made(
        'ExtUserPrmData = 1 "Mode"\nUnsigned8 3 0-9\nEndExtUserPrmData\n'
        "Ext_User_Prm_Data_Const(0) = 7\nExt_User_Prm_Data_Ref(0) = 1\n"
    )
    assert file.diagnostics == ()
    assert [d.text for d in check(file)] == [
        "8:1: warning: the device: defaults contradict the constant octets (Mode@0: its default is 3, the constant "
        'octets say 7); the defaults are used, defaults = "const" takes the constants'
    ]


TWO_MODULES = (
    'ExtUserPrmData = 1 "Mode"\nUnsigned8 3 0-9\nEndExtUserPrmData\n'
    'Module = "zero" 0x10\nExt_Module_Prm_Data_Len = 2\nExt_User_Prm_Data_Const(0) = 0,0xFF\n'
    "Ext_User_Prm_Data_Ref(0) = 1\nEndModule\n"
    'Module = "seven" 0x10\nExt_Module_Prm_Data_Len = 2\nExt_User_Prm_Data_Const(0) = 7,8\n'
    "Ext_User_Prm_Data_Ref(0) = 1\nExt_User_Prm_Data_Ref(1) = 1\nEndModule\n"
)


def test_check_reports_contradictions_once_a_file_and_not_over_zero_bits() -> None:
    zero, _, seven = TWO_MODULES.partition('Module = "seven"')
    assert check(made(zero)) == ()
    assert [d.text for d in check(made(zero + 'Module = "seven"' + seven))] == [
        "14:1: warning: module 'seven': defaults contradict the constant octets (Mode@0: its default is 3, the "
        'constant octets say 7; 1 more in this file); the defaults are used, defaults = "const" takes the constants'
    ]


def test_a_parameter_that_is_set_contradicts_nothing() -> None:
    p = prm()
    p.set("Diagnosis", "off")
    p.set("1/Range", 0)
    assert [c.field.key for c in p.contradictions() if c.matters] == ["0/Range@3.4", "1/Offset@1"]


KINDS = st.one_of(
    st.tuples(st.integers(0, 31), st.integers(0, 31)).map(
        lambda ab: PrmType(PrmKind.BIT_AREA, min(ab), max(ab), 1 if max(ab) < 8 else 2 if max(ab) < 16 else 4)
    ),
    st.sampled_from(
        [
            PrmType(PrmKind.UNSIGNED8, 0, 7, 1),
            PrmType(PrmKind.SIGNED8, 0, 7, 1),
            PrmType(PrmKind.UNSIGNED16, 0, 15, 2),
            PrmType(PrmKind.SIGNED16, 0, 15, 2),
            PrmType(PrmKind.UNSIGNED32, 0, 31, 4),
            PrmType(PrmKind.SIGNED32, 0, 31, 4),
        ]
    ),
)


@given(kind=KINDS, before=st.binary(min_size=8, max_size=8), at=st.integers(0, 4), data=st.data())
def test_a_value_changes_its_own_bits_only(kind: PrmType, before: bytes, at: int, data: st.DataObject) -> None:
    value = data.draw(st.integers(*kind.limits))
    octets = bytearray(before)
    write_bits(octets, at, kind, value)
    assert read_bits(bytes(octets), at, kind) == value
    own = ((1 << kind.width) - 1) << kind.first
    mask = own << 8 * (8 - at - kind.size)
    assert (int.from_bytes(octets, "big") ^ int.from_bytes(before, "big")) & ~mask == 0
