"""The pages, dialogs and keys of the live screen (textual)."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping
from datetime import datetime
from functools import cache
from itertools import accumulate
from time import monotonic
from typing import Any, ClassVar, Final

from rich.segment import Segment
from rich.style import Style
from textual import events
from textual.app import App, ComposeResult
from textual.binding import Binding
from textual.containers import Vertical
from textual.geometry import Size
from textual.screen import ModalScreen, Screen
from textual.scroll_view import ScrollView
from textual.strip import Strip
from textual.widgets import Input

from dpstack.plant.items import Item
from dpstack.screen import overview
from dpstack.screen.lines import STYLES, Line, cut_line, padded, piece, wrapped
from dpstack.screen.one_slave import page
from dpstack.screen.view import View
from dpstack.text import printable

#: cells of the bar that shows the place on a long page
_BAR: Final = 1
#: an order of the person at the keys, for ``run``
Order = dict[str, Any]
#: the page is drawn again no more often (s)
_REDRAW_S: Final = 0.1

_HELP: Final = """\
The screen shows the bus that this run operates. It never sends anything to the bus by itself.

up, down, page up, page down, home, end   pick a slave, or move on a page
enter      all about the slave: values, diagnosis, drive, counters, modules, events
w          why is the slave not in data exchange: the run asks it and shows the reasons
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

Values that have just changed are marked for a second. "late" counts answers that came too late, or were \
no answers to the request. Names, texts of diagnosis and units come from the configuration and the GSD file."""


class Lines(ScrollView, can_focus=False):
    """Shows lines of pieces. ``make`` gives one line by its number; only visible lines are made."""

    def __init__(self, *, id: str) -> None:
        super().__init__(id=id)
        self._make: Callable[[int], Line] = lambda _number: []
        self._count = 0
        #: the marked lines
        self.marked = range(0)

    def show(self, count: int, make: Callable[[int], Line]) -> None:
        self._make, self._count = make, count
        size = Size(max(1, self.size.width), count)
        if size != self.virtual_size:
            self.virtual_size = size
        self.refresh()

    def show_lines(self, lines: list[Line]) -> None:
        self.show(len(lines), lines.__getitem__)

    def render_line(self, y: int) -> Strip:
        number, width = y + round(self.scroll_y), self.size.width
        if number >= self._count:
            return Strip.blank(width)
        marked = Style(reverse=True) if number in self.marked else None
        plain = marked is not None or self.app.no_color
        segments = []
        # the only place where lines reach the terminal: nothing raw passes, whoever made the line
        for text, name in cut_line([piece(text, name) for text, name in self._make(number)], width):
            style = Style.parse(STYLES[name][plain])
            segments.append(Segment(text, style + marked if marked else style))
        return Strip(segments).adjust_cell_length(width, marked)

    def keep_visible(self, lines: range) -> None:
        """Scroll so that these lines are seen, at least the first one."""
        top, height = round(self.scroll_y), max(1, self.size.height)
        if lines.start < top:
            self.scroll_to(y=lines.start, animate=False, immediate=True)
        elif lines.stop > top + height:
            self.scroll_to(y=min(lines.start, lines.stop - height), animate=False, immediate=True)


class FilterInput(Input):
    """The words of the filter. Pasted text may hold escape sequences of the terminal: they stand as escapes."""

    def validate_value(self, value: str) -> str:
        return printable(value)


class Page(Screen[None]):
    """A page that is drawn anew when something has changed."""

    def draw(self, view: View) -> None:
        raise NotImplementedError

    def on_screen_resume(self) -> None:
        self.app.dirty = True  # type: ignore[attr-defined]

    def on_resize(self, _event: events.Resize) -> None:
        self.app.dirty = True  # type: ignore[attr-defined]


class Overview(Page):
    """State of the bus, the slaves, the last events."""

    BINDINGS: ClassVar = [
        Binding("up,k", "move(-1)"),
        Binding("down,j", "move(1)"),
        Binding("pageup", "page(-1)"),
        Binding("pagedown", "page(1)"),
        Binding("home", "edge(0)"),
        Binding("end", "edge(-1)"),
        Binding("enter", "open"),
        Binding("w", "why"),
        Binding("slash", "filter"),
        Binding("f", "conspicuous"),
        Binding("escape", "no_filter"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._words = ""
        self._conspicuous = False
        self._addresses: list[str] = []
        self._picked: str | None = None

    def compose(self) -> ComposeResult:
        yield Lines(id="head")
        yield Lines(id="columns")
        yield Lines(id="slaves")
        yield Lines(id="events")
        yield FilterInput(placeholder="filter: words in address, name, state, remark; enter", id="filter")
        yield Lines(id="keys")

    def on_mount(self) -> None:
        self.query_one("#filter").display = False

    def draw(self, view: View) -> None:
        app, width, height = self.plant_app, self.size.width, self.size.height
        head = overview.head(view, width, paused=app.paused_at, note=app.note)
        head = head[: max(1, height // 3)]
        self._set_height("#head", len(head))
        self._lines("#head").show_lines(head)
        self._lines("#columns").show_lines([self._filter_text() or overview.slaves_head(width - _BAR)])
        room = 0 if height < 12 else min(8, max(2, (height - len(head)) // 4))
        self._set_height("#events", room)
        told = [overview.event_line(event) for event in view.events_of()[1 - room :]] if room else []
        self._lines("#events").show_lines([[("last events", "label")], *told])
        keys = "? help  enter slave  w why  / filter  f faults  e events  space pause  q end"
        self._lines("#keys").show_lines([[(padded(keys, width), "title")]])
        self._addresses = view.addresses(self._words, conspicuous=self._conspicuous)
        slaves = self._lines("#slaves")
        if self._picked not in self._addresses:
            self._picked = self._addresses[0] if self._addresses else None
        if self._addresses:
            rest = height - len(head) - room - 2 - self.query_one("#filter").display
            rooms = overview.rooms(view, self._addresses, width - _BAR, rest)
            starts = list(accumulate(rooms, initial=0))
            slaves.marked = range(starts[self._number], starts[self._number + 1])

            @cache
            def lines_of(number: int) -> list[Line]:
                return overview.slave_lines(view, self._addresses[number], width - _BAR, rooms[number])

            def line(number: int) -> Line:
                slave = bisect_right(starts, number) - 1
                at, lines = number - starts[slave], lines_of(slave)
                return lines[at] if at < len(lines) else []  # it got shorter since

            slaves.show(starts[-1], line)
            slaves.keep_visible(slaves.marked)
        else:
            filtered = self._words or self._conspicuous
            text = "no slave is like that; escape shows all" if filtered else "no slaves yet"
            slaves.marked = range(0)
            slaves.show_lines([[(text, "stale")]])

    @property
    def plant_app(self) -> Plant:
        app = self.app
        assert isinstance(app, Plant)
        return app

    @property
    def picked(self) -> str | None:
        """Address of the marked slave."""
        return self._picked

    @property
    def _number(self) -> int:
        return self._addresses.index(self._picked) if self._picked in self._addresses else -1

    def _filter_text(self) -> Line:
        parts = [f'filter "{self._words}"'] if self._words else []
        parts += ["only with remarks or not alive"] if self._conspicuous else []
        return [(f"{' and '.join(parts)}: escape shows all", "warn")] if parts else []

    def _lines(self, selector: str) -> Lines:
        return self.query_one(selector, Lines)

    def _set_height(self, selector: str, height: int) -> None:
        widget = self.query_one(selector)
        widget.display = height > 0
        if widget.styles.height is None or widget.styles.height.value != height:
            widget.styles.height = height

    def _pick(self, number: int) -> None:
        if self._addresses:
            self._picked = self._addresses[min(max(number, 0), len(self._addresses) - 1)]
            self.plant_app.draw_now()

    def action_move(self, step: int) -> None:
        self._pick(self._number + step)

    def action_page(self, step: int) -> None:
        self._pick(self._number + step * max(1, self._lines("#slaves").size.height - 1))

    def action_edge(self, end: int) -> None:
        self._pick(0 if end == 0 else len(self._addresses) - 1)

    def action_open(self) -> None:
        if self._picked is not None:
            self.app.push_screen(OneSlave(self._picked))

    def action_why(self) -> None:
        if self._picked is not None:
            self.plant_app.ask_why(self._picked)
            self.app.push_screen(OneSlave(self._picked))

    def action_filter(self) -> None:
        field = self.query_one("#filter", Input)
        field.value = self._words
        field.display = True
        field.focus()

    def on_input_changed(self, event: Input.Changed) -> None:
        self._words = event.value
        self.plant_app.draw_now()

    def on_input_submitted(self, _event: Input.Submitted) -> None:
        self._close_filter()

    def action_no_filter(self) -> None:
        self._words, self._conspicuous = "", False
        self._close_filter()

    def action_conspicuous(self) -> None:
        self._conspicuous = not self._conspicuous
        self.plant_app.draw_now()

    def _close_filter(self) -> None:
        self.set_focus(None)
        self.query_one("#filter").display = False
        self.plant_app.draw_now()


class Scrolled(Page):
    """A page of lines that may be longer than the terminal."""

    BINDINGS: ClassVar = [
        Binding("up,k", "move(-1)"),
        Binding("down,j", "move(1)"),
        Binding("pageup", "page(-1)"),
        Binding("pagedown", "page(1)"),
        Binding("home", "edge(0)"),
        Binding("end", "edge(-1)"),
        Binding("escape,enter", "back"),
    ]
    keys = "escape back  up/down move  space pause  ? help"

    def compose(self) -> ComposeResult:
        yield Lines(id="head")
        yield Lines(id="body")
        yield Lines(id="keys")

    def draw(self, view: View) -> None:
        app = self.app
        assert isinstance(app, Plant)
        width = self.size.width
        told = overview.notices(view, paused=app.paused_at, note=app.note)
        head = self.query_one("#head", Lines)
        head.display = bool(told)
        head.styles.height = len(told)
        head.show_lines([cut_line([one], width) for one in told])
        self.query_one("#body", Lines).show_lines(self.lines(view, width - _BAR))
        self.query_one("#keys", Lines).show_lines([[(padded(self.keys, width), "title")]])

    def lines(self, view: View, width: int) -> list[Line]:
        raise NotImplementedError

    def action_move(self, step: int) -> None:
        self.query_one("#body", Lines).scroll_relative(y=step, animate=False)

    def action_page(self, step: int) -> None:
        body = self.query_one("#body", Lines)
        body.scroll_relative(y=step * max(1, body.size.height - 1), animate=False)

    def action_edge(self, end: int) -> None:
        body = self.query_one("#body", Lines)
        body.scroll_to(y=0 if end == 0 else body.virtual_size.height, animate=False)

    def action_back(self) -> None:
        self.app.pop_screen()


class OneSlave(Scrolled):
    """All about one slave."""

    BINDINGS: ClassVar = [Binding("w", "why")]
    keys = "escape back  w why  up/down move  space pause  ? help"

    def __init__(self, address: str) -> None:
        super().__init__()
        self.address = address

    def lines(self, view: View, width: int) -> list[Line]:
        app = self.app
        assert isinstance(app, Plant)
        return page(view, self.address, width, app.stories.get(self.address))

    def action_why(self) -> None:
        app = self.app
        assert isinstance(app, Plant)
        app.ask_why(self.address)


class Events(Scrolled):
    """All events that are kept, the latest first."""

    def lines(self, view: View, width: int) -> list[Line]:
        told = [overview.event_line(event) for event in reversed(view.events_of())]
        return [part for line in told for part in wrapped(line, width, 9)] or [[("no events yet", "stale")]]


class Help(Scrolled):
    """The keys."""

    def lines(self, view: View, width: int) -> list[Line]:
        return [part for text in _HELP.split("\n") for part in wrapped([(text, "")], width, 11)]


class Question(ModalScreen[bool]):
    """A question that y answers with yes, and any other key with no."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self._text = text

    def compose(self) -> ComposeResult:
        with Vertical(id="question"):
            yield Lines(id="text")

    def on_mount(self) -> None:
        self._show()

    def on_resize(self, _event: events.Resize) -> None:
        self._show()

    def _show(self) -> None:
        width = max(20, min(64, self.app.size.width - 6))
        lines = [*wrapped([(self._text, "bold")], width, 0), [], [("y yes   n no", "label")]]
        text = self.query_one("#text", Lines)
        text.styles.width, text.styles.height = width, len(lines)
        text.show_lines(lines)

    def on_key(self, event: events.Key) -> None:
        event.stop()
        self.dismiss(event.character in ("y", "Y"))


class Plant(App[None]):
    """``order`` takes the orders of the person; ``clock`` is monotonic, in s."""

    AUTO_FOCUS = None
    ENABLE_COMMAND_PALETTE = False
    CSS = """
    Screen { background: ansi_default; color: ansi_default; layers: base; }
    Lines { background: ansi_default; height: 1; scrollbar-size-horizontal: 0; scrollbar-size-vertical: 1;
            overflow-x: hidden; }
    #head, #columns, #events, #keys { overflow-y: hidden; }
    #slaves, #body { height: 1fr; scrollbar-color: ansi_default; scrollbar-background: ansi_default; }
    #filter { height: 1; border: none; padding: 0; background: ansi_default; }
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
        self._ask("End the run? All outputs go to their safe values.", {"order": "interrupt"})

    def action_suspend_run(self) -> None:
        self._ask(
            "Stop the run for a while? The bus goes to Clear first, with safe values for all outputs. "
            "`fg` in the shell goes on.",
            {"order": "suspend"},
        )

    def _ask(self, text: str, order: Order) -> None:
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

    def action_redraw(self) -> None:
        self.refresh(repaint=True, layout=True)
        self.screen.refresh(repaint=True, layout=True)
        self.draw_now()
