"""The orders that move a drive, as jobs over a :class:`~dpstack.profile.master.core.DriveCore`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from dpstack.profile.model.jobs import Args, CommandError, Job, Steps
from dpstack.profile.model.states import FAULTED, MOVING, Goal, State
from dpstack.units import NS_PER_S

if TYPE_CHECKING:
    from dpstack.profile.master.core import DriveCore

OPS: Final = ("start", "stop", "quick_stop", "coast", "acknowledge")

#: default time-outs in s; 15 s of them is the time some drives lock a fault
_TIMEOUTS: Final = {"start": 5.0, "stop": 60.0, "quick_stop": 60.0, "coast": 5.0, "acknowledge": 20.0}
#: of the reference, for a drive that has no bit for it
_NEAR: Final = 0.01
#: of the reference: how far the actual speed may be from the set point where the drive's bit says that it is reached.
#: More than the rounding of any drive; a wrong scale or source of the set point is off by more at most set points
_BELIEVED: Final = 0.02
_GOALS: Final = {"stop": Goal.STOP, "quick_stop": Goal.QUICK_STOP, "coast": Goal.COAST}


def job(core: DriveCore, op: str, args: Args, token: int) -> Job:
    """The job of one order of :data:`OPS`. Raises CommandError."""
    deadline = core.now + args.timeout_ns(_TIMEOUTS[op])
    args.done()
    if op == "start":
        steps = start(core, deadline)
    elif op == "acknowledge":
        steps = acknowledge(core, deadline)
    else:
        steps = halt(core, op, deadline)
    return Job(op, token, steps, motion=True)


def start(core: DriveCore, deadline: int) -> Steps[dict[str, object]]:
    """Walk to RUNNING. On any failure the goal falls back to IDLE: a drive never starts later by surprise."""
    try:
        yield from _online(core, deadline)
        yield from settled(core, lambda: core.raw_state not in FAULTED, deadline)
        if core.raw_state in FAULTED:
            text = yield from _named(core, deadline)
            raise CommandError("fault", f"{text}; acknowledge it first")
        yield from core.prepare(deadline)
        yield from core.settings_check.known(deadline)
        # a status word that says running already may be older than our last stop
        trust = core.now + (core.settle_ns if core.raw_state in MOVING else 0)
        core.set_goal(Goal.RUN)
        since: int | None = None
        while core.state is not State.RUNNING or core.now < trust:
            if core.raw_state in FAULTED:
                raise CommandError("fault", (yield from _named(core, deadline)))
            if core.now >= deadline:
                raise CommandError(
                    "timeout", core.obstacle() or f"the drive reports {core.raw_state}, not running{core.start_hint}"
                )
            if core.obstacle() is None:
                since = None
            elif since is None:
                since = core.now
            elif core.now >= since + core.settle_ns:
                yield from core.prepare(deadline)  # raises when it is there to stay
                since = None
            yield
    except BaseException:
        core.set_goal(Goal.IDLE)
        raise
    core.achieved()
    return {"value": str(core.state)}


def halt(core: DriveCore, op: str, deadline: int) -> Steps[dict[str, object]]:
    """Ramp, quick stop or coast; done when the drive reports that the power stage is off."""
    core.set_goal(_GOALS[op])
    yield from _online(core, deadline)
    trust = core.now + core.settle_ns
    while core.state in MOVING or core.now < trust:
        if core.now >= deadline:
            speed = core.status().speed
            still = "" if speed is None else f" at {speed:.1%}"
            raise CommandError("timeout", f"the drive still reports {core.raw_state}{still}")
        yield
    value = str(core.state)
    yield from core.halted(deadline)
    return {"value": value}


def acknowledge(core: DriveCore, deadline: int) -> Steps[dict[str, object]]:
    """Edges of the acknowledge bit until the fault is gone; a drive may lock it for a while."""
    yield from _online(core, deadline)
    yield from settled(core, lambda: core.raw_state in FAULTED, deadline)
    if core.raw_state not in FAULTED:
        return {"value": str(core.state)}
    yield from core.before_acknowledge(deadline)
    try:
        while core.raw_state in FAULTED:
            for goal in (Goal.ACK_HIGH, Goal.ACK_LOW):
                core.set_goal(goal)
                until = core.now + core.settle_ns
                while core.now < until:
                    yield
            if core.now >= deadline and core.raw_state in FAULTED:
                raise CommandError("fault", f"{fault_text(core)} cannot be acknowledged{core.lock_hint}")
    finally:
        core.set_goal(Goal.IDLE)
    return {"value": str(core.state)}


def reached(core: DriveCore, deadline: int, tolerance: float | None) -> Steps[dict[str, object]]:
    """The drive says that it has reached its reference, and its actual speed (where it tells one) agrees within 2 % of
    the reference. With ``tolerance``, or where the drive has no bit for it: by its speed alone.
    """
    yield from _online(core, deadline)
    if tolerance is None and "reached" not in core.table.status.bits:
        tolerance = _NEAR
    if tolerance is not None and core.measured()[0] is None:
        raise CommandError("usage", "the drive does not tell its speed, so nobody knows when it is reached")
    while True:
        if core.raw_state in FAULTED:
            raise CommandError("fault", (yield from _named(core, deadline)))
        if core.state is not State.RUNNING and core.goal is not Goal.RUN:
            raise CommandError("usage", f"the drive is not running (it reports {core.state}): start it first")
        status = core.status()
        speed = status.speed
        off = None if speed is None else abs(speed - core.wanted_speed())
        if tolerance is not None:
            done = off is not None and off <= tolerance
        else:
            # the bit may still belong to the last set point
            near = off is not None and off <= 0.001
            done = status.reached and (near or core.now >= core.setpoint_at + core.settle_ns)
            done = done and (off is None or off <= _BELIEVED)
        if done and status.running:
            return {"value": speed}
        if core.now >= deadline:
            at = "" if speed is None else f", at {speed:.1%}"
            if tolerance is None and status.reached:
                at += (
                    f" (the drive itself reports its set point as reached; more than {_BELIEVED:.0%} of the reference "
                    "lie between: are scale and source of the set point right, or is it limited?)"
                )
            raise CommandError("timeout", f"{core.wanted_speed():.1%} not reached{at}")
        yield


def told(core: DriveCore, deadline: int) -> Steps[dict[str, object]]:
    """What the drive tells is about what it is given now, and a fault has its name, as far as it tells one."""
    yield from _online(core, deadline)
    yield from settled(core, lambda: False, deadline)
    if core.raw_state in FAULTED:
        yield from _named(core, deadline)
    return {"value": str(core.state)}


def near(core: DriveCore, speed: float | None, tolerance: float = _NEAR) -> bool:
    """Running, and with this speed close to its set point."""
    return core.state is State.RUNNING and speed is not None and abs(speed - core.wanted_speed()) <= tolerance


def left(core: DriveCore) -> Steps[dict[str, object]]:
    """Tell, as soon as it has a name, why the drive left RUNNING by itself."""
    if core.raw_state in FAULTED:
        why = yield from _named(core, core.now + NS_PER_S)
    else:
        reports = f"it reports {core.raw_state}"
        why = (yield from core.why_left()) or reports
    core.notice(f"left the running state by itself: {why}; it stays off until the next start")
    return {}


def settled(core: DriveCore, wanted: Callable[[], bool], deadline: int) -> Steps[None]:
    """Wait until ``wanted()`` is true, at most until the inputs belong to the present outputs."""
    until = min(core.now + core.settle_ns, deadline)
    while not wanted() and core.now < until:
        yield


def fault_text(core: DriveCore) -> str:
    """The present fault by name."""
    return f"fault {', '.join(core.faults()) or 'without a name'}"


def _online(core: DriveCore, deadline: int) -> Steps[None]:
    while not core.online:
        if core.now >= deadline:
            raise CommandError("lost", "the drive is not in data exchange")
        yield


def _named(core: DriveCore, deadline: int) -> Steps[str]:
    """The fault's text; some drives tell its number only some cycles later."""
    until = min(core.now + 4 * core.settle_ns, deadline)
    while core.raw_state in FAULTED and not core.fault_named() and core.now < until:
        yield
    return fault_text(core)
