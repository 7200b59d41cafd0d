"""pyprofibus as a program: its class 1 master with its configuration file. Run: ``pyprofibus_master.py FILE.conf``.

Standard input: a line of JSON, slave -> outputs (hex). Standard output: lines of JSON, first with what was sent
(``{"sent": {slave: {"prm": .., "cfg": ..}}}``), then whenever something changed ``{"connected": [slaves],
"inputs": {slave: hex}}``. The end of standard input ends it without a word to the slaves: it has none.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
from typing import Any


def main() -> None:
    from pyprofibus import PbConf

    told = os.fdopen(os.dup(1), "w")  # its own messages go to standard error
    with contextlib.redirect_stdout(sys.stderr):
        config = PbConf.fromFile(sys.argv[1])
        master = config.makeDPM()
        outputs: dict[str, bytearray] = {}
        sent = {}
        for conf in config.slaveConfs:
            slave = conf.makeDpSlaveDesc()
            sent[conf.name] = {
                "prm": bytes(slave.setPrmTelegram.getDU()).hex(),
                "cfg": bytes(slave.chkCfgTelegram.getDU()).hex(),
            }
            # its words are the slave's: input is what the slave takes in
            outputs[conf.name] = bytearray(conf.inputSize)
            master.addSlave(slave)
        print(json.dumps({"sent": sent}), file=told, flush=True)
        ended = threading.Event()
        threading.Thread(target=listen, args=(outputs, ended), daemon=True).start()
        master.initialize()
        slaves = {slave.name: slave for slave in master.getSlaveList()}
        inputs: dict[str, str] = {}
        last = ""
        while not ended.is_set():
            for name, slave in slaves.items():
                slave.setMasterOutData(outputs[name])
            served: Any = master.run()
            if served is not None and (data := served.getMasterInData()) is not None:
                inputs[served.name] = bytes(data).hex()
            state = {"connected": sorted(n for n, slave in slaves.items() if slave.isConnected()), "inputs": inputs}
            if (line := json.dumps(state, sort_keys=True)) != last:
                last = line
                print(line, file=told, flush=True)


def listen(outputs: dict[str, bytearray], ended: threading.Event) -> None:
    """Take orders until standard input ends."""
    for line in sys.stdin:
        for name, octets in json.loads(line).items():
            outputs[name] = bytearray.fromhex(octets)
    ended.set()


if __name__ == "__main__":
    main()
