#!/bin/sh
# A GSD file in CP1252 with the character "…" (octet 0x85), read by the GSD parser of industriagents-profibus-mcp 0.3.0.
# Guess: it takes the file as Latin-1 if it is no UTF-8 and shows a control character in place of "…"; all else is read.
# It joins and splits the lines by str.splitlines() after decoding, and for that U+0085, which 0x85 is in Latin-1, ends a line. So
# the module "AI 4…20 mA" loses its configuration octets and half its name, with a warning; and what stands in a comment behind
# "…" is a line of its own: it sets Max_Module to 2 without any warning but "repeated". As UTF-8 the same text is read well.
# dpstack reads CP1252, and ends lines only at CR, LF, VT and FF.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install industriagents-profibus-mcp==0.3.0 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import pathlib
import sys

from profibus_mcp.gsd_parser import GSDParser

TEXT = """#Profibus_DP
GSD_Revision = 3
Vendor_Name = "Plant"
Model_Name = "Analog I/O"
Revision = "1"
Ident_Number = 0x1234
Protocol_Ident = 0
Station_Type = 0
Modular_Station = 1
Max_Module = 8 ; up to release 2…Max_Module = 2
Module = "AI 4…20 mA" 0x53
1
EndModule
Module = "DI 24 V" 0x10
2
EndModule
"""
seen = {}
for encoding in ("utf-8", "cp1252"):
    path = pathlib.Path(sys.argv[1], f"{encoding}.gsd")
    path.write_bytes(TEXT.encode(encoding))
    found = GSDParser().load(path)
    modules = {module["name"]: module["config_hex"] for module in found["modules"]}
    seen[encoding] = (modules, found["io_config"]["max_module"])
    print(f"{encoding}: {modules}, Max_Module {found['io_config']['max_module']}", *found["warnings"], sep="\n  ")
assert seen == {
    "utf-8": ({"AI 4…20 mA": "53", "DI 24 V": "10"}, 8),
    "cp1252": ({'"AI 4': None, "DI 24 V": "10"}, 2),
}, "the behaviour has changed"
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py" "$dir"
# output seen:
# utf-8: {'AI 4…20 mA': '53', 'DI 24 V': '10'}, Max_Module 8
# cp1252: {'"AI 4': None, 'DI 24 V': '10'}, Max_Module 2
#   line 11: Max_Module repeated; the last value wins
#   line 12: Module '"AI 4' has no configuration identifier; its I/O lengths are unknown
