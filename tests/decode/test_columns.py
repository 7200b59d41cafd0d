"""The columns of a table of telegrams: the values of ``decode --json``, each in one cell."""

from __future__ import annotations

from recordings import WHOLE
from support import MS, S

from dpstack.capture.cutter import split
from dpstack.capture.transmission import Damage, Transmission
from dpstack.decode.columns import COLUMNS, FIXED, OF_STEP, fixed_cells
from dpstack.decode.course import Step
from dpstack.decode.telegram import Explained, explain

_SHARED = ("kind", "da", "sa", "dsap", "ssap", "service", "function", "fc", "fcb", "fcv", "error")


def _cells(one: Explained) -> dict[str, object]:
    cells = fixed_cells(one, "p")
    return dict(zip((column.name for column in FIXED), cells, strict=True))


def test_the_cells_are_the_values_of_the_json_line() -> None:
    octets = [one for recording in WHOLE for asked, said in recording.pairs for one in (asked, *split(said))]
    # a poll, its retry, a damaged answer, a token, an answer with a data unit that is no diagnosis
    octets += [bytes.fromhex(text) for text in ("68 04 04 68 03 02 5D 07 69 16", "68 04 04 68 03 02 5D 07 69 16")]
    octets += [bytes.fromhex(text) for text in ("68 04 04 68 02 03 08 AA B6 16", "DC 02 04", "10 7F 02 46 C7 16")]
    sent = [Transmission(one, S + number * MS, 500_000) for number, one in enumerate(octets)]
    kinds = set()
    for one in explain(sent):
        line, cells = one.as_dict(), _cells(one)
        assert {name: cells[name] for name in _SHARED} == {name: line[name] for name in _SHARED}
        assert (cells["port"], cells["baud"], cells["size"]) == ("p", 500_000, len(one.transmission.octets))
        fc = line["fc"]
        at = "da" if isinstance(fc, int) and fc & 0x40 else "sa" if fc is not None else "from"
        assert cells["station"] == line.get(at)
        kinds.add(line["kind"])
    assert kinds == {"SD1", "SD2", "SD4", "SC", None}


def test_what_a_file_may_claim_fits_the_types() -> None:
    (one,) = explain([Transmission(bytes(100_000), None, 1 << 40, "", Damage.TOO_LONG | Damage.FCS)])
    cells = _cells(one)
    assert (cells["baud"], cells["size"], cells["damage"]) == (None, 65_535, "check sequence, too long")
    assert (cells["port"], fixed_cells(one, "")[0]) == ("p", None)


def test_the_other_columns_are_of_the_course() -> None:
    assert {column.name for column in OF_STEP} - set(Step._fields) == {"t_sdr_ns"}
    assert len({column.name for column in COLUMNS}) == len(COLUMNS)
