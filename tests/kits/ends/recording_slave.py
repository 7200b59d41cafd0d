"""Slaves on a pty that record the last telegrams to them, with watchdogs that act. Imports nothing of dpstack.

    python -m ends.recording_slave LINK 4:1234:2111:2:2=1122 5:1234:2010:1:1=77

Each argument is a slave as in ``support_responder`` and the outputs that count as live. The program makes a pty whose
path is LINK, and writes one JSON value a line: ``"ready"``; ``"live"`` when all slaves have their live outputs; after
the command ``end`` on its standard input the record, once the line is silent and each slave has safe outputs or no
watchdog. Commands: ``mark`` (the record begins here), ``look`` (the record so far), ``hang up`` (the line is cut),
``end``.

The record has for each address: ``words`` (the telegrams without repetitions: outputs in hex, "clear", "operate"),
``outputs`` (at the end), ``exchanges``, ``watchdog_ms`` (of Set_Prm, 0 is off) and ``expired_ms``: the time from the
last telegram of the master to the expiry of the watchdog, None where it has not expired.
"""

from __future__ import annotations

import json
import os
import select
import sys
import time
import tty

from support_responder import Responder, Slave, parse

#: s without a telegram after which the line is silent
QUIET_S = 0.3


class Recorder(Responder):
    """The slaves, and what was sent to them since the last mark."""

    def __init__(self, link: str, specs: list[str]) -> None:
        given = [spec.partition("=") for spec in specs]
        master, self.slave_fd = os.openpty()
        tty.setraw(self.slave_fd)
        super().__init__(os.ttyname(self.slave_fd), [parse(spec) for spec, _, _ in given])
        os.dup2(master, self.fd)
        os.close(master)
        self.link = link
        os.symlink(os.ttyname(self.slave_fd), link)
        self.live = {
            slave.address: bytes.fromhex(octets)
            for slave, (_, _, octets) in zip(self.slaves.values(), given, strict=True)
        }
        self.asked = dict.fromkeys(self.slaves, 0.0)
        self.heard = time.monotonic()
        self.was_live = False
        self.mark()

    def mark(self) -> None:
        self.words: dict[int, list[str]] = {address: [] for address in self.slaves}
        self.expired_ms: dict[int, float | None] = dict.fromkeys(self.slaves)
        self.exchanges = {address: slave.exchanges for address, slave in self.slaves.items()}

    # --- telegrams ---
    def request(self, body: bytes) -> bytes:
        now = self.heard = time.monotonic()
        da, sa, fc = body[0], body[1], body[2]
        if fc & 0x40:
            for address, slave in self.slaves.items():
                if da & 0x7F in (address, 127):
                    self.note(address, body)
                    if sa & 0x7F == slave.owner:
                        self.asked[address] = now
        answer = super().request(body)
        owner = self.slaves.get(da & 0x7F)
        if owner is not None and sa & 0x7F == owner.owner:  # Set_Prm has made it this master's
            self.asked[owner.address] = now
        if not self.was_live and all(self.slaves[address].outputs == octets for address, octets in self.live.items()):
            self.was_live = True
            say("live")
        return answer

    def note(self, address: int, body: bytes) -> None:
        word = None
        if body[0] == address:  # no SAP: Data_Exchange
            if len(body) > 3:
                word = body[3:].hex()
        elif body[3] == 58 and len(body) > 6:
            word = "clear" if body[5] & 0x02 else "operate"
            if word == "clear":
                slave = self.slaves[address]
                slave.outputs = bytes(slave.output_count)
        words = self.words[address]
        if word is not None and words[-1:] != [word]:
            words.append(word)

    # --- watchdogs ---
    def limit_ms(self, slave: Slave) -> int:
        if not (slave.prm_ok and slave.cfg_ok and slave.watchdog):
            return 0
        return slave.watchdog_factors[0] * slave.watchdog_factors[1] * 10

    def act(self) -> None:
        """Each watchdog that is due makes its slave's outputs safe."""
        now = time.monotonic()
        for address, slave in self.slaves.items():
            limit, gap = self.limit_ms(slave), (now - self.asked[address]) * 1000
            if limit and gap >= limit:
                slave.prm_ok = slave.cfg_ok = False
                slave.owner, slave.outputs, slave.kept_fcb = 255, bytes(slave.output_count), -1
                slave.expired += 1
                self.expired_ms[address] = gap

    def wait_s(self) -> float:
        now = time.monotonic()
        left = [
            self.asked[address] + self.limit_ms(slave) / 1000 - now
            for address, slave in self.slaves.items()
            if self.limit_ms(slave)
        ]
        return max(0.0, min([*left, QUIET_S / 3]))

    # --- the program ---
    def record(self) -> dict[str, object]:
        return {
            str(address): {
                "words": self.words[address],
                "outputs": slave.outputs.hex(),
                "exchanges": slave.exchanges - self.exchanges[address],
                "watchdog_ms": slave.watchdog_factors[0] * slave.watchdog_factors[1] * 10 if slave.watchdog else 0,
                "expired_ms": self.expired_ms[address],
            }
            for address, slave in self.slaves.items()
        }

    def is_over(self) -> bool:
        """Nobody sends, and each slave with a watchdog has other outputs than the live ones."""
        waits = [a for a, slave in self.slaves.items() if self.limit_ms(slave) and slave.outputs == self.live[a]]
        return time.monotonic() - self.heard > QUIET_S and not waits

    def hang_up(self) -> None:
        os.unlink(self.link)
        os.close(self.slave_fd)
        null = os.open(os.devnull, os.O_RDONLY)
        os.dup2(null, self.fd)
        os.close(null)

    def serve(self) -> None:
        """Until ``end``, or the end of standard input."""
        line, ending = self.fd, False
        commands = open(0, "rb", buffering=0, closefd=False)  # noqa: SIM115 -- select looks at the descriptor
        while not (ending and self.is_over()):
            readable, _, _ = select.select((line, 0) if line >= 0 else (0,), (), (), self.wait_s())
            self.act()
            if line in readable:
                try:
                    out = self.feed(os.read(line, 4096))
                    if out:
                        os.write(line, out)
                except OSError:
                    pass
            if 0 in readable and not ending:
                command = commands.readline().decode().strip()
                if command == "mark":
                    self.mark()
                elif command == "look":
                    say(self.record())
                elif command == "hang up":
                    self.hang_up()
                    line = -1
                else:
                    if not command:
                        return
                    ending = True
            elif ending and 0 in readable:
                return  # the test has gone
        say(self.record())


def say(value: object) -> None:
    print(json.dumps(value), flush=True)


def main() -> None:
    recorder = Recorder(sys.argv[1], sys.argv[2:])
    say("ready")
    recorder.serve()


if __name__ == "__main__":
    main()
