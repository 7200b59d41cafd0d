"""How finely a source times its octets, in words that a file keeps."""

from __future__ import annotations

import pytest

from dpstack.capture.timing import LineTiming, timing_of


@pytest.mark.parametrize(
    ("timing", "text"),
    [
        (timing_of("tap", 500_000, exact=True), "times by tap, resolution 0.001 us"),
        (timing_of("adapter", 1_500_000), "times by adapter, resolution 1000 us"),
        (timing_of("adapter", 9_600), "times by adapter, resolution 4583.33 us"),
        (timing_of("host", 9_600), "times by host, resolution 1000 us"),
        (LineTiming("file", None), "times by file, resolution unknown"),
    ],
)
def test_the_words_in_a_file_give_the_timing_back(timing: LineTiming, text: str) -> None:
    assert timing.text == text
    again = LineTiming.parse(f"/dev/ttyUSB0 at 500 kbit/s; {text}; CP2102")
    assert again.source == timing.source
    assert (again.resolution_ns or 0) == pytest.approx(timing.resolution_ns or 0, rel=1e-4)


@pytest.mark.parametrize("text", ["", "a port", "times by magic, resolution 5 us", "times by tap, resolution x us"])
def test_other_descriptions_say_nothing(text: str) -> None:
    assert LineTiming.parse(text) == LineTiming("file", None)
