"""Both ends of record 47 against each other, for what has too many cases, and what a whole list takes."""

from __future__ import annotations

from acyclic_kit import IS_965, MS, READ_965, Wire, octets, talk
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from property_kit import examples

from dpstack.dpv1.pdu.read_write import ReadReq, WriteReq
from dpstack.profile.record47.client import Item, ParameterClient
from dpstack.profile.record47.formats import FORMATS
from dpstack.profile.record47.param_lists import Description, ReadParameter, defined, read_limits, read_out
from dpstack.profile.record47.parameter_server import ParameterModel, ParameterServer, Rules
from dpstack.profile.record47.pdu import (
    Address,
    Answer,
    ErrorValue,
    Limits,
    Refused,
    Request,
    Response,
    Result,
    Service,
    Values,
)

# -- both ends ---------------------------------------------------------------------------------------------------------


class Model(ParameterModel):
    """Parameters of any format; arrays by number."""

    def __init__(self, parameters: dict[int, Values]) -> None:
        self.parameters = parameters

    def read(self, address: Address) -> Result:
        here = self.parameters.get(address.pnu)
        if here is None:
            return ErrorValue(0)
        if FORMATS[here.format].string:
            return here
        end = address.subindex + max(address.elements, 1)
        return Values(here.format, here.raws[address.subindex : end]) if end <= len(here.raws) else ErrorValue(3, end)

    def change(self, address: Address, values: Values) -> ErrorValue | None:
        here = self.parameters.get(address.pnu)
        if here is None:
            return ErrorValue(0)
        if here.format != values.format:
            return ErrorValue(5)
        end = address.subindex + len(values.raws)
        raws = here.raws[: address.subindex] + values.raws + here.raws[end:]
        self.parameters[address.pnu] = Values(here.format, raws)
        return None

    def describe(self, address: Address) -> Result:
        here = self.parameters[address.pnu]
        told = Description(here.format, len(here.raws), "", False, len(here.raws) > 1, False, 1, 0, bytes(4), bytes(4))
        return Values(10, (told.build(),))


NUMBERS = [form for form in FORMATS.values() if form.code and form.octets and form.name != "Error"]


@st.composite
def arrays(draw: st.DrawFn) -> Values:
    form = draw(st.sampled_from(NUMBERS))
    length = draw(st.integers(1, 300))
    seed = draw(st.integers(0, 255))
    size = form.octets * length
    raws = form.unpack(bytes((seed + 7 * n) % 120 for n in range(size)))
    return Values(form.number, raws)


@examples(40)
@given(
    st.lists(arrays(), min_size=1, max_size=60),
    st.builds(Limits, st.integers(20, 240), st.integers(1, 39), st.integers(1, 234)),
    st.integers(0, 30),
)
def test_any_set_split_and_joined_gives_the_same_values(wanted: list[Values], limits: Limits, busy_ms: int) -> None:
    """No request and no response is longer than the drive's limits, and no value gets lost or doubled."""
    there = dict(enumerate(wanted, 1))
    model = Model(dict(there))
    wire = Wire(ParameterServer(model, Rules(limits=limits, busy_ns=busy_ms * MS)))
    master = ParameterClient(3, limits=limits)
    items = [Item(Address(pnu, 0, len(one.raws)), width=FORMATS[one.format].octets) for pnu, one in there.items()]
    told: list[tuple[int, int]] = []
    assert talk(master.read(items, progress=lambda *one: told.append(one)), wire) == wanted
    assert wire.longest <= limits.octets
    assert told == sorted(told)
    assert told[-1] == (len(wanted), len(wanted))
    backwards = [
        (one.address, Values(there[one.address.pnu].format, there[one.address.pnu].raws[::-1])) for one in items
    ]
    assert all(one == Values(0x40) for one in talk(master.change(backwards), wire))
    assert {pnu: one.raws[::-1] for pnu, one in model.parameters.items()} == {
        pnu: one.raws for pnu, one in there.items()
    }
    assert wire.longest <= limits.octets


@examples(30)
@given(st.lists(arrays(), min_size=1, max_size=8), st.integers(20, 240))
def test_a_drive_that_hides_its_limits_is_met_by_trying(wanted: list[Values], most: int) -> None:
    wire = Wire(ParameterServer(Model(dict(enumerate(wanted, 1))), Rules(limits=Limits(octets=most))))
    items = [
        Item(Address(pnu, 0, len(one.raws)), width=FORMATS[one.format].octets) for pnu, one in enumerate(wanted, 1)
    ]
    assert talk(ParameterClient(3).read(items), wire) == wanted


@examples(80)
@given(st.binary(max_size=24), st.integers(0, 60))
def test_the_server_takes_any_octets(data: bytes, length: int) -> None:
    server = ParameterServer(Model({965: Values(6, (0x328,))}))
    taken = server.write_record(1, 47, data, 0)
    answer = server.read_record(1, 47, length, 0)
    if taken is not None:
        assert answer == Refused(0xB5)
    elif isinstance(answer, bytes):
        assert Response.parse(answer).reference == data[0]


# -- drives that lie ---------------------------------------------------------------------------------------------------


class Undescribed(Model):
    """A drive without descriptions."""

    def describe(self, address: Address) -> Result:
        return ErrorValue(0x13)


class Endless(Undescribed):
    """A drive whose list has one more element behind every element."""

    def read(self, address: Address) -> Result:
        return Values(6, (7,) * max(address.elements, 1))


class Numbers(Wire):
    """The octets of a float that is no number instead of each value, where the request is not for the list."""

    def __call__(self, service: Service) -> Answer:
        if isinstance(service, WriteReq):
            self.request = service.data
        answer = super().__call__(service)
        if isinstance(service, ReadReq) and isinstance(answer.data, bytes) and self.request[6:8] != b"\x03\xd4":
            count = self.request[3]
            value = bytes.fromhex("08 01 7F C0 00 00") * count
            return Answer(answer.now, self.request[:3] + bytes((count,)) + value)
        return answer


def test_a_float_that_is_no_number_is_read_as_it_came() -> None:
    wire = Numbers(ParameterServer(Undescribed({980: Values(6, (1, 2, 0))})))
    found = talk(read_out(ParameterClient(1)), wire)
    assert [one.pnu for one in found] == [1, 2]
    assert all(one.description is None for one in found)
    assert [str(value) for one in found for value in one.values] == ["nan"] * 2


def test_the_list_of_a_drive_ends_with_the_last_subindex() -> None:
    wire = Wire(ParameterServer(Endless({})))
    assert talk(defined(ParameterClient(1)), wire) == [7]
    assert wire.now < 700 * 10 * MS


# -- the figure --------------------------------------------------------------------------------------------------------


def thousand() -> Wire:
    model = Model({980 + n: Values(6, _list(n)) for n in range(4)} | {pnu: Values(6, (pnu,)) for pnu in range(1, 976)})
    model.parameters |= {pnu: Values(8, tuple(float(one) for one in range(8))) for pnu in range(2000, 2025)}
    model.parameters[974] = Values(6, (240, 39, 0))
    return Wire(ParameterServer(model))


def _list(n: int) -> tuple[int, ...]:
    numbers = (*range(1, 976), *range(2000, 2025))
    here = numbers[299 * n : 299 * (n + 1)]
    return (*here, *(0,) * (299 - len(here)), 981 + n if n < 3 else 0)


def test_a_list_of_1000_parameters_whole_with_progress() -> None:
    """The numbers of services and octets: the time on a bus follows from them."""
    wire = thousand()
    master = ParameterClient(1)
    told: list[tuple[int, int]] = []

    def run() -> list[ReadParameter]:
        talk(read_limits(master), wire)
        return talk(read_out(master, progress=lambda *one: told.append(one)), wire)

    found = run()
    assert len(found) == 1000
    assert [one.pnu for one in found] == [*range(1, 976), *range(2000, 2025)]
    assert found[0].values == (1,)
    assert found[-1].values == tuple(float(one) for one in range(8))
    assert told[-1] == (1000, 1000)
    # by Write and Read: 974; four lists of 300 with their descriptions; descriptions of 46 octets, four a response;
    # words, 39 a request; arrays of 32 octets, six a response
    assert master.counters.requests == 1 + (4 + 10) + 250 + (25 + 5)
    assert master.counters.services == 2 * master.counters.requests
    assert master.counters.octets == 69_456
    short = ParameterClient(1)
    talk(read_out(short, described=False), thousand())
    assert short.counters.services == 2 * ((4 + 10) + 26)
    assert short.counters.octets == 12_698


def test_the_servers_request_is_the_manuals() -> None:
    server = ParameterServer(Model({965: Values(6, (0x328,))}))
    assert server.write_record(1, 47, octets(READ_965)[4:], 0) is None
    assert server.read_record(1, 47, 240, 0) == octets(IS_965)
    assert Request.parse(octets(READ_965)[4:]).addresses == (Address(965),)
    assert structs.replace(Limits(), octets=20).of_974([240]).octets == 20
