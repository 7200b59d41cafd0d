"""The residual error of a noisy line: answers sent through each adapter, and how many arrive changed and pass.

``job_noise PER_BIT SEED COUNT CHIP...``: each bit of a character is inverted with this probability. The decoder and the
port are those of a master.
"""

from __future__ import annotations

import os
import sys
import time

from vm_lab import plugged, row

from dpstack.fdl.codec import decode
from dpstack.fdl.decoder import Decoder
from dpstack.ports.tty import TtyPort

#: a Data_Exchange answer with twelve octets
ANSWER = bytes.fromhex("68 0F 0F 68 02 05 08 C4 1B 07 F0 5A 33 9E 62 D8 01 7F A6 70 16")
_BAUD = 500_000
#: longer than the answer on the line, and than the delay of any adapter here
_WAIT_S = 0.004


def main() -> None:
    per_bit, seed, count = float(sys.argv[1]), sys.argv[2], int(sys.argv[3])
    sound = decode(ANSWER)
    assert sound is not None
    for chip in sys.argv[4:]:
        line, far = os.openpty()
        os.set_blocking(line, False)
        noise = ("--far", os.ttyname(far), "--noise", str(per_bit), "--seed", seed)
        with plugged(chip, options=noise) as adapter:
            port = TtyPort(adapter.tty, _BAUD)
            port.open_now()
            same = wrong = 0
            for _ in range(count):
                os.write(line, ANSWER)
                time.sleep(_WAIT_S)
                decoder = Decoder(stall_ns=1)
                for telegram in decoder.feed(port.read_now(), 0) + decoder.stalled(1):
                    same += telegram == sound
                    wrong += telegram != sound
            damaged = adapter.news("damage")
            row("noise", chip=chip, sent=count, damaged=len(damaged), same=same, wrong=wrong, damage=port.damage())
            port.close()
        os.close(line)
        os.close(far)


if __name__ == "__main__":
    main()
