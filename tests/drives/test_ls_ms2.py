"""The simulated LS S100 (docs/reference/drives/ls-s100.md#record-47) for masters of both classes at once: record 47 is
carried out for one at a time."""

from __future__ import annotations

from octet_class2 import ABORT, INITIATE, RS, SC, Class2
from octet_wire import MS, Wire
from slave_kit import make_slave
from support import instance

from dpstack.dp.slave.application import SlaveApp
from dpstack.params import BusParams
from dpstack_drives.ls import DRIVE
from dpstack_drives.ls.simulator import LsDevice

#: PNU 965 and 964, as the manual has them (6.2.2)
READ_965 = "5F 01 2F 0A 01 01 01 01 10 00 03 C5 00 00"
READ_964 = "5F 01 2F 0A 02 01 01 01 10 01 03 C4 00 00"
TAKEN = "5F 01 2F 0A"
READ = "5E 01 2F F0"
IS_965 = "5E 01 2F 08 01 01 01 01 06 01 03 28"
IS_964 = "5E 01 2F 08 02 01 01 01 06 01 03 51"
BUSY, TAKEN_BY_ANOTHER = "DE 80 B5 00", "DF 80 C2 00"


class Drive:
    """The drive at address 8 of a wire, two masters of class 2 with a connection each."""

    def __init__(self) -> None:
        device = instance(DRIVE.device("PPO3", {"COM-07": 8}), LsDevice)
        station = make_slave(8, device, BusParams.preset(500_000))
        app = instance(station.responder, SlaveApp)
        self.app = app
        self.wire = Wire(station)
        self.one, self.two = Class2(self.wire, 1), Class2(self.wire, 3)
        self.first, self.second = self.one.connect(), self.two.connect()

    def until_ready(self) -> None:
        self.wire.pass_time(20 * MS)


def test_l8_class_2_needs_no_data_exchange() -> None:
    drive = Drive()
    assert drive.one.service(drive.first, READ) == BUSY  # nobody asked for anything
    assert drive.one.service(drive.first, READ_965) == TAKEN
    assert drive.one.service(drive.first, READ) == BUSY  # two scans
    drive.until_ready()
    assert drive.one.service(drive.first, READ) == IS_965
    assert drive.one.service(drive.first, READ) == BUSY
    assert drive.one.service(drive.first, "5F 00 FF 04 08 00 FD E8") == "5F 00 FF 04"
    assert drive.one.service(drive.first, "5E 00 FF F0")[54:59] == "03 51"


def test_one_at_a_time() -> None:
    drive = Drive()
    assert drive.one.service(drive.first, READ_965) == TAKEN
    assert drive.two.service(drive.second, READ_964) == TAKEN_BY_ANOTHER
    drive.until_ready()
    assert drive.two.service(drive.second, READ) == BUSY  # not the other one's
    assert drive.two.service(drive.second, READ_964) == TAKEN_BY_ANOTHER  # it waits for whoever asked
    assert drive.one.service(drive.first, READ) == IS_965
    assert drive.two.service(drive.second, READ_964) == TAKEN
    drive.until_ready()
    assert drive.one.service(drive.first, READ) == BUSY
    assert drive.two.service(drive.second, READ) == IS_964


def test_a_master_that_is_gone_or_never_comes_keeps_nobody_out() -> None:
    drive = Drive()
    assert drive.one.service(drive.first, READ_965) == TAKEN
    drive.until_ready()
    assert drive.one.ask(drive.first, ABORT) == SC
    assert drive.two.service(drive.second, READ) == BUSY
    assert drive.two.service(drive.second, READ_964) == TAKEN
    again = drive.one.connect()
    for _ in range(4):
        assert drive.one.service(again, READ_965) == TAKEN_BY_ANOTHER
        drive.wire.pass_time(450 * MS)
    drive.wire.pass_time(300 * MS)
    assert drive.one.service(again, READ_965) == TAKEN
    assert drive.two.service(drive.second, READ) == BUSY


def cyclic(drive: Drive, unit: str, fc: int) -> str:
    """A telegram of the class 1 master 2, with SAPs."""
    octets = bytes((0x88, 0x82, fc)) + bytes.fromhex(unit)
    head = bytes((0x68, len(octets), len(octets), 0x68))
    return drive.wire.ask((head + octets + bytes((sum(octets) & 0xFF, 0x16))).hex())


def ms1(drive: Drive, request: str) -> str:
    """A record service of the class 1 master."""
    assert cyclic(drive, f"33 33 {request}", 0x6D) == "E5"
    return bytes.fromhex(cyclic(drive, "33 33", 0x5D))[9:-2].hex(" ").upper()


def test_beside_its_class_1_master() -> None:
    drive = Drive()
    device = drive.app.device
    user_prm = "80" + "00" * (len(device.profile.user_prm) - 1) if isinstance(device, LsDevice) else ""
    prm = f"3D 3E 80 01 01 0B {device.ident >> 8:02X} {device.ident & 0xFF:02X} 00 {user_prm}"
    assert cyclic(drive, prm, 0x6D) == "E5"
    assert cyclic(drive, f"3E 3E {device.configs[0].hex()}", 0x5D) == "E5"
    assert drive.app.master == 2
    assert drive.two.service(drive.second, READ_964) == TAKEN
    assert ms1(drive, READ_965) == TAKEN_BY_ANOTHER
    assert ms1(drive, READ) == BUSY
    drive.until_ready()
    assert drive.two.service(drive.second, READ) == IS_964
    assert ms1(drive, READ_965) == TAKEN
    assert drive.two.service(drive.second, READ_964) == TAKEN_BY_ANOTHER
    drive.until_ready()
    assert ms1(drive, READ) == IS_965


def test_two_connections_and_none_in_version_2_01() -> None:
    drive = Drive()
    assert Class2(drive.wire, 5).ask(49, INITIATE) == RS
    old = DRIVE.device("VENDOR 2/3", {"version": "2.01"})
    assert old.ms2 == 0
