"""Lines of the screen: pieces of text, each with the name of a style; cut, padded and wrapped by terminal cells."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from rich.cells import cell_len

from dpstack.text import printable

#: text and the name of its style: a key of :data:`STYLES`
Piece = tuple[str, str]
Line = list[Piece]

#: by name: the style with colours of the terminal, and without colours. Every mark is a word or sign too.
STYLES: Final[dict[str, tuple[str, str]]] = {
    "": ("", ""),
    "bold": ("bold", "bold"),
    "title": ("bold reverse", "bold reverse"),
    "label": ("cyan", ""),
    "good": ("green", ""),
    "warn": ("yellow", "bold"),
    "bad": ("bold red", "bold"),
    "stale": ("dim", "dim"),
    "changed": ("bold cyan", "underline"),
}
_MORE: Final = "…"
#: blanks between groups of a line
_BETWEEN: Final = 2


def piece(text: object, style: str = "") -> Piece:
    """A piece of foreign text: escape sequences and characters of direction stand as escapes."""
    return printable(str(text)), style


def octets(digits: str) -> str:
    """Hex digits, a blank after every two octets."""
    return " ".join(digits[at : at + 4] for at in range(0, len(digits), 4))


def width_of(line: Iterable[Piece]) -> int:
    """Cells of the terminal."""
    return sum(cell_len(text) for text, _ in line)


def cut(text: str, width: int) -> str:
    """``text`` in at most ``width`` cells; an ellipsis shows that something is missing."""
    if cell_len(text) <= width:
        return text
    if width <= 0:
        return ""
    taken, used = [], 0
    for letter in text:
        size = cell_len(letter)
        if used + size > width - 1:
            break
        taken.append(letter)
        used += size
    return "".join(taken) + _MORE


def padded(text: object, width: int, *, right: bool = False) -> str:
    """``text`` in exactly ``width`` cells."""
    found = cut(printable(str(text)), width)
    space = " " * (width - cell_len(found))
    return space + found if right else found + space


def with_more(line: Line, width: int) -> Line:
    """``line`` in at most ``width`` cells with an ellipsis at its end: further lines are left out."""
    text, style = line[-1]
    return cut_line([*line[:-1], (text + _MORE, style)], width)


def cut_line(line: Line, width: int) -> Line:
    """``line`` in at most ``width`` cells."""
    found: Line = []
    left = width
    for text, style in line:
        if left <= 0:
            break
        size = cell_len(text)
        found.append((text if size <= left else cut(text, left), style))
        left -= size
    return found


def wrapped(line: Line, width: int, indent: int = 2) -> list[Line]:
    """``line`` broken between words, or within a word that is too long; later lines begin with ``indent`` blanks."""
    indent = min(indent, max(0, width - 8))
    found: list[Line] = [[]]
    used = 0
    for text, style in line:
        for word in _words(text):
            rest = word
            while True:
                size = cell_len(rest)
                if used + size <= width:
                    break
                if used > indent and (size <= width - indent or rest.isspace()):
                    head = ""
                else:
                    head = _fitting(rest, max(1, width - used))
                    if used > indent and cell_len(head) > width - used:  # no room for its first letter
                        head = ""
                if head:
                    found[-1].append((head, style))
                    rest = rest[len(head) :]
                found.append([(" " * indent, "")])
                used = indent
                if rest.isspace():
                    rest = ""
            if rest:
                found[-1].append((rest, style))
                used += cell_len(rest)
    return found


def flowed(head: Line, groups: Iterable[Line], width: int, indent: int) -> list[Line]:
    """``head``, and ``groups`` behind it side by side; a group that does not fit into a line begins the next one, which
    begins with ``indent`` blanks."""
    found = [head]
    used, is_empty = width_of(head), True
    for group in groups:
        size, gap = width_of(group), 0 if is_empty else _BETWEEN
        if not is_empty and used + gap + size > width:
            found.append([(" " * indent, "")])
            used, gap = indent, 0
        line = [*found.pop(), *([(" " * gap, "")] if gap else []), *group]
        found += wrapped(line, width, indent) if used + gap + size > width else [line]
        used, is_empty = width_of(found[-1]), False
    return found


def _words(text: str) -> list[str]:
    """Words and the blanks between them."""
    words: list[str] = []
    for letter in text:
        if words and (letter == " ") == words[-1].isspace():
            words[-1] += letter
        else:
            words.append(letter)
    return words


def _fitting(text: str, width: int) -> str:
    """The first letters of ``text`` that fit into ``width``; at least one."""
    used = 0
    for number, letter in enumerate(text):
        used += cell_len(letter)
        if used > width:
            return text[: max(1, number)]
    return text
