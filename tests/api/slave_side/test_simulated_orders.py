"""Orders of ``dpstack ctl`` to simulated drives and their effect on a bus: supply, link, errors, alarms, address."""

from __future__ import annotations

import asyncio

import pytest
from api_kit import device_of, operating

import dpstack
from dpstack.api.control.control_server import ControlServer
from dpstack.api.control.handlers import control_run
from dpstack.dp.pdu.alarm_blocks import AlarmType, Specifier
from dpstack.errors import UsageError

pytestmark = pytest.mark.virtual_time

ALONE = {"check_settings": False}
HOIST: dict[str, object] = {
    "name": "hoist",
    "address": 3,
    "drive": "demag-dedrive",
    "telegram": "PPO1",
    "simulated": {"412": 1, "supply": "24v"},
    "options": ALONE,
}
FAN: dict[str, object] = {"name": "fan", "address": 4, "drive": "fuji-frenic", "telegram": "PPO1", "options": ALONE}
SAW: dict[str, object] = {"name": "saw", "address": 5, "drive": "keb-f5", "telegram": "PCH+4/4", "options": ALONE}
PUMP: dict[str, object] = {
    "name": "pump",
    "address": 6,
    "drive": "ls-s100",
    "gsd": "ls-s100",
    "telegram": "PPO1",
    "dpv1": {"alarms": ["diagnostic"]},
    "options": ALONE,
}


def order(server: ControlServer, text: str) -> object:
    name, *args = text.split()
    return server._handlers[name](args)


async def test_orders_that_take_power_links_and_answers() -> None:
    async with operating(HOIST, FAN, SAW) as bus:
        server = control_run(bus, "virtual")
        order(server, "parameter-error fan 104 3")
        assert device_of(bus, 4).injected == ("parameter-error 104 3",)
        await bus.drive("fan").write("F26", 15)  # asked again until it is taken
        assert device_of(bus, 4).injected == ()
        order(server, "parameter-error 3 104")
        with pytest.raises(dpstack.ParameterError, match="error 104, fault while writing the EEPROM"):
            await bus.drive("hoist").write(400, 4)
        await bus.drive("hoist").write(400, 4)
        order(server, "mains hoist off")
        assert device_of(bus, 3).injected == ("mains off",)
        with pytest.raises(dpstack.DriveTimeout, match="did not answer in its parameter channel"):
            await bus.drive("hoist").read(400, timeout=0.5)
        assert bus.drive("hoist").status.words == (0, 0)
        order(server, "mains hoist on")
        assert await bus.drive("hoist").read(400) == 4
        order(server, "link saw off")
        with pytest.raises(dpstack.ParameterError, match="error 6/2/0000"):
            await bus.drive("saw").read("oP.3")
        order(server, "link saw on")
        order(server, "parameter-error saw busy 3")
        assert await bus.drive("saw").read("oP.3") == 0
        for text, says in (
            ("mains saw off", "power-off"),
            ("link fan off", "no link"),
            ("parameter-error fan 5", "known: 11"),
            ("parameter-error fan 104 0", "1 or more"),
            ("parameter-error fan 104 often", "no whole number"),
        ):
            with pytest.raises((UsageError, ValueError), match=says):
                order(server, text)


async def test_a_trip_of_the_ls_is_an_alarm_with_the_gsd_file_of_revision_5() -> None:
    async with operating(PUMP) as bus:
        pump = bus.drive("pump")
        alarms = bus.slave("pump").alarms()
        device_of(bus, 6).trip("overcurrent")
        came = await asyncio.wait_for(anext(alarms), 5)
        assert (came.type, came.slot, came.specifier) == (AlarmType.DIAGNOSIS, 1, Specifier.APPEARS)
        assert came.data == bytes.fromhex("00 0B")
        async for status in pump.statuses():
            if status.fault == "11 overcurrent":
                break
        await pump.acknowledge()
        gone = await asyncio.wait_for(anext(alarms), 5)
        assert (gone.type, gone.slot, gone.specifier) == (AlarmType.DIAGNOSIS, 1, Specifier.DISAPPEARS)
        assert await pump.read(965) == 0x0328  # record 47 beside it


@pytest.mark.parametrize(
    ("table", "writes"), [(HOIST, [(391, 9)]), (PUMP, [("COM-07", 9), ("COM-94", 1)])], ids=["demag", "ls"]
)
async def test_an_address_that_acts_at_once(table: dict[str, object], writes: list[tuple[str | int, int]]) -> None:
    async with operating(table) as bus:
        drive = bus.drive(str(table["name"]))
        for parameter, value in writes:
            await drive.write(parameter, value)
        await asyncio.sleep(0.5)
        found = await bus.scan()
        assert {station.address for station in found if station.ident is not None} == {9}


async def test_contacts_set_point_and_the_keypad_by_ctl() -> None:
    """A local run of a hoist, a fan whose terminal takes the command away, and a fault acknowledged at the keypad."""
    local = HOIST | {"simulated": {"412": 0, "434": 1, "ready": False}}
    async with operating(local, FAN) as bus:
        server = control_run(bus, "virtual")
        for text in ("contact hoist S1 on", "contact hoist S2 on", "set-point hoist 12.5"):
            order(server, text)
        await asyncio.sleep(1)
        assert device_of(bus, 3).motor.frequency == pytest.approx(0.25)
        assert device_of(bus, 3).injected == ("contact S1 on", "contact S2 on")
        fan = bus.drive("fan")
        await fan.start()
        order(server, "contact fan LOC on")
        await asyncio.sleep(2)
        with pytest.raises(dpstack.DriveFault, match="STW bit 9 is 0 although y98 is 3"):
            await fan.start()
        order(server, "contact fan LOC off")
        order(server, "trip fan OC1")
        await asyncio.sleep(0.2)
        assert list(fan.status.faults) == ["OC1 overcurrent during acceleration"]
        order(server, "acknowledge fan")
        await asyncio.sleep(0.2)
        assert list(fan.status.faults) == []
        with pytest.raises(ValueError, match="no fault stands"):
            order(server, "acknowledge fan")
        with pytest.raises(ValueError, match="'S7' is no contact of demag-dedrive; it has S1, S2"):
            order(server, "contact hoist S7 on")
        with pytest.raises(ValueError, match="fuji-frenic has no internal set point here"):
            order(server, "set-point fan 10")
