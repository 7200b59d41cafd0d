"""Names and types proposed for the channels of a slave, from literal identifier octets."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.api.config.channel_names import name_lines
from dpstack.api.config.config import parse_config
from dpstack.dp.channels import channels, proposed_names
from dpstack.dp.slot_map import slot_map


def test_bits_words_and_octets_of_unknown_width() -> None:
    # a bit octet in; two words in; empty; 3 octets out consistent as a whole; an octet in and out; a word in and out
    slots = slot_map(bytes.fromhex("10 51 00 A2 30 70"))
    assert proposed_names(slots) == {
        "inputs": {
            "slot1": [f"bool@0.{bit}" for bit in range(8)],
            "slot2_ai0": "i16@1",
            "slot2_ai1": "i16@3",
            "slot5_di": [f"bool@5.{bit}" for bit in range(8)],
            "slot6_ai0": "i16@6",
        },
        "outputs": {
            "slot4_out": "bytes@0:3",
            "slot5_do": [f"bool@3.{bit}" for bit in range(8)],
            "slot6_ao0": "i16@4",
        },
    }


#: identifiers of the general format: up to 4 octets or words, in, out, both, or neither; and special ones
_IDENTIFIERS = st.one_of(
    st.builds(
        lambda kind, count: bytes((kind | count,)),
        st.sampled_from([0x10, 0x20, 0x30, 0x50, 0x60, 0x70, 0x90, 0xD0, 0xF0]),
        st.integers(0, 3),
    ),
    st.sampled_from([b"\0", bytes.fromhex("C0 81 42"), bytes.fromhex("40 03"), bytes.fromhex("81 41 AA")]),
)


@examples(15)
@given(st.lists(_IDENTIFIERS, min_size=1, max_size=6))
def test_taken_names_are_those_of_all_channels(identifiers: list[bytes]) -> None:
    config = b"".join(identifiers)
    slots = slot_map(config)
    text = f'[bus]\nport = "virtual"\nbaud = 500000\n[[slave]]\naddress = 8\nident = 1\nconfig = "{config.hex()}"\n'
    (slave,) = parse_config("\n".join([text, *name_lines(slots, taken=True)])).slaves
    named = {**slave.input_fields.fields, **slave.output_fields.fields}
    assert {name: field.spec for name, field in named.items()} == {
        channel.field.name: channel.field.spec for channel in channels(slots)
    }
    for fields, length in (
        (slave.input_fields, slave.params.input_len),
        (slave.output_fields, slave.params.output_len),
    ):
        # each bit has a name, and only one
        assert sum(field.mask for field in fields.fields.values()) == (1 << 8 * length) - 1
