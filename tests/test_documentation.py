"""Check README and docs: links resolve, pages keep their size, commands and configuration keys exist."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
import typer
from pydantic import BaseModel

from calrig.cli.main import app
from calrig.laboratory import LaboratorySettings, StandardSettings
from calrig.settings import (
    BoardSettings,
    CentreSettings,
    FilterSettings,
    LimitSettings,
    ReferenceSettings,
    RigSettings,
    Settings,
    StageSettings,
    WebhookSettings,
)

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "calrig" / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
FOLDERS = {"tutorial", "how-to", "reference", "explanation", "validation"}
README_LINES, PAGE_LINES = 150, 120
CONFIGURED = (
    Settings,
    RigSettings,
    StageSettings,
    BoardSettings,
    ReferenceSettings,
    StandardSettings,
    FilterSettings,
    LimitSettings,
    LaboratorySettings,
    CentreSettings,
    WebhookSettings,
)


def named(page: Path) -> str:
    """The path of a page in the repository."""
    return str(page.relative_to(ROOT))


def prose(page: Path) -> str:
    """The page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """The headings of a page, as GitHub names them in addresses."""
    titles = re.findall(r"^#+ (.*)$", prose(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def leaves(
    command: click.Command, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Every command by its words."""
    yield path, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from leaves(inner, (*path, name))


COMMANDS = dict(leaves(typer.main.get_command(app)))


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_every_relative_link_leads_somewhere(page):
    dead = []
    for link in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if link.startswith(("http:", "https:")):
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            dead.append(link)
    assert dead == []


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_a_page_has_at_most_so_many_lines(page):
    most = README_LINES if page.name == "README.md" else PAGE_LINES
    assert len(page.read_text(encoding="utf-8").splitlines()) <= most


def test_pages_lie_in_five_folders_and_each_is_reached_by_a_link():
    assert {page.parent for page in PAGES[1:]} == {DOCS / folder for folder in FOLDERS}
    linked = {
        (page.parent / link.partition("#")[0]).resolve()
        for page in PAGES
        for link in re.findall(r"\]\(([^)\s:]+)\)", prose(page))
    }
    assert [named(page) for page in PAGES[1:] if page not in linked] == []


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_every_command_shown_exists_with_its_options(page):
    text = page.read_text(encoding="utf-8")
    shells = re.findall(r"^```sh\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    code = [*re.findall(r"`([^`\n]+)`", prose(page)), *"\n".join(shells).splitlines()]
    code += re.findall(r"^    (.*)$", prose(page), flags=re.MULTILINE)
    shown = [one for line in code for one in re.findall(r"(?:^|[|;&] |bin/)calrig ([a-z][^|;#]*)", line)]
    wrong = []
    for line in shown:
        words = re.findall(r"^[a-z-]+(?: (?:add|token|role|disable|list|revoke|enroll)\b)?", line)[0].split()
        command = COMMANDS.get(tuple(words)) or COMMANDS.get((words[0],))
        options = set(re.findall(r"(?<![\w-])--[a-z-]+", line)) - {"--help"}
        if command is None or options - {
            name for one in command.params for name in (*one.opts, *one.secondary_opts)
        }:
            wrong.append(line)
    assert wrong == []


def test_the_reference_of_commands_has_every_option():
    told = (DOCS / "reference" / "cli.md").read_text(encoding="utf-8")
    rows = {row.split("`")[1]: row for row in told.splitlines() if row.startswith("| `calrig ")}
    missing = []
    for path, command in COMMANDS.items():
        if not path or (getattr(command, "commands", None) and path != ("agent",)):
            continue
        row = next((row for shown, row in rows.items() if shown.split()[1 : 1 + len(path)] == list(path)), "")
        options = [one.opts[0] for one in command.params if one.param_type_name == "option"]
        missing += [(" ".join(path), name) for name in options if f"{name}" not in row]
    assert missing == []


@pytest.mark.parametrize("model", CONFIGURED, ids=lambda model: model.__name__)
def test_the_reference_of_the_configuration_has_every_key(model: type[BaseModel]):
    told = (DOCS / "reference" / "configuration.md").read_text(encoding="utf-8")
    keys = set(re.findall(r"(?:\b|\.)([a-z][a-z0-9_]+)\b", " ".join(re.findall(r"`[^`\n]+`", told))))
    assert [name for name in model.model_fields if name not in keys] == []


@pytest.mark.parametrize("unit", ["calrig.service", "calrig-agent.service"])
def test_systemd_takes_each_unit(unit: str, tmp_path: Path) -> None:
    """As written, but for the place of the program, which is not installed there."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze")
    page = (DOCS / "how-to" / "operate-a-centre.md").read_text(encoding="utf-8")
    (text,) = re.findall(rf"^```ini\n# {unit}: .*?\n(.*?)^```", page, flags=re.DOTALL | re.MULTILINE)
    program = shutil.which("true")
    (tmp_path / unit).write_text(text.replace("/opt/calrig/bin/calrig", str(program)))
    verify = ["systemd-analyze", "verify", "--man=no", tmp_path / unit]
    done = subprocess.run(verify, check=False, capture_output=True, text=True)
    assert (done.returncode, [line for line in done.stderr.splitlines() if unit in line]) == (0, [])
