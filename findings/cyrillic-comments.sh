#!/bin/sh
# A hardware configuration of 17 kB, mostly ASCII, with nine short comments: Russian in cp1251, or German in cp1252. Two
# libraries find its encoding: charset-normalizer 3.4.4, which requests uses, and chardet 5.2.0, which it has replaced.
# Guess: whole Cyrillic words are easy, so both find cp1251, and with more text of the same kind they become surer.
# charset-normalizer finds cp1251 in 7 kB, and in 17 kB and more cp1250, in which no letter of the comments is right. chardet says
# windows-1251 each time. The German comments are cp1250 for one and ISO-8859-1 for the other: both give the same letters.
# dpstack import counts runs of three letters of the upper half instead, says what it took, and has --encoding.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install charset-normalizer==3.4.4 chardet==5.2.0 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import chardet
import charset_normalizer

BLOCK = """DPSUBSYSTEM 1, DPADDRESS {n}, SLOT 4, "6ES7 321-7BH00-0AB0", "A{n}"
BEGIN
  ASSET_ID "{n:032X}"
  POS_X "0"
LOCAL_IN_ADDRESSES
  ADDRESS  {n}, 0, 2, 5, 1, 0
{symbol}END
"""
TEXTS = {
    "cp1251": [f"Давление {n}" for n in range(31, 35)] + ["Температура 41"] + [f"Уровень {n}" for n in range(51, 55)],
    "cp1252": [f"Füllstand {n}" for n in range(31, 35)] + ["Kühlwasser 41"] + [f"Störung {n}" for n in range(51, 55)],
}
EXPECTED = {
    ("cp1251", 36): ("cp1251", "windows-1251", True),
    ("cp1251", 90): ("cp1250", "windows-1251", False),
    ("cp1251", 180): ("cp1250", "windows-1251", False),
    **{("cp1252", blocks): ("cp1250", "ISO-8859-1", True) for blocks in (36, 90, 180)},
}


def made(texts, blocks):
    every = blocks // len(texts)
    lines = [f'SYMBOL  I , 0, "S{n}", "{texts[n // every]}"\n' if n % every == 0 and n // every < 9 else "" for n in range(blocks)]
    return "".join(BLOCK.format(n=n + 3, symbol=line) for n, line in enumerate(lines))


changed = False
for encoding, texts in TEXTS.items():
    for blocks in (36, 90, 180):
        text = made(texts, blocks)
        octets = text.encode(encoding)
        newer, older = charset_normalizer.from_bytes(octets).best(), chardet.detect(octets)["encoding"]
        found = newer.encoding, older, str(newer) == text
        print(f"{encoding} {len(octets):6} octets: charset-normalizer {found[0]}, chardet {older}, same text: {found[2]}")
        changed = changed or found != EXPECTED[encoding, blocks]
assert not changed, "the behaviour has changed"
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py"
# output seen:
# cp1251   6851 octets: charset-normalizer cp1251, chardet windows-1251, same text: True
# cp1251  16681 octets: charset-normalizer cp1250, chardet windows-1251, same text: False
# cp1251  33314 octets: charset-normalizer cp1250, chardet windows-1251, same text: False
# cp1252   6854 octets: charset-normalizer cp1250, chardet ISO-8859-1, same text: True
# cp1252  16684 octets: charset-normalizer cp1250, chardet ISO-8859-1, same text: True
# cp1252  33317 octets: charset-normalizer cp1250, chardet ISO-8859-1, same text: True
