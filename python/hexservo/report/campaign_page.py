"""The page of a campaign, in the style of a run's report."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from hexservo.campaigns.distributions import Variation
from hexservo.campaigns.drawing import with_unit
from hexservo.campaigns.pictures import campaign_sections
from hexservo.campaigns.result import CampaignResult
from hexservo.campaigns.writing import require_own, write_bytes, write_text
from hexservo.draw.evidence import item_figure
from hexservo.draw.style import image_bytes
from hexservo.findings.evidence import Column, Section, Table
from hexservo.report.evidence_html import badges, item_html, section_html, table_html
from hexservo.report.html import TITLE, Html, element, paragraphs
from hexservo.report.page import assembled, explanations, plotly_script, scenario_part
from hexservo.run.files import check_folder, mark_folder
from hexservo.run.publish import named
from hexservo.scenario.wording import wrong_type

__all__ = ["REPORT", "write_campaign_report"]

REPORT, PICTURES = "report.html", "pictures"


def write_campaign_report(result: CampaignResult, more: tuple[Section, ...] = (), *, pictures: bool = False) -> Path:
    """Write ``report.html`` into a campaign's folder: one HTML file, in place of an earlier report (docs/campaigns.md).

    Other files of that name are kept, as are pictures that hexservo did not write or that were changed since.

    Parameters
    ----------
    result
        The campaign; it need not be complete.
    more
        Sections of other findings, such as those of `worst_case`, `sensitivity` and `tune`.
    pictures
        Write every picture as SVG and PNG too, into the folder ``pictures`` beside it.

    Returns
    -------
    Path
        Of the file.

    Raises
    ------
    TypeError
        For anything but a `CampaignResult`.
    ResultError
        A chunk is damaged.
    OutputError
        There is such a file that is no report, or the folder ``pictures`` holds other files; both are kept. Or they
        cannot be written.
    """
    if not isinstance(result, CampaignResult):
        raise wrong_type("result", "a CampaignResult (see hs.campaign)", result)
    require_own_report(result.folder, pictures=pictures)
    path, folder = result.folder / REPORT, result.folder / PICTURES
    sections = [*campaign_sections(result), *more]
    verdict, *others = sections
    plan = result.plan
    rows = [(with_unit(plan.scenario, key), _words(variation)) for key, variation in plan.vary.items()]
    varied = Table("What varies", (Column("key"), Column("distribution")), rows, page="docs/campaigns.md")
    parts = [
        ("verdict", "Verdict", section_html(verdict, "section-verdict")),
        *((section.name, section.title, _content(section)) for section in others),
        ("vary", "Variations", table_html(varied)),
        ("scenario", "Scenario", scenario_part(plan.scenario)),
        ("versions", "Versions", _versions(result)),
        ("pages", "Explanations", explanations(sections)),
    ]
    name = f"Campaign on {plan.scenario.name}"
    write_text(path, assembled(name, result.section().sentences[0], parts, plotly_script()))
    if pictures:
        _write_pictures(folder, sections)
    return path


def require_own_report(folder: Path, *, pictures: bool = False) -> None:
    """Refuse the folder of a campaign where `write_campaign_report` would keep what is there.

    Raises
    ------
    OutputError
        As `write_campaign_report`, as far as it can be checked without writing.
    """
    if not folder.is_dir():
        return
    require_own(folder / REPORT, lambda content: content.startswith(f"{TITLE}\n".encode()))
    if pictures:
        check_folder(folder / PICTURES, force=True)


def _write_pictures(folder: Path, sections: Sequence[Section]) -> None:
    """Write the pictures of sections into a folder; the same picture gives the same bytes."""
    names: Counter[str] = Counter()
    images: dict[str, bytes] = {}
    for section in sections:
        for item in section.items:
            if isinstance(item, Table):
                continue
            name = f"{section.name}-{re.sub('[^a-z0-9]+', '-', item.title.lower()).strip('-')}"
            names[name] += 1
            if names[name] > 1:  # as of two bounds of one metric
                name = f"{name}-{names[name]}"
            figure = item_figure(item)
            images |= {f"{name}.{kind}": image_bytes(figure, kind) for kind in ("svg", "png")}
    for name, content in images.items():  # all at once: an interruption seldom leaves some without the marker
        write_bytes(folder / name, content)
    if images:
        mark_folder("the pictures of a campaign", folder)


def _content(section: Section) -> Html:
    """Return a section without the title, which its part has."""
    return element("div", *badges(section), paragraphs(*section.sentences), *map(item_html, section.items))


def _words(variation: Variation) -> str:
    """Return a distribution as the file has it."""
    plain = variation.to_plain()
    return (
        plain if isinstance(plain, str) else ", ".join(f"{key}: {str(value).lower()}" for key, value in plain.items())
    )


def _versions(result: CampaignResult) -> Html:
    summary = result.summary
    rows = [
        ("hexservo", summary["hexservo"]),
        ("compiled variant", summary["variant"]),
        ("campaign", summary["campaign"]),
        ("folder", named(result.folder)),
    ]
    return element("div", table_html(Table("What ran", (Column("part"), Column("value")), rows)))
