"""The pages of the watch table (textual): chosen values and orders to them, and the choice."""

from __future__ import annotations

from typing import ClassVar, Final

from textual.app import ComposeResult
from textual.binding import Binding
from textual.widgets import Input

from dpstack.plant.items import Plant
from dpstack.screen import watch
from dpstack.screen.lines import Line, padded
from dpstack.screen.pages import BAR, Filtered, FilterInput, Lines, Listed
from dpstack.screen.view import View
from dpstack.screen.watch import Point
from dpstack.text import printable

#: the simulated station whose inputs nobody makes (docs/reference/io-station.md)
_IO_STATION: Final = "io-station"


class _Points:
    """All values of the plant, found again only if it is another one."""

    def __init__(self) -> None:
        self._plant: Plant | None = None
        self._known: dict[str, Point] = {}

    def of(self, view: View) -> dict[str, Point]:
        if view.state.plant is not self._plant:
            self._plant, self._known = view.state.plant, watch.points_of(view)
        return self._known


class Watch(Listed):
    """The chosen values, a row each, and orders to them."""

    BINDINGS: ClassVar = [
        Binding("a", "choose"),
        Binding("enter", "order"),
        Binding("r", "release"),
        Binding("d,delete", "remove"),
        Binding("escape", "back"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._points = _Points()
        #: the value that an order is typed for
        self._ordered: Point | None = None

    def compose(self) -> ComposeResult:
        yield Lines(id="head")
        yield Lines(id="columns")
        yield Lines(id="rows")
        yield FilterInput(id="value")
        yield Lines(id="keys")

    def on_mount(self) -> None:
        self.query_one("#value").display = False

    def draw(self, view: View) -> None:
        app, width = self.plant_app, self.size.width - BAR
        text, style = app.answer
        self.show_head([*self.notices(view), *([[(printable(text), style)]] if text else [])])
        self.lines_at("#columns").show_lines([watch.watch_head(width)])
        keys = "escape back  a choose  enter order  r release  d remove  space pause  ? help"
        self.lines_at("#keys").show_lines([[(padded(keys, self.size.width), "title")]])
        points, rows = self._points.of(view), app.watched
        self.set_rows(rows)
        lines = [
            watch.watch_lines(view, points[one], width) if one in points else watch.without_point(one, width)
            for one in rows
        ]
        self.show_rows([len(one) for one in lines], lines.__getitem__, "nothing is chosen yet: a chooses values")

    # --- keys -----------------------------------------------------------------------------------------------------

    def _point(self) -> Point | None:
        return self._points.of(self.view_now).get(self.picked or "")

    @property
    def view_now(self) -> View:
        return self.plant_app.view

    def action_choose(self) -> None:
        self.app.push_screen(Choose())

    def action_remove(self) -> None:
        if self.picked in self.plant_app.watched:
            self.plant_app.watched.remove(self.picked)
            self.plant_app.draw_now()

    def action_back(self) -> None:
        if self._ordered is None:
            self.app.pop_screen()
        else:
            self._close()

    def action_order(self) -> None:
        """Ask for the value of an output, or of an input of a simulated slave."""
        point = self._point()
        if point is None or not point.order(self.view_now):
            self._refuse()
            return
        self._ordered = point
        field = self.query_one("#value", Input)
        verb = "force the input" if point.order(self.view_now) == "force" else "set the output"
        field.placeholder = f"{verb} {point.label} to: a number, on, off; enter, or escape"
        field.value = ""
        field.display = True
        field.focus()

    def _refuse(self) -> None:
        self._answer("orders are for named outputs of slaves without a drive, and for named inputs of simulated ones")

    def _answer(self, text: str) -> None:
        self.plant_app.answer = text, "warn"
        self.plant_app.draw_now()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        point, value = self._ordered, event.value.strip()
        self._close()
        if point is None or point.field is None or not value:
            return
        name, who = point.field.name, self.view_now.who(point.address)
        if point.order(self.view_now) == "force":
            text = f"Force the input {name} of the simulated {who} to {value}? It stays until another one is forced."
        else:
            text = f"Set the output {name} of {who} to {value}? The plant reacts to it."
        self.plant_app.confirm(printable(text), {"order": "set", "text": f"{point.address}.{name}={value}"})

    def action_release(self) -> None:
        """Let a simulated slave make its inputs itself again."""
        point = self._point()
        if point is None or point.order(self.view_now) != "force":
            self._refuse()
            return
        if self.view_now.slave_plant(point.address).gsd == _IO_STATION:
            self._answer("an I/O station makes no inputs itself: each stays as it was set")
            return
        text = f"Release the inputs of the simulated {self.view_now.who(point.address)}? They are its outputs again."
        self.plant_app.confirm(printable(text), {"order": "release", "slave": int(point.address)})

    def _close(self) -> None:
        self._ordered = None
        self.set_focus(None)
        self.query_one("#value").display = False
        self.plant_app.draw_now()


class Choose(Filtered):
    """All values of the plant; enter takes one into the watch table, or out of it."""

    BINDINGS: ClassVar = [Binding("enter", "choose")]

    def __init__(self, words: str = "") -> None:
        super().__init__(words)
        self._points = _Points()

    def compose(self) -> ComposeResult:
        yield Lines(id="head")
        yield Lines(id="columns")
        yield Lines(id="rows")
        yield FilterInput(placeholder="filter: words in slave, value, slot; enter", id="filter")
        yield Lines(id="keys")

    def draw(self, view: View) -> None:
        app = self.plant_app
        points, wanted = self._points.of(view), self.words.casefold().split()
        rows = [one for one, point in points.items() if all(word in point.label.casefold() for word in wanted)]
        self.show_head(self.notices(view))
        text = f"{len(rows)} values{''.join(f', {one}' for one in self.filter_text())}; {len(app.watched)} chosen"
        about: Line = [(text, "label")]
        self.lines_at("#columns").show_lines([about])
        keys = "escape done  enter choose  / filter  up/down move"
        self.lines_at("#keys").show_lines([[(padded(keys, self.size.width), "title")]])
        self.set_rows(rows)
        self.show_rows(
            [1] * len(rows),
            lambda number: watch.choice_line(points[rows[number]], chosen=rows[number] in app.watched),
            "no value is like that; / changes the filter" if points else "the plant has no values",
        )

    def action_choose(self) -> None:
        watched = self.plant_app.watched
        if self.picked in watched:
            watched.remove(self.picked)
        elif self.picked is not None and len(watched) < watch.MOST:
            watched.append(self.picked)
        self.plant_app.draw_now()

    def action_no_filter(self) -> None:
        """Close the field of the filter, else the page."""
        if self.query_one("#filter").display:
            super().action_no_filter()
        else:
            self.app.pop_screen()
