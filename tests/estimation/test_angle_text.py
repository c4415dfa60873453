"""An angle is written with the digits that show it, a small one in arcseconds as well."""

from __future__ import annotations

import math

import pytest

from calrig.estimation.angle_text import angle_text


@pytest.mark.parametrize(
    ("value_deg", "text"),
    [
        (0.0, "0°"),
        (0.0301, "0.0301°"),
        (0.000201, "0.000201° (0.724″)"),
        (-0.0024, "−0.00240° (−8.64″)"),
        (12.34, "12.3°"),
        (359.99, "360°"),
    ],
)
def test_an_angle_by_itself(value_deg, text):
    assert angle_text(value_deg) == text


@pytest.mark.parametrize(
    ("value_deg", "std_deg", "text"),
    [
        (1.7377, 0.1234, "1.74 ± 0.12°"),
        (-0.00240, 0.00012, "−0.00240 ± 0.00012° (−8.64 ± 0.43″)"),
        (0.1262, 11_000.0, "0.13 ± 11000.00°"),
        (0.05, 0.0, "0.05000°"),
        (0.05, math.nan, "0.05000°"),
    ],
)
def test_its_standard_error_decides_the_digits_and_hides_no_value(value_deg, std_deg, text):
    assert angle_text(value_deg, 4, std_deg) == text


@pytest.mark.parametrize("exponent", range(-15, 6))
@pytest.mark.parametrize("std", [None, 0.3, 2.0])
def test_no_angle_that_is_not_0_reads_as_0(exponent, std):
    value_deg = -3.2 * 10.0**exponent
    in_words = angle_text(value_deg, 2, None if std is None else std * abs(value_deg))
    number = in_words.split("°")[0].split(" ±")[0].replace("−", "-")
    assert float(number) == pytest.approx(value_deg, rel=0.05)
