"""Unit texts as people write them -> UCUM codes (https://ucum.org/ucum).

A text that is a UCUM code already stays as it is; a known spelling is respelled; anything else is
kept as a UCUM annotation, ``{raw(0-255)}``: dimension 1, but readable. So 'g' stays the gram, and
the acceleration is asked for as ``[g]`` (spelled gn, g0, g-force or [g]).
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable
from fractions import Fraction

from .errors import DataWarning, ParameterError, similar

MAX_SIZE = 255
"""Bytes of the longest code: a unit is stored behind one length byte."""

_PREFIXES = "Y Z E P T G M k h da d c m u n p f a z y"
_METRIC = (
    "m s g rad K C cd mol sr N Pa J W A V F Ohm S Wb Cel T H Hz lm lx L l bar eV gf B bit By t "
    "[g] [ppm] m[Hg] m[H2O]"
)
"""Atoms that take a prefix. Left out, since people mean something else by them: G (gauss), a
(year), b (barn), u, P, R."""
_SCALES = dict(
    zip(
        _PREFIXES.split(),
        (24, 21, 18, 15, 12, 9, 6, 3, 2, 1, -1, -2, -3, -6, -9, -12, -15, -18, -21, -24),
        strict=True,
    )
)
"""Powers of ten."""
_FIXED = (
    "% deg ' '' min h d [degF] [psi] [lbf_av] [lb_av] [in_i] [ft_i] [mi_i] "
    "[ppth] [ppb] [arb'U] [pi]"
)


def _any_of(codes: str) -> str:
    return "|".join(map(re.escape, sorted(codes.split(), key=len, reverse=True)))


_GROUP, _NOTE = "\0", "\1"
"""Stand for a pair of parentheses whose content was found to be a term, and for an annotation."""
_ANNOTATION = r"\{[!-z|~]+\}"
_ATOM = rf"(?:(?:{_any_of(_PREFIXES)})?(?:{_any_of(_METRIC)})|{_any_of(_FIXED)})"
_COMPONENT = rf"(?:{_ATOM}(?:[+-]?[1-9][0-9]?)?{_NOTE}?|1|{_NOTE}|{_GROUP})"
_TERM = re.compile(rf"/?{_COMPONENT}(?:[./]{_COMPONENT})*")
_FACTOR = re.compile(r"([./]?)([^./0-9+-]+|1)([+-]?[0-9]*)")
_PREFIXED = re.compile(rf"({_any_of(_PREFIXES)})({_any_of(_METRIC)})")
_TORQUE = re.compile(rf"((?:{_any_of(_PREFIXES)})?N)((?:{_any_of(_PREFIXES)})?m|s)")

_SPELLINGS = {
    "1": "none unitless dimensionless - ratio",
    "%": "percent pct",
    "{count}": "count counts cts",
    "{lsb}": "lsb lsbs",
    "{digit}": "digit digits",
    "{pulse}": "pulse pulses",
    "{rev}": "rev revs revolution revolutions turn turns",
    "{sample}": "sample samples",
    "{step}": "step steps",
    "deg": "deg degs degree degrees",
    "rad": "rad rads radian radians",
    "s": "sec secs second seconds",
    "ms": "msec msecs millisecond milliseconds",
    "us": "usec usecs microsecond microseconds",
    "min": "mins minute minutes",
    "h": "hr hrs hour hours",
    "m": "meter meters metre metres",
    "mm": "millimeter millimeters millimetre millimetres",
    "um": "micron microns micrometer micrometers micrometre micrometres",
    "g": "gram grams",
    "kg": "kgs kilogram kilograms",
    "N": "newton newtons",
    "mN": "millinewton millinewtons",
    "Pa": "pascal pascals",
    "kPa": "kpa",
    "V": "volt volts",
    "mV": "millivolt millivolts",
    "uV": "microvolt microvolts",
    "A": "amp amps ampere amperes",
    "W": "watt watts",
    "J": "joule joules",
    "Ohm": "ohm ohms",
    "Hz": "hz hertz",
    "kHz": "khz",
    "K": "kelvin kelvins",
    "Cel": "degc celsius",
    "[degF]": "degf fahrenheit",
    "dB": "db decibel decibels",
    "[g]": "gn g0 g_n g-force gforce",
    "[in_i]": "in inch inches",
    "[ft_i]": "ft foot feet",
    "[lb_av]": "lb lbs",
    "[lbf_av]": "lbf",
    "[psi]": "psi",
    "[ppm]": "ppm",
    "mm[Hg]": "mmhg",
}
_WORDS = {word: code for code, words in _SPELLINGS.items() for word in words.split()}
_WHOLE = {**_WORDS, "": "1", "n/a": "1", "rpm": "{rev}/min"}
"""Spellings of a whole text only: a code with a slash cannot follow another slash."""

_TYPO_CUTOFF = 0.75
"""Similarity of a mistyped spelling to the one that is meant."""
_TYPO_SIZE = 4
"""Letters of the shortest spelling that is looked for: of fewer, too many are alike."""

_ASCII = str.maketrans(
    {
        **dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+", strict=True)),
        **dict.fromkeys("\u00b5\u03bc", "u"),
        **dict.fromkeys("\u03a9\u2126", "Ohm"),
        **dict.fromkeys("·⋅∙×", "*"),
        "°": "deg",
        "−": "-",
        "‰": "[ppth]",
    }
)


def to_ucum(text: str) -> str:
    """The UCUM code of a unit text: at most 255 bytes of printable ASCII, never empty.

    ``to_ucum(to_ucum(text)) == to_ucum(text)``. No text is an error.

    >>> [to_ucum(text) for text in ("Nm", "m/s^2", "count", "", "raw(0-255)")]
    ['N.m', 'm/s2', '{count}', '1', '{raw(0-255)}']
    """
    text = _unwrapped(text.strip())
    if _is_code(text):
        return text
    text = text.translate(_ASCII)
    respelled = _respell(text)
    return respelled if _is_code(respelled) else _annotation(text)


def given_units(texts: Iterable[str], *, stacklevel: int = 2) -> list[str]:
    """The UCUM codes of units that a person gives, with a DataWarning for each unknown one."""
    texts = list(texts)
    for note in filter(None, map(unknown_unit, dict.fromkeys(texts))):
        warnings.warn(note, DataWarning, stacklevel=stacklevel + 1)
    return [to_ucum(text) for text in texts]


def unknown_unit(text: str, *, typos_only: bool = False, kept: str | None = None) -> str | None:
    """The note on a unit that is neither a known spelling nor in braces; None for any other.

    ``typos_only``: only where it resembles a known one. ``kept``: what is stored for it.
    """
    code = to_ucum(text)
    known = not code.startswith("{") or code in _SPELLINGS
    if known or "{" in text or "}" in text or not text.isascii():
        return None
    word = similar(text, [word for word in _WORDS if len(word) >= _TYPO_SIZE], _TYPO_CUTOFF)
    if typos_only and word is None:
        return None
    meant = f"; did you mean {_WORDS[word]!r} ({word})?" if word else "."
    return (
        f"unit {text!r} is not known{meant} It is stored as the free text {kept or code}, and "
        "preset perceptual does not know whether it is felt"
    )


def units_for(text: str, count: int) -> list[str]:
    """Codes of a text that a person gives: one unit for all channels, or one for each."""
    codes = given_units(text.split(","))
    if len(codes) == 1:
        return codes * count
    if len(codes) != count:
        raise ParameterError(f"{len(codes)} units for {count} channels: give one, or one for each")
    return codes


def split_name(name: str) -> tuple[str, str]:
    """Label and unit of a column: 'force [N]' and 'force (N)' -> 'force', 'N'. A label may hold
    brackets itself; a code holds no space, and what is in parentheses has to be a unit."""
    if name.endswith(")"):
        match = re.fullmatch(r"(.*\S) ?\(([^()]*)\)", name, re.DOTALL)
        if match is not None and match[2].strip() and "{" not in to_ucum(match[2]):
            return match[1].strip(), match[2]
        return name, ""
    if not name.endswith("]"):
        return name, ""
    match = re.fullmatch(r"(.*) \[(.*?)\]", f" {name}", re.DOTALL)
    match = match or re.fullmatch(r"(.*)\[([^][]*)\]", name, re.DOTALL)
    return (match[1].strip(), match[2]) if match is not None else (name, "")


def conversion(given: str, wanted: str) -> Fraction | None:
    """The factor from one UCUM code to another that differs from it in metric prefixes alone; None
    where they differ in more.

    >>> conversion("mN", "N"), conversion("mm/s2", "m/s2"), conversion("N", "m")
    (Fraction(1, 1000), Fraction(1, 1000), None)
    """
    if given == wanted:
        return Fraction(1)
    (power, one), (other_power, other) = _reduced(given), _reduced(wanted)
    return Fraction(10) ** (power - other_power) if one == other else None


def _reduced(code: str) -> tuple[int, list[tuple[str, int]]]:
    """The power of ten of a code's prefixes, and its atoms without them, with their exponents."""
    power, atoms = 0, []
    for slash, body, exponent in _FACTOR.findall(code):
        times = int(exponent or 1) * (-1 if slash == "/" else 1)
        prefixed = _PREFIXED.fullmatch(body)
        if prefixed:
            power += times * _SCALES[prefixed[1]]
        atoms.append((prefixed[2] if prefixed else body, times))
    return power, sorted(atoms)


def _unwrapped(text: str) -> str:
    """'[m/s]' and '(m/s)' -> 'm/s', but '[g]' is a code of its own."""
    while (inner := re.fullmatch(r"\(([^()]*)\)|\[([^][]*)\]", text)) is not None:
        if inner[1] is None and _is_code(text):
            break
        text = (inner[1] or inner[2] or "").strip()
    return text


def _is_code(text: str) -> bool:
    """Whether the text is a UCUM term of the atoms above, of a size that can be stored."""
    if len(text) > MAX_SIZE or any(not "!" <= character <= "~" for character in text):
        return False
    text = re.sub(_ANNOTATION, _NOTE, text)
    while (group := re.search(r"\(([^()]*)\)", text)) is not None:
        if _TERM.fullmatch(group[1]) is None:
            return False
        text = text[: group.start()] + _GROUP + text[group.end() :]
    return _TERM.fullmatch(text) is not None


def _respell(text: str) -> str:
    """One of many spellings -> UCUM's, where that is clear; the result may still be no code."""
    if "{" in text or len(text) > MAX_SIZE:
        return ""
    whole = _WHOLE.get(text.casefold())
    if whole is not None:
        return whole
    text = text.replace("**", "").replace("^", "")
    text = re.sub(r"\s+per\s+", "/", text)
    text = re.sub(r"(?<=[A-Za-z])-(?=[A-Za-z])|\*", ".", text)
    text = re.sub(r"\s*([./])\s*", r"\1", text)
    text = re.sub(r"\s+", ".", text)
    if re.search(r"/[^()]*\.", text):
        # UCUM reads J/kg.K from left to right, as J.K/kg; people mean J/(kg.K). Do not guess.
        return ""
    parts = re.split(r"([./()])", text)
    return "".join(
        _respell_part(part, below=index > 0 and parts[index - 1] == "/")
        for index, part in enumerate(parts)
    )


def _respell_part(part: str, *, below: bool) -> str:
    """One factor, with its exponent; ``below`` a slash a product needs parentheses."""
    if not part or part in "./()" or _is_code(part):
        return part
    if part.casefold() in _WORDS:
        return _WORDS[part.casefold()]
    if (product := _TORQUE.fullmatch(part)) is not None:
        joined = f"{product[1]}.{product[2]}"
        return f"({joined})" if below else joined
    body = part.rstrip("0123456789").rstrip("+-")
    return _WORDS.get(body.casefold(), body) + part[len(body) :]


def _annotation(text: str) -> str:
    """``{text}`` without what an annotation cannot hold; "1" where nothing is left."""
    kept = "".join(c for c in text if (" " <= c <= "~" and c not in "{}") or c.isspace()).strip()
    joined = re.sub(r"\s", "_", kept)[: MAX_SIZE - 2]
    return f"{{{joined}}}" if joined else "1"
