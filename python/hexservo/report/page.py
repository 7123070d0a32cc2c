"""Assembles the page: its parts in order, with style, scripts and plotly.js inside."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hexservo.findings.check import unlikely
from hexservo.findings.evidence import Column, Section, Table
from hexservo.findings.sections import Group, groups
from hexservo.report.documentation import is_page, page_html
from hexservo.report.evidence_html import badge, badges, section_html, table_html
from hexservo.report.figures import figures
from hexservo.report.html import TITLE, Html, element, json_script, paragraphs, sentence
from hexservo.report.scene import SpaceView, scene
from hexservo.report.still import VIEW, still
from hexservo.run.machine import versions
from hexservo.run.metrics import metric_meaning, metric_name, readable, shown_metrics
from hexservo.run.summary import summary_sentences

if TYPE_CHECKING:
    from hexservo.run.result import Result
    from hexservo.scenario.scenario import Scenario

# The browser itself prevents the page and its libraries from loading anything.
_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data: blob:; "
    "form-action 'none'; base-uri 'none'"
)
_SLIDER = "The slider takes smaller steps until the run has settled."
_MAX_SCENARIO = 60_000  # characters of the scenario that are shown: a recorded motion can be far longer
_METRICS_PAGE = "docs/model.md"
_WORST_FIRST = ("bad", "warning", "good", "open")  # verdicts, as the summary has them; the diagnosis before others


def page(result: Result) -> str:
    """Return the complete page of a run, beginning with the line that identifies reports."""
    name = result.scenario.name
    plotly = plotly_script()
    found = [group for group in groups(result) if group.sections or group.refusal]
    parts = [
        ("summary", "Summary", _summary(result, found)),
        ("figures", "Figures", _figures(result)),
        ("space", "The machine in space", _space(scene(result))),
        *((group.source.name, group.source.title, _group(group)) for group in found),
        ("metrics", "Metrics", _metrics(result)),
        ("scenario", "Scenario", scenario_part(result.scenario)),
        ("versions", "Versions", _versions(result, plotly)),
        ("pages", "Explanations", explanations([section for group in found for section in group.sections])),
    ]
    return assembled(name, result.scenario.description, parts, plotly)


def assembled(name: str, lead: str, parts: Sequence[tuple[str, str, Html]], plotly: str) -> str:
    """Return a page from its parts, each with its anchor and its title, and a sentence below the heading."""
    head = element(
        "head",
        Html('<meta charset="utf-8">'),
        Html(f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'),
        Html('<meta name="viewport" content="width=device-width, initial-scale=1">'),
        Html('<meta name="color-scheme" content="light dark">'),
        element("title", f"{name}: hexservo report"),
        element("style", Html(_asset("report.css"))),
    )
    contents = [element("li", element("a", title, href=f"#{anchor}")) for anchor, title, _ in parts]
    body = element(
        "body",
        element("header", element("h1", name), *([element("p", lead, class_="lead")] if lead else [])),
        element("nav", element("ul", *contents), aria_label="Contents"),
        element(
            "noscript",
            element("p", "JavaScript is off: there are no charts."),
        ),
        element("main", *[_part(*part) for part in parts]),
        element("script", Html(plotly)),
        element("script", Html(_asset("report.js"))),
    )
    return f"{TITLE}\n" + element("html", head, body, lang="en") + "\n"


def _part(anchor: str, title: str, content: Html) -> Html:
    return element("section", element("h2", title), content, id=anchor, class_="part")


def _summary(result: Result, found: list[Group]) -> Html:
    """Summarise the run, then warnings about its scenario, then each section's verdict and most important finding.

    The worst verdicts are first.
    """
    sections = [(group, section) for group in found for section in group.sections]
    sections.sort(key=lambda pair: (_WORST_FIRST.index(pair[1].verdict), pair[0].source.name != "diagnose"))
    doubts = [
        element("li", badge("warning"), " ", element("a", "Scenario", href="#scenario"), ": ", sentence(doubt))
        for doubt in unlikely(result.scenario, by_law=result.by_law)
    ]
    rows = doubts + [
        element(
            "li",
            *(Html(f"{one} ") for one in badges(section)),
            element("a", section.title, href=f"#{_anchor(group, section)}"),
            ": ",
            sentence(section.sentences[0]) if section.sentences else "no findings",
        )
        for group, section in sections
    ]
    rows += [
        element("li", badge("open"), f" {group.source.title}: {group.refusal}") for group in found if group.refusal
    ]
    events = [element("li", str(event)) for event in result.events]
    return Html(
        element("ul", *[element("li", words) for words in summary_sentences(result)], class_="findings")
        + (element("ul", *events, class_="events") if events else "")
        + (element("ul", *rows, class_="verdicts") if rows else "")
    )


def _figures(result: Result) -> Html:
    return Html(
        "".join(
            element("section", element("h3", title), element("div", *charts, class_="charts"))
            for title, charts in figures(result)
        )
    )


def _space(seen: SpaceView) -> Html:
    """Return the view in space, its slider, and the still picture that replaces it."""
    last = str(len(seen.time) - 1)
    controls = element(
        "div",
        element("button", "Play", type="button", id="play"),
        Html(f'<input type="range" id="instant" max="{last}" value="{last}" aria-label="Instant of the run">'),
        element("output", "", id="readout", for_="instant"),
        class_="controls",
    )
    targets = "Coloured rays end at the targets." if seen.targets is not None else "This plant has no targets in space."
    legs = "legs" if seen.feet is None else "rods; thick: cranks"
    centred = not (seen.on_base or seen.camera.any())
    where = "at the centre of the platform" if centred else f"on the {'base' if seen.on_base else 'platform'}"
    down = "down" if seen.z_down else "up"
    axis = f"points {down}; the view is upright." if seen.upright else f"is drawn {down}wards; it is not vertical."
    words = (
        f"Grey: base and {legs}. Orange: legs beyond a limit. Blue: platform. In front of the camera, {where}, "
        "is its image: "
        f"dots are features, squares their goals, lines the paths so far. {targets} The axis z of B {axis} "
    )
    shown = (
        f"features, ±{np.abs(seen.border[:, :2]).max() * seen.pixels_per_metre:.4g} px shown"
        if seen.size is None
        else f"{seen.size[0]:g} x {seen.size[1]:g} px"
    )
    image = element(
        "div",
        element("p", f"Camera image ({shown}, y up)"),
        Html('<svg id="image" role="img" aria-label="The image at the selected instant"></svg>'),
        class_="image",
    )
    return element(
        "figure",
        element(
            "div",
            element("div", id="webgl", role="img", aria_label="Interactive view of the machine in space"),
            image,
            class_="side",
        ),
        controls,
        still(seen),
        element("p", "", id="webgl-missing", hidden=True),
        element("figcaption", words, *([element("span", _SLIDER, class_="slider")] if seen.finer else [])),
        json_script({**seen.to_plain(), "view": VIEW}, id="scene"),
        id="view",
    )


def _group(group: Group) -> Html:
    if group.refusal:
        return paragraphs(group.source.introduction, f"Not available for this run: {group.refusal}")
    sections = [section_html(section, _anchor(group, section)) for section in group.sections]
    return Html(paragraphs(group.source.introduction) + "".join(sections))


def _anchor(group: Group, section: Section) -> str:
    return f"{group.source.name}-{section.name}"


def _metrics(result: Result) -> Html:
    robot = result.scenario.robot
    rows = [
        (metric_name(name, robot), " ".join(readable(name, value, robot)).strip(), metric_meaning(name, robot))
        for name, value in shown_metrics(result).items()
    ]
    columns = (Column("metric"), Column("value"), Column("meaning"))
    return table_html(Table("Computed at every step of the run", columns, rows, page=_METRICS_PAGE))


def scenario_part(scenario: Scenario) -> Html:
    """Return a scenario as YAML."""
    text = scenario.to_yaml()
    cut = len(text) - _MAX_SCENARIO
    if cut > 0:
        text = text[:_MAX_SCENARIO]
    return Html(
        paragraphs("Every key is resolved. Save it as a file and run it with hexservo run FILE.")
        + element("pre", element("code", text), tabindex="0", aria_label="Scenario as YAML")
        + paragraphs(f"{cut} more characters are left out here." if cut > 0 else "")
    )


def _versions(result: Result, plotly: str) -> Html:
    here = versions()
    rows = [("simulated by hexservo", result.version), ("report by hexservo", here.pop("hexservo"))]
    rows += [*here.items(), ("plotly.js", _plotly_version(plotly)), ("seed", str(result.scenario.seed))]
    return table_html(Table("What ran", (Column("part"), Column("version")), rows))


def explanations(sections: Sequence[Section]) -> Html:
    """Return the pages that explain the report, collapsed until a link to one is followed."""
    named = [item.page for section in sections for item in section.items]
    names = [name for name in dict.fromkeys([*named, _METRICS_PAGE]) if is_page(name)]
    return Html(
        paragraphs("Pages of the documentation that this report refers to, in the version that wrote it.")
        + "".join(page_html(name, names) for name in names)
    )


# ---- What is put inside ---------------------------------------------------------------------------------------------


def _asset(name: str) -> str:
    return (resources.files(__package__) / name).read_text(encoding="utf-8")


def plotly_script() -> str:
    """Return plotly.js from the package plotly, without importing it, which would take longer than the page."""
    package = find_spec("plotly")
    script = Path(package.origin or "").parent / "package_data" / "plotly.min.js" if package else Path()
    if script.is_file():
        text = script.read_text(encoding="utf-8")
    else:
        from plotly.offline import get_plotlyjs

        text = str(get_plotlyjs())
    return text.replace("</script", "<\\/script")


def _plotly_version(script: str) -> str:
    match = re.search(r"plotly\.js v(\d[\w.+-]*)", script[:1000])
    return match[1] if match else "unknown"
