"""The pages, dialogs and keys of the live screen (textual)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import datetime
from time import monotonic
from typing import Any, ClassVar, Final

from textual.app import App, ComposeResult
from textual.binding import Binding

from dpstack.plant.items import Item
from dpstack.screen import overview
from dpstack.screen.lines import Line, padded, wrapped
from dpstack.screen.one_slave import page
from dpstack.screen.pages import BAR, Filtered, FilterInput, Lines, Order, Page, Question, Scrolled
from dpstack.screen.view import View
from dpstack.screen.watch_page import Choose, Watch

#: the page is drawn again no more often (s)
_REDRAW_S: Final = 0.1

_HELP: Final = """\
The screen shows the bus that this run operates. It never sends anything to the bus by itself.

up, down, page up, page down, home, end   pick a slave, or move on a page
enter      all about the slave: values, diagnosis, drive, counters, modules, events
w          why is the slave not in data exchange: the run asks it and shows the reasons
t          watch table: chosen values of several slaves with quality and octets; there a chooses, enter
           sets an output, or forces an input of a simulated slave (asks first), r releases it
/          filter: words in address, name, state or remark; an empty filter shows all
f          only slaves that are not alive or have a remark; f again: all
e          all events
space      pause: the page stands still and says so, the bus goes on; space again goes on
escape     back
ctrl-l     draw the page again
q          end the run in order; asks first
ctrl-c     end the run in order: safe values, Clear. Again after a second: without waiting
ctrl-z     stop for a while; asks first. The bus goes to Clear with safe values, `fg` goes on

Signs:  * alive   ! there is a remark   - not alive: its values are old and grey
Before a value:  ! bad, not to be used   ? uncertain

Values that have just changed are marked for a second. "late" counts answers that came too late, or were \
no answers to the request. Names, texts of diagnosis and units come from the configuration and the GSD file."""


class Overview(Filtered):
    """State of the bus, the slaves, the last events."""

    BINDINGS: ClassVar = [Binding("enter", "open"), Binding("w", "why"), Binding("f", "conspicuous")]

    def __init__(self) -> None:
        super().__init__()
        self._conspicuous = False

    def compose(self) -> ComposeResult:
        yield Lines(id="head")
        yield Lines(id="columns")
        yield Lines(id="rows")
        yield Lines(id="events")
        yield FilterInput(placeholder="filter: words in address, name, state, remark; enter", id="filter")
        yield Lines(id="keys")

    def draw(self, view: View) -> None:
        app, width, height = self.plant_app, self.size.width, self.size.height
        head = overview.head(view, width, paused=app.paused_at, note=app.note)
        head = head[: max(1, height // 3)]
        self.show_head(head)
        told = self.filter_text()
        about: Line = [(f"{' and '.join(told)}: escape shows all", "warn")] if told else []
        self.lines_at("#columns").show_lines([about or overview.slaves_head(width - BAR)])
        room = 0 if height < 12 else min(8, max(2, (height - len(head)) // 4))
        self.set_height("#events", room)
        last = [overview.event_line(event) for event in view.events_of()[1 - room :]] if room else []
        self.lines_at("#events").show_lines([[("last events", "label")], *last])
        keys = "? help  enter slave  w why  t table  / filter  f faults  e events  space pause  q end"
        self.lines_at("#keys").show_lines([[(padded(keys, width), "title")]])
        addresses = view.addresses(self.words, conspicuous=self._conspicuous)
        self.set_rows(addresses)
        rest = height - len(head) - room - 2 - self.query_one("#filter").display
        rooms = overview.rooms(view, addresses, width - BAR, rest)
        self.show_rows(
            rooms,
            lambda number: overview.slave_lines(view, addresses[number], width - BAR, rooms[number]),
            "no slave is like that; escape shows all" if told else "no slaves yet",
        )

    def filter_text(self) -> list[str]:
        return super().filter_text() + (["only with remarks or not alive"] if self._conspicuous else [])

    def action_open(self) -> None:
        if self.picked is not None:
            self.app.push_screen(OneSlave(self.picked))

    def action_why(self) -> None:
        if self.picked is not None:
            plant_of(self).ask_why(self.picked)
            self.app.push_screen(OneSlave(self.picked))

    def action_no_filter(self) -> None:
        self._conspicuous = False
        super().action_no_filter()

    def action_conspicuous(self) -> None:
        self._conspicuous = not self._conspicuous
        self.plant_app.draw_now()


class OneSlave(Scrolled):
    """All about one slave."""

    BINDINGS: ClassVar = [Binding("w", "why")]
    keys = "escape back  w why  t table  up/down move  space pause  ? help"

    def __init__(self, address: str) -> None:
        super().__init__()
        self.address = address

    def lines(self, view: View, width: int) -> list[Line]:
        return page(view, self.address, width, plant_of(self).stories.get(self.address))

    def action_why(self) -> None:
        plant_of(self).ask_why(self.address)


class Events(Scrolled):
    """All events that are kept, the latest first."""

    def lines(self, view: View, width: int) -> list[Line]:
        told = [overview.event_line(event) for event in reversed(view.events_of())]
        return [part for line in told for part in wrapped(line, width, 9)] or [[("no events yet", "stale")]]


class Help(Scrolled):
    """The keys."""

    def lines(self, view: View, width: int) -> list[Line]:
        return [part for text in _HELP.split("\n") for part in wrapped([(text, "")], width, 11)]


class Plant(App[None]):
    """``order`` takes the orders of the person; ``clock`` is monotonic, in s."""

    AUTO_FOCUS = None
    ENABLE_COMMAND_PALETTE = False
    CSS = """
    Screen { background: ansi_default; color: ansi_default; layers: base; }
    Lines { background: ansi_default; height: 1; scrollbar-size-horizontal: 0; scrollbar-size-vertical: 1;
            overflow-x: hidden; }
    #head, #columns, #events, #keys { overflow-y: hidden; }
    #rows, #body { height: 1fr; scrollbar-color: ansi_default; scrollbar-background: ansi_default; }
    #filter, #value { height: 1; border: none; padding: 0; background: ansi_default; }
    Question { align: center middle; background: ansi_default; }
    #question { width: auto; height: auto; border: round ansi_default; padding: 1 2; background: ansi_default; }
    """
    BINDINGS: ClassVar = [
        Binding("ctrl+c", "interrupt", priority=True),
        Binding("ctrl+z", "suspend_run", priority=True),
        Binding("ctrl+q,q", "end_run"),
        Binding("ctrl+l", "redraw", priority=True),
        Binding("space,p", "pause"),
        Binding("question_mark,h,f1", "show_help"),
        Binding("e", "show_events"),
        Binding("t", "show_watch"),
    ]

    def __init__(self, order: Callable[[Order], None], *, clock: Callable[[], float] = monotonic) -> None:
        super().__init__(ansi_color=True)
        self.order = order
        self.view = View()
        self.dirty = True
        #: a line of ``run`` for the person, for instance that the bus is ending
        self.note = ""
        #: the story of a slave by address, as `why --json`, or a text in its place
        self.stories: dict[str, Mapping[str, Any] | str] = {}
        self.paused_at = ""
        #: ids of the values in the watch table, and the answer to the last order with its style
        self.watched: list[str] = []
        self.answer = ("", "")
        self._clock = clock
        self._frozen: View | None = None
        self._asking = False

    # --- from run -------------------------------------------------------------------------------------------------

    def feed(self, item: Item) -> None:
        """Take an item of the live stream; another one is left out. The page follows within 0.1 s."""
        try:
            self.view.apply(item, self._clock())
        except ValueError as error:
            self.note = str(error)
        self.dirty = True

    def tell_why(self, address: str, story: Mapping[str, Any] | str) -> None:
        """The answer of ``run`` to the order ``why``."""
        self.stories[address] = story
        self.dirty = True

    def tell_answer(self, text: str, style: str) -> None:
        """The answer of ``run`` to an order of the watch table."""
        self.answer = (text, style)
        self.dirty = True

    def on_mount(self) -> None:
        self.push_screen(Overview())
        self.set_interval(_REDRAW_S, self._redraw)

    @property
    def shown(self) -> View:
        """The view of this moment, or the one that stands still."""
        return self._frozen or self.view

    def _redraw(self) -> None:
        view = self.view
        before = view.silent_s
        view.now = self._clock()
        aged = int(view.silent_s * 2) != int(before * 2)
        if self.dirty or aged:
            self.draw_now()

    def draw_now(self) -> None:
        """Draw the page that is seen."""
        self.dirty = False
        for screen in reversed(self.screen_stack):
            if isinstance(screen, Page):
                if screen.is_mounted:
                    screen.draw(self.shown)
                return

    # --- keys -----------------------------------------------------------------------------------------------------

    def ask_why(self, address: str) -> None:
        self.stories[address] = "the run asks it ..."
        self.order({"order": "why", "slave": int(address)})

    def action_interrupt(self) -> None:
        self.order({"order": "interrupt"})

    def action_end_run(self) -> None:
        self.confirm("End the run? All outputs go to their safe values.", {"order": "interrupt"})

    def action_suspend_run(self) -> None:
        self.confirm(
            "Stop the run for a while? The bus goes to Clear first, with safe values for all outputs. "
            "`fg` in the shell goes on.",
            {"order": "suspend"},
        )

    def confirm(self, text: str, order: Order) -> None:
        """Ask the person, and give ``order`` after a yes."""
        if self._asking:
            return
        self._asking = True

        def answered(yes: bool | None) -> None:
            self._asking = False
            if yes:
                self.order(order)

        self.push_screen(Question(text), answered)

    def action_pause(self) -> None:
        if self._frozen is None:
            self._frozen = self.view.frozen()
            self.paused_at = datetime.now().strftime("%H:%M:%S")
        else:
            self._frozen, self.paused_at = None, ""
        self.draw_now()

    def action_show_help(self) -> None:
        if not isinstance(self.screen, Help):
            self.push_screen(Help())

    def action_show_events(self) -> None:
        if not isinstance(self.screen, Events):
            self.push_screen(Events())

    def action_show_watch(self) -> None:
        """Open the watch table, and the choice if nothing is chosen yet; at a slave the choice of its values."""
        if any(isinstance(screen, Watch) for screen in self.screen_stack):
            return
        of = self.screen.address if isinstance(self.screen, OneSlave) else None
        self.push_screen(Watch())
        if of is not None or not self.watched:
            self.push_screen(Choose("" if of is None else self.view.name(of)))

    def action_redraw(self) -> None:
        self.refresh(repaint=True, layout=True)
        self.screen.refresh(repaint=True, layout=True)
        self.draw_now()


def plant_of(page: Page) -> Plant:
    app = page.app
    assert isinstance(app, Plant)
    return app
