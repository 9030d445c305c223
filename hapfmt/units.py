"""Unit texts as people write them -> UCUM codes (https://ucum.org/ucum).

A text that is a UCUM code already stays as it is; a known spelling is respelled; anything else is
kept as a UCUM annotation, ``{raw(0-255)}``: dimension 1, but readable. So 'g' stays the gram, and
the acceleration is asked for as ``[g]`` (spelled gn, g0, g-force or [g]).
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator
from fractions import Fraction
from functools import lru_cache

from .errors import DataWarning, ParameterError, similar

MAX_SIZE = 255
"""Bytes of the longest code: a unit is stored behind one length byte."""

_PREFIXES = "Y Z E P T G M k h da d c m u n p f a z y"
_METRIC = (
    "m s g rad K C cd mol sr N Pa J W A V F Ohm S Wb Cel T H Hz lm lx L l bar eV gf B bit By t "
    "[g] [ppm] m[Hg] m[H2O]"
)
"""Atoms that take a prefix. Left out, since people mean something else by them: G (gauss), a
(year), b (barn), u, P, R. "ft" is the foot, never the femtotonne."""
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
    "[ppth] [ppb] [arb'U] [pi] atm"
)


def _any_of(codes: str) -> str:
    return "|".join(map(re.escape, sorted(codes.split(), key=len, reverse=True)))


_GROUP, _NOTE = "\0", "\1"
"""Stand for a pair of parentheses whose content was found to be a term, and for an annotation."""
_ANNOTATION = r"\{[!-z|~]+\}"
_ATOM = rf"(?:(?!ft)(?:{_any_of(_PREFIXES)})?(?:{_any_of(_METRIC)})|{_any_of(_FIXED)})"
_COMPONENT = rf"(?:{_ATOM}(?:[+-]?[1-9][0-9]?)?{_NOTE}?|1|{_NOTE}|{_GROUP})"
_TERM = re.compile(rf"/?{_COMPONENT}(?:[./]{_COMPONENT})*")
_POWER = re.compile(
    rf"(?:({_any_of(_PREFIXES)})?({_any_of(_METRIC)})|({_any_of(_FIXED)}))([+-]?[1-9][0-9]?)?"
)
_FACTOR = re.compile(r"([./]?)([^./0-9+-]+|1)([+-]?[0-9]*)")
_PREFIXED = re.compile(rf"({_any_of(_PREFIXES)})({_any_of(_METRIC)})")
_TEMPERATURE = re.compile(
    r"\bdeg(?:ree)?s?[.]?[\s_]*(c(?=elsius\b)|f(?=ahrenheit\b)|[cf]\b)(?:elsius|ahrenheit)?", re.I
)
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
    "{pixel}": "pixel pixels px",
    "deg": "deg degs degree degrees",
    "rad": "rad rads radian radians",
    "s": "sec secs second seconds",
    "ms": "msec msecs",
    "us": "usec usecs",
    "ns": "nsec nsecs",
    "min": "mins minute minutes",
    "h": "hr hrs hour hours",
    "m": "meter meters metre metres",
    "um": "micron microns",
    "L": "liter liters litre litres",
    "g": "gram grams",
    "kg": "kgs",
    "N": "newton newtons",
    "Pa": "pascal pascals",
    "kPa": "kpa",
    "bar": "bar bars",
    "atm": "atm atmosphere atmospheres",
    "V": "volt volts",
    "A": "amp amps ampere amperes",
    "C": "coulomb coulombs",
    "F": "farad farads",
    "H": "henry henries",
    "S": "siemens",
    "T": "tesla teslas",
    "Wb": "weber webers",
    "W": "watt watts",
    "J": "joule joules",
    "Ohm": "ohm ohms",
    "kOhm": "kohm kohms",
    "By": "byte bytes",
    "bit": "bit bits",
    "Hz": "hz hertz",
    "kHz": "khz",
    "K": "kelvin kelvins",
    "Cel": "degc celsius",
    "[degF]": "degf fahrenheit",
    "dB": "db decibel decibels",
    "[g]": "gn g0 g_n g-force gforce gee gees g's gravity standard_gravity standard_free_fall",
    "[in_i]": "in inch inches",
    "[ft_i]": "ft foot feet",
    "[mi_i]": "mile miles",
    "[lb_av]": "lb lbs pound pounds",
    "[lbf_av]": "lbf pound-force",
    "kgf": "kilogram-force",
    "[psi]": "psi",
    "[ppm]": "ppm",
    "mm[Hg]": "mmhg",
}
_PREFIX_NAMES = {
    "giga": "G", "mega": "M", "kilo": "k", "hecto": "h", "deci": "d", "centi": "c", "milli": "m",
    "micro": "u", "nano": "n", "pico": "p",
}  # fmt: skip
_NAMES = {word: code for code, words in _SPELLINGS.items() for word in words.split()}
_WORDS = {
    **{
        prefix + word: symbol + code
        for prefix, symbol in _PREFIX_NAMES.items()
        for word, code in _NAMES.items()
        if code in _METRIC.split() and word.isalpha()
    },
    **_NAMES,
}
_TORQUES = {
    "ft-lb": "[ft_i].[lbf_av]", "ft-lbf": "[ft_i].[lbf_av]", "lb-ft": "[ft_i].[lbf_av]",
    "in-lb": "[in_i].[lbf_av]", "in-lbf": "[in_i].[lbf_av]", "lb-in": "[in_i].[lbf_av]",
}  # fmt: skip
_WHOLE = {
    **_WORDS, **_TORQUES, "": "1", "n/a": "1", "rpm": "{rev}/min", "dps": "deg/s", "kph": "km/h",
    "mph": "[mi_i]/h", "lpm": "L/min",
}  # fmt: skip
"""Spellings of a whole text only: a code with a slash cannot follow another slash."""
_POWERS = {"squared": "2", "square": "2", "sq": "2", "cubed": "3", "cubic": "3"}

_UDUNITS = {
    "Ohm": "ohm",
    "By": "byte",
    "t": "tonne",
    "deg": "degree",
    "'": "arc_minute",
    "''": "arc_second",
    "[g]": "gravity",
    "[psi]": "psi",
    "[lbf_av]": "lbf",
    "[lb_av]": "lb",
    "[in_i]": "international_inch",
    "[ft_i]": "international_foot",
    "[mi_i]": "international_mile",
    "[ppm]": "ppm",
    "[ppb]": "ppb",
    "[ppth]": "(1e-3)",
    "[pi]": "pi",
    "[arb'U]": "1",
    "Cel": "K",
    "[degF]": "degR",
    "{rev}": "revolution",
    **dict.fromkeys(("{count}", "{digit}", "{lsb}", "{pulse}", "{sample}", "{step}"), "count"),
}
"""UDUNITS names of the atoms that have another one there; of temperatures, that of a difference."""
_UDUNITS_ALONE = {"Cel": "degC", "[degF]": "degF"}
"""Names of a whole unit: these count from another zero."""
_COLUMNS = {"m[Hg]": ("mmHg", -3), "m[H2O]": ("cmH2O", -2)}
"""Columns of a liquid: the one prefix that UDUNITS has, and its power of ten."""

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


@lru_cache(maxsize=256)
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


def to_udunits(text: str) -> str | None:
    """The UDUNITS text of a unit, as the CF conventions want it; None where UDUNITS has none, as
    for dB/m. Free text becomes the unit 1.

    >>> [to_udunits(code) for code in ("N.m", "m/s2", "Cel", "Cel/s", "mm[Hg]", "{count}", "dB")]
    ['N m', 'm s-2', 'degC', 'K s-1', 'mmHg', 'count', '0.1 lg(re 1)']
    """
    factors = list(_factors(to_ucum(text)))
    alone = len(factors) == 1 and factors[0][2] == 1
    parts = []
    for prefix, atom, exponent in factors:
        power = _SCALES[prefix] if prefix else 0
        if atom == "B":
            if not alone:
                return None
            name = f"{_ten(power)} lg(re 1)" if power else "lg(re 1)"
        elif atom in _COLUMNS:
            name, own = _COLUMNS[atom]
            if power != own or exponent != 1:
                name = f"({name})" if power == own else f"({_ten(power - own)} {name})"
        else:
            name = prefix + ((alone and _UDUNITS_ALONE.get(atom)) or _UDUNITS.get(atom, atom))
        if name != "1":
            parts.append(name if exponent == 1 else f"{name}{exponent}")
    return " ".join(parts) or "1"


def _ten(power: int) -> str:
    return "0.1" if power == -1 else f"1e{power}"


def _factors(code: str) -> Iterator[tuple[str, str, int]]:
    """Prefix, atom and exponent of each factor of a code, as it is read from left to right. An
    annotation is a factor where there is no atom before it, and one of the known spellings."""
    signs, sign, before = [1], 1, "."
    for token in re.findall(r"\{[^{}]*\}|[()./]|[^(){}./]+", code):
        if token in "./":
            sign = 1 if token == "." else -1
        elif token == "(":
            signs.append(signs[-1] * sign)
            sign = 1
        elif token == ")":
            signs.pop()
        elif not token.startswith("{"):
            if (found := _POWER.fullmatch(token)) is not None:
                yield found[1] or "", found[2] or found[3], signs[-1] * sign * int(found[4] or 1)
        elif before in "./(" and token in _UDUNITS:
            yield "", token, signs[-1] * sign
        before = token


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
    # m_s may be m.s or m/s, but newton_meter is clear.
    text = re.sub(r"(?<=[A-Za-z]{3})_(?=[A-Za-z]{3})", " ", text)
    text = re.sub(r"\s*(\*\*|\^)\s*", "", text)
    text = re.sub(r"(?:^|\s+)per\s+", "/", text)
    text = _TEMPERATURE.sub(r"deg\1", text)
    text = re.sub(r"\s+(squared|cubed)\b", lambda found: _POWERS[found[1]], text)
    text = re.sub(r"\b(square|sq|cubic)\s+([A-Za-z]+)", lambda x: x[2] + _POWERS[x[1]], text)
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


def unit_text(unit: str) -> str:
    """Return a UCUM unit for people: nothing for the unit 1, counts for {count}, raw for {raw}."""
    if unit in ("1", "{count}"):
        return "" if unit == "1" else "counts"
    return unit[1:-1] if re.fullmatch(r"\{[^{}]+\}", unit) else unit
