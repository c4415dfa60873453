"""What tuning the filter gained over the paper's constants, in one sentence: both, or which for which."""

from __future__ import annotations

from calrig.estimation.filter_comparison import FilterComparison


def tuned_against_paper(comparison: FilterComparison) -> str | None:
    """Whether the tuned filter beats the paper's constants on jitter and on lag, and if not, what it trades.

    Returns:
        None where one of the two was not run or stood nowhere.
    """
    rows = {row.name: row for row in comparison.rows}
    paper, tuned = rows["kalman_paper"], rows["kalman_tuned"]
    if paper.jitter is None or tuned.jitter is None:
        return None
    calmer = tuned.jitter.std_deg < paper.jitter.std_deg
    jitters = f"jitter ({tuned.jitter.std_deg:.2g}° against {paper.jitter.std_deg:.2g}° in 100 ms)"
    if paper.transient is None or tuned.transient is None:
        verb = "beats" if calmer else "does not beat"
        return f"The tuned filter {verb} the paper's constants on {jitters}; no move shows their lag."
    lag_ms, paper_ms = tuned.transient.lag_ms, paper.transient.lag_ms
    prompter = abs(lag_ms) < abs(paper_ms)
    lags = f"lag ({lag_ms:+.1f} ms against {paper_ms:+.1f} ms)"
    if calmer and prompter:
        return f"The tuned filter beats the paper's constants on {jitters} and on {lags} at once."
    if not (calmer or prompter):
        return f"The tuned filter beats the paper's constants on neither {jitters} nor {lags}."
    gained, given = (jitters, lags) if calmer else (lags, jitters)
    why = "; it trusts the gyro more, and with it the gyro's error of scale: calibrate that" if calmer else ""
    return f"The tuned filter is better than the paper's constants on {gained} and worse on {given}{why}."
