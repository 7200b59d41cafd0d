"""A watcher of a plant that deals with every event of a bus by ``match``, and logs by the loggers of dpstack.

Start it with ``python examples/plant_watcher.py`` for five seconds of a simulated plant, or with
``python examples/plant_watcher.py /dev/ttyUSB0`` for the slaves of plant.toml on a real bus, until Ctrl-C.
"""

import asyncio
import contextlib
import logging
import sys
from collections import Counter
from pathlib import Path

import dpstack
from dpstack.events import (
    AddressCollision,
    AlarmRaised,
    ApplicationSilent,
    AutoCleared,
    BehindRealTime,
    BusFailed,
    BusProcessBack,
    BusProcessSilent,
    ConnectionOver,
    CyclesMissed,
    DoesNotFit,
    DriveEvent,
    Event,
    ForcedClear,
    Injected,
    MasterSeen,
    MasterStopped,
    ModeChanged,
    Notice,
    OperateWaits,
    OrdersRefused,
    OutputsDropped,
    OutputsWithheld,
    PortBack,
    PortDisturbed,
    PortLost,
    QualityChanged,
    RingJoined,
    RingLeft,
    ScenarioEvent,
    SlaveDiagnosis,
    SlaveEvent,
    SlaveFaulted,
    SlaveFlapping,
    SlaveRemark,
    SlaveState,
    SlaveStateChanged,
    Stalled,
    StationFound,
    StationSeen,
    StatusTold,
    TokenLost,
)

PLANT = Path(__file__).with_name("plant.toml")
log = logging.getLogger("plant.watch")


class Watcher:
    """A summary of a bus for the control room: its mode, missing slaves with the reason, diagnoses, masters."""

    def __init__(self) -> None:
        self.mode = "not running"
        self.missing: dict[str, str] = {}
        self.diagnoses: dict[str, tuple[str, ...]] = {}
        self.masters: set[int] = set()
        self.counts: Counter[str] = Counter()

    def see(self, event: Event) -> None:
        """The first case that fits counts: bases come last."""
        self.counts[type(event).__name__] += 1
        match event:
            # slaves and drives
            case SlaveStateChanged(name=name, state=SlaveState.DATA_EXCHANGE):
                self.missing.pop(name, None)
            case SlaveStateChanged(name=name, state=state):
                self.missing.setdefault(name, state.value)
            case SlaveFaulted(name=name, fault=fault):
                self.missing[name] = f"{fault.kind.value}; {fault.remedy}"
            case SlaveDiagnosis(name=name, texts=texts):
                self.diagnoses[name] = texts
            case QualityChanged(name=name, values=values):
                log.warning("%s: %s", name, ", ".join(one.line for one in values))
            case AlarmRaised(name=name, alarm=alarm):
                log.warning("call the electrician: %s raises a %s", name, alarm.full_text)
            case StatusTold(name=name, status=status):
                log.info("%s: %s", name, status.full_text)
            case DriveEvent(name=name, payload={"type": "notice", "text": text}):
                log.warning("drive %s: %s", name, text)
            case DriveEvent():
                pass  # its status: dpstack.Drive.status has the latest one
            case SlaveFlapping(name=name, count=count):
                log.warning("%s comes and goes: %d changes were left out; look at its plug", name, count)
            case OutputsDropped(name=name, outputs=outputs):
                log.error("%s did not get %s", name, outputs.hex(" "))
            case OutputsWithheld(name=name, outputs=outputs):
                log.warning("%s was away: %s waits until somebody sets its outputs anew", name, outputs.hex(" "))
            case SlaveRemark(name=name, message=message):
                log.info("%s deviates from the standard: %s", name, message)
            # the mode of the master
            case ModeChanged(mode=mode):
                self.mode = mode.name.lower()
            case OperateWaits(slaves=slaves) | AutoCleared(slaves=slaves):
                log.warning("outputs are off because of the slaves %s", slaves)
            case ApplicationSilent(limit_ns=limit_ns):
                log.error("this program was silent for %d ms: outputs are off", limit_ns // 1_000_000)
            case Stalled(slaves=slaves, blocked=blocked):
                log.error("no requests to %s: %s", slaves, blocked.value if blocked else "the obstacle is not known")
            case MasterStopped(cleared=cleared):
                self.mode = "stopped" if cleared else "stopped without Clear"
            # time
            case CyclesMissed(missed=missed, reason=reason):
                log.warning("%d fixed cycles missed in all: %s", missed, reason)
            case BehindRealTime(behind_ns=behind_ns, keeps_up=False):
                log.warning("the simulated bus is %d ms behind", behind_ns // 1_000_000)
            case BehindRealTime():
                log.info("the simulated bus keeps up again")
            case DoesNotFit(service=service, takes_ns=takes_ns):
                log.info("%s takes %d us, longer than a gap between two cycles", service, takes_ns // 1000)
            # the token ring and the stations
            case RingJoined(masters=masters):
                self.masters = set(masters)
            case MasterSeen(address=address, present=present):
                (self.masters.add if present else self.masters.discard)(address)
            case RingLeft(reason=reason):
                log.info("out of the token ring: %s", reason)
            case TokenLost():
                log.warning("the token was lost; this master makes a new one")
            case AddressCollision(address=address):
                log.error("two stations have the address %d: give one of them another", address)
            case StationFound(address=address, kind=kind):
                log.info("station %d %s", address, "is gone" if kind is None else f"is there: {kind.name.lower()}")
            case StationSeen(found=found, present=present):
                log.info("station %d %s", found.address, "is there" if present else "is gone")
            # the port and the bus process
            case PortLost(port=port, reason=reason):
                log.error("plug the adapter in again: %s (%s)", port, reason)
            case PortBack(port=port):
                log.info("%s is back", port)
            case PortDisturbed(port=port, what=what):
                log.warning("another program at %s: %s", port, what)
            case BusProcessSilent(silent_ns=silent_ns) | BusProcessBack(silent_ns=silent_ns):
                log.error("the bus process was silent for %d ms", silent_ns // 1_000_000)
            case ConnectionOver(address=address, reason=reason):
                log.info("the class 2 connection to %d is over: %s", address, reason)
            case BusFailed(message=message):
                log.critical("the bus has ended: %s", message)
            # simulated faults
            case Injected(command=command, args=args):
                log.info("somebody typed: %s %s", command, " ".join(args))
            case ScenarioEvent(step=step, state=state, detail=detail):
                log.info("step %d: %s %s", step, state, detail)
            case OrdersRefused(count=count, orders=orders):
                log.warning("%d orders were refused, the first from %s", count, orders[0].origin)
            # remarks, and the bases of several classes
            case Notice(source=source, message=message):
                log.info("%s says %s", source, message)
            case ForcedClear() | SlaveEvent():
                log.warning("%s", event.text)

    def report(self) -> str:
        missing = ", ".join(f"{name} ({why})" for name, why in self.missing.items()) or "no slave"
        diagnoses = ", ".join(f"{name}: {'; '.join(texts)}" for name, texts in self.diagnoses.items() if texts)
        return f"{self.mode}, missing: {missing}; diagnoses: {diagnoses or 'none'}; masters: {sorted(self.masters)}"


async def main(port: str | None) -> None:
    watcher = Watcher()
    try:
        async with dpstack.open_bus(PLANT, port=port) as bus:
            reading = asyncio.create_task(read(bus, watcher))
            await bus.operate()
            await asyncio.wait([reading], timeout=None if port else 5)
        await reading  # it ends with the bus
    finally:
        print(watcher.report())
        print(f"{watcher.counts.total()} events, of them {watcher.counts['SlaveStateChanged']} changes of states")


async def read(bus: dpstack.Bus, watcher: Watcher) -> None:
    async for event in bus.events():
        watcher.see(event)


if __name__ == "__main__":
    logging.basicConfig(format="%(levelname)s %(name)s %(message)s")
    logging.getLogger("dpstack.bus").setLevel(logging.INFO)  # mode, token ring, port
    logging.getLogger("dpstack.slave").setLevel(logging.WARNING)  # of all slaves: faults and alarms
    logging.getLogger("dpstack.slave.valves").setLevel(logging.INFO)  # of one slave: everything
    log.setLevel(logging.INFO)
    with contextlib.suppress(KeyboardInterrupt):  # Ctrl-C: the bus has ended in order
        asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else None))
