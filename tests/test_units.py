"""Unit texts -> UCUM codes."""

import doctest

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hapfmt import units
from hapfmt.units import MAX_SIZE, to_ucum

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


def test_docstring() -> None:
    assert doctest.testmod(units).failed == 0
