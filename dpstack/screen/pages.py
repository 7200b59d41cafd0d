"""Parts of the pages of the live screen (textual): lines, a page, a list with a picked row, a question."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from functools import cache
from itertools import accumulate
from typing import Any, ClassVar, Final, Protocol, cast

from rich.segment import Segment
from rich.style import Style
from textual import events
from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Vertical
from textual.geometry import Size
from textual.screen import ModalScreen, Screen
from textual.scroll_view import ScrollView
from textual.strip import Strip
from textual.widgets import Input

from dpstack.screen import overview
from dpstack.screen.lines import STYLES, Line, cut_line, padded, piece, wrapped
from dpstack.screen.view import View
from dpstack.text import printable

#: cells of the bar that shows the place on a long page
BAR: Final = 1
#: an order of the person at the keys, for ``run``
Order = dict[str, Any]


class PlantApp(Protocol):
    """The application, as its pages use it."""

    #: time of the pause; empty without one
    paused_at: str
    #: a line of ``run`` for the person, for instance that the bus is ending
    note: str
    #: the page is to be drawn again
    dirty: bool
    #: the plant of this moment, also while the page stands still
    view: View
    #: ids of the values in the watch table, and the answer to the last order with its style
    watched: list[str]
    answer: tuple[str, str]

    def draw_now(self) -> None: ...
    def confirm(self, text: str, order: Order) -> None: ...


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

    @property
    def plant_app(self) -> PlantApp:
        return cast(PlantApp, self.app)

    def on_screen_resume(self) -> None:
        self.plant_app.dirty = True

    def on_resize(self, _event: events.Resize) -> None:
        self.plant_app.dirty = True

    def lines_at(self, selector: str) -> Lines:
        return self.query_one(selector, Lines)

    def show_head(self, lines: list[Line]) -> None:
        """Show these lines at the top; none: the next part begins there."""
        self.set_height("#head", len(lines))
        self.lines_at("#head").show_lines(lines)

    def set_height(self, selector: str, height: int) -> None:
        widget = self.query_one(selector)
        widget.display = height > 0
        if widget.styles.height is None or widget.styles.height.value != height:
            widget.styles.height = height

    def notices(self, view: View) -> list[Line]:
        """Why the page is not the plant of this moment."""
        app = self.plant_app
        told = overview.notices(view, paused=app.paused_at, note=app.note)
        return [cut_line([one], self.size.width) for one in told]


class Listed(Page):
    """A page with a list of rows, of which one is picked. A row has one or more lines."""

    BINDINGS: ClassVar = [
        Binding("up,k", "move(-1)"),
        Binding("down,j", "move(1)"),
        Binding("pageup", "page(-1)"),
        Binding("pagedown", "page(1)"),
        Binding("home", "edge(0)"),
        Binding("end", "edge(-1)"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._rows: Sequence[str] = []
        self._picked: str | None = None

    @property
    def picked(self) -> str | None:
        """The id of the marked row."""
        return self._picked

    @property
    def _number(self) -> int:
        return self._rows.index(self._picked) if self._picked in self._rows else -1

    def set_rows(self, rows: Sequence[str]) -> None:
        """Take the ids of the rows; the picked one stays if it is there."""
        at, self._rows = max(0, self._number), rows
        if self._picked not in rows:
            self._picked = rows[min(at, len(rows) - 1)] if rows else None

    def show_rows(self, heights: Sequence[int], lines_of: Callable[[int], list[Line]], none: str) -> None:
        """Show the rows with these numbers of lines, made by their numbers; without rows the text ``none``."""
        widget = self.lines_at("#rows")
        if not self._rows:
            widget.marked = range(0)
            widget.show_lines([[(none, "stale")]])
            return
        starts = list(accumulate(heights, initial=0))
        widget.marked = range(starts[self._number], starts[self._number + 1])
        made = cache(lines_of)

        def line(number: int) -> Line:
            row = bisect_right(starts, number) - 1
            at, lines = number - starts[row], made(row)
            return lines[at] if at < len(lines) else []  # it got shorter since

        widget.show(starts[-1], line)
        widget.keep_visible(widget.marked)

    def _pick(self, number: int) -> None:
        if self._rows:
            self._picked = self._rows[min(max(number, 0), len(self._rows) - 1)]
            self.plant_app.draw_now()

    def action_move(self, step: int) -> None:
        self._pick(self._number + step)

    def action_page(self, step: int) -> None:
        self._pick(self._number + step * max(1, self.lines_at("#rows").size.height - 1))

    def action_edge(self, end: int) -> None:
        self._pick(0 if end == 0 else len(self._rows) - 1)


class Filtered(Listed):
    """A list with a filter: words that each row must have."""

    BINDINGS: ClassVar = [Binding("slash", "filter"), Binding("escape", "no_filter")]

    def __init__(self, words: str = "") -> None:
        super().__init__()
        self.words = words

    def on_mount(self) -> None:
        self.query_one("#filter").display = False

    def filter_text(self) -> list[str]:
        """Words about the filter; empty without one."""
        return [f'filter "{self.words}"'] if self.words else []

    def action_filter(self) -> None:
        field = self.query_one("#filter", Input)
        field.value = self.words
        field.display = True
        field.focus()

    def on_input_changed(self, event: Input.Changed) -> None:
        self.words = event.value
        self.plant_app.draw_now()

    def on_input_submitted(self, _event: Input.Submitted) -> None:
        self.close_filter()

    def action_no_filter(self) -> None:
        self.words = ""
        self.close_filter()

    def close_filter(self) -> None:
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
        width = self.size.width
        self.show_head(self.notices(view))
        self.query_one("#body", Lines).show_lines(self.lines(view, width - BAR))
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
        for text in self.query("#text").results(Lines):  # none yet if the first size comes early
            text.styles.width, text.styles.height = width, len(lines)
            text.show_lines(lines)

    def on_key(self, event: events.Key) -> None:
        event.stop()
        self.dismiss(event.character in ("y", "Y"))
