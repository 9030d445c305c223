"""--tolerance: what is understood, and what is refused with an example."""

from __future__ import annotations

from math import inf, nan

import pytest

from hapfmt.encoder.settings import Tolerance
from hapfmt.errors import ParameterError


@pytest.mark.parametrize(
    ("text", "tolerance"),
    [
        ("1e-6", Tolerance(1e-6)),
        (" .5 ", Tolerance(0.5)),
        ("+2.", Tolerance(2.0)),
        ("0.5lsb", Tolerance(0.5, "lsb")),
        ("1 LSB", Tolerance(1.0, "lsb")),
        ("0.01%", Tolerance(0.0001, "range")),
        ("0.07 %", Tolerance(0.0007, "range")),
        ("1e-3%", Tolerance(1e-5, "range")),
        ("10mN", Tolerance(10.0, unit="mN")),
        ("1e-6 N", Tolerance(1e-6, unit="N")),
        ("2 Nmm", Tolerance(2.0, unit="N.mm")),
    ],
)
def test_parse(text: str, tolerance: Tolerance) -> None:
    assert Tolerance.parse(text) == tolerance


@pytest.mark.parametrize(
    "text",
    [
        "",
        "abc",
        "nan",
        "inf",
        "-1",
        "-1e-6lsb",
        "1e",
        "1,5",
        "lsb",
        "%",
        "1 sheep",
        "1 N 2",
        "1_0",
        "0x10",
        "1%lsb",
        "\u0661",
        "1e12345",
        "1\n2",
    ],
)
def test_parse_refuses_with_an_example(text: str) -> None:
    with pytest.raises(ParameterError, match=r"0\.5lsb"):
        Tolerance.parse(text)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [("10mN", "N", 0.01), ("0.5 mN", "kN", 5e-7), ("3N", "N", 3.0), ("2mm/s2", "m/s2", 0.002)],
)
def test_an_amount_in_the_unit_of_a_channel(text: str, unit: str, value: float) -> None:
    assert Tolerance.parse(text).in_unit(unit) == value


@pytest.mark.parametrize("unit", ["m", "N.m", "1", "gf"])
def test_an_amount_in_another_unit_is_refused(unit: str) -> None:
    with pytest.raises(ParameterError, match="does not fit a channel in"):
        Tolerance.parse("10mN").in_unit(unit)


@pytest.mark.parametrize("text", ["0", "0.0lsb", "0%", "1e-400", "1e999", "1e400%"])
def test_parse_refuses_zero_and_infinity(text: str) -> None:
    with pytest.raises(ParameterError, match="above 0 and finite"):
        Tolerance.parse(text)


@pytest.mark.parametrize("value", [0.0, -1.0, nan, inf])
def test_tolerance_is_positive_and_finite(value: float) -> None:
    with pytest.raises(ParameterError, match="above 0 and finite"):
        Tolerance(value)


def test_tolerance_has_three_kinds() -> None:
    with pytest.raises(ParameterError, match="absolute, lsb, range"):
        Tolerance(1.0, "percent")  # type: ignore[arg-type]
