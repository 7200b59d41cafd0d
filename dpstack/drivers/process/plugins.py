"""Drive plugins by name (``package.module:name``): a bus process imports those of its slaves, because it cannot receive
objects."""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import sys
from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import TYPE_CHECKING, Final, TypeVar

from msgspec import Struct, field

from dpstack.dp.process_image import CyclicPlugin
from dpstack.errors import ConfigError
from dpstack.machine import Order

if TYPE_CHECKING:
    import threading

    from dpstack.drivers.line.select_loop import SelectLoop

T = TypeVar("T")


#: the loop gets the interpreter this long after it asks for it, or after one long call of the interpreter itself (such
#: as reading the byte code of a module); Python's own 5 ms hold a bus up
_SWITCH_S: Final = 0.000_1
#: of the thread; locked memory counts all of it
_STACK: Final = 1 << 20


class DriveOfSeveral(Struct, frozen=True):
    """One of the drives of a slave: as in :class:`AttachPlugin`, with its number in record 47 (None: that of the
    profile) and its octets of inputs and outputs, the first and the one behind the last."""

    place: str
    argument: str
    name: str
    telegram: str
    options: Mapping[str, object]
    record_object: int | None
    inputs: tuple[int, int]
    outputs: tuple[int, int]


class AttachPlugin(Order):
    """Put the drive plugin at ``place`` ("package.module:name") onto the process image of the slave at ``address``.

    ``argument``: what ``place`` is called with to make the profile, "" for a profile itself (a device file: its digest
    and path). ``name``: of the slave; ``options`` are plain data. ``records``: the slave has DP-V1, and the plugin may
    ask it by Read and Write. ``drives``: those of a slave with several, which ``place`` joins; ``octets`` of outputs.
    """

    address: int
    place: str
    name: str
    argument: str = ""
    telegram: str | None = None
    options: Mapping[str, object] = field(default_factory=dict)
    records: bool = False
    drives: tuple[DriveOfSeveral, ...] = ()
    octets: int = 0


def core_at(place: str, argument: str = "") -> Callable[..., CyclicPlugin]:
    """The method ``core`` of the drive profile at ``place``, which makes the drive plugin of a slave. With ``argument``
    the function at ``place`` is called with it and returns the profile
    (see :class:`dpstack.profile.DriveProfile`).

    Raises ConfigError that names the place, and why it cannot be imported.
    """
    _complete_path()
    module, colon, path = place.partition(":")
    if not (module and colon and path):
        raise ConfigError(f"plugin {place!r}: write its place as package.module:name")
    try:
        found = importlib.import_module(module)
        for name in path.split("."):
            found = getattr(found, name)
        if argument:
            found = found(argument)  # type: ignore[operator]
    except ConfigError:
        raise
    except Exception as error:  # the module of a plugin may raise any exception when it is imported
        raise ConfigError(
            f"plugin {place} cannot be imported in the bus process ({type(error).__name__}: {error}); "
            'install it as a package, or take driver = "asyncio"'
        ) from None
    core = getattr(found, "core", None)
    if not callable(core):
        raise ConfigError(f"plugin {place} makes no cyclic unit: it has no method core()")
    make: Callable[..., CyclicPlugin] = core
    return make


@cache
def _complete_path() -> None:
    """Prepare this process as Python prepares each program, with all that packages add to the import of modules:
    plugins of others may need it. The bus process has begun without (:mod:`dpstack.drivers.process.early_start`)."""
    if sys.flags.no_site:
        import site

        site.main()


def load(order: AttachPlugin) -> CyclicPlugin:
    """The drive plugin that ``order`` names. Raises ConfigError."""
    records = None
    if order.records:
        from dpstack.dpv1.master.plugin_queue import RecordQueue  # here, as most drives have no DP-V1

        records = RecordQueue()
    if order.drives:
        cores = (
            core_at(one.place, one.argument)(
                one.name, one.telegram, one.options, records=records, record_object=one.record_object
            )
            for one in order.drives
        )
        parts = [(core, one.inputs, one.outputs) for core, one in zip(cores, order.drives, strict=True)]
        return core_at(order.place)(parts, order.octets, records)
    return core_at(order.place, order.argument)(order.name, order.telegram, order.options, records=records)


def do_beside(
    loop: SelectLoop, work: Callable[[], T], done: Callable[[T | None, Exception | None], object]
) -> threading.Thread:
    """Call ``work``, for which a running bus has no time, in a thread; then ``done`` in ``loop`` with its result or its
    exception. Raises RuntimeError if the system has no thread left."""
    import threading  # here, as most buses need no other thread

    def run() -> None:
        result, failed = None, None
        try:
            _give_way()
            result = work()
        except Exception as error:
            failed = error
        except BaseException as error:  # sys.exit() in a plugin
            failed = ConfigError(f"a plugin ended its import with {type(error).__name__}")
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody waits any more
            loop.call_soon_threadsafe(partial(done, result, failed))

    sys.setswitchinterval(_SWITCH_S)  # for good: it has no effect on one thread
    threading.stack_size(_STACK)
    thread = threading.Thread(target=run, daemon=True, name="beside the bus")
    thread.start()
    return thread


def _give_way() -> None:
    """Leave the signals to the thread of the loop, and run behind it, but before all ordinary programs: while one of
    those has the processor, this thread could hold the interpreter."""
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    priority = os.sched_getparam(os.getpid()).sched_priority  # of the main thread, which runs the loop
    if priority:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(max(1, priority - 1)))
