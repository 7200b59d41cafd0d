"""The I/O list: its rows, what is taken back from it, and what is refused, with the line."""

from __future__ import annotations

import csv
import io

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.api.config.config import Config, parse_config
from dpstack.api.lists.io_list import COLUMNS, csv_text, fields_of, io_rows
from dpstack.api.lists.io_list_reader import TakenList, take_list
from dpstack.dp.slot_map import Direction
from dpstack.errors import ConfigError

PLANT = """\
# a plant
[bus]
port = "virtual"
baud = 500000   # for now

[[slave]]
name = "rack"
address = 8
gsd = "io-station"
modules = ["8 DI", "2 AI", "", "8 DO"]  # four slots
[slave.inputs]
limit = "bool@0.3"          # the door
level = { at = "slot 2 channel 0 i16", scale = 0.1, unit = "bar" }
# behind the names

[[slave]]
name = "raw"
address = 9
ident = 0x1234
config = "A2 10"            # 3 octets out as a whole, 1 in
inputs = { slot2 = ["bool@0.0", "bool@0.1"] }
outputs.order = "bytes@1:1"
"""
HEADER = "slave,direction,name,type,octet,bit,scale"
WHOLE = ",".join(COLUMNS)


def taken(text: str, rows: str, header: str = HEADER) -> TakenList:
    return take_list(f"{header}\n{rows}".encode(), "list.csv", parse_config(text, "plant.toml"), text)


def names(config: Config) -> dict[str, str]:
    """Type and place of all values, by slave, direction and name."""
    return {
        f"{slave.name}.{direction}.{field.name}": field.spec
        for slave in config.slaves
        for direction in Direction
        for field in fields_of(slave, direction)
    }


def test_rows_of_names_and_of_channels_without_one() -> None:
    lines = csv_text(io_rows(parse_config(PLANT))).split("\r\n")
    assert lines[0] == (
        "slave,address,slot,module,channel,direction,name,type,octet,bit,unit,scale,offset,dead_band,status,quality"
    )
    bits = [*range(3), *range(4, 8)]
    assert lines[1:9] == [
        *[f"rack,8,1,8 DI,{bit},input,,bool,0,{bit},,,,,," for bit in bits[:3]],
        "rack,8,1,8 DI,3,input,limit,bool,0,3,,,,,,",
        *[f"rack,8,1,8 DI,{bit},input,,bool,0,{bit},,,,,," for bit in bits[3:]],
    ]
    assert lines[9:11] == [
        "rack,8,2,2 AI,0,input,level,i16,1,,bar,0.1,,,,",
        "rack,8,2,2 AI,1,input,,i16,3,,,,,,,",
    ]
    assert lines[19:24] == [
        "raw,9,1,,,output,,bytes:1,0,,,,,,,",
        "raw,9,1,,,output,order,bytes:1,1,,,,,,,",
        "raw,9,1,,,output,,bytes:1,2,,,,,,,",
        "raw,9,2,,0,input,slot2_0,bool,0,0,,,,,,",
        "raw,9,2,,1,input,slot2_1,bool,0,1,,,,,,",
    ]
    assert len(lines) == 31  # empty slots have no row
    german = csv_text(io_rows(parse_config(PLANT)), semicolons=True).split("\r\n")
    assert german[9] == "rack;8;2;2 AI;0;input;level;i16;1;;bar;0,1;;;;"


def test_names_are_taken_and_all_other_lines_stay() -> None:
    rows = """\
rack,input,door,bool,0,3,
rack,input,level,i16,1,,0.25
rack,input,,i16,3,,
rack,output,valve,bool,0,7,
raw,input,slot2_1,bool,0,1,
raw,input,,bool,0,0,
raw,output,order,bytes:1,1,,
raw,output,"last one",u8,2,,
"""
    found = taken(PLANT, rows)
    assert (
        found.text
        == """\
# a plant
[bus]
port = "virtual"
baud = 500000   # for now

[[slave]]
name = "rack"
address = 8
gsd = "io-station"
modules = ["8 DI", "2 AI", "", "8 DO"]  # four slots
[slave.inputs]
door = "bool@0.3"          # the door
level = { at = "slot 2 channel 0 i16", scale = 0.25, unit = "bar" }
# behind the names

[slave.outputs]
valve = "bool@0.7"

[[slave]]
name = "raw"
address = 9
ident = 0x1234
config = "A2 10"            # 3 octets out as a whole, 1 in
inputs = { slot2_1 = "bool@0.1" }
outputs.order = "bytes@1:1"
outputs."last one" = "u8@2"
"""
    )
    assert [change.text for change in found.changes] == [
        "rack: input door renamed, it was limit (bool@0.3)",
        "rack: input level changed (i16@1)",
        "rack: output valve added (bool@0.7)",
        "raw: input slot2_0 removed",
        "raw: output last one added (u8@2)",
    ]
    assert found.kept == ()


def test_names_that_the_list_does_not_have_stay() -> None:
    found = taken(PLANT, "raw,input,x,u8,0,,\n")
    assert found.kept == ("rack.limit", "rack.level", "raw.slot2_0", "raw.slot2_1", "raw.order")
    assert found.text == PLANT.replace('"bool@0.1"] }', '"bool@0.1"], x = "u8@0" }')


@pytest.mark.parametrize(
    ("names_now", "rows", "names_then"),
    [
        ('a = "i16@0"', "r,input,a,u16,0,,\n", 'a = "u16@0"'),
        ('a = "i16@0" # word', "r,input,a,i16,0,,2\n", 'a = { at = "i16@0", scale = 2 } # word'),
        ('a = "i16@0"\nb = "i16@2"  # b', "r,input,,i16,0,,\n", 'b = "i16@2"  # b'),
        ('a.at = "i16@0"\na.scale = 2', "r,input,b,i16,0,,0.5\n", 'b.at = "i16@0"\nb.scale = 0.5'),
        ('a.at = "i16@0"\na.scale = 2', "r,input,a,i16,0,,\n", 'a.at = "i16@0"'),
        ('a.at = "i16@0"', "r,input,a,i16,0,,0.5\n", 'a.at = "i16@0"\na.scale = 0.5'),
        (
            'z = "u8@3"\n[slave.inputs.a]\nat = "i16@0"',
            "r,input,b,i16,0,,0.5\n",
            'z = "u8@3"\n[slave.inputs.b]\nat = "i16@0"\nscale = 0.5',
        ),
        ('z = "u8@3"\n[slave.inputs.a]\nat = "i16@0"', "r,input,,i16,0,,\n", 'z = "u8@3"'),
        ('  a = ["u8@0", "u8@1"]  # two', "r,input,b,u8,1,,\n", '  a_0 = "u8@0"\n  b = "u8@1"  # two'),
        (
            'a = [\n  "u8@0", # 0\n  "u8@1",\n]',
            "r,input,a_1,u8,1,,3\n",
            'a = [\n  "u8@0", # 0\n  { at = "u8@1", scale = 3 },\n]',
        ),
        ('a = ["u8@0"]', "r,input,,u8,0,,\n", None),
        ('"a b" = "u8@0"', "r,input,b,u8,0,,\nr,input,c d,u8,1,,\n", 'b = "u8@0"\n"c d" = "u8@1"'),
        ('a = "slot 1 u8@0"', "r,input,b,u8,0,,\n", 'b = "slot 1 u8@0"'),
        ('a = "slot 1 u8@0"', "r,input,a,u8,1,,\n", 'a = "u8@1"'),
    ],
)
def test_changes_of_each_layout(names_now: str, rows: str, names_then: str | None) -> None:
    head = '[bus]\nport = "virtual"\nbaud = 500000\n[[slave]]\nname = "r"\naddress = 3\nident = 1\nconfig = "13"\n'
    for line_end in ("\n", "\r\n"):
        text = f"{head}[slave.inputs]\n{names_now}\n# end\n".replace("\n", line_end)
        then = f"{head}[slave.inputs]\n{names_then}\n# end\n" if names_then else f"{head}[slave.inputs]\n# end\n"
        assert taken(text, rows).text == then.replace("\n", line_end)


def test_spreadsheets_have_their_own_ways() -> None:
    rows = "sep=;\r\nSlave;Direction;Channel;Slot;Name;Type;Octet;Bit;Scale;Unit;Remark\r\n"
    rows += 'rack;INPUT;1;2;"flow";I16;;;0,01;"l/min";"=A1; ""quoted"""\r\n'
    rows += ";;;;;;;;;;\r\n"
    rows += "rack;input;;;offset_ok;u8;1,0;;\u22122,5e-1;'-\r\n"
    found = take_list(b"\xef\xbb\xbf" + rows.encode(), "list.csv", parse_config(PLANT), PLANT)
    assert found.refused == ()
    assert found.notes == ("list.csv: the column 'remark' is not read",)
    added = '\nflow = { at = "slot 2 channel 1 i16", scale = 0.01, unit = "l/min" }\n'
    added += 'offset_ok = { at = "u8@1", scale = -0.25, unit = "-" }\n'
    assert added in found.text


def test_texts_that_a_spreadsheet_would_calculate() -> None:
    text = PLANT.replace('unit = "bar"', 'unit = "=1+1"').replace('name = "raw"', 'name = "@raw"')
    written = csv_text(io_rows(parse_config(text)))
    assert "level,i16,1,,'=1+1,0.1," in written
    assert "\r\n'@raw,9," in written
    assert take_list(written.encode(), "list.csv", parse_config(text), text).text == text


def test_a_column_that_is_missing_changes_nothing() -> None:
    text = PLANT.replace('"bar" }', '"bar", offset = 3 }')
    found = taken(text, "rack,input,pressure,i16,1,,\n")
    assert found.text == text.replace("level = ", "pressure = ").replace("scale = 0.1, ", "")
    found = taken(text, "rack,input,pressure,i16,1\n", "slave,direction,name,type,octet")
    assert found.text == text.replace("level = ", "pressure = ")


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("rakc,input,a,u8,0,,", "no slave is called 'rakc'; did you mean rack?"),
        (",input,a,u8,0,,", "no slave; write its name"),
        ("rack,sideways,a,u8,0,,", "direction = 'sideways'; write input or output"),
        ("rack,input,1a,u8,0,,", "slave rack: '1a' is no name for a field; use letters"),
        ("rack,input,a,u9x,0,,", "slave rack: a: unknown type 'u9x'"),
        ("rack,input,a,,0,,", "no type; write for instance bool, i16 or f32"),
        ("rack,input,a,u8,,,", "no octet; write octet and bit, or slot and channel"),
        ("rack,input,a,i16,4,,", 'slave rack: a = "i16@4" ends in octet 5; its configuration has octets 0..4'),
        ("rack,input,a,bool,0,,", 'slave rack: a = "bool@0": no bit; write for instance "bool@0.3"'),
        ("rack,input,a,bool,0,8,", 'slave rack: a = "bool@0.8": bit 8; an octet has bits 0..7'),
        ("rack,input,a,bool,0.3,,", "octet = 0.3 is no whole number from 0; write the bit into a column of its own"),
        ("rack,input,a,u8,-1,,", "octet = -1 is no whole number from 0"),
        ("rack,input,a,u8,99999999,,", "slave rack: a = \"u8@99999999\": no slave has so many octets"),
        ("rack,input,a,bytes,0,,", 'slave rack: a = "bytes@0": no length; write for instance "bytes@4:3"'),
        ("rack,input,a,u8,0,,1e999", "slave rack: a: scale = inf is outside -1e+09..1e+09"),
        ("rack,input,a,u8,0,,0", "slave rack: a: scale = 0 makes all values equal"),
        ('rack,input,a,u8,0,,"1.000,5"', "scale = '1.000,5' is no number; write for instance 0.1"),
        ("rack,input,a,u8,0,,nan", "scale = 'nan' is no number"),
        ("rack,input,a,bool,0,0,2", "slave rack: a: bool has no scale; only numbers have one: leave it out"),
        ("rack,input,a,u8,0,,,,x", "9 cells, the header has 7; put a text with the delimiter in it into quotes"),
        ("rack,output,limit,u8,0,,", "slave rack: 'limit' is an input and an output; give one of them another name"),
        ("raw,output,a,u8,1,,\nraw,output,b,u16,1,,", "slave raw: b (u16@1) and a (u8@1) share bits; move one"),
        ("raw,input,,u8,9,,", 'slave raw: channel = "u8@9" ends in octet 9'),
        ('rack,input,"a', "is no line of CSV (unexpected end of data); save the list as CSV again"),
    ],
)  # fmt: skip
def test_refused_rows(row: str, says: str) -> None:
    good = "rack,input,good,u8,1,,\n\nrack,input,good_too,u8,2,,\n"
    found = taken(PLANT, good + row)
    (error,) = found.refused
    assert str(error).startswith(f"list.csv:{5 + row.count(chr(10))}: {says}")
    assert (found.text, found.changes) == (PLANT, ())


def test_every_refused_line_is_listed() -> None:
    found = taken(PLANT, "rack,input,a,u8,0,,\nx,input,b,u8,0,,\nrack,input,a,u8,1,,\nrack,input,c,u8,9,,\n")
    assert [error.line for error in found.refused] == [3, 4, 5]
    assert "slave rack: 'a' stands in line 2 already; give one of them another name" in str(found.refused[1])


@pytest.mark.parametrize(
    ("header", "row", "says"),
    [
        (WHOLE, "rack,8,2,,,input,a,bool,0,0", "octet 0 of the inputs is in slot 1 (8 DI), the row has slot 2"),
        (WHOLE, "rack,8,1,,3,input,a,bool,0,0", "octet 0 is not in channel 3 of slot 1 (8 DI)"),
        (WHOLE, "rack,9,,,,input,a,bool,0,0", "rack has address 8, the row 9; correct one of them"),
        (WHOLE, "rack,80,,,,input,a,bool,0,0", "no slave has the address 80"),
        (WHOLE, "rack,8,7,,0,input,a,bool,,", 'slave rack: a = "slot 7 channel 0 bool": there is no slot 7'),
        (WHOLE, "rack,8,,,,input,a,u8,0,,[x]", "slave rack: a: unit = '[x]' has a bracket"),
        (WHOLE, "rack,8,,,,input,a,u8,0,,,,,,1,", "slave rack: status and quality go together; add quality"),
        (WHOLE, "rack,8,,,,input,a,u8,0,,,,,,1,good", "slave rack: a: unknown quality 'good'; it must be"),
    ],
)
def test_refused_rows_of_all_columns(header: str, row: str, says: str) -> None:
    (error,) = taken(PLANT, row, header).refused
    assert str(error).startswith(f"list.csv:2: {says}")


@pytest.mark.parametrize(
    ("octets", "says"),
    [
        (b"", "list.csv:1: the header has no column 'slave', 'direction', 'name', 'type', 'octet'; the first line"),
        (b"slave,direction,name,type,octett\n", "list.csv:1: there is no column 'octett'; did you mean 'octet'?"),
        (b"slave,direction,name,type,octet,name\n", "list.csv:1: the column 'name' is there twice; take one"),
        (b"slave,direction,name,type,octet\n\nrack,input,\xb0,u8,1\n", "list.csv:3: is not UTF-8 text; save it as CSV"),
        (b'slave,direction,name,type,octet,"\n', "list.csv:1: is no CSV (unexpected end of data)"),
    ],
)
def test_files_that_are_no_list(octets: bytes, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        take_list(octets, "list.csv", parse_config(PLANT), PLANT)
    assert str(caught.value).startswith(says)


# --- properties -------------------------------------------------------------------------------------------------------

#: four octets each way: bits, two words, an octet out; by octets, and the second slot by its number
_PLACES = (
    "bool@0.0",
    "bool@0.7",
    "u8@0",
    "i16@1",
    "slot 2 channel 0 i16",
    "slot 2 i16@2",
    "f32@1",
    "u12@3",
    "bytes@1:4",
)
_NAMES = st.from_regex(r"\A[a-zµ][a-z_ -]{0,3}[a-z]\Z")
_SCALES = st.fixed_dictionaries(
    {},
    optional={
        "scale": st.sampled_from([0.1, -2, 1e-5, 1]),
        "offset": st.sampled_from([-50, 0.5]),
        "unit": st.sampled_from(["°C", "=x", "'", "a;b", 'l"m', "m,n", " pad "]),
    },
)


@st.composite
def _declared(draw: st.DrawFn, name: str, *, on_one_line: bool) -> str:
    """An input in one of the layouts."""
    key = f'"{name}"'
    at = draw(st.sampled_from(_PLACES))
    scale = draw(_SCALES) if at[0] in "iuf" else {}
    written = [f"{one} = {value!r}" if one != "unit" else f"unit = '''{value}'''" for one, value in scale.items()]
    layout = draw(st.sampled_from(["inline", "dotted", "list", "table"]))
    inline = f'{{ at = "{at}"{"".join(f", {one}" for one in written)} }}'
    if on_one_line:
        found = {
            "dotted": ", ".join(f"{key}.{one}" for one in (f'at = "{at}"', *written)),
            "list": f'{key} = ["u8@0", {inline}]',
        }
        return found.get(layout, f"{key} = {inline if written else repr(at)}")
    comment = draw(st.sampled_from(["", " # why, [slave]"]))
    if layout == "dotted":
        return "\n".join(f"{key}.{one}{comment}" for one in (f'at = "{at}"', *written))
    if layout == "list":
        return f'{key} = [{comment and " # why" + chr(10)}"u8@0", {inline}]{comment}'
    if layout == "table":
        return "\n".join([f"[slave.inputs.{key}]{comment}", f'at = "{at}"', *written])
    return f"{key} = {inline if written else repr(at)}{comment}"


@st.composite
def _plants(draw: st.DrawFn) -> str:
    """A configuration with names in several layouts."""
    lines = ["[bus]", 'port = "virtual"', "baud = 500000"]
    for address in range(3, 3 + draw(st.integers(1, 2))):
        lines += ["[[slave]]", f'name = "s{address}"', f"address = {address}", "ident = 1", 'config = "10 51 20"']
        if draw(st.booleans()):
            unique = draw(st.lists(_NAMES, max_size=4, unique=True))
            on_one_line = draw(st.booleans())
            found = [draw(_declared(name, on_one_line=on_one_line)) for name in unique]
            found.sort(key=lambda text: text.startswith("["))  # tables of their own come last
            if on_one_line:
                lines += [f"inputs = {{ {', '.join(found)} }}  # names"]
            else:
                lines += ["# names", "[slave.inputs]", *found, "# end"]
        if draw(st.booleans()):
            lines += ["[slave.outputs]", 'valve = "bool@0.1"']
    end = draw(st.sampled_from(["\n", "\r\n"]))
    return "\n".join(lines).replace("\n", end) + draw(st.sampled_from(["", end]))


@examples(25)
@given(_plants(), st.booleans())
def test_a_list_as_it_was_written_changes_no_octet(text: str, semicolons: bool) -> None:
    config = parse_config(text)
    written = csv_text(io_rows(config), semicolons=semicolons).encode()
    found = take_list(written, "list.csv", config, text)
    assert (found.refused, found.changes, found.kept, found.text) == ((), (), (), text)


@examples(25)
@given(_plants(), st.data())
def test_a_list_that_was_edited_is_what_the_configuration_has_then(text: str, data: st.DataObject) -> None:
    config = parse_config(text)
    rows = list(csv.DictReader(io.StringIO(csv_text(io_rows(config)), newline="")))
    for number in data.draw(st.sets(st.integers(0, len(rows) - 1), max_size=6)):
        row = rows[number]
        row["name"] = data.draw(st.sampled_from(["", f"new {number}", row["name"]]))
        if row["type"] == "i16" and data.draw(st.booleans()):
            row["scale"], row["unit"] = "0,5", "kg"
    written = io.StringIO(newline="")
    writer = csv.DictWriter(written, COLUMNS)
    writer.writeheader()
    writer.writerows(rows)
    found = take_list(written.getvalue().encode(), "list.csv", config, text)
    assert found.refused == ()
    then = parse_config(found.text, "plant.toml")
    assert names(then) == {
        f"{row['slave']}.{row['direction']}.{row['name']}": (
            f"{row['type'].partition(':')[0]}@{row['octet']}"
            + (f".{row['bit']}" if row["bit"] else "")
            + "".join(row["type"].partition(":")[1:])
        )
        for row in rows
        if row["name"]
    }
    scaled = {(row["slave"], row["name"]) for row in rows if row["name"] and row["scale"] == "0,5"}
    fields = [(slave.name, field) for slave in then.slaves for way in Direction for field in fields_of(slave, way)]
    assert {(slave, field.name) for slave, field in fields if (field.scale, field.unit) == (0.5, "kg")} == scaled
    # all lines that are no names stay, in their order
    others = [line for line in text.splitlines() if line.startswith(("#", "[[", "port", "baud", "name", "config"))]
    rest = iter(found.text.splitlines())
    assert all(line in rest for line in others)
    # and the new text says the same in its own list
    again = take_list(csv_text(io_rows(then)).encode(), "list.csv", then, found.text)
    assert (again.changes, again.text) == ((), found.text)


@examples(40)
@given(
    st.one_of(
        st.binary(max_size=60),
        st.text(alphabet='slave,direction;name"\n\r\x0b\x00\u2028\ufeff=@0a', max_size=60).map(str.encode),
        st.lists(st.text(alphabet="rack input,a8\"'=;.:-@\n\tbool", max_size=12), max_size=12).map(
            lambda cells: f"{HEADER}\n{','.join(cells)}\n".encode()
        ),
    )
)
def test_any_file_is_taken_or_refused_in_one_line(octets: bytes) -> None:
    try:
        found = take_list(octets, "list.csv", parse_config(PLANT), PLANT)
    except ConfigError as error:
        errors: tuple[ConfigError, ...] = (error,)
    else:
        errors = found.refused
        parse_config(found.text)
    for refused in errors:
        assert "\n" not in str(refused)
        assert str(refused).startswith("list.csv")
