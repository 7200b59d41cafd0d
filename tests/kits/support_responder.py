"""PROFIBUS-DP slaves that know only octets: an independent other end for tests and benchmarks.

Nothing of the project is imported here. Slaves are plain dictionaries of octets on one tty; a token is ignored, FDL
status and the DP services needed for data exchange are answered, a repeated frame count bit gets the kept answer again.

    python tests/kits/support_responder.py TTY 3:0696:f3f1:12:12 4:1234:2010:1:1,refuse=cfg

SPEC is ``ADDRESS:IDENT:IDENTIFIERS:INPUTS:OUTPUTS[,key=value...]``: ident and identifier octets in hex, lengths in
octets. Inputs mirror the outputs. Keys: ``refuse=prm`` or ``refuse=cfg`` (the fault shows in the diagnosis),
``owner=N`` (locked to master N from the start), ``answer=N`` (Data_Exchange answers have N octets), ``dies=N`` (silent
after N data exchanges), ``fixed=HEX`` (these inputs instead of the mirror), ``locked=1`` (keeps its address),
``records=1`` (Read and Write of DP-V1 at SAP 51: acknowledged, answered when polled, with zeros), ``watchdog=1`` (it
keeps the watchdog of Set_Prm; when it expires, outputs are zeros and it wants parameters).
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import threading
import time
import tty
from collections.abc import Iterable

SC = b"\xe5"


class Slave:
    """One slave's octets and what it remembers."""

    def __init__(self, address: int, ident: bytes, identifiers: bytes, inputs: int, outputs: int, **keys: str) -> None:
        self.address = address
        self.ident = ident
        self.identifiers = identifiers
        self.outputs = bytes(outputs)
        self.output_count = outputs
        self.answer_count = int(keys.get("answer", inputs))
        self.fixed_inputs = bytes.fromhex(keys["fixed"]) if "fixed" in keys else None
        self.refuse = keys.get("refuse", "")
        self.dies = int(keys.get("dies", 0))
        self.owner = int(keys.get("owner", 255))
        self.foreign = "owner" in keys
        self.prm_ok = self.foreign
        self.cfg_ok = self.foreign
        self.prm_fault = False
        self.cfg_fault = False
        self.watchdog = False
        self.watchdog_factors = b""
        self.keeps_watchdog = "watchdog" in keys
        self.asked_at = 0.0
        self.expired = 0
        self.exchanges = 0
        self.repeats = 0
        self.control = b""
        self.user_prm = b""
        self.address_locked = "locked" in keys
        self.records = "records" in keys
        self.ms1 = b""
        self.kept_sa = -1
        self.kept_fcb = -1
        self.kept_answer = b""

    def answer(self, sa: int, fc: int, saps: bytes, data: bytes) -> bytes:
        """The answer to one request; empty when there is none."""
        if self.dies and self.exchanges >= self.dies:
            return b""
        if self.keeps_watchdog:
            self.look_at_watchdog(sa)
        function = fc & 0x0F
        if function == 0x09:
            return short(sa, self.address, 0x00)
        if function in (0x04, 0x06):
            if saps[:1] == b"\x3a" and len(data) >= 2:
                self.control = data[:2]
            return b""
        if function not in (0x03, 0x05, 0x0C, 0x0D):
            return short(sa, self.address, 0x03)
        counted, bit = fc & 0x10, 1 if fc & 0x20 else 0
        if counted and sa == self.kept_sa and bit == self.kept_fcb:
            self.repeats += 1
            return self.kept_answer
        self.kept_sa, self.kept_fcb = sa, bit
        self.kept_answer = self.serve(sa, saps, data)
        return self.kept_answer

    def look_at_watchdog(self, sa: int) -> None:
        """A request of master ``sa``: whether it comes too late, by the factors of Set_Prm (10 ms each)."""
        now = time.monotonic()
        watched = self.prm_ok and self.watchdog
        if watched and now - self.asked_at > self.watchdog_factors[0] * self.watchdog_factors[1] * 0.01:
            self.prm_ok = self.cfg_ok = False
            self.owner, self.outputs, self.kept_fcb = 255, bytes(self.output_count), -1
            self.expired += 1
        if sa == self.owner or not self.prm_ok:
            self.asked_at = now

    def serve(self, sa: int, saps: bytes, data: bytes) -> bytes:
        """One service, executed."""
        if not saps:
            return self.data_exchange(sa, data)
        service = saps[0]
        if service == 60:
            return long(sa, self.address, 0x08, bytes((saps[1], saps[0])), self.diagnosis())
        if service == 61:
            self.set_prm(sa, data)
            return SC
        if service == 62:
            self.chk_cfg(sa, data)
            return SC
        if service == 55:
            return self.set_address(sa, data)
        if service in (56, 57):
            return self.read(sa, saps)
        if service == 51 and self.records and self.cfg_ok and sa == self.owner:
            return self.record(sa, saps, data)
        if service == 59:
            return long(sa, self.address, 0x08, bytes((saps[1], saps[0])), self.identifiers)
        return short(sa, self.address, 0x03)

    def record(self, sa: int, saps: bytes, data: bytes) -> bytes:
        """5E: Read, 5F: Write; then slot, index, length. No data: a poll."""
        if len(data) >= 4 and data[0] in (0x5E, 0x5F):
            self.ms1 = data[:4] + bytes(data[3] if data[0] == 0x5E else 0)
            return SC
        answer, self.ms1 = self.ms1, b""
        return long(sa, self.address, 0x08, bytes((saps[1], saps[0])), answer) if answer else SC

    def read(self, sa: int, saps: bytes) -> bytes:
        """Inputs (SAP 56) and outputs (57) for anybody, in data exchange."""
        if not self.cfg_ok:
            return short(sa, self.address, 0x03)
        source = self.outputs if saps[0] == 57 or self.fixed_inputs is None else self.fixed_inputs
        count = self.answer_count if saps[0] == 56 else self.output_count
        if not count:
            return short(sa, self.address, 0x09)
        return long(sa, self.address, 0x08, bytes((saps[1], saps[0])), source[:count].ljust(count, b"\x00"))

    def set_address(self, sa: int, data: bytes) -> bytes:
        """New address, ident, no more changes; only while nobody owns the slave."""
        if self.prm_ok:
            return short(sa, self.address, 0x03)
        if len(data) >= 4 and data[1:3] == self.ident and not self.address_locked:
            self.address, self.address_locked = data[0], data[3] != 0
        return SC

    def diagnosis(self) -> bytes:
        """Six octets."""
        one = (0x02 if not (self.prm_ok and self.cfg_ok) else 0) | (0x04 if self.cfg_fault else 0)
        one |= 0x40 if self.prm_fault else 0
        two = 0x04 | (0x00 if self.prm_ok else 0x01) | (0x08 if self.watchdog else 0)
        return bytes((one, two, 0x00, self.owner)) + self.ident

    def set_prm(self, sa: int, data: bytes) -> None:
        """Octet 1: 10 lock, 01 and 11 unlock; octets 5 and 6: ident."""
        if self.foreign or len(data) < 7:
            return
        if data[0] & 0x40:
            self.prm_ok = self.cfg_ok = False
            self.owner = 255
        elif data[4:6] != self.ident or self.refuse == "prm":
            self.prm_ok = self.cfg_ok = False
            self.prm_fault, self.owner = True, 255
        elif data[0] & 0x80:
            self.prm_fault = self.cfg_fault = self.cfg_ok = False
            self.prm_ok, self.owner = True, sa
            self.watchdog, self.watchdog_factors = bool(data[0] & 0x08), data[1:3]
            self.user_prm = data[7:]

    def chk_cfg(self, sa: int, data: bytes) -> None:
        """The identifiers must be the slave's own."""
        if self.foreign or not self.prm_ok or sa != self.owner:
            return
        if data != self.identifiers or self.refuse == "cfg":
            self.cfg_fault, self.cfg_ok, self.prm_ok, self.owner = True, False, False, 255
        else:
            self.cfg_fault, self.cfg_ok = False, True

    def data_exchange(self, sa: int, data: bytes) -> bytes:
        """Outputs in, inputs out; not before parameters and configuration."""
        if not (self.prm_ok and self.cfg_ok and sa == self.owner):
            return short(sa, self.address, 0x03)
        if len(data) not in (0, self.output_count):  # none: fail-safe Clear, or a slave without outputs
            self.prm_ok = self.cfg_ok = False
            self.cfg_fault, self.owner = True, 255
            return short(sa, self.address, 0x03)
        self.outputs = data or bytes(self.output_count)
        self.exchanges += 1
        if not self.answer_count:
            return SC
        source = self.outputs if self.fixed_inputs is None else self.fixed_inputs
        return long(sa, self.address, 0x08, b"", source[: self.answer_count].ljust(self.answer_count, b"\x00"))


def short(da: int, sa: int, fc: int) -> bytes:
    """SD1."""
    return bytes((0x10, da, sa, fc, (da + sa + fc) & 0xFF, 0x16))


def long(da: int, sa: int, fc: int, saps: bytes, data: bytes) -> bytes:
    """SD2; ``saps`` is DSAP, SSAP or nothing."""
    if saps:
        da, sa = da | 0x80, sa | 0x80
    body = bytes((da, sa, fc)) + saps + data
    size = len(body)
    return bytes((0x68, size, size, 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))


def cut(buffer: bytearray) -> bytes | None:
    """Takes one telegram off the front of ``buffer``: its octets from DA to the data; None when more is needed.

    A token and a short acknowledgement come out empty. Octets that start nothing are dropped.
    """
    while buffer:
        start = buffer[0]
        if start == 0xDC:
            if len(buffer) < 3:
                return None
            del buffer[:3]
            return b""
        if start == 0xE5:
            del buffer[:1]
            return b""
        if start == 0x68:
            if len(buffer) < 4:
                return None
            size, offset = buffer[1], 4
            bad = buffer[2] != size or buffer[3] != 0x68 or size < 3
        elif start in (0x10, 0xA2):
            size, offset, bad = (3 if start == 0x10 else 11), 1, False
        else:
            bad, size, offset = True, 0, 0
        if not bad:
            end = offset + size
            if len(buffer) < end + 2:
                return None
            body = bytes(buffer[offset:end])
            if buffer[end] == sum(body) & 0xFF and buffer[end + 1] == 0x16:
                del buffer[: end + 2]
                return body
        del buffer[:1]
    return None


def parse(spec: str) -> Slave:
    """``ADDRESS:IDENT:IDENTIFIERS:INPUTS:OUTPUTS[,key=value...]``."""
    head, *rest = spec.split(",")
    address, ident, identifiers, inputs, outputs = head.split(":")
    keys = dict(item.split("=", 1) for item in rest)
    return Slave(int(address), bytes.fromhex(ident), bytes.fromhex(identifiers), int(inputs), int(outputs), **keys)


class Responder:
    """Slaves on one tty. Run it in the foreground (:meth:`run`) or in a thread (as a context manager)."""

    def __init__(self, path: str, slaves: Iterable[Slave | str]) -> None:
        made = [parse(s) if isinstance(s, str) else s for s in slaves]
        self.slaves = {slave.address: slave for slave in made}
        self.tokens = 0
        self.idle = 0  # looks of 50 ms each in which nobody sent anything
        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        with contextlib.suppress(termios.error):
            tty.setraw(self.fd)
        termios.tcflush(self.fd, termios.TCIOFLUSH)
        self._buffer = bytearray()
        self._stop_read, self._stop_write = os.pipe()
        self._thread: threading.Thread | None = None

    def feed(self, chunk: bytes) -> bytes:
        """Octets in, octets out."""
        buffer = self._buffer
        buffer += chunk
        out = b""
        while buffer:
            token = buffer[0] == 0xDC
            body = cut(buffer)
            if body is None:
                break
            if body:
                out = self.request(body)  # an earlier request in the same chunk is too old to be answered
            elif token:
                self.tokens += 1
        return out

    def request(self, body: bytes) -> bytes:
        """One telegram from DA on."""
        da, sa, fc = body[0], body[1], body[2]
        if not fc & 0x40:
            return b""  # an answer
        saps, data = b"", body[3:]
        if da & 0x80:
            saps, data = data[:1], data[1:]
        if sa & 0x80:
            saps, data = saps + data[:1], data[1:]
        da, sa = da & 0x7F, sa & 0x7F
        if len(saps) == 1:
            return b""
        if da == 127:
            for slave in self.slaves.values():
                slave.answer(sa, fc, saps, data)
            return b""
        asked = self.slaves.get(da)
        if asked is None:
            return b""
        answer = asked.answer(sa, fc, saps, data)
        if asked.address != da:
            self.slaves[asked.address] = self.slaves.pop(da)
        return answer

    def run(self) -> None:
        """Serve until :meth:`stop` or until the line hangs up."""
        fd, stop = self.fd, self._stop_read
        while True:
            # 50 ms without the rest of a telegram: it does not come any more
            ready, _, _ = select.select((fd, stop), (), (), 0.05)
            if stop in ready:
                return
            if not ready:
                self.idle += 1
                self._buffer.clear()
                continue
            try:
                chunk = os.read(fd, 4096)
            except OSError:
                return
            if not chunk:
                return
            out = self.feed(chunk)
            if out:
                try:
                    os.write(fd, out)
                except OSError:
                    return

    def stop(self) -> None:
        """End :meth:`run` and close the tty."""
        os.write(self._stop_write, b"x")
        if self._thread is not None:
            self._thread.join(5)
        for fd in (self.fd, self._stop_read, self._stop_write):
            os.close(fd)

    def __enter__(self) -> Responder:
        self._thread = threading.Thread(target=self.run, name="responder", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_exc: object) -> None:
        self.stop()


def main() -> int:
    """The script: serves until it is killed or the line hangs up."""
    if len(sys.argv) < 3:
        print(__doc__, file=sys.stderr)
        return 2
    responder = Responder(sys.argv[1], sys.argv[2:])
    print("ready", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        responder.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
