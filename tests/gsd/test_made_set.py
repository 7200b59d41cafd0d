"""The generator of made-up GSD files: no errors in a part of its set, and the sizes that it announces."""

from __future__ import annotations

from gsd_kit import errors

from dpstack.gsd.parser import parse_gsd
from tools.make_gsd_set import LARGEST, make_file, make_set, sizes


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
