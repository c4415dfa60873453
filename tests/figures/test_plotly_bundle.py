"""The page's chart script: what is cut out of plotly's own, and what is left alone."""

from __future__ import annotations

from importlib.metadata import files

import pytest

from calrig.figures.plotly_bundle import TRACES, BundleError, partial_bundle

WRAPPER = "var W=(e,t)=>()=>{try{return t||e((t={exports:{}}).exports,t)}"


@pytest.fixture(scope="module")
def whole():
    (script,) = [file for file in files("plotly") if file.name == "plotly.min.js"]
    return script.read_text(encoding="utf-8")


def test_a_quarter_of_it_is_left_and_its_ends_are_the_makers(whole):
    cut = partial_bundle(whole)
    assert len(cut) < 0.3 * len(whole)
    assert cut[:2000] == whole[:2000]
    assert cut[-200:] == whole[-200:]


def test_a_trace_more_is_a_trace_more(whole):
    more = partial_bundle(whole, [*TRACES, "heatmap"])
    assert 'name:"heatmap"' in more
    assert 'name:"box"' not in more
    assert 'name:"heatmap"' not in partial_bundle(whole)


def test_a_trace_that_plotly_does_not_have_is_named(whole):
    with pytest.raises(BundleError, match="no trace is called pyramid"):
        partial_bundle(whole, ["pyramid"])


@pytest.mark.parametrize("script", ["", "var a=1;", WRAPPER])
def test_another_build_of_it_is_refused(script):
    with pytest.raises(BundleError):
        partial_bundle(script)
