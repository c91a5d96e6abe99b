"""Damage: bits, blocks, lines, numbers and words of a valid file."""

import random
import re
from collections.abc import Callable

_NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")
_WORD = re.compile(rb"[A-Za-z_][\w.]*")
_NUMBERS = [
    *(b"", b"0", b"-0", b"-1", b"1e400", b"-1e400", b"1e266", b"1e-320", b"nan", b"inf", b"-inf"),
    *(b"9" * 20, b"9" * 4301, b"4294967295", b"2147483648", b"18446744073709551615", b"0x10"),
    *(b"1,5", b"1.5.5", b"1_000", b"1e", b"0.1", b"101", b"-9999", b"1e9", b"1e-9", b"3.4e38"),
]
_WORDS = [
    *(b"", b" ", b"\0", b"\r", b"\n", b"\r\n", b'"', b"'", b",", b";", b"\t", b"#", b"=", b"{"),
    *(b"}", b"[", b"]", b"<", b"&", b"\xff", b"\xe9", "µé漢".encode(), b"\xef\xbb\xbf", b"\x1b[2J"),
    *(b"..", b"../../../etc/hostname", b"/dev/zero", b".", b"nan", b"none", b"true", b"a" * 300),
    *(b"a" * 140_000, b"[" * 100_000, b"(" * 3000, b"EPSG:4326", b"%s%n", b"a.b.c.d"),
]
RUNS = [
    *(b" ", b"\t", b"a", b"0", b"-", b".", b",", b";", b'"', b"'", b"#", b"[", b"(", b"{", b"="),
    *(b"\\", b"\n", b"\r", b"a.", b"a ", b"0 ", b"1,", b'" ', b"<a>", b"[a]\n", b">>>", b"/", b"_"),
    *(b"e", b"%"),
]
"""What a text may be made long with, in which a search can take the square of its length."""
_SMALL = [
    bytes([value]) * width for value in (0x00, 0xFF, 0x7F, 0x80, 0x01) for width in (1, 2, 4, 8)
]


def _bits(data: bytearray, chance: random.Random) -> bytearray:
    for _ in range(chance.choice((1, 1, 2, 8, 64))):
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return data


def _values(data: bytearray, chance: random.Random) -> bytearray:
    """Extreme numbers of one to eight bytes, early in the file, where headers are, or anywhere."""
    end = len(data) if chance.random() < 0.3 else min(len(data), 512)
    at, value = chance.randrange(end), chance.choice(_SMALL)
    data[at : at + len(value)] = value
    return data


def _cut(data: bytearray, chance: random.Random) -> bytearray:
    return data[: chance.randrange(len(data))]


def _block(data: bytearray, chance: random.Random) -> bytearray:
    """A block is removed, written twice, or moved."""
    first = chance.randrange(len(data))
    block = data[first : first + chance.choice((1, 7, 64, 1000))]
    if chance.random() < 0.6:
        del data[first : first + len(block)]
    if chance.random() < 0.6:
        at = chance.randrange(len(data) + 1)
        data[at:at] = block * chance.choice((1, 1, 2, 100))
    return data


def _lines(data: bytearray, chance: random.Random) -> bytearray:
    lines = data.split(b"\n")
    if chance.random() < 0.1:
        return bytearray(chance.choice((b"\r", b"\r\n", b"\n\n", b" ")).join(lines))
    first, second = chance.randrange(len(lines)), chance.randrange(len(lines))
    how = chance.randrange(3)
    if how == 0:
        del lines[first]
    elif how == 1:
        lines[first], lines[second] = lines[second], lines[first]
    else:
        lines[first:first] = [lines[second]] * chance.choice((1, 1, 2, 1000))
    return bytearray(b"\n".join(lines))


def _run(data: bytearray, chance: random.Random) -> bytearray:
    """Some letters a hundred thousand times, in a line or behind one."""
    ends = [end.start() for end in re.finditer(rb"\n|\Z", bytes(data[:20_000]))]
    at = chance.choice((0, len(data), chance.randrange(len(data)), chance.choice(ends)))
    data[at:at] = chance.choice(RUNS) * chance.choice((1000, 100_000)) + chance.choice(
        (b"", b"!x\n")
    )
    return data


def _token(
    pattern: re.Pattern[bytes], instead: list[bytes]
) -> Callable[[bytearray, random.Random], bytearray]:
    def change(data: bytearray, chance: random.Random) -> bytearray:
        # Of a large file one part is searched, its beginning most often.
        start = 0 if chance.random() < 0.7 else chance.randrange(len(data))
        found = list(pattern.finditer(data, start, start + 20_000))
        if not found:
            return _bits(data, chance)
        at = chance.choice(found)
        other = bytes(chance.choice(found)[0])
        new = other if chance.random() < 0.3 else chance.choice(instead)
        if chance.random() < 0.2:  # beside the token, not in its place
            new = bytes(at[0]) + new
        data[at.start() : at.end()] = new
        return data

    return change


def _encoding(data: bytearray, chance: random.Random) -> bytearray:
    text = bytes(data).decode("latin-1")
    return bytearray(text.encode(chance.choice(("utf-16", "utf-16-le", "utf-8", "utf-8-sig"))))


_KINDS = {
    _bits: 4, _values: 4, _cut: 2, _block: 3, _lines: 3, _run: 1, _encoding: 0.3,
    _token(_NUMBER, _NUMBERS): 6, _token(_WORD, _WORDS): 5,
}  # fmt: skip


def damaged(data: bytes, chance: random.Random) -> bytes:
    """The content of a file with one to three kinds of damage."""
    changed = bytearray(data)
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        if changed:
            (kind,) = chance.choices(list(_KINDS), list(_KINDS.values()))
            changed = kind(changed, chance)
    return bytes(changed)
