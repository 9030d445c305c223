"""Unit texts -> UCUM codes."""

import doctest
import math

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from hapfmt import units
from hapfmt.units import MAX_SIZE, to_ucum, to_udunits

SPELLINGS = {
    "": "1",
    "  ": "1",
    "none": "1",
    "percent": "%",
    "Nm": "N.m",
    "mNm": "mN.m",
    "N m": "N.m",
    "N·m": "N.m",
    "N*m": "N.m",
    "N-m": "N.m",
    "rad/Nm": "rad/(N.m)",
    "m/s^2": "m/s2",
    "m/s**2": "m/s2",
    "m/s²": "m/s2",
    "m s^-2": "m.s-2",
    "m s⁻²": "m.s-2",
    "m/sec^2": "m/s2",
    "[m/s]": "m/s",
    "(kPa)": "kPa",
    "count": "{count}",
    "Counts": "{count}",
    "counts/s": "{count}/s",
    "degrees": "deg",
    "°/s": "deg/s",
    "degrees per second": "deg/s",
    "°C": "Cel",
    "\u00b5m": "um",
    "\u03bcm": "um",
    "k\u03a9": "kOhm",
    "k\u2126": "kOhm",
    "hz": "Hz",
    "rpm": "{rev}/min",
    "microvolts": "uV",
    "millivolt": "mV",
    "Millinewton": "mN",
    "g0": "[g]",
    "lbf": "[lbf_av]",
    "Newton": "N",
    "newtons": "N",
    "newton_meter": "N.m",
    "Newton metres": "N.m",
    "m/s/s": "m/s/s",
    "meter / second ** 2": "m/s2",
    "meters per second squared": "m/s2",
    "meters_per_second": "m/s",
    "square meters": "m2",
    "cubic meters per hour": "m3/h",
    "per second": "/s",
    "deg/s": "deg/s",
    "dps": "deg/s",
    "degC": "Cel",
    "deg C": "Cel",
    "degree_Celsius": "Cel",
    "Degrees Celsius": "Cel",
    "deg. C/min": "Cel/min",
    "degrees F": "[degF]",
    "microTesla": "uT",
    "kilopascals": "kPa",
    "millivolts": "mV",
    "millibar": "mbar",
    "nanoseconds": "ns",
    "centimetres": "cm",
    "kohm": "kOhm",
    "microsiemens": "uS",
    "litres": "L",
    "bytes": "By",
    "ft": "[ft_i]",
    "ft/s": "[ft_i]/s",
    "ft-lb": "[ft_i].[lbf_av]",
    "miles": "[mi_i]",
    "mph": "[mi_i]/h",
    "atmospheres": "atm",
    "standard_gravity": "[g]",
    "g's": "[g]",
    "px": "{pixel}",
}
# fmt: off
CODES = [
    "1", "%", "g", "[g]", "mg", "m[g]", "deg", "N", "mN", "N.m", "rad", "rad/s", "V", "mV",
    "A", "Hz", "m/s", "m/s2", "kPa", "Ohm", "s-1", "/min", "1/s", "m.s-2", "kg.m2/(s3.A)",
    "N/(m/s)", "{count}", "{count}/s", "m/s2{peak}", "mm[Hg]", "J/kg.K", "dB", "Cel",
]
# fmt: on
ANNOTATED = {
    "raw(0-255)": "{raw(0-255)}",
    "count(39.811uNm)": "{count(39.811uNm)}",
    "count, rectified": "{count,_rectified}",
    "g?": "{g?}",
    "a{b}c": "{abc}",
    "{two words}": "{two_words}",
    "J/kg K": "{J/kg_K}",  # not J/kg.K, which is J.K/kg
    "G": "{G}",  # not gauss
    "N\u00f8rd": "{Nrd}",
    "m/(s": "{m/(s}",
    "m_s": "{m_s}",  # m.s or m/s
    "newton_apples": "{newton_apples}",
    "()": "1",
    "[(m)]": "m",
    "([g])": "[g]",
    "m(s)": "{m(s)}",
    "{}": "1",
    "\u65e5\u672c": "1",
    "\0": "1",
    "x" * 300: "{" + "x" * 253 + "}",
}


@pytest.mark.parametrize(("text", "code"), (SPELLINGS | ANNOTATED).items(), ids=ascii)
def test_spelling(text: str, code: str) -> None:
    assert to_ucum(text) == code


@pytest.mark.parametrize("code", CODES)
def test_a_code_stays(code: str) -> None:
    assert to_ucum(code) == code


texts = st.one_of(
    st.text(max_size=400),
    st.text(st.sampled_from("Nmgs123/.^*-+ ()[]{}%²°µ"), max_size=12),
    st.sampled_from([*SPELLINGS, *CODES, *ANNOTATED]),
)


@given(texts)
@example("." * 300)
@example("(" * 255)
@example("m." * 127 + "m")
@example("m." * 128 + "m")
@example("[" * 128 + "]" * 127)
def test_any_text_gives_a_code_that_stays(text: str) -> None:
    code = to_ucum(text)
    assert to_ucum(code) == code
    assert 1 <= len(code.encode()) <= MAX_SIZE
    assert all("!" <= character <= "~" for character in code)
    assert code.count("{") == code.count("}")


UDUNITS = {
    "1": "1",
    "N.m": "N m",
    "kg.m2/(s3.A)": "kg m2 s-3 A-1",
    "N/(m/s)": "N m-1 s",
    "/min": "min-1",
    "J/kg.K": "J kg-1 K",
    "Cel": "degC",
    "Cel/s": "K s-1",
    "[degF]": "degF",
    "[degF]/s": "degR s-1",
    "deg/s": "degree s-1",
    "m.%": "m %",  # " percent" is "per cent" there
    "[g]": "gravity",
    "m[g]": "mgravity",
    "[psi]": "psi",
    "[lbf_av]": "lbf",
    "[in_i].[lbf_av]": "international_inch lbf",
    "mm[Hg]": "mmHg",
    "mm[Hg]2": "(mmHg)2",
    "m[Hg]/s": "(1e3 mmHg) s-1",
    "cm[H2O]": "cmH2O",
    "{count}": "count",
    "{rev}/min": "revolution min-1",
    "m/s2{peak}": "m s-2",
    "{raw(0-255)}": "1",
    "[arb'U]/s": "s-1",
    "kOhm": "kohm",
    "ft": "international_foot",
    "'": "arc_minute",
    "dB": "0.1 lg(re 1)",
    "B": "lg(re 1)",
    "dB/m": None,
    "B-1": None,
    "newtons": "N",
}


@pytest.mark.parametrize(("code", "text"), UDUNITS.items())
def test_udunits(code: str, text: str | None) -> None:
    assert to_udunits(code) == text


KELVIN = 5 / 9
SI = {
    "m": (1, "m"), "s": (1, "s"), "g": (1e-3, "kg"), "rad": (1, "1"), "K": (1, "K"), "C": (1, "A s"),
    "cd": (1, "cd"), "mol": (1, "mol"), "sr": (1, "1"), "N": (1, "kg m s-2"), "Pa": (1, "kg m-1 s-2"),
    "J": (1, "kg m2 s-2"), "W": (1, "kg m2 s-3"), "A": (1, "A"), "V": (1, "kg m2 s-3 A-1"),
    "F": (1, "kg-1 m-2 s4 A2"), "Ohm": (1, "kg m2 s-3 A-2"), "S": (1, "kg-1 m-2 s3 A2"),
    "Wb": (1, "kg m2 s-2 A-1"), "Cel": (1, "K"), "T": (1, "kg s-2 A-1"), "H": (1, "kg m2 s-2 A-2"),
    "Hz": (1, "s-1"), "lm": (1, "cd"), "lx": (1, "cd m-2"), "L": (1e-3, "m3"), "l": (1e-3, "m3"),
    "bar": (1e5, "kg m-1 s-2"), "eV": (1.602176634e-19, "kg m2 s-2"), "gf": (9.80665e-3, "kg m s-2"),
    "bit": (1, "1"), "By": (8, "1"), "t": (1e3, "kg"), "[g]": (9.80665, "m s-2"), "[ppm]": (1e-6, "1"),
    "m[Hg]": (133322.387415, "kg m-1 s-2"), "m[H2O]": (9806.65, "kg m-1 s-2"),
    "%": (0.01, "1"), "deg": (math.pi / 180, "1"), "'": (math.pi / 10800, "1"),
    "''": (math.pi / 648000, "1"), "min": (60, "s"), "h": (3600, "s"), "d": (86400, "s"),
    "[degF]": (KELVIN, "K"), "[psi]": (6894.757293168361, "kg m-1 s-2"),
    "[lbf_av]": (4.4482216152605, "kg m s-2"), "[lb_av]": (0.45359237, "kg"), "[in_i]": (0.0254, "m"),
    "[ft_i]": (0.3048, "m"), "[mi_i]": (1609.344, "m"), "[ppth]": (1e-3, "1"), "[ppb]": (1e-9, "1"),
    "[arb'U]": (1, "1"), "[pi]": (math.pi, "1"), "atm": (101325, "kg m-1 s-2"),
}  # fmt: skip
"""Values of the atoms by the UCUM specification."""
METRIC, FIXED = units._METRIC.split(), units._FIXED.split()
PREFIXED = [
    (prefix, atom)
    for prefix in ("", *units._SCALES)
    for atom in METRIC
    if atom != "B" and prefix + atom != "ft"
]
ATOMS = [*PREFIXED, *(("", atom) for atom in FIXED)]


class TestUdunits:
    """UDUNITS itself reads the texts."""

    @pytest.fixture(autouse=True)
    def library(self) -> None:
        self.unit = pytest.importorskip("cf_units", reason="cf-units is not installed").Unit

    def value(self, text: str, base: str) -> float:
        """A difference of one of the unit, in SI base units."""
        given, wanted = self.unit(text), self.unit(base)
        return float(given.convert(1.0, wanted)) - float(given.convert(0.0, wanted))

    def test_every_atom_with_every_prefix(self) -> None:
        assert {atom for _, atom in ATOMS} == set(SI)
        for prefix, atom in ATOMS:
            value, base = SI[atom]
            value *= 10.0 ** units._SCALES[prefix] if prefix else 1.0
            text = to_udunits(prefix + atom)
            # UDUNITS has another mantissa of eV. An offset takes digits of small differences.
            near = self.value(f"{text} s", f"{base} s") if atom in ("Cel", "[degF]") else None
            near = self.value(text, base) if near is None else near
            assert near == pytest.approx(value, rel=1e-6), (prefix, atom, text)

    def test_zeros_of_temperatures(self) -> None:
        kelvin = self.unit("K")
        assert self.unit(to_udunits("Cel")).convert(25.0, kelvin) == pytest.approx(298.15)
        assert self.unit(to_udunits("[degF]")).convert(77.0, kelvin) == pytest.approx(298.15)

    def test_decibels(self) -> None:
        assert self.unit(to_udunits("dB")).convert(20.0, "1") == pytest.approx(100)

    @given(
        st.lists(st.tuples(st.sampled_from(ATOMS), st.sampled_from([-3, -1, 1, 2])), min_size=1, max_size=4),
        st.booleans(),
        st.data(),
    )  # fmt: skip
    def test_products(self, factors, inside: bool, data) -> None:
        code, wanted = "", []
        for place, ((prefix, atom), exponent) in enumerate(factors):
            below = data.draw(st.booleans()) if place else False
            code += ("/" if below else "." if place else "") + f"{prefix}{atom}"
            code += str(exponent) if exponent != 1 else ""
            value, base = SI[atom]
            scale = 10.0 ** units._SCALES[prefix] if prefix else 1.0
            wanted.append((scale * value, base, -exponent if below else exponent))
        if inside:
            code, wanted = f"cd/({code})", [(1.0, "cd", 1), *((v, b, -e) for v, b, e in wanted)]
        assert to_ucum(code) == code
        text = to_udunits(f"{code}.s")
        bases = " ".join(f"({base}){power}" for _, base, power in wanted)
        value = math.prod(v**e for v, _, e in wanted)
        assume(1e-200 < value < 1e200)
        assert self.value(text, f"{bases} s") == pytest.approx(value, rel=1e-5), text

    @given(texts)
    def test_any_text(self, text: str) -> None:
        found = to_udunits(text)
        assert found is None or not self.unit(found).is_unknown()


def test_docstring() -> None:
    assert doctest.testmod(units).failed == 0
