"""What commands print: one JSON document for programs; lines and tables with units and errors for people."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest
from operator import methodcaller
from textwrap import fill
from typing import TYPE_CHECKING, Any, TypeVar

import typer
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from calrig.errors import printable
from calrig.estimation.angle_text import SMALL_DEG, angle_text, number_text
from calrig.run_ids import short_name

if TYPE_CHECKING:
    from calrig.client.documents import RunRecord
    from calrig.model.base import Model
    from calrig.model.diagnosis import BaseErrors, Diagnosis, EffectFound
    from calrig.model.noise import Coefficient, NoiseReport
    from calrig.model.result import Result
    from calrig.model.service import KnownUser, Membership, RigState
    from calrig.model.verdict import Verdict
    from calrig.settings import RigSettings
    from calrig.store.moving import Moved

T = TypeVar("T")
FRAME = "│  "
"""Of a column."""


def print_line(text: str, style: str = "") -> None:
    """Prints text as it is: no markup, no escape sequences."""
    Console(soft_wrap=True, highlight=False).print(Text(printable(text), style))


def print_sentence(text: str) -> None:
    """The same for what is read as prose: a terminal's lines break between words, a pipe's not at all."""
    console, text = Console(soft_wrap=True, highlight=False), printable(text)
    if console.is_terminal:
        indent = " " * (len(text) - len(text.lstrip("· ")))
        text = fill(
            text,
            console.width,
            subsequent_indent=indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
    console.print(Text(text))


def print_table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    title: str | None = None,
    caption: str | None = None,
    justify: Any = "right",
) -> None:
    """Prints a table: names to the left in the first column, the others as told.

    Cells wrap between words and are never cut: what is too wide for the terminal is a list instead.
    """
    console = Console(soft_wrap=True, highlight=False)
    cells = [[printable(cell) for cell in row] for row in rows]
    widths = _widths(headings, cells, console.width)
    if widths is None:
        for line in _as_list(headings, cells, title, caption):
            print_line(line)
        return
    table = Table(
        title=None if title is None else Text(printable(title)),
        title_justify="left",
        caption=None if caption is None else Text(caption),
        caption_justify="left",
    )
    for place, (heading, width) in enumerate(zip(headings, widths, strict=True)):
        table.add_column(heading, justify=justify if place else "left", width=width)
    for row in cells:
        table.add_row(*map(Text, row))
    console.print(table)


def _widths(headings: Sequence[str], rows: Sequence[Sequence[str]], most: int) -> list[int] | None:
    """The width of each column of a table that is `most` wide at most; None where a word would be cut."""
    columns = [[str(cell) for cell in column] for column in zip_longest(headings, *rows, fillvalue="")]
    whole = [max(map(cell_len, cells)) for cells in columns]
    least = [max(cell_len(word) for cell in cells for word in cell.split() or [""]) for cells in columns]
    least[0] = max(least[0], *map(cell_len, columns[0][1:]), 0)  # names do not wrap
    spare = most - 1 - sum(least) - len(FRAME) * len(least)
    if spare < 0:
        return None
    for place, (narrow, wide) in enumerate(zip(least, whole, strict=True)):
        given = min(spare, wide - narrow)
        least[place], spare = narrow + given, spare - given
    return least


def _as_list(
    headings: Sequence[str], rows: Sequence[Sequence[str]], title: str | None, caption: str | None
) -> Iterator[str]:
    """The same, a line each; what is empty is left out."""
    if title is not None:
        yield title
    for row in rows:
        yield " ".join(part for part in (headings[0], row[0]) if part)
        for heading, cell in zip(headings[1:], row[1:], strict=False):
            if cell:
                yield f"  {heading}: {cell}"
    if caption is not None:
        yield caption


def print_parameter(title: str, parameter: Mapping[str, Any] | Model | None, unit: str = "") -> None:
    """Prints a parameter with its standard error; one that does not apply is left out."""
    if parameter is not None:
        value, std = parameter["value"], parameter["std"]
        written = (
            angle_text(value, 4, std) if unit == "°" else number_text(value, std, 4, unit and f" {unit}")
        )
        print_line(f"  {title} = {written}")


def print_warnings(warnings: Iterable[str]) -> None:
    """Prints what a person should know, a line each."""
    for warning in warnings:
        print_sentence(f"warning: {warning}")


def number(value: float | None, unit: str, decimals: int = 4) -> str:
    """A number with its unit, or that it is not known; a small angle with the digits that show it."""
    if value is not None and unit == "°" and 0.0 < abs(value) < SMALL_DEG:
        return angle_text(value)
    return "not known" if value is None else f"{value:.{decimals}f}{unit}"


def print_json(document: object) -> None:
    """Prints a document, or models in it; what is not known is null in it, never NaN."""
    plain = methodcaller("model_dump", mode="json")
    typer.echo(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False, default=plain))


def show(found: T, in_words: Callable[[T], None], *, as_json: bool) -> None:
    """Prints what was found, as JSON or in words."""
    (print_json if as_json else in_words)(found)


def print_result(run: RunRecord) -> None:
    """Print the result of a run, where it has one, and its verdict."""
    if run.result is not None:
        headings = ("", "value", "u, type A (noise)", "u, type B (stage)")
        where = "imported" if run.plan is None else f"on {run.rig}"
        print_table(headings, _rows_of(run), title=f"run {run.id}: unit {run.unit}, {where}")
        print_warnings(run.provenance.get("warnings", ()))
    if run.verdict is not None:
        _print_sentences(run.verdict.says)
    mounts_deg = (run.plan or {}).get("mounts_deg", [0.0])
    if len(mounts_deg) > 1 and run.status == "completed":
        of = f"All of this is of the first mount ({mounts_deg[0]:g}°): " if run.result is not None else ""
        _print_sentences([f"{of}`calrig solve {run.id}` takes all {len(mounts_deg)} mounts together."])


def _rows_of(run: RunRecord) -> Iterable[tuple[str, ...]]:
    """The figures that the verdict judges, with accepted effects; below them the plain fit, if it differs.

    A verification measures errors of indication, no bias and no scale.
    """
    result = run.result
    assert result is not None  # noqa: S101 (as the caller looks for it)
    stage, temperature, gyro, over = result.reference, result.temperature_c, result.gyro, result.over_range
    of_stage = (stage.bias_std_deg, stage.scale_std) if stage else (None, None)
    plain: tuple[tuple[float, float | None], tuple[float | None, float | None]]
    plain = (result.bias_deg, result.bias_std_deg), (result.scale, result.scale_std)
    if not _is_calibration(run):
        if over is not None:
            yield "mean error of indication", number(over.mean_error_deg, "°")
            ends = min(over.lowest_error_deg), max(over.highest_error_deg)
            yield "errors of indication", " to ".join(number(end, "°") for end in ends)
    else:
        bias_deg, bias_std_deg, scale_value, scale_std = _judged_line(result)
        bias, scale = (bias_deg, bias_std_deg), (scale_value, scale_std)
        yield "bias", *(number(value, "°") for value in (*bias, of_stage[0]))
        yield "scale", *(number(value, "", 6) for value in (*scale, of_stage[1]))
        if bias != plain[0]:
            yield "plain fit: bias", *(number(value, "°") for value in plain[0])
            yield "plain fit: scale", *(number(value, "", 6) for value in plain[1])
    yield "RMS raw", number(result.rms_raw_deg, "°")
    yield "RMS calibrated", number(result.rms_calibrated_deg, "°")
    if result.rms_with_effects_deg is not None:
        yield "RMS with effects", number(result.rms_with_effects_deg, "°")
    yield "standard error of a reading", number(result.noise_deg, "°")
    yield "poses", str(result.n_poses)
    lowest, highest = (temperature.min, temperature.max) if temperature else (None, None)
    yield "temperature", number(lowest, f" to {highest:.1f} °C" if highest is not None else "", 1)
    for axis, bias_dps, std_dps in zip("xyz", gyro.bias_dps, gyro.bias_std_dps, strict=True):
        yield f"gyro bias {axis}", number(bias_dps, " °/s"), number(std_dps, " °/s")
    yield "gyro scale", number(gyro.scale, "", 6), number(gyro.scale_std, "", 6)


def _is_calibration(run: RunRecord) -> bool:
    return (run.plan or {}).get("kind") != "verification"


def _judged_line(result: Result) -> tuple[float, float | None, float | None, float | None]:
    """Return bias and scale as the verdict judges them, each with its standard error."""
    over = result.over_range
    if result.rms_with_effects_deg is None or over is None or over.covariance is None:
        return result.bias_deg, result.bias_std_deg, result.scale, result.scale_std
    bias_std_deg, scale_std = (math.sqrt(over.covariance[k][k]) for k in range(2))
    return over.bias_deg, bias_std_deg, over.scale, scale_std


def print_says(sentences: Iterable[str]) -> None:
    """Prints a verdict's sentences on standard error, beside what a program reads on standard output."""
    for sentence in sentences:
        typer.echo(f"· {printable(sentence)}", err=True)


def print_runs(runs: Sequence[RunRecord], next_cursor: str | None, *, is_filtered: bool) -> None:
    """Print runs as a table, one line each, and how to list older ones."""
    if not runs:
        how = (
            "no run matches"
            if is_filtered
            else "no runs yet: `calrig run` or `calrig import` makes the first"
        )
        print_line(how)
        return
    names = ("run", "unit", "rig", "status", "verdict", "created (UTC)", "bias", "scale", "RMS error")
    print_table(names, (_line_of(run) for run in runs), justify="left")
    if next_cursor is not None:
        print_line(f"older runs: --cursor {next_cursor}")


def _line_of(run: RunRecord) -> tuple[str, ...]:
    """Return the figures that the verdict judges; a verification measures no bias and no scale."""
    figures = ("", "", "")
    if (result := run.result) is not None:
        rms_deg = (
            result.rms_calibrated_deg if result.rms_with_effects_deg is None else result.rms_with_effects_deg
        )
        bias_deg, _, scale, _ = _judged_line(result)
        line = (number(bias_deg, "°"), number(scale, "", 6)) if _is_calibration(run) else ("", "")
        figures = (*line, number(rms_deg, "°"))
    status = f"{run.status}, voided" if run.voided is not None else run.status
    created = f"{run.created_at:%Y-%m-%d %H:%M}"
    return short_name(run.id), run.unit, run.rig or "", status, _answer(run.verdict), created, *figures


def _answer(verdict: Verdict | None) -> str:
    if verdict is None:
        return ""
    if verdict.answer != "no_limits" or verdict.left is None:
        return verdict.answer.replace("_", " ")
    return "residual within noise" if verdict.left == "noise" else "residual above noise"


def print_rigs(rigs: Iterable[RigSettings]) -> None:
    """Print the rigs that are configured."""
    rows = (
        (
            rig.name,
            f"{rig.limits_deg[0]:g}° to {rig.limits_deg[1]:g}°",
            *(
                "simulated" if rig.simulated is not None or part is None else f"{part.driver} on {part.port}"
                for part in (rig.stage, rig.imu)
            ),
        )
        for rig in rigs
    )
    print_table(("rig", "elevation", "stage", "imu"), rows, justify="left")


def print_rigs_there(rigs: Iterable[RigState]) -> None:
    """Print the rigs of a running service and what they are doing."""
    rows = (
        (
            rig.name,
            rig.state + (f", run {rig.run_id[:8]}" if rig.run_id else ""),
            *("simulated" if rig.simulated else driver for driver in (rig.stage, rig.imu)),
        )
        for rig in rigs
    )
    print_table(("rig", "is", "stage", "imu"), rows, justify="left")


def print_ports(found: Sequence[Mapping[str, Any]], stanza: str) -> None:
    """Prints who answers on which port, and what can be pasted into the configuration."""
    if not found:
        print_line("there is no serial port: is the USB cable plugged in?")
        return
    names = ("port", "kind", "driver", "identity", "usb_id", "usb_serial")
    rows = (tuple(one[name] or "" for name in names) for one in found)
    print_table(("port", "device", "driver", "identity", "USB", "serial number"), rows, justify="left")
    if stanza:
        print_line(f"for calrig.toml:\n\n{stanza.rstrip()}")


def print_users(users: Sequence[KnownUser]) -> None:
    """Print all users."""
    if not users:
        print_line("nobody is known by name: `calrig users add NAME --role admin` makes the first one known")
        return
    rows = ((user.name, user.role, _way_in(user), str(user.created_at)[:10]) for user in users)
    print_table(("name", "role", "comes in", "since"), rows, justify="left")


def _way_in(user: KnownUser) -> str:
    if user.disabled_at is not None:
        return "no more"
    return "by token, or a trusted proxy" if user.has_token else "by a trusted proxy"


def print_moved(moved: Moved) -> None:
    """Prints what a store that was taken over consists of; `--json` has the hashes in full."""
    rows = ((table.name, str(table.rows), f"{table.sha256[:16]}…") for table in moved.tables)
    print_table(("table", "rows", "SHA-256, the same at both ends"), rows)
    print_line(f"moved in {moved.duration_s:.1f} s")


def print_benches(benches: Sequence[Membership]) -> None:
    """Print which benches may join, have joined or were revoked."""
    if not benches:
        print_line("no bench has joined: `calrig bench add NAME` makes a code for the first one")
        return
    rows = (
        (b.name, b.hall or "", _standing(b), b.version or "", str(b.last_seen_at or "")[:19]) for b in benches
    )
    print_table(("bench", "hall", "is", "calrig", "last seen, UTC"), rows, justify="left")


def _standing(bench: Membership) -> str:
    if bench.code_until is not None:
        return f"awaited until {bench.code_until:%Y-%m-%d %H:%M} UTC"
    if bench.revoked_at is not None:
        return "revoked"
    notes = [bench.refused and f"takes no orders: {bench.refused}", bench.clock]
    return "; ".join(["joined", *filter(None, notes)])


def print_diagnosis(found: Diagnosis, *, of_files: bool) -> None:
    """Print a diagnosis: verdict, each effect with parameters and evidence, the errors before and after.

    `of_files` tells whether its poses are files, of which no service can take a follow-up run.
    """
    from calrig.calibration.effects import EFFECTS
    from calrig.calibration.uncertainty import SAME_EFFECT

    print_line(f"{found.verdict}: {found.final.model}", style="bold")
    for effect in found.effects:
        _print_effect(effect, reference_is_good=found.reference == "good")
    print_line("")
    base, final, noise = found.base, found.final, found.noise
    rows = [
        ("fit", number(base.fit_rms_deg, "°"), number(final.fit_rms_deg, "°")),
        ("held-out poses", number(base.held_out_rms_deg, "°"), number(final.held_out_rms_deg, "°")),
        ("held-out blocks", number(base.blocked_rms_deg, "°"), number(final.blocked_rms_deg, "°")),
        ("noise floor", "", number(noise.floor_deg, "°")),
        ("pure error", "", number(noise.pure_error_deg, "°")),
    ]
    print_table(("RMS", "before", "after"), rows)
    says = found.says[1:]  # the first has the names, as above
    for sentence in (f"held out: {found.held_out.how}", *says, *_of_base(base)):
        print_sentence(sentence)
    print_warnings(found.warnings)
    if found.follow_up is not None:
        sigmas = f"{found.follow_up.separation_sigma:.1f} standard errors"
        separated = [
            EFFECTS[name].wording(reference_is_good=found.reference == "good").title
            for name in found.follow_up.separates
        ]
        names = " and ".join(separated if len(separated) > 1 else [*separated, SAME_EFFECT])
        how = "its plan is in --json" if of_files else f"POST /api/runs/{found.runs[-1]}/follow-up"
        print_line(f"a follow-up run would separate {names} by {sigmas}: {how}")


def _of_base(base: BaseErrors) -> Iterator[str]:
    """Bias and scale, in which degrees RMS and sizes are, and why there is no error before."""
    bias = angle_text(base.bias_deg, 5)
    scale = "not known" if base.scale is None else f"{base.scale:z.5f}".replace("-", "−")
    yield f"before: bias {bias}, scale {scale}; RMS in degrees of elevation, sizes in degrees of the reading"
    if base.fit_rms_deg is None:
        yield "no error before is stated: with bias and scale alone the readings do not follow the stage"


def print_fleet(found: dict[str, Any]) -> None:
    """Prints what a fleet's re-analysis changed, and how large each rig's error is."""
    n, changed = found["runs"], found["changed"]
    print_line(f"{n} runs in {found['duration_s']:.1f} s, {len(changed)} with another verdict", style="bold")
    if changed:
        rows = [(c["run_id"], c["verdict_before"] or "", c["verdict_now"] or "") for c in changed]
        print_table(("run", "before", "now"), rows, justify="left")
    if found["failed"]:
        lost = [(one["run_id"], printable(one["error"])) for one in found["failed"]]
        print_table(("run", "failed, and is tried again next time"), lost, justify="left")
    maps = [(rig["rig"], rig["units"], rig["map"]["error_deg"]) for rig in found["rigs"]]
    by_rig = [
        (name, str(units), str(len(errors)), number(max(map(abs, errors), default=None), "°"))
        for name, units, errors in maps
    ]
    if by_rig:
        print_table(("rig", "units", "places in common", "largest error"), by_rig)


def print_gravity(found: dict[str, Any]) -> None:
    """Print a calibration against gravity: parameters with standard errors, |a| − 1 g before and after."""
    base, final, n = found["base"], found["final"], found["n_poses"]
    names = [effect["name"] for effect in found["effects"]]
    print_line(f"{found['verdict']}: {', '.join(['bias', 'scale', *names])}", style="bold")
    axes = zip("xyz", *(final[key] for key in ("bias_g", "bias_std_g", "scale", "scale_std")), strict=True)
    rows = [
        (axis, *_with_error(1e3 * bias, 1e3 * bias_std), *_with_error(gain, gain_std))
        for axis, bias, bias_std, gain, gain_std in axes
    ]
    print_table(
        ("axis", "bias, mg", "±", "gain", "±"), rows, caption="gain = reading by acceleration, along the axis"
    )
    angles = [
        (name.removesuffix("_mrad"), *_with_error(value, std), *_with_error(*_in_deg(value, std)))
        for effect in found["effects"]
        for name, value, std in ((name, *one.values()) for name, one in effect["parameters"].items())
        if name.endswith("_mrad") and value is not None
    ]
    if angles:
        print_table(("misalignment", "mrad", "±", "°", "±"), angles)
    for effect in found["effects"]:
        for name, parameter in effect["parameters"].items():
            if not name.endswith("_mrad"):
                print_parameter(f"{effect['title']}: {name}", parameter)
        if effect["confusable_with"]:
            print_line(
                f"  {effect['name']} is not distinguishable from {', '.join(effect['confusable_with'])}"
            )
    errors = (
        (name, number(base[key], " mg", 2), number(final[key], " mg", 2))
        for name, key in (("fit", "fit_rms_mg"), ("held out", "held_out_rms_mg"))
    )
    said = f"before: bias and gain alone\nheld out: {found['held_out']['how']}"
    print_table((f"RMS of |a| − 1 g, {n} poses", "before", "after"), errors, caption=said)
    print_warnings(found["warnings"])


def _with_error(value: float, std: float) -> tuple[str, str]:
    """Return a value and its standard error as text, to two digits of the error."""
    decimals = min(max(1 - math.floor(math.log10(std)), 0), 12) if std > 0.0 else 6
    return f"{value:z.{decimals}f}", f"{std:.{decimals}f}"


def _in_deg(mrad: float, std_mrad: float) -> tuple[float, float]:
    return math.degrees(mrad / 1e3), math.degrees(std_mrad / 1e3)


def print_noise(found: NoiseReport) -> None:
    """Print CONTRACT section 7's noise report: the paper's Table 2 for this unit, then the summary."""
    from calrig.noise.units import bias_instability, level, white_density

    rows = (
        (
            name,
            _signed(channel.adf_slope),
            _signed(channel.psd_slope),
            level(name, channel.std),
            _level(name, channel.coefficients.white, white_density),
            _level(name, channel.coefficients.flicker, bias_instability),
            channel.colour or "",
        )
        for name, channel in found.channels.items()
    )
    headings = ("channel", "ADEV slope", "PSD slope", "std", "white noise", "flicker", "colour")
    print_table(headings, rows, caption="white noise alone has slopes of −0.5 and 0")
    _print_sentences(found.summary)


def print_filters(found: dict[str, Any]) -> None:
    """Prints a comparison of filters: one row each, then what it says."""
    rows = (
        (
            row["label"],
            number(row["jitter_deg"], "°"),
            _signed(row["lag_ms"], " ms", 1),
            number(row["largest_offset_deg"], "°", 3),
            "yes" if row["causal"] else "no",
        )
        for row in found["filters"]
    )
    headings = ("filter", "jitter in 100 ms", "lag", "largest offset", "causal")
    print_table(headings, rows, caption="Nirmal et al. (2016): jitter 0.330° → 0.143°")
    _print_sentences(found["summary"])


def _print_effect(effect: EffectFound, *, reference_is_good: bool) -> None:
    from calrig.calibration.effects import EFFECTS, covariate_of
    from calrig.calibration.uncertainty import SAME_EFFECT

    known, covariate, changed = EFFECTS[effect.name], covariate_of(effect.covariate), effect.changed
    own = known.wording(reference_is_good=reference_is_good, covariate=effect.covariate)
    others = [
        SAME_EFFECT
        if name == known.name
        else EFFECTS[name].wording(reference_is_good=reference_is_good).title
        for name in effect.confusable_with
    ]
    against = f"against {covariate.title}" + (f" in {covariate.unit}" if covariate.unit else "")
    between = f", changed from run {changed.from_} to run {changed.to}" if changed else ""
    heading = f"{', or '.join([own.title, *others])}{between}"
    print_line(f"\n{heading} ({effect.verdict}; {own.owner}; {against})")
    for one in known.parameters:
        if not one.flag:
            unit = covariate.unit if one.unit is None else one.unit
            print_parameter(one.title, effect.parameters.get(one.name), unit)
    for sentence in (*effect.evidence, effect.remedy):
        print_sentence(f"  · {sentence}")


def _print_sentences(sentences: Iterable[str]) -> None:
    for sentence in sentences:
        print_sentence(f"· {sentence}")


def _signed(value: float | None, unit: str = "", decimals: int = 2) -> str:
    return "not known" if value is None else f"{value:+z.{decimals}f}{unit}".replace("-", "−")


def _level(name: str, found: Coefficient | None, words: Callable[[str, float], str]) -> str:
    return "not known" if found is None else words(name, found.value)
