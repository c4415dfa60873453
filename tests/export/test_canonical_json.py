"""The text that a document's hash is of, against bytes written by hand (CONTRACT section 6)."""

from __future__ import annotations

import hashlib

import pytest

from calrig.canonical_json import canonical, sha256_of, with_sha256

DOCUMENT = {"unit": "Ä°", "range_deg": [-60.0, 60], "bias_deg": 0.5, "effects": {"b": None, "a": True}}
TEXT = '{"bias_deg":0.5,"effects":{"a":true,"b":null},"range_deg":[-60.0,60],"unit":"Ä°"}'


def test_keys_are_in_order_at_every_depth_and_characters_as_they_are():
    assert canonical(DOCUMENT) == TEXT


def test_the_hash_is_of_these_bytes_whatever_the_order_and_an_earlier_hash():
    expected = hashlib.sha256(TEXT.encode("utf-8")).hexdigest()
    assert sha256_of(DOCUMENT) == expected
    assert sha256_of({"sha256": "0" * 64, **dict(reversed(DOCUMENT.items()))}) == expected
    assert with_sha256(DOCUMENT)["sha256"] == expected


def test_a_number_that_json_has_not_is_refused():
    with pytest.raises(ValueError, match="not JSON compliant"):
        canonical({"bias_deg": float("nan")})
