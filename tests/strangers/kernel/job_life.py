"""A run whose plug is pulled and comes back under another name, and other programs at its port."""

from __future__ import annotations

import glob
import os
import subprocess
import time

from vm_lab import attempt, dpstack, member_of_dialout, plant, plugged, row, slaves, start, ttys, until


def unplugged(config: str, far: str) -> None:
    with plugged("ft232r=FT1", options=("--far", far, "--far-baud", "187500")) as adapter:
        (by_id,) = glob.glob("/dev/serial/by-id/*FT1*")
        run = start("run", config, "--port", by_id, "--seconds", "5", "--plain")
        time.sleep(2.2)
        adapter.say("unplug")
        time.sleep(0.1)
        with plugged("cp2102n") as other:
            adapter.say("plug", "3")
            until(lambda: os.path.exists(by_id))
            name = os.path.realpath(by_id)
            text, _ = run.communicate(timeout=120)
            row("unplugged", before=adapter.tty, other=other.tty, after=name, code=run.returncode, text=text[:9000])
        adapter.ttys = sorted(ttys())


def by_stty(config: str, far: str) -> None:
    """Another program of root sets the port while it runs."""
    with plugged("ft232r", options=("--far", far, "--far-baud", "187500")) as adapter:
        run = start("run", config, "--port", adapter.tty, "--seconds", "4", "--plain")
        time.sleep(2.2)
        adapter.news()
        done = subprocess.run(["stty", "-F", adapter.tty, "9600", "-parenb"], check=False)
        text, _ = run.communicate(timeout=120)
        rates = [entry["real"] for entry in adapter.news("rate")]
        row("stty", code=run.returncode, stty=done.returncode, rates=rates, text=text[:9000])


def by_reader(config: str, far: str) -> None:
    """Another program of root reads along, and steals octets; one of a user cannot."""
    with plugged("ft232r", options=("--far", far, "--far-baud", "187500")) as adapter:
        os.chmod(adapter.tty, 0o666)
        run = start("run", config, "--port", adapter.tty, "--seconds", "6", "--plain")
        time.sleep(2.2)
        user = subprocess.run(["cat", adapter.tty], capture_output=True, text=True, preexec_fn=member_of_dialout)
        reader = subprocess.Popen(["cat", adapter.tty], stdout=subprocess.DEVNULL)
        time.sleep(0.5)
        _, doctor = dpstack("doctor", "--port", adapter.tty)
        text, _ = run.communicate(timeout=120)
        reader.kill()
        reader.wait(5)
        row("reader", code=run.returncode, user=user.stderr.strip(), doctor=doctor, text=text[:9000])


def held() -> None:
    """A port that another program holds: names, advice."""
    with plugged("ft232r") as adapter:
        os.chown(adapter.tty, 0, 20)
        os.chmod(adapter.tty, 0o660)
        code = f"open('/proc/self/comm', 'w').write('ModemManager'); port = open({adapter.tty!r}); input()"
        holder = subprocess.Popen(["python3", "-c", code], stdin=subprocess.PIPE)
        time.sleep(0.3)
        _, doctor = dpstack("doctor", "--port", adapter.tty)
        _, as_user = dpstack("doctor", "--port", adapter.tty, as_user=True)
        holder.kill()
        holder.wait(5)
        row("held", doctor=doctor, as_user=as_user)


def mark_parity() -> None:
    """CMSPAR left by another program; what the chip is sent then."""
    with plugged("ft232r") as adapter:
        code = (
            "import sys; sys.path[:0] = ['/job', '/app']\n"
            "import fcntl, os, struct, time\n"
            f"fd = os.open({adapter.tty!r}, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)\n"
            "b = bytearray(44); fcntl.ioctl(fd, 0x802C542A, b, True)\n"
            "t = list(struct.unpack('=4IB19s2I', b)); t[2] |= 0o10000000400\n"
            "fcntl.ioctl(fd, 0x402C542B, struct.pack('=4IB19s2I', *t)); os.write(1, b'set'); time.sleep(60)\n"
        )
        other = subprocess.Popen(["python3", "-c", code], stdout=subprocess.PIPE, text=True)
        assert other.stdout is not None
        other.stdout.read(3)
        left = adapter.news("frame")
        from dpstack.ports.tty import TtyPort

        port = TtyPort(adapter.tty, 187_500)
        refused = attempt(port.open_now)
        taken = adapter.news("frame")
        port.close()
        other.kill()
        sent = [frames[-1]["parity"] if frames else None for frames in (left, taken)]
        row("parity", left=sent[0], taken=sent[1], error=refused)


def main() -> None:
    config = plant()
    with slaves(config) as far:
        unplugged(config, far)
        by_stty(config, far)
        by_reader(config, far)
    held()
    mark_parity()


if __name__ == "__main__":
    main()
