"""Text of others on the way to a terminal, into JSON and into TOML."""

from __future__ import annotations

import json
import re
import tomllib
import unicodedata
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.api.streams import SlaveFlapping, call_on_event
from dpstack.dp.master.events import DriveEvent, SlaveRemark
from dpstack.drivers.runtime import PortLost
from dpstack.errors import ConfigError, DriveTimeout, NoInputs, PortError, SlaveFault
from dpstack.text import json_text, octets_in_words, printable, shortened, traceback_text
from dpstack.toml.reading import quoted
from dpstack.trace import Event, Notice

#: C0, DEL, C1; bidi embeddings, isolates and marks; zero width; line and paragraph separator; a tag
HOSTILE = [
    *map(chr, [*range(0x20), *range(0x7F, 0xA0)]),
    *"\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\u200e\u200f\u061c",
    *"\u200b\u200c\u200d\u2060\ufeff\xad\u180e\u2028\u2029\U000e0001",
]


@pytest.mark.parametrize("letter", [*HOSTILE, *map(chr, (0xD800, 0xDCFF))], ids=lambda letter: f"{ord(letter):04x}")
def test_a_hostile_character_never_gets_out_as_it_is(letter: str) -> None:
    text = f"a{letter}b"
    for encoding in ("utf-8", "ascii", "latin-1"):
        made = json_text({"text": text}, encoding=encoding)
        made.encode(encoding)
        assert letter not in made
        assert json.loads(made) == {"text": text}
    assert letter not in printable(text)
    assert printable(text)[:2] == "a\\"
    assert printable(text)[-1] == "b"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b]0;x\x07", r"\x1b]0;x\x07"),
        ("a\nb\tc\r", r"a\nb\tc\r"),
        ("\x9b31m", r"\x9b31m"),
        ("\u202egnp.exe", r"\u202egnp.exe"),
        ("\U000e0041", r"\U000e0041"),
        ("Übertemperatur 80\xa0°C 温度", "Übertemperatur 80\xa0°C 温度"),
    ],
)
def test_shown_to_people(text: str, shown: str) -> None:
    assert printable(text) == shown


def test_json_of_plain_text_is_as_it_was() -> None:
    assert json_text({"a": ["Übertemperatur", 1, None]}) == '{"a":["Übertemperatur",1,null]}'
    assert json_text("温\U0001f600", encoding="ascii") == r'"\u6e29\ud83d\ude00"'


@given(st.text(alphabet=st.characters(), max_size=30))
def test_any_text(text: str) -> None:
    made = json_text([text])
    assert json.loads(made) == [text]
    for shown in (made, printable(text)):
        assert not {unicodedata.category(letter) for letter in shown} & {"Cc", "Cf", "Cs", "Zl", "Zp"}


@given(st.text(max_size=30))
def test_a_toml_string_has_the_same_value(text: str) -> None:
    written = quoted(text)
    assert tomllib.loads(f"a = {written}") == {"a": text}
    assert not {unicodedata.category(letter) for letter in written} & {"Cc", "Cf", "Cs", "Zl", "Zp"}


def test_text_that_toml_cannot_hold_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"'\\udcff.gsd' is no Unicode text, as a TOML file must be; rename it"):
        quoted("\udcff.gsd")


def test_a_message_shows_the_beginning_of_a_long_text() -> None:
    assert shortened("9" * 60) == "9" * 60
    assert shortened("9" * 61) == "9" * 57 + "..."


EVIL = "\x1b]0;owned\x07\x9b31m\x7f\u202eevil\nforged"


def test_errors_are_printable_wherever_they_are_shown() -> None:
    for error in (ConfigError(EVIL), PortError(EVIL), SlaveFault(3, EVIL), DriveTimeout("it", EVIL), NoInputs(3, EVIL)):
        assert str(error) == printable(EVIL)
        assert EVIL in error.args
        assert_printable(traceback_text(error))
        assert r"\x1b]0;owned\x07" in traceback_text(error)


def test_events_are_printable_and_their_fields_are_as_they_came() -> None:
    events = [
        Notice(t_ns=0, source=EVIL, message=EVIL),
        SlaveRemark(t_ns=0, address=3, name=EVIL, message=EVIL),
        SlaveFlapping(t_ns=0, address=3, name=EVIL, count=2),
        DriveEvent(t_ns=0, address=3, name=EVIL, payload={"type": "notice", "text": EVIL}),
        PortLost(t_ns=0, port=EVIL, reason=EVIL),
    ]
    for event in events:
        assert r"\x1b]0;owned\x07" in event.text
        assert_printable(event.text)
    assert events[1].name == EVIL  # type: ignore[attr-defined]


def test_an_event_of_an_application_has_a_printable_text() -> None:
    class Own(Notice):
        TEMPLATE = "{e.message}{e.message}"

    assert Own(t_ns=0, source="x", message="\x1b").text == r"\x1b\x1b"


async def test_an_exception_of_an_event_handler_is_logged_printable(caplog: pytest.LogCaptureFixture) -> None:
    def handler(event: Event) -> None:
        raise ConfigError(EVIL)

    call_on_event(handler, Notice(t_ns=0, source="x", message=EVIL))
    assert r"on_event raised at 'x: \\x1b]0;owned\\x07" in caplog.text
    assert_printable(caplog.text)


def assert_printable(text: str) -> None:
    assert all(line.isprintable() for line in text.split("\n")), text


@pytest.mark.parametrize(
    ("text", "most", "short"),
    [
        ("a watchdog of 1000 ms", 18, "a watchdog of ..."),
        ("a watchdog of 1000 ms", 21, "a watchdog of 1000 ms"),
        ("a watchdog of 1000 ms, which", 22, "a watchdog of 1000 ..."),
        ("at 12.5 Hz", 9, "at ..."),
        ("123456789", 6, "123..."),
        ("", 3, ""),
    ],
)
def test_a_text_is_not_cut_within_a_number(text: str, most: int, short: str) -> None:
    assert shortened(text, most) == short


def test_no_sentence_begins_with_a_bus_address() -> None:
    """ "1 does not answer" reads as a count: "station 1", "slave 1 (fan)" or "address 1" stands there."""
    # the address of a parameter (PNU) is no bus address
    begins = re.compile(r'f"\{(?!piece\.)(?:\w+\.)*(?:address|station|sa|da)\} [a-z]')
    root = Path(__file__).resolve().parents[1]
    sources = [path for top in ("dpstack", "drives") for path in (root / top).rglob("*.py")]
    found = [
        f"{path.relative_to(root)}: {line.strip()}"
        for path in sources
        for line in path.read_text(encoding="utf-8").splitlines()
        if begins.search(line)
    ]
    assert len(sources) > 300
    assert found == []


@pytest.mark.parametrize(
    ("octets", "shown"),
    [
        (b"Overtemp motor 3", '"Overtemp motor 3"'),
        (b"Sicherung \xfcber 5A\0\0", '"Sicherung über 5A"'),
        (b"\x01\x02Fuse F1\x00", '"Fuse F1" (01 02 46 75 73 65 20 46 31 00)'),
        (b"low\x01pump oil\x02empty", '"pump oil ... empty" (6c 6f 77 01 70 75 6d 70 20 6f 69 6c 02 65 6d 70 74 79)'),
        # few characters may be a number: its octets stay
        (b"ABCD", '"ABCD" (41 42 43 44)'),
        (b"\x00AB\x00", "00 41 42 00"),
        (b"E-42", "45 2d 34 32"),
        (b"", ""),
    ],
)
def test_text_in_octets_of_a_device(octets: bytes, shown: str) -> None:
    assert octets_in_words(octets) == shown


@given(st.binary(max_size=244))
def test_octets_in_words_never_have_what_a_terminal_obeys(octets: bytes) -> None:
    shown = octets_in_words(octets)
    assert shown == printable(shown)
    assert not set(shown) & {"\x1b", "\x9b", "\x7f", "\n"}
