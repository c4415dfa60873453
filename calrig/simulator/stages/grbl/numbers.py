"""How GRBL reads a number: its own routine, which no exponent and no ninth digit passes (nuts_bolts.c)."""

from __future__ import annotations

MOST_DIGITS = 8


class Refusal(Exception):  # noqa: N818 (an answer of the dialect, caught where it is sent)
    """A line is answered with `error:` and this number."""

    def __init__(self, number: int) -> None:
        self.number = number


def read_number(text: str, start: int) -> tuple[float, int]:
    """Read the number that begins at an index of a line.

    Leading zeros count as digits. From the ninth on, they are zeros before the decimal point, nothing after.

    Returns:
        The number and the index after it.

    Raises:
        Refusal: there is no digit (2, bad number format).
    """
    at, sign, digits, exponent, n_digits, after_point = start, 1.0, 0, 0, 0, False
    if text[at : at + 1] in ("-", "+") and text[at : at + 1]:
        sign = -1.0 if text[at] == "-" else 1.0
        at += 1
    while at < len(text):
        if text[at] in "0123456789":
            n_digits += 1
            if n_digits <= MOST_DIGITS:
                exponent -= after_point
                digits = digits * 10 + int(text[at])
            else:
                exponent += not after_point
        elif text[at] == "." and not after_point:
            after_point = True
        else:
            break
        at += 1
    if not n_digits:
        raise Refusal(2)
    return sign * (digits * 10.0**exponent if exponent > 0 else digits / 10.0**-exponent), at
