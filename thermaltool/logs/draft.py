"""A column map drafted from what a log looks like, with a comment on each guess."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from thermaltool.logs.columns import Clock, ColumnMap, Dialect, SensorMessages
from thermaltool.logs.draft_clock import guess_clock
from thermaltool.logs.draft_names import distinct, guess_channel
from thermaltool.logs.foreign_units import known_unit
from thermaltool.logs.formats import load_reader, read_format_of
from thermaltool.logs.ndjson_table import message_keys
from thermaltool.logs.table import InputBytes, Table, read_source
from thermaltool.logs.text import decoded
from thermaltool.logs.time_stamps import iso_clock, joined_stamps
from thermaltool.record import Array
from thermaltool.units import UNITS

# Lines that are looked at.
MAX_LINES = 5000
SEPARATORS = ("\t", ";", "|", ",")
# Share of the cells of a column that are numbers, where the others are words for missing values.
MIN_NUMBERS = 0.6
# Messages of one sensor each have a few keys, such as those that brokers add.
MAX_MESSAGE_KEYS = 8
MAX_WORDS = 6
_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?")
# Groups of thousands, which no command reads: for check to find.
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(?:[.,' ]\d{3})+(?:[.,]\d+)?")
# Letters that are typed in place of digits.
_LOOK_ALIKE = str.maketrans("OoIlSB", "001158")


@dataclass
class _Draft:
    """What has been found so far."""

    mapping: ColumnMap
    units: dict[str, str] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class DraftedMap:
    """A column map for a log.

    Attributes
    ----------
    text : str
        The TOML file.
    left_out : tuple of str
        Columns that it leaves out, each with its reason.
    typos : tuple of str
        Cells that are no words for a missing value, each with its column: a check finds them.
    """

    text: str
    left_out: tuple[str, ...]
    typos: tuple[str, ...]


def draft_map(source: str, from_format: str | None = None) -> DraftedMap:
    """A column map for a log.

    Parameters
    ----------
    source : str
        A file; ``-`` is stdin.
    from_format : str, optional
        As for `read_log`.

    Raises
    ------
    LogError
        The log cannot be read, or holds no table.
    """
    raw = read_source(source)
    form = read_format_of(raw, from_format)
    draft = _Draft(ColumnMap())
    sample = raw
    if form == "csv":
        sample = _text_layout(raw, draft)
    elif form == "xlsx":
        from thermaltool.logs.workbook_table import sheet_rows

        rows = [[_shown(cell) for cell in row] for row in sheet_rows(raw, None, MAX_LINES)]
        _head(rows, draft)
    # What was decoded for the sample is UTF-8 there.
    mapping = draft.mapping
    here = replace(mapping, dialect=replace(mapping.dialect, encoding="utf-8"))
    reader = load_reader(sample, form)
    table = reader.open_table(sample, here)
    if form in ("ndjson", "json") and (messages := _messages(table)) is not None:
        draft.mapping = replace(mapping, messages=messages)
        table = reader.open_table(sample, draft.mapping)
    draft.units = {**getattr(table, "units", {}), **draft.units}
    return _written(raw.name, draft, table)


def _shown(cell: Any) -> str:
    return "" if cell is None else str(cell)


def _text_layout(raw: InputBytes, draft: _Draft) -> InputBytes:
    """Encoding, separator, decimal sign and head of a text; its first lines as a sample."""
    text, encoding = decoded(raw.data, "utf-8")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")[:MAX_LINES]
    filled = [line for line in lines if line.strip() and not line.startswith("#")]
    body = filled[len(filled) // 2 :]
    separator = ","
    for each in SEPARATORS:
        counts = Counter(line.count(each) for line in body)
        common, times = counts.most_common(1)[0] if counts else (0, 0)
        if common and times >= 0.8 * len(body):
            separator = each
            break
    rows = [
        [cell.strip().strip('"') for cell in line.split(separator)]
        if line.strip() and not line.startswith("#")
        else []
        for line in lines
    ]
    cells = [cell for row in rows[len(rows) // 2 :] for cell in row]
    comma = separator != "," and any(re.fullmatch(r"[-+]?\d*,\d+", cell) for cell in cells)
    marked = encoding in ("utf-8", "utf-8-sig", "utf-16")
    draft.mapping = replace(
        draft.mapping,
        dialect=Dialect(
            separator=separator,
            decimal="," if comma else ".",
            encoding="utf-8" if marked else encoding,
        ),
    )
    _head(rows, draft)
    return InputBytes(raw.name, "\n".join([*lines, ""]).encode())


def _head(rows: Sequence[Sequence[str]], draft: _Draft) -> None:
    """How many lines stand before the names, and behind them before the values."""
    begin = next((k for k in range(len(rows)) if all(map(_is_values, rows[k : k + 3]))), None)
    before = [k for k in range(begin or 0) if any(rows[k])]
    if not before or begin is None:
        return
    head, after = before[-1], 0
    units = [re.sub(r"^[\[(](.*)[\])]$", r"\1", cell) for cell in rows[head]]
    said = [cell for cell in units if cell]
    names = rows[before[-2]] if len(before) > 1 else []
    if len(before) > 1 and said and len([c for c in names if c]) >= len(said):
        known = [cell for cell in said if known_unit(cell) or cell in ("-", "hh:mm:ss")]
        if 2 * len(known) > len(said):
            after, head = begin - before[-2] - 1, before[-2]
            draft.units = dict(zip(names, units, strict=False))
    skip = head if any(any(rows[k]) for k in range(head)) else 0
    dialect = replace(draft.mapping.dialect, skip=skip, skip_after_names=after)
    draft.mapping = replace(draft.mapping, dialect=dialect)


def _is_values(row: Sequence[str]) -> bool:
    """Whether a row holds values: more than a third of its cells begin as numbers."""
    filled = [cell for cell in row if cell]
    numbers = [c for c in filled if _NUMBER.fullmatch(c) or re.match(r"\d+[-:./]\d+", c)]
    return len(filled) > 1 and 3 * len(numbers) > len(filled)


def _messages(table: Table) -> SensorMessages | None:
    """The keys of messages of one sensor each; None where lines hold more."""
    found = message_keys(table.names)
    if len(table.names) > MAX_MESSAGE_KEYS or found is None:
        return None
    cells = table.cells(["text" if name == found.name else None for name in table.names])
    sensors = cells.values[table.names.index(found.name)]
    repeats = sensors is not None and len(set(sensors)) < len(sensors) / 2
    return found if repeats else None


def _written(file: str, draft: _Draft, table: Table) -> DraftedMap:
    """The map as text, and what it leaves out."""
    mapping = draft.mapping
    cells = table.cells(["text"] * len(table.names))
    texts: dict[str, list[str | None]] = {}
    numbers: dict[str, Array] = {}
    words: list[str] = list(mapping.dialect.missing)
    typos: list[str] = []
    for name, column in zip(table.names, cells.values, strict=True):
        values, odd = _as_numbers(column, mapping.dialect.decimal)  # type: ignore[arg-type]
        if np.isfinite(values).mean() >= MIN_NUMBERS or (not odd and not texts.get(name)):
            numbers[name] = values
            mistyped = [
                word
                for word, times in odd.items()
                if (times == 1 and _is_typo(word)) or _THOUSANDS.fullmatch(word)
            ]
            typos += [f"{word!r} in {name}" for word in mistyped]
            words += [word for word in odd if word not in words and word not in mistyped]
        elif odd and len(odd) <= MAX_WORDS and mapping.messages and np.isfinite(values).any():
            numbers[name] = values
        else:
            texts[name] = column  # type: ignore[assignment]
    words = words[:MAX_WORDS]
    found = guess_clock(texts, numbers)
    clock, reason = found or (Clock(period=1.0), "guessed: no clock in the log, a row each second")
    time = _seconds(file, clock, texts, numbers)
    if mapping.messages is not None and time is not None:
        clock = replace(clock, within=_half_a_period(time, numbers, clock))
        mapping = replace(mapping, duplicates="first")
    elif time is not None and np.any(np.diff(time) == 0):
        groups = len(time) / max(1, len(np.unique(time)))
        mapping = replace(mapping, duplicates="spread" if groups > 1.5 else "first")
    lines = [f"# Drafted from {_quoted(file)[1:-1]}: look at each guess.", *_head_lines(mapping)]
    if words:
        lines.append(f"missing = {json.dumps(words, ensure_ascii=False)}  # words amid numbers")
    if typos:
        lines.append(f"# typos, for check to find: {_in_a_comment(', '.join(typos))}")
    if mapping.messages is not None:
        lines += ["", "[messages]  # one sensor each", f"name = {_quoted(mapping.messages.name)}"]
        lines.append(f"value = {_quoted(mapping.messages.value)}")
    lines += ["", "[time]", *_clock_lines(clock, reason), "", "[columns]"]
    taken: set[str] = set()
    left_out: list[str] = []
    # A name that is there twice can be mapped once.
    for name in dict.fromkeys(table.names):
        if name not in clock.columns:
            line, reason = _column_line(name, draft.units.get(name, ""), texts, numbers, taken)
            lines.append(line)
            left_out += [f"{name} ({reason})"] if reason else []
    return DraftedMap("\n".join(lines) + "\n", tuple(left_out), tuple(typos))


def _in_a_comment(text: str) -> str:
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _is_typo(word: str) -> bool:
    """Whether a cell would be a number with look-alikes put right or one character less."""
    digits = [word, word.translate(_LOOK_ALIKE)]
    tries = [*digits, *(each[:k] + each[k + 1 :] for each in digits for k in range(len(each)))]
    return any(c.isdigit() for c in word) and any(_NUMBER.fullmatch(each) for each in tries)


def _as_numbers(column: Sequence[str | None], decimal: str) -> tuple[Array, Counter[str]]:
    """The numbers of a column, NaN where there is none, and the words between them, counted."""
    values, odd = np.full(len(column), np.nan), Counter[str]()
    for k, cell in enumerate(column):
        word = (cell or "").strip()
        if not word:
            continue
        try:
            if decimal != "." and "." in word:  # of thousands
                raise ValueError
            number = float(word.replace(decimal, "."))
        except ValueError:
            odd[word] += 1
            continue
        if np.isfinite(number):
            values[k] = number
    return values, odd


def _seconds(
    file: str, clock: Clock, texts: Mapping[str, list[str | None]], numbers: Mapping[str, Array]
) -> Array | None:
    if clock.column is None:
        return None
    if clock.unit != "iso":
        return numbers[clock.column] * UNITS[clock.unit][1]
    stamps = texts[clock.column]
    if clock.joined is not None:
        stamps = joined_stamps(stamps, texts[clock.joined])
    return iso_clock(file, clock, stamps, list(range(len(stamps))))[0]


def _half_a_period(time: Array, numbers: Mapping[str, Array], clock: Clock) -> float:
    """Half the time between two messages of one sensor [s]: what lies closer is one row."""
    read = [np.isfinite(values) for name, values in numbers.items() if name not in clock.columns]
    # What each message carries is of the broker, and no sensor.
    steps = [np.median(np.diff(time[has])) for has in read if has.sum() > 1 and not has.all()]
    return float(f"{0.5 * min(steps):.3g}") if steps else 0.0


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _head_lines(mapping: ColumnMap) -> list[str]:
    dialect, plain = mapping.dialect, Dialect()
    keys = ("encoding", "separator", "decimal", "skip", "skip_after_names")
    said = {"skip": "lines before the names", "skip_after_names": "lines of units behind them"}
    lines = []
    for key in keys:
        if (value := getattr(dialect, key)) != getattr(plain, key):
            comment = f"  # {said[key]}" if key in said else ""
            lines.append(f"{key} = {_quoted(value) if isinstance(value, str) else value}{comment}")
    if mapping.duplicates is not None:
        lines.append(f"duplicates = {_quoted(mapping.duplicates)}  # time stamps repeat")
    return lines


def _clock_lines(clock: Clock, reason: str) -> list[str]:
    reason = _in_a_comment(reason)
    if clock.column is None:
        return [f"period = {clock.period}  # {reason}"]
    names = clock.columns
    column = _quoted(names[0]) if len(names) == 1 else f"[{', '.join(map(_quoted, names))}]"
    lines = [f"column = {column}"]
    if clock.format is not None:
        lines.append(f"format = {_quoted(clock.format)}  # {reason}")
    else:
        lines.append(f"unit = {_quoted(clock.unit)}  # {reason}")
    if clock.within:
        lines.append(f"within = {clock.within}  # s: messages that lie closer make one row")
    return lines


def _column_line(
    name: str,
    unit: str,
    texts: Mapping[str, Sequence[str | None]],
    numbers: Mapping[str, Array],
    taken: set[str],
) -> tuple[str, str]:
    """The line of a column, and why it leaves the column out; empty where it does not."""
    if name in texts:
        return f"{_quoted(name)} = false  # text", "text"
    guess = guess_channel(name, unit, numbers[name])
    if guess.name is None:
        why = "no unit known" if np.isfinite(numbers[name]).any() else "no numbers"
        return f"{_quoted(name)} = false  # {_in_a_comment(guess.reason)}", why
    reason = _in_a_comment(guess.reason)
    own = distinct(guess.name, taken)
    if guess.unit is None:
        return f"{_quoted(name)} = {_quoted(own)}  # {reason}", ""
    entry = f"{{ name = {_quoted(own)}, unit = {_quoted(guess.unit)} }}"
    return f"{_quoted(name)} = {entry}  # {reason}", ""
