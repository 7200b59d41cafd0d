#!/bin/sh
# The modules that `import msgspec` (0.22.0) loads, before and after typing_extensions (4.16.0) is installed beside it.
# Guess: msgspec depends on no package, so a package that no program imports changes nothing in the start of one.
# msgspec takes typing_extensions where it finds it (any package may have brought it), and that loads inspect and with it
# ast, dis and tokenize: a third more of the processor for the import.
# A budget of the modules or of the time of a start holds for one environment only: dpstack's leaves inspect out.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
install() { "$dir/env/bin/pip" --quiet --disable-pip-version-check install "$1" >/dev/null 2>&1; }
show() {
    "$dir/env/bin/python" -c '
import sys
import msgspec
print(f"msgspec {msgspec.__version__}, " + sys.argv[1] + ":", *(n for n in ("ast", "dis", "inspect", "tokenize") if n in sys.modules))
' "$1"
}
install msgspec==0.22.0
show alone >"$dir/seen"
install typing_extensions==4.16.0
show "typing_extensions is there" >>"$dir/seen"
cat "$dir/seen"
cat >"$dir/expected" <<'TXT'
msgspec 0.22.0, alone:
msgspec 0.22.0, typing_extensions is there: ast dis inspect tokenize
TXT
cmp -s "$dir/expected" "$dir/seen" || { echo "the behaviour has changed" >&2; exit 1; }
# output seen:
# msgspec 0.22.0, alone:
# msgspec 0.22.0, typing_extensions is there: ast dis inspect tokenize
