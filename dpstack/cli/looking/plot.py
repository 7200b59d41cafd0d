"""``dpstack plot``: a recording drawn."""

from __future__ import annotations

import argparse
from pathlib import Path

from dpstack.api.files import AtomicFile
from dpstack.cli import options
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import UsageError
from dpstack.record.plot import FORMATS, MARK, Drawing, drawing_of, picture, show
from dpstack.record.reader import Recording

#: octets at the beginning of a picture in which its mark stands
_HEAD = 4096


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "example: dpstack plot plant.csv\n         dpstack plot plant.csv boiler hoist.speed --write plant.svg"
    )
    parser.value("file", "FILE", "a recording of `dpstack run --record`; of a rotated one the name that was given")
    parser.value("names", "NAME", "only these slaves, or columns like boiler.level", nargs="*", default=[])
    parser.value("--write", "FILE.svg", "write the picture, .svg, .png or .pdf, instead of opening a window", type=Path)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 0."""
    options.require("matplotlib", "dpstack plot", "plot")
    form = "" if args.write is None else args.write.suffix.lower().removeprefix(".")
    if args.write is not None and form not in FORMATS:
        raise UsageError(f"{args.write}: the suffix says the kind of picture; end the name in .svg, .png or .pdf")
    recording = Recording(args.file)
    if args.write is None:
        show(_drawing(recording, args.names), recording.path.name)
        return 0
    with AtomicFile(args.write, _is_picture, "picture of `dpstack plot`") as file:
        drawing = _drawing(recording, args.names)
        file.keep(picture(drawing, recording.path.name, form))
    traces = sum(map(len, drawing.panes.values()))
    if args.json:
        output.json_line(
            {
                "event": "picture",
                "file": str(args.write),
                "rows": drawing.rows,
                "traces": traces,
                "bands": len(drawing.bands),
                "left_out": list(drawing.left_out),
                "remarks": recording.remarks,
            }
        )
    else:
        output.line(f"{args.write}: {drawing.rows} rows, {traces} values, {len(drawing.bands)} bits and states")
    return 0


def _drawing(recording: Recording, names: list[str]) -> Drawing:
    drawing = drawing_of(recording, names)
    for remark in recording.remarks:
        output.warn(remark)
    if drawing.left_out:
        output.warn(
            f"{len(drawing.left_out)} columns found no room in the picture, the first is {drawing.left_out[0]}; "
            "name the slaves or columns to draw"
        )
    return drawing


def _is_picture(path: Path) -> bool:
    with path.open("rb") as file:
        return MARK.encode() in file.read(_HEAD)
