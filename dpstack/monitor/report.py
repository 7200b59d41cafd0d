"""The acceptance report of a bus: one HTML file that a customer reads, prints and signs. No network, no script.

It is made of the summary of ``monitor --json``; every figure there is in the report. Foreign text (names, texts of GSD
files) is escaped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any, Final

from dpstack.monitor import drawings
from dpstack.monitor.counters import Counters
from dpstack.monitor.markup import (
    NOT_TIMED,
    Html,
    html_inputs,
    html_list,
    html_page,
    html_pairs,
    html_section,
    html_table,
    join_lines,
    plain_text,
    text,
)
from dpstack.monitor.monitor import Happening
from dpstack.monitor.not_heard import verdict_text
from dpstack.monitor.run_sections import (
    RunSlave,
    count_of_standing,
    inventory_section,
    modules_section,
    standing_section,
)
from dpstack.monitor.schedule import Rotation, Use
from dpstack.monitor.summary import UNSEEN
from dpstack.monitor.thresholds import limits
from dpstack.stats import Histogram
from dpstack.units import NS_PER_S, NS_PER_US, baud_text

Summary = Mapping[str, Any]


#: stations whose histogram of T_SDR is drawn: those with the longest 99 % quantiles
MOST_HISTOGRAMS: Final = 24
#: rows of the time line, and of the table of one rotation
MOST_CHANGES: Final = 200
MOST_SLOTS: Final = 200
_SIGNS: Final = {"good": "✓", "warning": "!", "critical": "✕", "unknown": "?"}
_SOURCES: Final = {
    "tap": "the octets of a dpstack program that holds the port; telegrams that it sends have exact times",
    "host": "a pty or a socket: the octets come from another process, not from a wire",
    "adapter": "a serial adapter",
    "waveform": "the samples of a logic analyser",
    "file": "a capture file that does not say how it was timed",
}
#: what the report says that it cannot see
CANNOT_SEE: Final = (
    *UNSEEN,
    "noise that damages no octet",
    "a station that nobody asks",
    "the bus before and after the time of this report",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """A report before it is written.

    ``summary``: of ``monitor --json``. ``counters``: for the histograms. ``begun_ns``: begin in ns since 1970.
    ``changes``: the time line; ``changes_left_out``: earlier ones that were not kept. ``rotation``: a typical one.
    ``line``: port and adapter in words, by name; ``parameters``: those that the listener's own master runs with.
    ``slaves``: of the bus that the program runs, none of one that it only listens to. ``made``: time of the report.
    ``remarks``: one line each.
    """

    summary: Summary
    counters: Counters
    begun_ns: int
    version: str
    made: datetime
    changes: Sequence[Happening] = ()
    changes_left_out: int = 0
    rotation: Rotation | None = None
    line: Mapping[str, object] = field(default_factory=dict)
    parameters: Mapping[str, object] = field(default_factory=dict)
    slaves: Sequence[RunSlave] = ()
    remarks: Sequence[str] = ()
    cannot_see: Sequence[str] = CANNOT_SEE

    # --- the page ---
    def html(self) -> str:
        """The whole page."""
        sections = (
            self._fields(),
            self._verdict(),
            self._record(),
            self._signatures(),
            self._verdicts(),
            self._parameters(),
            self._masters(),
            self._stations(),
            self._diagnoses(),
            *self._links(),
            *self._run(),
            self._histograms(),
            self._time_line(),
            self._schedule(),
            self._limits(),
            self._thresholds(),
        )
        is_profibus = self.summary.get("profibus", True)
        name = "PROFIBUS acceptance report" if is_profibus else "Report of a line that was not recognised as PROFIBUS"
        title = f"{name}, {self._begun():%Y-%m-%d}"
        made = f"dpstack {self.version}, report made {_time(self.made)}"
        header = f"<h1>{name}</h1><p>Made of the octets on the bus; listening sends none.</p>"
        return html_page(title, header, join_lines(sections), made, self.version)

    # --- sections ---
    def _record(self) -> str:
        s = self.summary
        begun = self._begun()
        seconds = float(s.get("seconds") or 0)
        rows: dict[str, object] = {
            "Begin": _time(begun),
            "End": _time(begun + timedelta(seconds=seconds)),
            "Duration": f"{_duration(seconds)} ({plain_text(s.get('seconds'))} s)",
            **self.line,
            "Rate": "unknown" if not s.get("baud") else f"{baud_text(s['baud'])} ({s['baud']} bit/s)",
            "Recognised as PROFIBUS": s.get("profibus"),
            "Telegrams": s.get("telegrams"),
            "Telegrams a second": s.get("telegrams_per_s"),
            "Load": _share(s.get("load")),
            "Damaged transmissions": _causes(s.get("damaged") or {}),
            "Not attributed to a station": s.get("unattributed"),
            "Answers that nobody asked for": s.get("strays"),
        }
        remarks = "".join(f'<p class="remark">{text(one)}</p>' for one in self.remarks)
        return html_section("Record", html_pairs(rows) + self._timing() + remarks)

    def _timing(self) -> str:
        timing = self.summary.get("timing") or {}
        source = timing.get("source")
        resolution = timing.get("resolution_us")
        rows = {
            "Source of the times": f"{source}: {_SOURCES[source]}" if source in _SOURCES else source,
            "Resolution": "unknown" if resolution is None else f"{plain_text(resolution)} us",
            "Telegrams that arrived together with others": _share(timing.get("batched")),
        }
        note = (
            "Figures finer than this port can time are not given (n/a), and no verdict rests on them. Counts, "
            "repetitions, load and mean rotation need no such timing."
        )
        return f"<h3>Adapter and its limits</h3>{html_pairs(rows)}<p>{note}</p>"

    def _fields(self) -> str:
        names = ("Customer", "Plant", "Segment or machine", "Order or report number", "Inspector", "Company")
        note = '<p class="screen">Fill in here, or on paper; the browser keeps nothing after the page is closed.</p>'
        return html_section("Acceptance", f'{note}<div class="fields">{html_inputs(names, "f")}</div>')

    def _signatures(self) -> str:
        names = [f"Place, date, signature of the {who}" for who in ("inspector", "customer")]
        return html_section("Signatures", f'<div class="fields signed">{html_inputs(names, "s")}</div>', "whole")

    def _verdict(self) -> str:
        verdict = self.summary.get("verdict", "unknown")
        missing = self.summary.get("not_heard") or ()
        nothing = "No reason to object, as far as heard." if missing else "No reason to object."
        reasons = html_list(self.summary.get("reasons"), nothing if verdict == "good" else "")
        css = verdict if verdict in _SIGNS else "unknown"
        words = f"<p><strong>The bus: {_badge(self.summary)}</strong></p>{reasons}"
        if missing:
            words += f"<p>Not heard, and so not judged:</p>{html_list(missing, '')}"
        standing = count_of_standing(self.slaves)
        if standing:
            words += f"<p>Standing diagnoses at the end of the run: {standing}.</p>"
        return html_section("Verdict", f'<div class="verdict v-{css}">{words}</div>')

    def _verdicts(self) -> str:
        rows = []
        for kind, entries in (("master", self._by_address("masters")), ("", self._by_address("stations"))):
            for address, one in entries:
                if one.get("verdict") is not None:
                    role, name = one.get("role") or kind, one.get("name") or one.get("model") or ""
                    reasons = Html(html_list(one.get("reasons"), ""))
                    rows.append((address, role, name, Html(_badge(one)), reasons))
        columns = ("Address", "Role", "Name", "Verdict", "Reasons")
        table = html_table("Verdict on each station", columns, rows, numbers=())
        return html_section("Verdicts on stations", table if rows else "<p>No station was heard.</p>")

    def _parameters(self) -> str:
        counters, s = self.counters, self.summary
        asked = [address for address, station in counters.stations.items() if station.requests]
        rows: dict[str, object] = {
            "Rate": "unknown" if not s.get("baud") else baud_text(s["baud"]),
            "Characters": "8 data bits, even parity, 1 stop bit: 11 bits",
            "Masters, by address": ", ".join(map(str, sorted(counters.masters))) or "none heard",
            "Highest address asked (HSA is at least this)": max(asked, default="none"),
            "GAP polls and FDL status requests": sum(master.gap_polls for master in counters.masters.values()),
        }
        if self.parameters:
            own = ", ".join(f"{name} {value}" for name, value in self.parameters.items())
            rows["The master of this program runs with (bit times, unless another unit is named)"] = own
        return html_section("Bus parameters seen", html_pairs(rows) + self._set_prm())

    def _set_prm(self) -> str:
        """The parameters that masters gave to slaves, as far as a bring-up was heard."""
        rows = []
        for address, station in sorted(self.counters.stations.items()):
            octets = station.set_prm
            if octets is None or len(octets) < 7:
                continue
            watchdog = f"{10 * octets[1] * octets[2]} ms" if octets[0] & 8 else "off"
            groups = ", ".join(str(bit + 1) for bit in range(8) if octets[6] & 1 << bit) or "none"
            rows.append(
                (address, watchdog, octets[3], f"0x{octets[4] << 8 | octets[5]:04X}", groups, octets[7:].hex(" "))
            )
        if not rows:
            return "<p>No bring-up was heard: the parameters of the slaves are not known.</p>"
        columns = ("Address", "Watchdog", "min T_SDR (bits)", "Ident", "Groups", "User parameters (hex)")
        return html_table("Parameters of the slaves (Set_Prm heard)", columns, rows, numbers=(2,))

    def _masters(self) -> str:
        rows, times = [], []
        for address, one in self._by_address("masters"):
            slaves = ", ".join(map(str, one.get("slaves") or ())) or "none"
            rows.append((address, one.get("mode"), slaves, one.get("gap_polls"), one.get("drops")))
            for key, name in (("rotation_us", "DP cycle"), ("token_us", "token rotation"), ("hold_us", "token held")):
                times.append((address, name, *_points(one.get(key), _TIMES)))
            clock = one.get("clock") or {}
            for key, name in (("interval_us", "interval of the time sent"), ("jitter_us", "jitter of the time sent")):
                if clock:
                    times.append((address, name, *_points(clock.get(key), _TIMES)))
        columns = ("Address", "Mode", "Slaves", "GAP polls", "Drops out of the ring")
        counters = html_table("Masters", columns, rows, numbers=(3, 4))
        names = ("Address", "Time (us)", *_TIMES)
        return html_section("Masters", counters + html_table("Times of the masters", names, times, numbers=range(2, 8)))

    def _stations(self) -> str:
        who, counts, course, times = [], [], [], []
        for address, one in self._by_address("stations"):
            verdict = one.get("verdict")
            sign = Html(_badge(one)) if verdict is not None else ""
            about = {**one, "state": str(one.get("state") or "").replace("_", " ")}
            who.append((address, *(plain_text(about.get(key), "") for key in _WHO), sign))
            counts.append((address, *(one.get(key) for key in _COUNTS)))
            depth = one.get("retry_depth")
            depths = ", ".join(map(str, depth)) if isinstance(depth, (list, tuple)) else depth
            diagnosis = plain_text(one.get("diagnosis"), "none")
            course.append((address, depths, *(one.get(key) for key in _COURSE), diagnosis))
            limit = self._max_tsdr_us(one)
            limit_us = "unknown" if limit is None else f"{limit:.1f}"
            bits = plain_text(one.get("max_tsdr"), "unknown")
            times.append((address, *_points(one.get("tsdr_us"), _ANSWER), bits, limit_us))
        explained = (
            "Requests = answers + damaged + no answer. Repetitions: requests with an unturned frame count bit. "
            "Repeated polls: unanswered requests without frame count that were sent again. RS, RR: refusals for lack "
            "of the service, or of resources."
        )
        tables = (
            html_table("Stations", ("Address", *_WHO.values(), "Verdict"), who, numbers=()),
            html_table("Requests and answers", ("Address", *_COUNTS.values()), counts, numbers=range(1, 10)),
            f"<p>{explained}</p>",
            html_table(
                "Repetitions by depth, data exchange, diagnosis",
                ("Address", "Exchanges with 1, 2, ... repetitions", *_COURSE.values(), "Last diagnosis (hex)"),
                course,
                numbers=(2, 3, 4),
            ),
            html_table(
                "T_SDR in us: from the end of a request to the begin of the answer",
                ("Address", *_ANSWER, "MaxTsdr (bits)", "MaxTsdr (us)"),
                times,
                numbers=range(1, 7),
            ),
        )
        return html_section("Stations", join_lines(tables))

    def _diagnoses(self) -> str:
        rows = []
        for address, one in self._by_address("stations"):
            if one.get("role") in ("master", "cpu"):
                continue
            texts, heard = one.get("diagnosis_texts"), one.get("diagnoses")
            found = "no Slave_Diag was heard" if texts is None else Html(html_list(texts, "nothing to report"))
            missing = ", ".join(one.get("not_heard") or ())
            rows.append((address, one.get("name") or one.get("model") or "", heard, found, missing))
        columns = ("Address", "Name", "Diag\xadnoses heard", "In the last one", "Not heard")
        table = html_table("Diagnosis of each slave", columns, rows, numbers=(2,))
        note = (
            "A slave sends its diagnosis when its master asks for it: in a bring-up, and after an answer that "
            "announces a new one. Listening asks nobody: a diagnosis that stood before is not on the wire."
        )
        return html_section("Diagnoses", f"<p>{note}</p>{table}" if rows else "<p>No slave was heard.</p>")

    def _links(self) -> list[str]:
        """Data exchange broadcast, if a station has it: publishers, and the links of subscribers with their states."""
        publishers = [self._name(int(address)) for address, one in self._by_address("stations") if one.get("publisher")]
        rows = [
            (address, one.get("name") or one.get("model") or "", self._name(link["publisher"]), link["text"],
             link["state"] or "no link status message was heard")
            for address, one in self._by_address("stations") for link in one.get("links") or ()
        ]  # fmt: skip
        if not publishers and not rows:
            return []
        columns = ("Address", "Name", "Publisher", "Octets", "State in the last link status message")
        table = html_table("Links of each subscriber", columns, rows, numbers=())
        named = ", ".join(publishers) or "none; its Set_Prm was not heard"
        note = f"<p>Publishers by their Set_Prm: {text(named)}.</p>"
        return [html_section("Links between slaves (data exchange broadcast)", note + (table if rows else ""))]

    def _run(self) -> list[str]:
        """Facts that the master of this program knows beside the octets."""
        if not self.slaves:
            return []
        return [modules_section(self.slaves), standing_section(self.slaves), inventory_section(self.slaves)]

    def _histograms(self) -> str:
        figures: list[str] = []
        untimed: list[str] = []
        for address, one in self._by_address("masters"):
            master = self.counters.masters.get(int(address))
            if master is not None:
                for key, values, name in (
                    ("rotation_us", master.rotation_ns, "DP cycle"),
                    ("token_us", master.token_ns, "token rotation"),
                    ("hold_us", master.hold_ns, "token held"),
                ):
                    drawn = _figure(one.get(key), values, f"{name} of master {address}")
                    figures += drawn
                    if values.count and not drawn:
                        untimed.append(f"{name} of master {address}")
        timed = []
        for address, one in self._by_address("stations"):
            station = self.counters.stations.get(int(address))
            if station is not None and _is_timed(one.get("tsdr_us")):
                timed.append((address, one, station.answer_ns))
        overview = ""
        if timed:
            rows = [(self._name(int(address)), one["tsdr_us"], self._max_tsdr_us(one)) for address, one, _ in timed]
            overview = _figure_of(
                "T_SDR of each station: bar up to 99 %, its cross line is the median, thin line to the longest, dashed "
                "line at MaxTsdr",
                drawings.answer_times(rows, "us"),
            )
            timed.sort(key=lambda row: -row[2].quantile_ns(0.99))
            for address, one, values in sorted(timed[:MOST_HISTOGRAMS], key=lambda row: int(row[0])):
                figures += _figure(one["tsdr_us"], values, f"T_SDR of {self._name(int(address))}")
        left = len(timed) - MOST_HISTOGRAMS
        note = "" if left <= 0 else f"<p>{left} stations with shorter T_SDR have no histogram here.</p>"
        untimed += [] if timed else ["T_SDR of the stations"]
        none = f"<p>This port cannot time, or not finely enough: {text(', '.join(untimed))}.</p>" if untimed else ""
        grid = f'<div class="grid">{join_lines(figures)}</div>' if figures else ""
        return html_section("Histograms", overview + grid + note + none)

    def _time_line(self) -> str:
        if not self.changes and not self.changes_left_out:
            return html_section(
                "Time line", "<p>No station was lost or came back, no diagnosis changed, no alarm came.</p>"
            )
        seconds = max(float(self.summary.get("seconds") or 0), 1e-3)
        shown = self.changes[-MOST_CHANGES:]
        left_out = self.changes_left_out + len(self.changes) - len(shown)
        changes = [drawings.Mark(self._seconds(one.t_ns), one.kind, one.address) for one in shown]
        names = {address: self._name(address) for address in {one.address for one in shown}}
        rows = [
            (
                f"{self._seconds(one.t_ns):.3f}",
                "bus" if one.address is None else one.address,
                one.kind.replace("_", " "),
                one.text,
            )
            for one in shown
        ]
        note = f"<p>{left_out} earlier changes are not shown.</p>" if left_out else ""
        drawing = _figure_of("Changes by station", drawings.time_line(changes, seconds, names))
        legend = drawings.marks_legend(one.kind for one in shown)
        table = html_table("Changes", ("Seconds", "Address", "Change", "Text"), rows, numbers=(), head_is_number=True)
        return html_section("Time line", drawing + legend + note + table)

    def _seconds(self, t_ns: int) -> float:
        return (t_ns - self.begun_ns) / NS_PER_S

    def _schedule(self) -> str:
        rotation = self.rotation
        if rotation is None:
            return html_section("Schedule of one rotation", "<p>No whole rotation was heard.</p>")
        timed = self._times_neighbours()
        begins = "where the master passes the token" if rotation.by_token else "with the first Data_Exchange of a round"
        words = (
            f"A typical rotation of {drawings.microseconds(rotation.duration_ns)} us, "
            f"{self._seconds(rotation.begun_ns):.3f} s after the begin; it begins {begins}. "
        )
        words += (
            "Drawn to scale, in us; strips follow each other."
            if timed
            else "Lengths of telegrams are to scale. This port cannot time the silence between them, so they stand "
            "without it, one after the other."
        )
        used = [
            (use.value, drawings.microseconds(ns), _part(ns, rotation.duration_ns))
            for use in Use
            if (ns := rotation.used_ns(use))
        ]
        if timed:
            used.append(
                ("idle", drawings.microseconds(rotation.idle_ns), _part(rotation.idle_ns, rotation.duration_ns))
            )
        shares = html_table("Use of the wire in this rotation", ("Use", "us", "Share"), used, numbers=(1, 2))
        rows = []
        for slot in rotation.slots[:MOST_SLOTS]:
            start = f"{slot.start_ns / NS_PER_US:.1f}" if timed else "n/a"
            idle = f"{slot.idle_ns / NS_PER_US:.1f}" if timed else "n/a"
            ends = (plain_text(slot.sa, ""), "all" if slot.da == 127 else plain_text(slot.da, ""))
            rows.append(
                (start, idle, f"{slot.duration_ns / NS_PER_US:.1f}", slot.size, slot.use.value, *ends, slot.text)
            )
        columns = ("Begin (us)", "Idle before (us)", "Length (us)", "Octets", "Use", "From", "To", "Service")
        left = len(rotation.slots) - len(rows)
        note = f"<p>{left} more telegrams are not in the table.</p>" if left > 0 else ""
        table = html_table("Telegrams of this rotation", columns, rows, numbers=(1, 2, 3), head_is_number=True)
        drawing = _figure_of("One rotation", drawings.schedule(rotation, timed=timed))
        return html_section(
            "Schedule of one rotation",
            f"<p>{text(words)}</p>{drawing}{drawings.schedule_legend()}{shares}{table}{note}",
        )

    def _limits(self) -> str:
        return html_section("What this report cannot see", html_list(self.cannot_see, ""))

    def _thresholds(self) -> str:
        values = self.summary.get("thresholds") or {}
        rows = [
            (limit.name, f"{values[limit.name]:g}", limit.unit, limit.text, limit.source)
            for limit in limits()
            if limit.name in values
        ]
        columns = ("Threshold", "Value", "Unit", "Meaning", "Source")
        table = html_table("Thresholds", columns, rows, numbers=(1,)) if rows else "<p>Not known.</p>"
        return html_section("Thresholds of the verdicts", table)

    # --- parts ---
    def _begun(self) -> datetime:
        try:
            return datetime.fromtimestamp(self.begun_ns / NS_PER_S, UTC) if self.begun_ns else self.made
        except (ValueError, OverflowError, OSError):  # a file may claim any time
            return self.made

    def _by_address(self, key: str) -> list[tuple[str, Summary]]:
        return sorted((self.summary.get(key) or {}).items(), key=lambda entry: int(entry[0]))

    def _name(self, address: int | None) -> str:
        if address is None:
            return "the bus"
        one = (self.summary.get("stations") or {}).get(str(address), {})
        name = one.get("name") or one.get("model")
        return f"{address} ({name})" if name else f"station {address}"

    def _max_tsdr_us(self, one: Summary) -> float | None:
        bits, baud = one.get("max_tsdr"), self.summary.get("baud")
        return bits * 1e6 / baud if bits and baud else None

    def _times_neighbours(self) -> bool:
        """Whether the port could time the silence between telegrams: it could if it timed an answer."""
        return any(_is_timed(one.get("tsdr_us")) for _, one in self._by_address("stations"))


#: columns of the stations' tables: keys of the summary and headings
_WHO: Final = {
    "name": "Name",
    "role": "Role",
    "ident": "Ident",
    "model": "Model",
    "state": "State",
    "master": "Master",
}
_COUNTS: Final = {
    "requests": "Requests",
    "answers": "Answers",
    "damaged": "Damaged",
    "no_answer": "No answer",
    "repetitions": "Repeti\xadtions",
    "repeated_polls": "Repeated polls",
    "late": "Late",
    "rs": "RS",
    "rr": "RR",
}
_COURSE: Final = {"syncs": "Bring-ups", "lost": "Lost", "diagnoses": "Diag\xadnoses"}
_TIMES: Final = ("mean", "min", "p50", "p99", "p999", "max")
_ANSWER: Final = ("min", "p50", "p99", "max")


def _figure_of(caption: str, drawing: str) -> str:
    return f'<figure><figcaption>{text(caption)}</figcaption><div class="scroll">{drawing}</div></figure>\n'


def _figure(points: Any, values: Histogram, name: str) -> list[str]:
    """The histogram, if the port could time it."""
    return [_figure_of(name, drawings.histogram(values, name))] if values.count and _is_timed(points) else []


def _is_timed(points: Any) -> bool:
    return isinstance(points, Mapping) and all(points.get(key) is not None for key in _ANSWER)


def _points(points: Any, keys: Sequence[str]) -> list[object]:
    if not isinstance(points, Mapping):
        return [NOT_TIMED] * len(keys)
    return [NOT_TIMED if (value := points.get(key, "")) is None else value for key in keys]


def _share(value: object) -> str:
    return f"{value * 100:.3g} % ({value})" if isinstance(value, (int, float)) else NOT_TIMED


def _part(part: int, whole: int) -> str:
    return f"{100 * part / max(whole, 1):.1f} %"


def _causes(damaged: Mapping[str, int]) -> str:
    total = sum(damaged.values())
    causes = ", ".join(f"{cause} {count}" for cause, count in sorted(damaged.items()))
    return f"{total} ({causes})" if causes else "0"


def _badge(found: Summary) -> str:
    """The verdict of a bus or station in words with a sign; the colour says nothing more."""
    name = str(found.get("verdict", "unknown"))
    css = name if name in _SIGNS else "unknown"
    words = text(verdict_text({"verdict": "unknown", **found}))
    return f'<span class="badge v-{css}"><span aria-hidden="true">{_SIGNS[css]} </span>{words}</span>'


def _time(at: datetime) -> str:
    return f"{at.astimezone(UTC):%Y-%m-%d %H:%M:%S} UTC"


def _duration(seconds: float) -> str:
    whole = int(seconds)
    hours, minutes = whole // 3600, whole // 60 % 60
    parts = [f"{hours} h"] * bool(hours) + [f"{minutes} min"] * bool(hours or minutes)
    return " ".join([*parts, f"{seconds - whole // 60 * 60:.3g} s"])
