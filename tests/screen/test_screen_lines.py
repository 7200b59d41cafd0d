"""Lines of the live screen: they fit every width, nothing foreign is markup, and nothing old looks fresh."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.cells import cell_len

from dpstack.plant.items import FieldPlant, Item
from dpstack.screen.lines import STYLES, Line, cut, padded, width_of, wrapped
from dpstack.screen.one_slave import page
from dpstack.screen.overview import bars, event_line, head, notices, rooms, slave_lines, slaves_head
from dpstack.screen.places import Place, place_of
from dpstack.screen.view import View
from dpstack.screen.watch import points_of, watch_lines
from tests.screen.screen_kit import (
    BREAK,
    INVALID,
    LONG,
    doubt,
    event,
    field,
    judged,
    link,
    plant,
    rack_plant,
    slave_plant,
    snapshot,
    some_plant,
    values,
)


def view_of(items: list[Item], now: float = 10.0) -> View:
    view = View()
    for item in items:
        view.apply(item, now)
    return view


def text_of(line: Line) -> str:
    return "".join(text for text, _ in line)


def all_lines(view: View, width: int) -> list[Line]:
    lines = [*head(view, width, paused="12:00:00", note=LONG), slaves_head(width)]
    for address in view.addresses():
        lines += [slave_lines(view, address, width)[0], *page(view, address, width, LONG)]
    return lines


@pytest.mark.parametrize("width", [40, 59, 60, 80, 119, 200])
def test_every_line_fits_and_is_plain_text(width: int) -> None:
    view = view_of(some_plant())
    for line in all_lines(view, width):
        assert width_of(line) <= width
        assert text_of(line).isprintable()
        assert {style for _, style in line} <= set(STYLES)
    assert text_of(event_line(view.state.events[-1])).isprintable()


def hostile(value: Any) -> Any:
    """``value`` with an escape sequence of terminals and a change of direction in each of its texts."""
    if isinstance(value, dict):
        return {key: hostile(one) for key, one in value.items()}
    if isinstance(value, list):
        return [hostile(one) for one in value]
    return f"\x1b[2J\u202e{value}" if isinstance(value, str) else value


@pytest.mark.parametrize("ended", [False, True])
def test_no_text_of_any_item_is_drawn_raw(ended: bool) -> None:
    held = {"since": 3.5, "because": "stall"}
    items = [*some_plant(), snapshot({}, whole=False, clear=held), *([{"end": {"text": "over"}}] if ended else [])]
    view = view_of([hostile(item) for item in items])
    lines = [*all_lines(view, 4_000), *([one] for one in notices(view, paused="", note=LONG))]
    lines += [event_line(event) for event in view.events_of()]
    assert all(text_of(line).isprintable() for line in lines)
    assert {"\\x1b[2J\\u202e" in text_of(line) for line in lines} == {True, False}


def test_a_slave_shows_names_values_and_units() -> None:
    view = view_of(some_plant())
    text = text_of(slave_lines(view, "3", 120)[0])
    assert " ".join(text.split()) == "* 3 valves data exchange 3 0 level 3.4 bar limit on out target 5"
    drive = text_of(slave_lines(view, "4", 160)[0])
    assert "drive fault: F2100 overload" in drive
    assert "12.3 % set 50.0 %  6.2 Hz  current 42.0 %" in drive
    assert "1500" not in drive
    assert "185 rpm" in "\n".join(map(text_of, page(view, "4", 80)))


def _valve_with_words(position: int, text: str, quality: str = "good") -> View:
    words = {"0": "closed", "1": "open\x1b[31m", "-2": "fault"}
    fields = [field("position", at="i8@2") | {"type": "i8", "words": words}, field("steps", at="i8@3")]
    lamp = field("lamp", at="u8@0") | {"type": "u8", "words": {"5": "blinks"}}
    told = {"quality": quality, "reason": f"status_{quality}", "text": text, "since": 1.0}
    now = values(fields={"position": position, "steps": 1, "lamp": 5}, qualities={"position": told})
    now |= {"held": "0100", "held_fields": {"lamp": 5, "rest": 1}}
    return view_of([plant({"8": slave_plant(8, "valve", inputs=fields, outputs=[lamp])}), snapshot({"8": now})])


def test_a_number_with_a_word_has_it_in_list_page_and_watch_table() -> None:
    view = _valve_with_words(1, "open\x1b[31m")
    [listed, *_] = slave_lines(view, "8", 400)
    assert "position 1 (open\\x1b[31m)  steps 1  out lamp 5 (blinks)" in text_of(listed)
    assert "not sent: lamp 5 (blinks), rest 1" in text_of(listed)
    lines = [text_of(line).rstrip() for line in page(view, "8", 100)]
    assert "  position 1 (open\\x1b[31m)  i8@2" in lines  # the word stands once
    assert "  steps 1  i8@3" in lines
    assert "  lamp 5 (blinks)" in lines
    [watched] = watch_lines(view, points_of(view)["8.position"], 120)
    assert text_of(watched).split() == ["valve.position", "1", "(open\\x1b[31m)", "00", "good"]


def test_a_number_without_a_word_and_the_rest_of_a_quality_are_shown() -> None:
    view = _valve_with_words(-2, "fault; not specific (status 40)", "uncertain")
    lines = [text_of(line).rstrip() for line in page(view, "8", 100)]
    assert "  position ?-2 (fault)  i8@2  uncertain: not specific (status 40)" in lines
    lines = [text_of(line).rstrip() for line in page(_valve_with_words(7, "no meaning"), "8", 100)]
    assert "  position 7 (no meaning)  i8@2" in lines


def test_links_to_publishers_and_nothing_old_is_good() -> None:
    links = [link("encoder", good=True, text="valid data"), link("fan", good=False, text="no data")]

    def shown(**more: Any) -> list[tuple[str, str]]:
        items = some_plant()
        items[-1] = snapshot({"3": values(links=links, **more)})
        return [one for line in page(view_of(items), "3", 90) for one in line]

    alive, dead = shown(), shown(inputs_valid=False)
    text = "".join(word for word, _ in alive)
    assert "7 encoder: octets 1:3 to output octet 3: valid data" in text
    assert {style for word, style in alive if word == "valid"} == {"good"}
    assert "bad" in {style for word, style in alive if word == "no"}
    assert {style for word, style in dead if word == "(old)"} == {"stale"}
    assert "good" not in {style for word, style in dead if word == "valid"}
    assert "links to publishers" not in "\n".join(map(text_of, page(view_of(some_plant()), "4", 90)))


def test_markup_of_a_device_stays_text() -> None:
    assert "module 2 [red]missing[/]" in "\n".join(map(text_of, page(view_of(some_plant()), "8", 80)))
    assert "[bold red]x[/]" in text_of(slave_lines(view_of(some_plant()), "125", 100)[0])


# --- quality ----------------------------------------------------------------------------------------------------------

#: the rack at some widths, with the empty lines of a screen of 20
BROKEN = {
    40: [
        "!   8 boiler ra… exchange  line break:",
        "      slot 3 (2 AI), input channel 0;",
        "      data invalid: slot 3 (2 AI)",
        "      level !3.2 m  pressure ?1.25 bar",
        "      limit on  temperature 81.5 °C",
        "      out inlet on",
    ],
    60: [
        "!   8 boiler rack    data exchange line break: slot 3 (2",
        "                                   AI), input channel 0;",
        "                                   data invalid: slot 3 (2",
        "                                   AI)",
        "                                   level !3.2 m",
        "                                   pressure ?1.25 bar",
        "                                   limit on",
        "                                   temperature 81.5 °C",
        "                                   out inlet on",
    ],
    120: [
        "!   8 boiler rack              data exchange      0      0 "
        "line break: slot 3 (2 AI), input channel 0; data invalid:",
        "                                                           slot 3 (2 AI)",
        "                                                           level !3.2 m  pressure ?1.25 bar  limit on",
        "                                                           temperature 81.5 °C  out inlet on",
    ],
}


@pytest.mark.parametrize("width", BROKEN)
def test_a_fault_has_the_empty_lines_of_the_screen_and_the_values_stay_beside_it(width: int) -> None:
    view = view_of(rack_plant())
    found = rooms(view, ["8", "9"], width, 17)
    lines = [text_of(line).rstrip() for line in slave_lines(view, "8", width, found[0])]
    assert lines == BROKEN[width]
    assert found == [len(lines), 1]


@pytest.mark.parametrize("room", [1, 2, 3, 6])
def test_words_of_the_fault_and_the_value_can_be_read_in_any_room(room: int) -> None:
    view = view_of(rack_plant())
    for width in range(48, 130):
        lines = slave_lines(view, "8", width, room)
        assert len(lines) <= room
        assert all(width_of(line) <= width for line in lines)
        text = " ".join(text_of(line) for line in lines)
        if width >= 60:
            assert "line break" in text
            assert "level !3.2 m" in text
        # never the number alone, wherever the line ends
        assert "level 3" not in text
        assert {style for line in lines for one, style in line if "3.2" in one} <= {"bad"}


def test_what_does_not_fit_has_one_ellipsis() -> None:
    view = view_of(rack_plant())
    lines = [text_of(line).rstrip() for line in slave_lines(view, "8", 60, 3)]
    assert [line[35:] for line in lines] == ["line break: slot 3 (2", "AI), input channel 0; …", "level !3.2 m…"]


def test_slaves_have_the_colour_of_the_worst_of_their_values() -> None:
    def styles(quality: str) -> set[str]:
        own = {"level": {"quality": quality, "reason": "status_bad", "text": "sensor failure", "since": None}}
        items = rack_plant()
        items[1] = snapshot({"8": values(qualities=own)})
        return {
            style for text, style in slave_lines(view_of(items), "8", 100)[0] if text.strip() in ("!", "boiler rack")
        }

    assert styles("bad") == {"bad"}
    assert styles("uncertain") == {"warn"}
    assert "good" not in {style for text, style in slave_lines(view_of(rack_plant()), "8", 100)[0] if "data" in text}


def test_without_empty_lines_each_slave_has_one_and_errors_come_first() -> None:
    rack, other = rack_plant()[0]["plant"]["slaves"]["8"], some_plant()[0]["plant"]["slaves"]["8"]
    broken = rack_plant()[1]["snapshot"]["slaves"]["8"]
    warned = values(conspicuous="static diagnosis: the words of a GSD file that do not fit into this line")
    view = view_of([plant({"3": other, "8": rack}), snapshot({"3": warned, "8": broken})])
    assert rooms(view, ["3", "8"], 60, 2) == [1, 1]
    assert rooms(view, ["3", "8"], 60, 5) == [1, 4]
    assert rooms(view, ["3", "8"], 60, 99) == [5, 9]
    assert rooms(view, ["8"] * 1, 60, 0) == [1]


def test_quantities_of_a_drive_have_the_mark_of_its_quality() -> None:
    announced = {"quality": "uncertain", "reason": "announced", "text": "diagnosis announced", "since": 1.0}
    view = view_of([*some_plant(), snapshot({"4": {"quality": announced}}, whole=False)])
    assert "?12.3 % set 50.0 %  ?6.2 Hz  current ?42.0 %" in text_of(slave_lines(view, "4", 160)[0])


RACK = """\
! slave 8  boiler rack  data exchange
! bad          line break: slot 3 (2 AI), input channel 0  since {at}
? uncertain    data invalid: slot 3 (2 AI)  since {at}
diagnosis      ext diag, wd on
               slot 3 (2 AI), input channel 0 (word): line break

modules and channels
  slot 1  8 DI  10  1 in, 0 out
    inputs 1 0 0 0 0 0 0 0
    input 0   1      limit on
  slot 2  8 DO  20  0 in, 1 out
    outputs 0 1 0 0 0 0 0 0
    output 1  1      inlet on
! slot 3  2 AI  51  4 in, 0 out  uncertain: data invalid: slot 3 (2 AI)
  ! input 0   0140   level !3.2 m  bad: line break: slot 3 (2 AI), input channel 0
  ? input 1   04e2   pressure ?1.25 bar  uncertain: data invalid: slot 3 (2 AI)
  slot 4  2 AI  51  4 in, 0 out
    input 0   032f   temperature 81.5 °C
    input 1   0000

inputs         9 octets
    0 0101 4004 e203 2f00 00
outputs        1 octet
    0 02
"""


def test_one_slave_shows_its_slots_with_the_doubt_and_the_value_beside_the_channel() -> None:
    view = view_of(rack_plant())
    at = datetime.fromtimestamp(1763830000.0 + 4.5).strftime("%H:%M:%S")
    lines = [text_of(line).rstrip() for line in page(view, "8", 100)]
    assert lines[: len(RACK.splitlines())] == RACK.format(at=at).splitlines()


def test_doubts_without_a_named_value_stand_at_their_channel_and_other_qualities_above() -> None:
    items = rack_plant(inputs=[], outputs=[])
    broken = items[1]["snapshot"]["slaves"]["8"]
    of_all = {"quality": "uncertain", "reason": "announced", "text": "diagnosis announced", "since": None}
    own = {"flow": {"quality": "bad", "reason": "status_bad", "text": "sensor failure", "since": None}}
    items[1] = snapshot({"8": broken | {"quality": of_all, "qualities": own, "fields": {}}})
    lines = [text_of(line).rstrip() for line in page(view_of(items), "8", 100)]
    assert "  ! input 0   0140   bad: line break: slot 3 (2 AI), input channel 0" in lines
    assert "    input 1   04e2" in lines
    assert "? uncertain    diagnosis announced" in lines
    assert "! bad          flow: sensor failure" in lines


def test_values_without_a_place_in_the_rack_keep_their_line_and_quality() -> None:
    named = {"inputs": [field("level", "m"), field("far", at="i16@200"), field("new", at="decimal@3,4")]}
    items = [
        plant({"3": slave_plant(3, "old", **named)}),
        snapshot({"3": values(fields={"level": 1, "far": 2, "new": 3})}),
    ]
    own = {"new": {"quality": "bad", "reason": "status_bad", "text": "sensor failure", "since": None}}
    lines = [
        text_of(line) for line in page(view_of([*items, snapshot({"3": {"qualities": own}}, whole=False)]), "3", 100)
    ]
    assert "  slot 1  2 AI  51  4 in, 0 out" in lines  # where its octets are is not known
    assert [line.rstrip() for line in lines if "@" in line] == [
        "  level 1 m  i16@0", "  far 2  i16@200", "  new !3  decimal@3,4  bad: sensor failure",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("at", "place", "raw"),
    [
        ("bool@1.7", (1, 7, 1), "1"),
        ("i16@0", (0, 0, 16), "0080"),
        ("u32ws@0", (0, 0, 32), "0080 ff01"),
        ("u5@2.3", (2, 3, 5), "31"),
        ("bytes@1:2", (1, 0, 16), "80ff"),
        ("f64@0", (0, 0, 64), ""),
        ("decimal@3,4", None, None),
    ],
)
def test_the_place_of_a_named_value_gives_its_octets(at: str, place: tuple[int, int, int] | None, raw: str) -> None:
    found = place_of(FieldPlant(name="x", at=at))
    assert found == (None if place is None else Place(*place))
    assert found is None or found.raw("0080ff01") == raw
    assert found is None or found.raw(None) == ""


def test_places_share_bits() -> None:
    for one, other, shares in (
        ((0, 0, 1), (0, 1, 1), False),
        ((0, 0, 4), (0, 3, 1), True),
        ((1, 0, 16), (2, 7, 1), True),
        ((1, 0, 16), (3, 0, 8), False),
        ((0, 0, 31), (3, 7, 1), True),  # within several octets the octets count
    ):
        assert Place(*one).shares(Place(*other)) is shares
        assert Place(*other).shares(Place(*one)) is shares


def test_a_bad_value_that_gets_old_stays_bad() -> None:
    view = view_of(rack_plant())
    view.now += 2.5
    line = slave_lines(view, "8", 200)[0]
    assert [(text, style) for text, style in line if text == "!" or "3.2" in text] == [("!", "bad"), ("3.2 m", "stale")]
    assert [style for text, style in line if "1.25" in text] == ["stale"]


NOT_ALIVE: dict[str, list[Item]] = {
    "the slave left data exchange": [snapshot({"3": judged(state="set_prm")}, whole=False)],
    "its inputs are not valid": [snapshot({"3": judged(state="data_exchange", inputs_valid=False)}, whole=False)],
    "the counters are stale": [snapshot({}, whole=False, stale=True)],
    "the bus process is silent": [{"event": {"event": "bus_process", "silent": True, "text": "silent"}}],
    "the bus has ended": [{"end": {"text": "closed"}}],
    "nothing comes any more": [],
}


@pytest.mark.parametrize("case", NOT_ALIVE)
def test_old_values_never_look_fresh(case: str) -> None:
    view = view_of([*some_plant(), *NOT_ALIVE[case]])
    view.now += 2.5 if case == "nothing comes any more" else 0
    line = slave_lines(view, "3", 120)[0]
    assert line[0][0] == "- "
    shown = [(text, style) for text, style in line if "3.4" in text or text.startswith("on")]
    assert len(shown) == 2
    assert {style for _, style in shown} == {"stale"}
    assert "old" in text_of(line)
    assert "data exchange" not in text_of(line)
    lines = page(view, "3", 100)
    assert "not alive" in "\n".join(map(text_of, lines))
    assert not any(text_of(one).startswith("  stale") for one in lines)  # the line above says it
    for one in lines:
        assert not any("3.4" in text and style != "stale" for text, style in one)


def test_events_and_unknown_items_do_not_make_old_values_fresh() -> None:
    view = view_of(some_plant())
    stream: list[Item] = [event("still there"), {"news": {}}]
    for item in stream:
        view.apply(item, 12.5)
        assert not view.alive("3")
        assert any("no values from the bus for 2 s" in text for text, _ in notices(view))


def test_silence_of_the_bus_process_ends_with_its_return() -> None:
    silent = {"event": {"event": "bus_process", "silent": True, "text": "silent"}}
    back = {"event": {"event": "bus_process", "silent": False, "text": "back"}}
    assert any("bus process is silent" in text for text, _ in notices(view_of([*some_plant(), silent])))
    assert view_of([*some_plant(), silent, back]).alive("3")


def test_conspicuous_states_are_shown() -> None:
    held = {"since": 3.5, "because": "stall"}
    view = view_of([*some_plant(), snapshot({}, whole=False, mode="clear", clear=held, in_ring=False), {"lost": 7}])
    texts = "\n".join(text for text, _ in notices(view))
    for expected in ("in Clear since 3.5 s: stall", "not in the token ring", "7 events"):
        assert expected in texts
    assert "12:00" not in texts
    clear = notices(view_of([*some_plant(), snapshot({}, whole=False, mode="clear")]))
    assert clear == [("in Clear: no outputs go out; dpstack ctl /dev/ttyUSB0 operate lets them out", "warn")]
    plant, *others = some_plant()
    one_of_several = {"plant": plant["plant"] | {"ctl": "virtual:4711"}}
    in_clear = notices(view_of([one_of_several, *others, snapshot({}, whole=False, mode="clear")]))
    assert in_clear == [("in Clear: no outputs go out; dpstack ctl virtual:4711 operate lets them out", "warn")]
    assert not notices(view_of(some_plant()))


def test_outputs_that_are_not_sent_are_marked() -> None:
    text = text_of(slave_lines(view_of(some_plant()), "125", 400)[0])
    assert "out 0000" in text
    assert "not sent: 0005" in text


def test_the_filter_takes_words_of_address_name_state_and_remark() -> None:
    view = view_of(some_plant())
    assert view.addresses() == ["3", "4", "8", "125"]
    assert view.addresses("TANK refused") == ["8"]
    assert view.addresses("f2100") == ["4"]
    assert view.addresses("nobody") == []
    assert view.addresses(conspicuous=True) == ["4", "8", "125"]


def test_a_changed_value_is_marked_for_a_second() -> None:
    view = view_of(some_plant())
    view.apply(snapshot({"3": {"fields": {"level": 3.5, "limit": True, "target": 5}}}, whole=False), 11.0)
    assert [text for text, style in slave_lines(view, "3", 120)[0] if style == "changed"] == ["3.5 bar"]
    view.apply(snapshot({}, whole=False), 12.5)
    assert not [text for text, style in slave_lines(view, "3", 120)[0] if style == "changed"]


def test_a_drive_that_repeats_its_state_fills_no_events() -> None:
    again = [event("drive 4 (hoist): running", 4, kind="drive")] * 50
    view = view_of([*some_plant(), *again, event("slave 3: diagnosis", 3), *again])
    assert [one["text"] for one in view.events_of("4")] == ["drive 4 (hoist): running"]
    assert [one["text"] for one in view.events_of()][-2:] == ["drive 4 (hoist): running", "slave 3: diagnosis"]


def test_events_mark_diagnoses_that_appear_and_are_gone() -> None:
    def texts(view: View) -> list[str]:
        return [text_of(event_line(one)).partition(" ")[2] for one in view.events_of("8")]

    view = view_of(rack_plant())
    broken, invalid = f"{BREAK}, slave 8 (boiler rack)", f"{INVALID}, slave 8 (boiler rack)"
    appeared = [f"+ appears: {broken}", f"+ appears: {invalid}"]
    assert texts(view) == appeared
    assert [style for text, style in event_line(view.events_of("8")[0]) if "line" in text or "app" in text] == [
        "bad"
    ] * 2
    announced = doubt(None, "uncertain", "announced", "diagnosis announced")
    for again in ([announced], [doubt(0, "bad", "channel_fault", BREAK)], []):
        more = [doubt(None, "uncertain", "slot_fault", INVALID)] if again else []
        view.apply(snapshot({"8": {"doubts": [*again, *more] or None}}, whole=False), 10.0)
    assert texts(view)[2:] == [f"- gone: {broken}", f"+ appears: {broken}", f"- gone: {broken}", f"- gone: {invalid}"]
    assert ("- gone: ", "good") in event_line(view.events_of("8")[-1])


def test_a_diagnosis_of_a_slave_that_is_lost_is_not_gone() -> None:
    view = view_of(rack_plant())
    doubts = rack_plant()[1]["snapshot"]["slaves"]["8"]["doubts"]
    for state, now in (("offline", None), ("data_exchange", doubts), ("offline", None)):
        view.apply(snapshot({"8": {"state": state, "doubts": now}}, whole=False), 10.0)
    assert len(view.events_of("8")) == 2
    view.apply(snapshot({"8": {"state": "data_exchange"}}, whole=False), 10.0)
    assert [one["change"] for one in view.events_of("8")] == ["appears", "appears", "gone", "gone"]


def test_many_diagnoses_at_once_are_few_events() -> None:
    view = view_of(rack_plant())
    many = [doubt(n, "bad", "channel_fault", f"line break: channel {n}") for n in range(32)]
    view.apply(snapshot({"8": {"doubts": many}}, whole=False), 10.0)
    events = view.events_of("8")[2:]
    assert len(events) == 9
    assert events[-1]["text"] == "26 more diagnoses, slave 8 (boiler rack)"


def test_alarms_that_come_and_go_are_marked() -> None:
    for specifier, mark in (
        ("appears", "+ appears: "),
        ("disappears", "- gone: "),
        ("disappears_others", "- gone, others stay: "),
    ):
        item = {"event": "alarm", "specifier": specifier, "text": "pull alarm", "time": "", "severity": "info"}
        assert text_of(event_line(item)) == f" {mark}pull alarm"


WATCHED = {
    ("8.level", 60): [
        "! boiler rack.level        !3.2 m       0140      bad: line",
        "    break: slot 3 (2 AI), input channel 0",
    ],
    ("8.level", 120): [
        "! boiler rack.level                    !3.2 m           0140           "
        "bad: line break: slot 3 (2 AI), input channel 0",
    ],
    ("8.temperature", 60): ["  boiler rack.temperature  81.5 °C      032f      good"],
    ("8.inlet", 60): ["  boiler rack.inlet        on           1         good"],
    ("8/3/input/1", 60): [
        "? boiler rack: slot 3 (2 AI), input channel 1",
        "                                        04e2      uncertain:",
        "    data invalid: slot 3 (2 AI)",
    ],
    ("4:speed", 60): ["  hoist: speed             12.3 %                 good"],
    ("4:torque", 60): ["  hoist: torque            -                      the slave", "    does not give it"],
}  # fmt: skip


@pytest.mark.parametrize(("name", "width"), WATCHED)
def test_a_row_of_the_watch_table_has_value_unit_octets_and_quality(name: str, width: int) -> None:
    hoist = some_plant()[0]["plant"]["slaves"]["4"]
    rack = rack_plant()
    rack[0]["plant"]["slaves"]["4"] = hoist
    rack[1]["snapshot"]["slaves"]["4"] = some_plant()[-1]["snapshot"]["slaves"]["4"]
    view = view_of(rack)
    point = points_of(view)[name]
    lines = watch_lines(view, point, width)
    assert [text_of(line).rstrip() for line in lines] == WATCHED[name, width]
    assert all(width_of(line) <= width for line in lines)
    view.now += 3
    assert "good" not in text_of(watch_lines(view, point, 200)[0])


def test_orders_are_for_outputs_and_for_inputs_of_simulated_slaves() -> None:
    def orders(**more: Any) -> dict[str, str]:
        items = [plant({**rack_plant()[0]["plant"]["slaves"], "4": some_plant()[0]["plant"]["slaves"]["4"]}, **more)]
        view = view_of([*items, *rack_plant()[1:]])
        return {name: order for name, point in points_of(view).items() if (order := point.order(view))}

    inputs = ["8.limit", "8.level", "8.pressure", "8.temperature"]
    assert orders() == {"8.inlet": "set"}
    assert orders(virtual=True) == {**dict.fromkeys(inputs, "force"), "8.inlet": "set"}
    assert orders(virtual=True, read_only=True) == {}


def test_the_channels_of_125_slaves_can_all_be_chosen() -> None:
    module = {"slot": 1, "name": "32 AI", "config": "5f", "inputs": 64, "input_at": 0, "input_width": 16, "outputs": 0}
    slaves = {str(n): slave_plant(n, f"s{n}", modules=[module]) for n in range(1, 126)}
    points = points_of(view_of([plant(slaves)]))
    assert len(points) == 125 * 32
    assert points["125/1/input/31"].label == "s125: slot 1 (32 AI), input channel 31"


def test_a_paused_view_stands_still() -> None:
    view = view_of(some_plant())
    still = view.frozen()
    view.apply(snapshot({"3": {"fields": {"level": 99.0, "limit": True, "target": 5}}}, whole=False), 10.1)
    assert "3.4 bar" in text_of(slave_lines(still, "3", 120)[0])
    assert "99 bar" in text_of(slave_lines(view, "3", 120)[0])


def test_a_histogram_shows_even_a_single_late_rotation() -> None:
    drawn = bars([[1000, 20], [1100, 400], [4012, 1]], 20)
    assert len(drawn) == 20
    assert drawn[-1] == "▁"
    assert drawn.count("█") == 1
    assert bars([[1130.0, 9]], 20) == "█"
    assert bars([[1000, 1], [1100, 8], [1300, 8]], 20) == "▂█ █"  # no blanks between classes that touch


def test_why_is_told_as_the_command_tells_it() -> None:
    story = {
        "slave": "tank", "address": 8, "source": "run", "state": "fault",
        "steps": [{"t": 0.1, "text": "Set_Prm: acknowledged"}],
        "causes": [{"cause": "module_order", "confidence": 0.9, "meaning": "another order [b]",
                    "for": ["module 2 is module 1"], "against": [], "next": "change the order"}],
    }  # fmt: skip
    text = "\n".join(map(text_of, page(view_of(some_plant()), "8", 60, story)))
    for expected in ("Set_Prm: acknowledged", "module_order (90 %): another order [b]", "next: change the order"):
        assert expected in text


@settings(max_examples=30)
@given(st.text(), st.integers(1, 50))
def test_cut_and_padded_keep_their_cells(text: str, width: int) -> None:
    assert cell_len(cut(text, width)) <= width
    assert cell_len(padded(text, width)) == width


@settings(max_examples=30)
@given(st.text(st.characters(exclude_categories=["C", "M"]), max_size=200), st.integers(12, 60))
def test_wrapped_lines_fit_and_lose_no_letter(text: str, width: int) -> None:
    lines = wrapped([(text, "")], width, 2)
    assert all(width_of(line) <= width for line in lines)
    assert "".join(map(text_of, lines)).replace(" ", "") == text.replace(" ", "")


def test_a_slave_without_any_values_yet() -> None:
    view = view_of([plant({"5": slave_plant(5, "new", inputs=[field("x")])}), snapshot({})])
    assert "unknown" in text_of(slave_lines(view, "5", 80)[0])
    assert "nothing is known" in "\n".join(map(text_of, page(view, "5", 80)))
    assert all_lines(view_of([]), 80)


def test_a_replay_has_no_masters_and_times_beyond_any_clock() -> None:
    view = View()
    view.apply({"plant": {"started": 1e300, "slaves": {}}}, 1.0)
    view.apply({"snapshot": {"t": 1.0, "whole": True, "bus": {"masters": None, "bad": None}, "slaves": {}}}, 1.0)
    assert head(view, 80)
    assert len(bars([(0.0, 1), (5e-324, 1), (1.0, 1)], 10)) == 1


@pytest.mark.parametrize(
    ("masters", "says"),
    [([2], ""), ([1, 2], ", other master at address 1"), ([1, 2, 7], ", other masters at addresses 1, 7")],
)
def test_other_masters_are_named_by_their_addresses(masters: list[int], says: str) -> None:
    """ "other masters 1" reads as a count."""
    view = view_of([plant({}), snapshot({}, masters=masters)])
    first = text_of(head(view, 200)[0]).rstrip()
    assert first.endswith(says or "500 kbit/s")
    assert ("other" in first) is bool(says)
