"""A stream of lines -> rows and objects (docs/streams.md)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import isinf

import numpy as np
from numpy.typing import NDArray

from ..times import may_be_times
from ..descriptions import parse_json
from ..errors import ParameterError
from ..units import split_name, to_ucum, units_for
from ..encoder.inputs import Input
from .session import Header, Session

LINE_SIZE = 1 << 24
"""A longer line is refused, not collected."""

TICK_DIGITS = 19
"""More than any tick has; Python refuses to read thousands of them."""

DECIMAL = re.compile(rb"[+-]?\d*[.,]?\d+(e[+-]?\d+)?", re.I)
"""A number with a decimal point or comma."""


class RangeError(ValueError):
    """A number, and no name, but too large for a double."""


@dataclass(frozen=True)
class Table:
    """What is known of a bare table of numbers, which has no header."""

    rate: Fraction | None = None
    labels: Sequence[str] = ()
    unit: str | None = None
    lsb: float | None = None

    def header(self, names: Sequence[str] = (), columns: int = 0) -> Header:
        """For columns of these names, or of so many without any."""
        if self.rate is None:
            raise ParameterError("a table needs its rate: --rate 1000, or a header of JSON")
        given = [split_name(name) for name in names]
        labels = list(self.labels) or [label for label, _ in given]
        labels = labels or [str(number + 1) for number in range(columns)]
        if len(labels) != (columns or len(names)):
            raise ParameterError(
                f"{len(labels)} labels for {columns or len(names)} columns: --labels a,b,c"
            )
        if self.unit is not None:
            units = units_for(self.unit, len(labels))
        else:
            units = [to_ucum(unit) for _, unit in given] or ["1"] * len(labels)
        notes = []
        if len(names) > 1 and may_be_times(names[0]):
            notes.append(
                f"column {names[0]!r} is recorded as a channel; hapfmt encode places rows by their "
                "times"
            )
        return Header(
            [
                Input(label, self.rate, unit, lsb=self.lsb)
                for label, unit in zip(labels, units, strict=True)
            ],
            notes=notes,
        )


@dataclass
class Rows:
    """Lines of numbers that follow on, not parsed yet."""

    lines: list[bytes] = field(default_factory=list)
    number: int = 0
    tick: int | None = None


class Lines:
    """Takes bytes in pieces of any size; whole lines are worked off at the end of each piece."""

    def __init__(self, session: Session, table: Table) -> None:
        self.session, self.table = session, table
        self.rest = b""
        self.number = 0
        self.rows = Rows()

    @property
    def place(self) -> str:
        return f"line {self.number}"

    def feed(self, data: bytes) -> None:
        *lines, self.rest = (self.rest + data).split(b"\n")
        for line in lines:
            self.line(line)
        self.settle()
        if len(self.rest) > LINE_SIZE:
            self.number += 1
            raise ParameterError(f"a line of more than {LINE_SIZE} bytes")

    def finish(self) -> None:
        """The last line may have no end."""
        if self.rest:
            self.line(self.rest)
        self.rest = b""
        self.settle()

    def line(self, line: bytes) -> None:
        line = line.strip(b" \r")
        self.number += 1
        if not line or line.startswith(b"#"):
            return
        if line.startswith(b"{"):
            self.settle()
            self.session.object(parse_json(line))
            return
        if self.session.recorder is None and self.begin(line):
            return
        tick = None
        if line.startswith(b"@"):
            self.settle()
            head, _, line = line[1:].partition(b" ")
            if not head.isdigit() or len(head) > TICK_DIGITS or not line.strip():
                raise ParameterError("@ is followed by a tick, a space, and a row")
            tick = int(head)
        if not self.rows.lines:
            self.rows.number, self.rows.tick = self.number, tick
        elif self.number != self.rows.number + len(self.rows.lines):
            # A comment stood between them, and errors count lines.
            self.settle()
            self.rows.number = self.number
        self.rows.lines.append(line)

    def begin(self, line: bytes) -> bool:
        """The recorder of a bare table; whether its first line holds names."""
        names = [name.decode("utf-8", "replace").strip() for name in fields_of(line)]
        refuse_commas(line)
        try:
            parse_rows([line.partition(b" ")[2] if line.startswith(b"@") else line], len(names))
        except RangeError as error:
            raise ParameterError(str(error)) from None
        except ValueError:
            self.session.start(self.table.header(names))
            return True
        self.session.start(self.table.header(columns=len(names)))
        return False

    def settle(self) -> None:
        """Hand over the rows that were collected."""
        rows, self.rows = self.rows, Rows()
        if not rows.lines:
            return
        columns = len(self.session.running.inputs)
        try:
            values = parse_rows(rows.lines, columns)
        except ValueError:
            good = []
            for place, line in enumerate(rows.lines):
                try:
                    good.append(parse_rows([line], columns))
                except ValueError as error:
                    self.hand_over(good, rows.tick)
                    self.number = rows.number + place
                    refuse_commas(line)
                    raise ParameterError(str(error)) from None
            raise AssertionError("rows that parse alone parse together") from None
        self.hand_over([values], rows.tick, rows.number)

    def hand_over(
        self, parts: Sequence[NDArray[np.float64]], tick: int | None, number: int | None = None
    ) -> None:
        if not parts:
            return
        last, self.number = self.number, self.number if number is None else number
        values, recorder = np.concatenate(parts), self.session.running
        taken = recorder.taken
        try:
            self.session.rows(values, tick)
        except ParameterError:
            if number is None or len(values) == 1 or recorder.taken > taken:
                raise
            # One of them is at fault: the others are kept.
            for place, row in enumerate(values):
                self.number = number + place
                self.session.rows(row[None], tick if place == 0 else None)
        self.number = last


def refuse_commas(line: bytes) -> None:
    """Decimal commas, which would be taken for commas between numbers, and the rest for names.

    "0,25" alone is two numbers; next to a semicolon, a tab or a space it is one.
    """
    for separator in (b";", b"\t", None):
        cells = [cell.strip() for cell in line.split(separator)]
        cells = [cell for cell in cells if cell]
        odd = [cell for cell in cells if b"," in cell]
        if len(cells) > 1 and odd and all(DECIMAL.fullmatch(cell) for cell in cells):
            raise ParameterError(
                f"{odd[0].decode()!r} has a decimal comma; write decimal points, as in 1.5"
            )


def fields_of(line: bytes) -> list[bytes]:
    for separator in (b",", b";", b"\t"):
        if separator in line:
            return line.split(separator)
    return line.split()


def parse_rows(lines: Sequence[bytes], columns: int) -> NDArray[np.float64]:
    """[lines, columns], NaN where a field is empty; ValueError says what is wrong."""
    out = np.empty((len(lines), columns))
    for place, line in enumerate(lines):
        found = fields_of(line)
        if len(found) != columns:
            raise ValueError(f"{len(found)} values for {columns} channels")
        try:
            out[place] = [float(text) if text and not text.isspace() else np.nan for text in found]
        except ValueError:
            odd = next(text for text in found if not is_number(text))
            raise ValueError(f"{odd.decode('utf-8', 'replace')!r} is not a number") from None
    if np.isinf(out).any():
        # "inf" is a value; a number too large would become one without a word.
        for line in lines:
            for text in fields_of(line):
                if overflows(text):
                    shown = text.decode("utf-8", "replace").strip()
                    raise RangeError(f"{shown[:40]!r} is beyond the range of a double")
    return out


def overflows(text: bytes) -> bool:
    return b"inf" not in text.lower() and bool(text.strip()) and isinf(float(text))


def is_number(text: bytes) -> bool:
    try:
        return float(text.strip() or b"nan") is not None
    except ValueError:
        return False
