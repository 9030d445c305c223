"""Wrong integers: division, rounding, varints, texts and lists (SPEC clauses 2, 6.2 and 9.1)."""

from __future__ import annotations

from .mutant import Edit, mutant

LINES = "codecs.knots:interpolate"
LINE = "numerator // (2 * divisor)"
SHARE = "rise[row] * along[:, None] / divisor"
CALIBRATION = "recording:Calibration.physical"
TEXT_SIGN = "return (values >> 1) ^ -(values & 1)"

MUTANTS = (
    mutant(
        "lines-truncate",
        "The division that rounds a line between knots truncates, as in C.",
        "CNV-001",
        Edit(LINES, LINE, "np.trunc(numerator / (2 * divisor)).astype(np.int64)"),
    ),
    mutant(
        "lines-half-even",
        "Lines between knots round ties to even.",
        "CNV-001",
        Edit(LINES, LINE, f"np.rint({SHARE}).astype(np.int64)"),
    ),
    mutant(
        "lines-half-away",
        "Lines between knots round ties away from zero.",
        "CNV-001",
        Edit(LINES, LINE, f"np.trunc((x := {SHARE}) + np.copysign(0.5, x)).astype(np.int64)"),
    ),
    mutant(
        "lines-half-down",
        "Lines between knots round ties towards minus infinity.",
        "CNV-001",
        Edit(LINES, LINE, "-((2 * divisor - numerator) // (2 * divisor))"),
    ),
    mutant(
        "lines-float-slope",
        "Lines are worked out with a slope in binary64.",
        "CNV-001",
        Edit(
            LINES,
            LINE,
            "np.floor(rise[row] / divisor * along[:, None] + 0.5).astype(np.int64)",
        ),
    ),
    mutant(
        "lines-float32",
        "Lines are worked out in binary32.",
        "CNV-001",
        Edit(
            LINES,
            LINE,
            "np.floor(np.float32(rise[row]) * np.float32(along[:, None]) / np.float32(divisor)"
            " + np.float32(0.5)).astype(np.int64)",
        ),
    ),
    mutant(
        "overlong-varints",
        "Varints that are longer than needed are taken.",
        "CNV-002",
        Edit("numbers:parse_varint", "if byte == 0 and index:", "if False:"),
        Edit("codecs.knots:parse_varints", "(sizes > 1) & (raw[stops - 1] == 0)", "sizes < 1"),
    ),
    mutant(
        "large-varints",
        "Varints of 2^53 and more are taken.",
        "CNV-002",
        Edit("numbers:parse_varint", "if value >= 1 << 53:", "if value >= 1 << 56:"),
        Edit("codecs.knots:parse_varints", "values >= 1 << 53", "values >= 1 << 56"),
    ),
    mutant(
        "svarint-sign-magnitude",
        "An odd svarint is minus its half: -1 is read as 0.",
        "CNV-001",
        Edit("numbers:to_signed", "(u >> 1) ^ -(u & 1)", "-(u >> 1) if u & 1 else u >> 1"),
        Edit(
            "codecs.knots:to_signed",
            TEXT_SIGN,
            "return np.where(values & 1, -(values >> 1), values >> 1)",
        ),
        Edit("codecs.knots:parse_start", "-(number >> 1) - 1", "-(number >> 1)"),
    ),
    mutant(
        "same-text-ignored",
        "The byte 255 of a string list is an empty text.",
        "TLV-004",
        Edit("format.wire:parse_strings", "items.append(items[-1])", 'items.append("")'),
    ),
    mutant(
        "one-entry-for-one",
        "A string list of one entry speaks for the first component alone.",
        "TLV-004",
        Edit(
            "format.wire:parse_strings",
            "return spread(items, count, offset)",
            'return tuple((items + [""] * count)[:count])',
        ),
    ),
    mutant(
        "text-unchecked",
        "Bytes that are no UTF-8 are replaced, not refused.",
        "CNV-004",
        Edit("format.wire:parse_text", 'raw.decode("utf-8")', 'raw.decode("utf-8", "replace")'),
    ),
    mutant(
        "no-unit-is-empty",
        "A channel without a unit has the unit '' instead of '1'.",
        "TLV-004",
        Edit(
            "format.track:parse_components",
            "named = {name",
            'named = {"unit": ""} | {name',
        ),
    ),
    mutant(
        "signed-d",
        "D of a calibration is read as an svarint.",
        "VAL-001 VAL-003",
        Edit(
            "format.track:parse_calibrations",
            "d, position = parse_varint(value, position, offset)",
            "d, position = parse_svarint(value, position, offset); d = abs(d)",
        ),
    ),
    mutant(
        "physical-two-roundings",
        "A physical value is count * (A / D) + B / D, rounded three times.",
        "VAL-003",
        Edit(
            CALIBRATION,
            "x *= self.a\n        x += self.b  # and -0.0 becomes 0.0\n"
            "    if self.d != 1:\n        x /= self.d",
            "x = x * (self.a / self.d) + self.b / self.d\n    elif self.d != 1:\n        x /= self.d",
        ),
    ),
    mutant(
        "physical-reciprocal",
        "A physical value is the numerator times 1 / D.",
        "VAL-003",
        Edit(
            CALIBRATION,
            "x /= self.d",
            "x *= 1 / self.d",
        ),
    ),
)
