"""A recording as a picture: values over wall clock, a pane for each unit, bits and states as bands. Needs matplotlib.

A value that is not valid leaves a gap. The octets of ``bytes`` fields are not drawn.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import warnings
from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from math import isfinite, nan
from pathlib import Path
from typing import Any, Final

from dpstack.errors import UsageError
from dpstack.plant.judge import DATA_EXCHANGE, DEACTIVATED
from dpstack.record.columns import BYTES, Cell, Column, Kind
from dpstack.record.reader import Recording
from dpstack.text import printable, shortened

#: suffixes of pictures
FORMATS: Final = ("svg", "png", "pdf")
#: in every picture that this module makes
MARK: Final = "dpstack plot"
#: traces of one pane, panes, and bands at most; more cannot be distinguished
MOST_TRACES: Final = 10
MOST_PANES: Final = 8
MOST_BANDS: Final = 24
#: points of one trace that a picture can show: the lowest and the highest of each place
_PLACES: Final = 2000
_WIDTH: Final = 11.0
_PANE: Final = 1.9
_BAND: Final = 0.26
#: rows that show the type of a column
_LOOKED_AT: Final = 1000
#: characters of a name
_SHOWN: Final = 40
#: part of the width below which a band has no text
_LEAST_TEXT: Final = 0.035
_GOOD: Final = "#9bd19b"
_BAD: Final = "#e58f8f"
_OTHER: Final = ("#9ecae1", "#fdd08a", "#c7b8e0", "#d9d9b0", "#f3bfd3")
_COLOURS: Final = {
    **dict.fromkeys((DATA_EXCHANGE, "running", "true"), _GOOD),
    **dict.fromkeys(("fault",), _BAD),
    **dict.fromkeys(("offline", DEACTIVATED, "false"), "#d9d9d9"),
}


@dataclass(slots=True)
class Band:
    """A bit or a state: from when to when it had which text; times in s since the first row."""

    name: str
    spans: list[tuple[float, float, str]] = field(default_factory=list)
    _text: str | None = None
    _since: float = 0.0

    def add(self, at: float, text: str | None) -> None:
        if text != self._text:
            self.end(at)
            self._text, self._since = text, at

    def end(self, at: float) -> None:
        if self._text is not None and at > self._since:
            self.spans.append((self._since, at, self._text))


@dataclass(slots=True)
class Trace:
    """A number; NaN if it is not valid."""

    name: str
    at: array[float] = field(default_factory=lambda: array("d"))
    values: array[float] = field(default_factory=lambda: array("d"))


@dataclass(frozen=True, slots=True)
class Drawing:
    """Data of a picture. ``panes``: traces by unit; ``notes``: times in s since the first row, and texts.

    ``rows``: of the recording; ``left_out``: names of columns for which there was no room.
    """

    began: float
    ended_at: float
    panes: Mapping[str, Sequence[Trace]]
    bands: Sequence[Band]
    notes: Sequence[tuple[float, str]]
    rows: int
    on_change: bool
    left_out: Sequence[str]


def drawing_of(recording: Recording, names: Sequence[str] = ()) -> Drawing:
    """Read ``recording``; ``names``: columns (``SLAVE.FIELD``) or slaves, none: all. Raises UsageError."""
    columns = _chosen(recording, names)
    bits = _bits_and_texts(recording, columns)
    panes: dict[str, list[Trace]] = {}
    bands: list[Band] = []
    places: list[tuple[Column, Trace | Band]] = []
    left_out = []
    for column in columns:
        place: Trace | Band | None = None
        if column.name in bits:
            if len(bands) < MOST_BANDS:
                place = Band(_name(column))
                bands.append(place)
        elif len(panes.get(column.unit, ())) < MOST_TRACES and (column.unit in panes or len(panes) < MOST_PANES):
            place = Trace(_name(column))
            panes.setdefault(column.unit, []).append(place)
        if place is None:
            left_out.append(column.name)
        else:
            places.append((column, place))
    notes: list[tuple[float, str]] = []
    began, at, rows = None, 0.0, 0
    for row in recording.rows():
        before, at = at, row.at
        if began is None:
            began = row.time
        rows += 1
        if row.note:
            notes.append((at, row.note))
        for column, place in places:
            if row.gap:
                _put(place, before, None)
            _put(place, at, row.values.get(column.name))
    if began is None:
        raise UsageError(f"{recording.path}: has no rows; nothing was recorded, or every line is damaged")
    for band in bands:
        band.end(at)
    panes = {unit: [trace for trace in traces if any(map(isfinite, trace.values))] for unit, traces in panes.items()}
    drawn = {unit: traces for unit, traces in panes.items() if traces}
    shown = [band for band in bands if band.spans]
    return Drawing(began, at, drawn, shown, notes, rows, recording.on_change, left_out)


def _chosen(recording: Recording, names: Sequence[str]) -> list[Column]:
    columns = [column for column in recording.columns.values() if column.type != BYTES]
    if not names:
        return columns
    for name in names:
        if not any(name in (column.name, column.slave, column.title) for column in columns):
            known = ", ".join(dict.fromkeys(column.slave or column.name for column in columns))
            raise UsageError(
                f"{recording.path}: has neither a slave nor a column {name!r}; there are: {known or 'none'}"
            )
    return [column for column in columns if {column.name, column.slave, column.title} & set(names)]


def _bits_and_texts(recording: Recording, columns: Sequence[Column]) -> set[str]:
    """The names of the columns that are no numbers; of those without a type the first values say it."""
    found = {one.name for one in columns if one.kind is Kind.STATE or one.type in ("bool", "text")}
    unknown = {one.name for one in columns if not one.type} - found
    for row in itertools.islice(recording.rows(), _LOOKED_AT) if unknown else ():
        known = {name for name in unknown if row.values.get(name) is not None}
        found |= {name for name in known if isinstance(row.values[name], (bool, str))}
        unknown -= known
    return found


def _name(column: Column) -> str:
    return shortened(printable(column.name), _SHOWN)


def _put(place: Trace | Band, at: float, value: Cell) -> None:
    if isinstance(place, Band):
        text = {True: "true", False: "false", None: None}.get(value) if isinstance(value, bool) else value
        place.add(at, None if text is None else printable(str(text)))
        return
    number = float(value) if isinstance(value, (int, float)) else nan
    place.at.append(at)
    place.values.append(number)


# --- with matplotlib -------------------------------------------------------------------------------------------------
def picture(drawing: Drawing, title: str, form: str) -> bytes:
    """The octets of the picture in one of :data:`FORMATS`. Raises UsageError without matplotlib."""
    mpl = _matplotlib()
    from matplotlib.figure import Figure

    made = io.BytesIO()
    key = {"svg": "Title", "png": "Software", "pdf": "Creator"}[form]
    with mpl.rc_context(_SETTINGS), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # letters that the font does not have
        figure = Figure(figsize=(_WIDTH, _height(drawing)), layout="constrained")
        _draw(figure, drawing, title)
        figure.savefig(made, format=form, dpi=110, metadata={key: MARK})
    return made.getvalue()


def show(drawing: Drawing, title: str) -> None:
    """Open a window and return when it is closed. Raises UsageError if none can be opened."""
    mpl = _matplotlib()
    import matplotlib.pyplot as plt

    with mpl.rc_context(_SETTINGS), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            figure = plt.figure(figsize=(_WIDTH, _height(drawing)), layout="constrained")
        except (ImportError, RuntimeError) as error:
            raise UsageError(f"no window can be opened here ({error}); give --write FILE.svg") from None
        if mpl.get_backend().lower() in ("agg", "svg", "pdf", "ps", "cairo"):
            raise UsageError("no window can be opened here; give --write FILE.svg")
        _draw(figure, drawing, title)
        plt.show()


#: names may hold $, which would begin a formula
_SETTINGS: Final = {"text.parse_math": False, "svg.fonttype": "none", "svg.hashsalt": MARK, "font.size": 8}


def _matplotlib() -> Any:
    """Imported elsewhere than in the working directory: a ``matplotlibrc`` there, perhaps of somebody who sent the
    recording, could start programs (``text.usetex``) and load modules (``backend``)."""
    try:
        with contextlib.ExitStack() as stack:
            with contextlib.suppress(FileNotFoundError):  # the working directory was removed
                stack.enter_context(contextlib.chdir(Path(__file__).parent))
            import matplotlib as mpl
            import matplotlib.dates
    except ImportError:
        raise UsageError("dpstack plot needs matplotlib; install it: pip install 'dpstack[plot]'") from None
    return mpl


def _height(drawing: Drawing) -> float:
    return 0.9 + _PANE * len(drawing.panes) + _BAND * len(drawing.bands) + (0.3 if drawing.bands else 0)


def _draw(figure: Any, drawing: Drawing, title: str) -> None:
    dates = _matplotlib().dates
    ratios = [_PANE] * len(drawing.panes) + [_BAND * len(drawing.bands) + 0.2] * bool(drawing.bands)
    if not ratios:
        raise UsageError(f"{title}: has no value that could be drawn; all of them are empty")
    panes = figure.subplots(len(ratios), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": ratios})[:, 0]
    for pane, (unit, traces) in zip(panes, drawing.panes.items(), strict=False):
        for trace in traces:
            times, values = _thinned(trace)
            # a label that begins with "_" would not be shown
            label = f" {trace.name}" if trace.name.startswith("_") else trace.name
            pane.plot(_dates(drawing, times), values, label=label, linewidth=1, drawstyle="steps-post")
        pane.set_ylabel(printable(unit))
        pane.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=7)
        pane.grid(visible=True, linewidth=0.3)
        pane.margins(x=0)
        for at, note in drawing.notes:
            if not note.startswith("end "):
                pane.axvline(_dates(drawing, [at])[0], color="#b00020", linewidth=0.8, linestyle=":")
    if drawing.bands:
        _draw_bands(panes[-1], drawing)
    axis = panes[-1].xaxis
    begin, end = _dates(drawing, [0.0, max(drawing.ended_at, 0.001)])
    panes[-1].set_xlim(begin, end)
    locator = dates.AutoDateLocator(tz=UTC)
    axis.set_major_locator(locator)
    axis.set_major_formatter(dates.ConciseDateFormatter(locator, tz=UTC))
    panes[-1].set_xlabel("UTC")
    when = f"{datetime.fromtimestamp(drawing.began, UTC):%Y-%m-%d %H:%M:%S} UTC"
    figure.suptitle(f"{printable(title)}, from {when}, {drawing.ended_at:.1f} s, {drawing.rows} rows", fontsize=9)


def _draw_bands(pane: Any, drawing: Drawing) -> None:
    colours = dict(_COLOURS)
    whole = max(drawing.ended_at, 0.001)
    for place, band in enumerate(drawing.bands):
        merged = _merged(band.spans, whole / _PLACES)
        for begin, end, text in merged:
            colour = colours.setdefault(text, _OTHER[len(colours) % len(_OTHER)])
            left, right = _dates(drawing, [begin, end])
            pane.barh(place, right - left, left=left, height=0.8, color=colour, linewidth=0)
            if end - begin > _LEAST_TEXT * whole:
                most = max(3, round((end - begin) / whole * 130))
                pane.text(*(left, place, f" {shortened(text, most)}"), va="center", ha="left", fontsize=6, clip_on=True)
    pane.set_yticks(range(len(drawing.bands)), [band.name for band in drawing.bands], fontsize=7)
    pane.set_ylim(len(drawing.bands) - 0.5, -0.5)
    pane.grid(visible=True, axis="x", linewidth=0.3)
    pane.margins(x=0)


def _merged(spans: Iterable[tuple[float, float, str]], least: float) -> list[tuple[float, float, str]]:
    """``spans`` without those shorter than ``least`` that nobody could see, unless they stand alone."""
    found: list[tuple[float, float, str]] = []
    for begin, end, text in spans:
        if found and end - begin < least and begin - found[-1][1] < least and found[-1][1] - found[-1][0] < least:
            found[-1] = (found[-1][0], end, found[-1][2])
        else:
            found.append((begin, end, text))
    return found


def _dates(drawing: Drawing, at: Sequence[float]) -> list[float]:
    """Times as matplotlib has them: days since 1970."""
    return [(drawing.began + one) / 86400 for one in at]


def _thinned(trace: Trace) -> tuple[Sequence[float], Sequence[float]]:
    """The trace with the lowest and the highest value of each place of the picture, its gaps kept."""
    count = len(trace.at)
    step = count // _PLACES
    if step < 4:
        return trace.at, trace.values
    times: list[float] = []
    values: list[float] = []
    for begin in range(0, count, step):
        piece = trace.values[begin : begin + step]
        valid = [place for place, value in enumerate(piece) if isfinite(value)]
        kept = {0, len(piece) - 1}
        if valid:
            kept |= {min(valid, key=piece.__getitem__), max(valid, key=piece.__getitem__)}
        if len(valid) < len(piece):
            kept.add(next(place for place, value in enumerate(piece) if not isfinite(value)))
        for place in sorted(kept):
            times.append(trace.at[begin + place])
            values.append(piece[place])
    return times, values
