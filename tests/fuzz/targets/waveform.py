"""The readers of files of logic analysers (.sr, VCD, CSV), and the search for the bus in them."""

from __future__ import annotations

import io
import zipfile

from dpstack.capture.waveforms.reader import read_waveform
from dpstack.errors import CaptureFileError, UsageError
from tests.fuzz.frame import Target, assert_plain

_LIMIT = 20_000


def run(octets: bytes) -> None:
    """The first octet chooses the rate and whether the rest is the metadata and samples of a session file."""
    if not octets:
        return
    how, body = octets[0], octets[1:]
    remarks: list[str] = []
    file = io.BytesIO(_session(body) if how & 1 else body)
    try:
        transmissions = read_waveform(
            file,
            "fuzz",
            baud=(0, 0, 500_000, 9_600)[how >> 1 & 3],
            channel="A" if how & 8 else "",
            on_interface=lambda interface: assert_plain(interface.description),
            on_remark=remarks.append,
        )
        before = 0
        for number, sent in enumerate(transmissions):
            assert sent.octets
            assert sent.t_ns is not None
            assert sent.t_ns >= before
            before = sent.t_ns
            if number == _LIMIT:
                break
    except (CaptureFileError, UsageError) as error:
        assert_plain(str(error))
    for remark in remarks:
        assert_plain(remark)


def _session(body: bytes) -> bytes:
    """A zip archive with the metadata before the first zero octet of ``body``, and the samples behind it."""
    metadata, _, samples = body.partition(b"\0")
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("version", "2")
        archive.writestr("metadata", metadata)
        archive.writestr("logic-1-1", b"".join(bytes((octet,)) * 8 for octet in samples))
    return file.getvalue()


TARGET = Target(
    run,
    covers=("dpstack.capture.waveforms",),
    executions=200_000,
    max_len=600,
    words=(
        b"[device 1]\ncapturefile=logic-1\ntotal probes=8\nsamplerate=4 MHz\nprobe1=A\nunitsize=1\n\0",
        b"$timescale 1 us $end\n$var wire 1 ! A $end\n$enddefinitions $end\n#0 1!\n#2 0!\n",
        b"; Channels (2/8): A, B\n; Samplerate: 4 MHz\nlogic,logic\n",
        b"nanoseconds,logic\n",
        b"META samplerate: 24000000\n",
        b"Time [s],A,B\n0.000000000,1,X\n",
        b"Time[s], Channel 0\n",
        b"2026-09-22T08:20:18.204048396+00:00,1\n",
        b"Time [s],Value,Parity Error,Framing Error\n0.042909760000000,0x68,,Error\n",
        b'name,type,start_time,duration,data,error\n"Bus","data",0.5,0.00002,0xDC,parity\n',
        b"0.000022000,0\n",
        b"#22 0!\n",
        b"b1 !",
        b"\0\1",
    ),
)
