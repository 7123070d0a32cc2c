"""Builds the site: ``python docs/tools/build_site.py --out build/site`` (`make docs`).

The pages are those of the repository, in the same folders, so that their links hold; links to source files become pages
of these. Written here are the front page, the reference of the public names, the commands, the keys of a scenario, the
metrics, the C++ headers and the gallery. Every warning of Sphinx is an error, and every link within the finished site
is followed: none is broken, and every page is reached.
"""

from __future__ import annotations

import argparse
import inspect
import json
import os
import posixpath
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import unquote, urlsplit

import hexservo as hs
from gallery import gallery
from hexservo.report.explorer import ExplorerError, checked_page
from hexservo.scenario.fields import field_names
from hexservo.scenario.schema import bounds_of, choices_of
from reference_pages import commands_page, headers_page

ROOT = Path(__file__).resolve().parents[2]
PARTS = ROOT / "docs" / "site"
ROOT_PAGES = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "BENCHMARKS.md")
GROUPS = {"analysis": "Before a run: analysis", "certificate": "After a run: certificate", "diagnosis": "Diagnosis"}
# Pages of docs/ that the front page lists by name; all others are guides.
LISTED = {"model", "errata", "claims", "proof", "robustness", "testing", "your-machine"}
EXPLORER = ROOT / "python" / "hexservo" / "explorer.html"
BAR = "\\|"  # in a cell of a table
MARKER = ".hexservo-site"  # in every folder that is written here

# Public names by what they are for, in the order of the reference; a name that is missing here is an error.
REFERENCE = {
    "Scenarios": ["load_scenario", "scenario_names", "Scenario", "ScenarioError", "camera_from_opencv"],
    "Reach": ["project", "reachable", "Reachability"],
    "Runs": [
        *("simulate", "Result", "LimitEvent", "metrics", "METRICS", "load_result"),
        *("ResultError", "OutputError", "VariantError"),
    ],
    "Controllers": [
        "Controller",
        "ControllerOutput",
        "Observation",
        "LegForces",
        "LegPositions",
        "feedback_margin",
        "integral_margin",
        "c_library",
    ],
    "Batches": ["simulate_batch", "BatchResult"],
    "Comparisons": ["compare", "Comparison", "ComparisonRow"],
    "Check, analysis, certificate, diagnosis": [
        *(
            "check",
            "Check",
            "analyse",
            "Analysis",
            "certify",
            "Certificate",
            "certify_batch",
            "BatchCertificate",
            "diagnose",
            "Diagnosis",
        ),
    ],
    "Machines from logs": ["read_log", "Log", "identify", "Identification"],
    "Campaigns": [
        *("campaign", "campaign_names", "CampaignPlan", "load_campaign", "CampaignResult", "WorstRun"),
        *("worst_case", "WorstCase", "estimate_rare_failures", "RareFailures", "sensitivity", "Sensitivity"),
        *("tune", "TuneResult"),
    ],
    "Reports and figures": ["write_report", "write_campaign_report", "plots"],
    "Other tools": ["bridges"],
}


# ---- Pages of the repository ----------------------------------------------------------------------------------------


def outside_code(text: str) -> Iterator[tuple[bool, str]]:
    """Split a page into pieces of prose (True) and of code (False)."""
    end = 0
    for code in re.finditer(r"^(```+|~~~+).*?^\1\s*?$|(`+)(?!`).+?(?<!`)\2(?!`)", text, re.DOTALL | re.MULTILINE):
        yield True, text[end : code.start()]
        yield False, code[0]
        end = code.end()
    yield True, text[end:]


def with_source_links(text: str, page: str) -> str:
    """Return a page whose links to files and folders that are no pages lead to ``source:`` and their path."""

    def target(link: re.Match[str]) -> str:
        path = posixpath.normpath(posixpath.join(posixpath.dirname(page), unquote(link[1])))
        file = ROOT / path
        if re.match(r"[a-z+.-]+:|#", link[1]) or not file.exists() or file.suffix in (".md", ".svg", ".png"):
            return link[0]
        return f"](source:{path})"

    return "".join(
        re.sub(r"\]\(([^()\s#]+)\)", target, piece) if prose else piece for prose, piece in outside_code(text)
    )


def stage_pages(folder: Path) -> list[str]:
    """Copy the repository's pages and figures into the folder of Sphinx's sources; return the names of the pages."""
    names = [*ROOT_PAGES, *(file.relative_to(ROOT).as_posix() for file in sorted((ROOT / "docs").rglob("*.md")))]
    for name in names:
        write(folder / name, with_source_links((ROOT / name).read_text(encoding="utf-8"), name))
    shutil.copytree(ROOT / "docs" / "figures", folder / "docs" / "figures")
    return names


def write(file: Path, text: str) -> None:
    """Write a page and the folders above it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="utf-8")


# ---- Pages that are written here ------------------------------------------------------------------------------------


def front_page(names: list[str], explorer: Path | None) -> str:
    """Return the front page with its lists of pages."""
    pages = [name.removesuffix(".md") for name in names if name.count("/") == 1]
    guides = [page for page in pages if page.removeprefix("docs/") not in LISTED]
    if explorer is None:
        place = (
            "[The explorer](docs/explorer.md), a page that runs the core in a browser, is not part of this build of\n"
            "the site: `make explorer` builds it, and `hexservo explore` opens it."
        )
    else:
        place = (
            '<iframe class="explorer" src="explorer.html" title="The controller in your browser"></iframe>\n\n'
            '<a href="explorer.html">In the whole window</a>; [what it shows](docs/explorer.md).'
        )
    text = (PARTS / "index.md.in").read_text(encoding="utf-8")
    return text.replace("@EXPLORER@", place).replace("@GUIDES@", "\n".join(guides))


def group_page(group: str, names: list[str]) -> str:
    """Return a page that lists the pages of a folder of docs/."""
    pages = [name.removesuffix(".md") for name in names if name.startswith(f"docs/{group}/")]
    pages.sort(key=lambda page: (not page.endswith("/ranking"), page))  # an overview is first
    return f"# {GROUPS[group]}\n\n```{{toctree}}\n:maxdepth: 1\n\n" + "\n".join(pages) + "\n```\n"


def first_line(name: str) -> str:
    """Return the first line of a name's docstring; of one without, what it is."""
    thing = getattr(hs, name)
    if name == "METRICS":
        return "Unit and description of each metric."
    return (inspect.getdoc(thing) or "").partition("\n")[0].replace("``", "`")


def api_pages() -> dict[str, str]:
    """Return the pages of the reference by their names: one for each public name, and a list of them."""
    listed = [name for group in REFERENCE.values() for name in group]
    missing = set(hs.__all__) - {"__version__"} ^ set(listed)
    if missing or len(listed) != len(set(listed)):
        raise SystemExit(f"REFERENCE of docs/tools/build_site.py differs from hexservo.__all__ in {sorted(missing)}")
    pages = {}
    index = [
        "# Reference of the Python package\n",
        "`import hexservo as hs`; `hs.__version__` is its version. Units are SI.\n",
    ]
    for title, group in REFERENCE.items():
        index += [f"## {title}\n", "| name | |", "| --- | --- |"]
        index += [f"| [`hs.{name}`]({name}.md) | {first_line(name)} |".replace("\n", " ") for name in group]
        index.append("")
        for name in group:
            pages[f"api/{name}.md"] = f"# {name}\n\n" + api_body(name, getattr(hs, name))
    toctree = "```{toctree}\n:hidden:\n\n" + "\n".join(listed) + "\n```\n"
    return {"api/index.md": "\n".join([*index, toctree]), **pages}


def api_body(name: str, thing: Any) -> str:
    """Return the directive that documents a public name."""
    if isinstance(thing, ModuleType):
        directive = [f".. automodule:: hexservo.{name}", ""]
        directive += [f".. autofunction:: hexservo.{name}.{each}" for each in thing.__all__]
    elif isinstance(thing, dict):
        about = (
            "   A mapping from the name of a metric to its unit and what it is: the table of :doc:`metrics </metrics>`."
        )
        directive = [f".. py:data:: hexservo.{name}", "", about]
    elif inspect.isclass(thing) and issubclass(thing, Exception):
        directive = [f".. autoexception:: hexservo.{name}", "   :members:", "   :show-inheritance:"]
    elif inspect.isclass(thing):
        directive = [f".. autoclass:: hexservo.{name}", "   :members:"]
        apart = list(field_names(thing))  # in a table
        if hasattr(thing, "model_fields"):
            apart = ["model_config", "model_post_init", *thing.model_fields]
            directive.insert(0, "Its blocks and their keys: :doc:`/keys`.\n")
        if apart:
            directive.append(f"   :exclude-members: {', '.join(apart)}")
    else:
        directive = [f".. autofunction:: hexservo.{name}"]
    return "```{eval-rst}\n" + "\n".join(directive) + "\n```\n"


def metrics_page() -> str:
    """Return the table of metrics."""
    rows = [f"| `{name}` | {unit} | {what} |" for name, (unit, what) in hs.METRICS.items()]
    head = "# Metrics of a run\n\n`hs.metrics(result)`, defined in [the model](docs/model.md#metrics).\n\n"
    head += "| metric | unit | |\n| --- | --- | --- |\n"
    return head + "\n".join(rows) + "\n"


def rounded(default: object) -> str:
    """Return a default as JSON with six digits, its first entries where it is long."""
    short = json.loads(json.dumps(default), parse_float=lambda text: float(f"{float(text):.6g}"))
    text = json.dumps(short)
    return text if len(text) <= 32 else text[:28].rpartition(",")[0] + ", ..."


def keys_page() -> str:
    """Return the table of all keys, from ``hexservo schema --json``."""
    schema = subprocess.run(
        [sys.executable, "-m", "hexservo", "schema", "--json"], check=True, capture_output=True, text=True
    ).stdout
    blocks: dict[str, list[str]] = {}
    for field in json.loads(schema):
        parts = field["key"].split(".")
        block = ".".join(parts[: 2 if parts[0] == "controller" else 1]) if len(parts) > 1 else "Of the scenario itself"
        shape = "x".join(str(length) for length in field.get("shape", []))
        kind = f"{field['type']} {shape}".strip() + (" or null" if field["optional"] else "")
        unit = field["unit"] or ", ".join(f"`{choice}`" for choice in choices_of(field))
        cells = (
            f"`{field['key']}`<br>{field['meaning']}",
            f"{kind}<br>{unit}",
            bounds_of(field).replace(" and ", "<br>"),
            f"`{rounded(field.get('default'))}`",
            field["mode"],
        )
        row = f"| {' | '.join(cell.replace('|', BAR) for cell in cells)} |"
        blocks.setdefault(block, []).append(row)
    text = [
        "# Keys of a scenario\n",
        "Every key of a scenario, as `hexservo schema` lists them, with its meaning in a line; more of it is in",
        "[the page of scenarios](docs/scenarios.md) and in [the model](docs/model.md). Frames and orders are those of",
        "[its section 1](docs/model.md#1-frames-units-and-order). `sampled` keys act in `simulation.mode: sampled`",
        "alone.\n",
    ]
    for block, rows in blocks.items():
        text += [
            f"## {block}\n",
            "| key | type, unit or choices | bounds | default | mode |",
            "| --- | --- | --- | --- | --- |",
        ]
        text += [*rows, ""]
    return "\n".join(text)


def gallery_page(folder: Path, kept: Path) -> str:
    """Return the page of all packaged scenarios, and copy their pictures beside it."""
    text = [
        "# Every packaged scenario\n",
        "One run of each, drawn by `python docs/tools/gallery.py`. On the left the ways of the features in the",
        "image, on the right their errors. `hexservo run NAME` repeats a run, `hexservo show NAME` prints its file.\n",
    ]
    pictures = folder / "gallery"
    pictures.mkdir(parents=True, exist_ok=True)
    for each in gallery(kept):
        shutil.copyfile(kept / f"{each.name}.svg", pictures / f"{each.name}.svg")
        mark = "verdict verdict-settled" if each.verdict == "settled" else "verdict"
        text += [
            f"## {each.name}\n",
            f'<span class="{mark}">{each.verdict}</span> {each.why}.\n',
            f"{each.description}{'' if each.description.endswith('.') else '.'} Law `{each.law}`, {each.mode}.\n",
            f"![Features of {each.name} in the image, and their errors](gallery/{each.name}.svg)\n",
        ]
    return "\n".join(text)


# ---- Links of the finished site -------------------------------------------------------------------------------------


class Page(HTMLParser):
    """Links and anchors of a page of the site."""

    def __init__(self, text: str) -> None:
        """Read a page."""
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        """Note what one element links to, and its id."""
        for name, value in attributes:
            if value is None:
                continue
            if name in ("href", "src"):
                self.links.append(value)
            elif name == "id" or (name == "name" and tag == "a"):
                self.anchors.add(value)


def broken_links(site: Path) -> list[str]:
    """Return the links within a site that lead nowhere, each with its page; links to the network are not followed."""
    pages = {
        file: Page(file.read_text(encoding="utf-8"))
        for file in sorted(site.rglob("*.html"))
        if file.name != "explorer.html"
    }
    broken = []
    for file, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            anchor = unquote(parts.fragment)
            if not target.is_relative_to(site) or not target.is_file():
                broken.append(f"{file.relative_to(site)}: {link}: no such file")
            elif anchor and target in pages and anchor not in pages[target].anchors:
                broken.append(f"{file.relative_to(site)}: {link}: no such place in the page")
    return broken


def pages_apart(site: Path) -> list[str]:
    """Return the pages of a site to which no way of links leads from its front page."""
    ahead, found = [site / "index.html"], {site / "index.html"}
    while ahead:
        file = ahead.pop()
        if file.name == "explorer.html":
            continue
        for link in Page(file.read_text(encoding="utf-8")).links:
            parts = urlsplit(link)
            target = (file.parent / unquote(parts.path)).resolve()
            known = bool(parts.scheme or parts.netloc) or target.suffix != ".html" or target in found
            if not known and target.is_relative_to(site) and target.is_file():
                found.add(target)
                ahead.append(target)
    return sorted(file.relative_to(site).as_posix() for file in set(site.rglob("*.html")) - found)


NO_READER_WANTS = {  # in a page -> what it is
    "object at 0x": "the address of an object",
    "_SupportsArray": "internals of NumPy",
    'Type<span class="colon">:</span>': "a sentence that was taken for the type of a property",
}


def poor_pages(site: Path) -> list[str]:
    """Return the pages of the reference that document nothing, and those with what was not meant for readers."""
    found = []
    for file in sorted((site / "api").glob("*.html")):
        text = file.read_text(encoding="utf-8")
        found += [f"{file.name}: {what}" for words, what in NO_READER_WANTS.items() if words in text]
        if file.name != "index.html" and 'class="sig ' not in text:
            found.append(f"{file.name}: no documented object")
    return found


# ---- The whole ------------------------------------------------------------------------------------------------------


def emptied(*folders: Path) -> None:
    """Make empty folders with `MARKER`; earlier contents are removed if all of the folders may be replaced.

    Replaced are folders with `MARKER`, and those below the repository's build folder; others have to be empty.
    """
    for folder in folders:
        ours = (folder / MARKER).is_file() or ROOT / "build" in folder.parents
        if folder.exists() and not ours and (not folder.is_dir() or any(folder.iterdir())):
            raise SystemExit(f"--out: expected an empty folder or an earlier site, got {folder}: choose another --out")
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)
        write(folder / MARKER, "Written by docs/tools/build_site.py, which replaces this folder the next time.\n")


def stage(folder: Path, kept: Path, explorer: Path | None) -> None:
    """Put Sphinx's sources together in a folder."""
    names = stage_pages(folder)
    pages = {
        "index.md": front_page(names, explorer),
        "install.md": (PARTS / "install.md.in").read_text(encoding="utf-8").replace("@VERSION@", hs.__version__),
        **{f"{group}.md": group_page(group, names) for group in GROUPS},
        "metrics.md": metrics_page(),
        "keys.md": keys_page(),
        "commands.md": commands_page(),
        "headers.md": headers_page(),
        "gallery.md": gallery_page(folder, kept),
        **api_pages(),
    }
    for name, text in pages.items():
        write(folder / name, text)


def main() -> None:
    """Build the site, or check its links to the network."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "site", help="folder of the site (build/site)")
    parser.add_argument(
        "--explorer", type=Path, default=EXPLORER, help="page of the controller in a browser, if it is built"
    )
    parser.add_argument("--links", action="store_true", help="check the links to the network instead")
    options = parser.parse_args()
    out = options.out.resolve()
    sources = out.with_name(f"{out.name}-sources")
    explorer = options.explorer if options.explorer.is_file() else None
    if explorer is not None:
        try:
            checked_page(explorer.read_text(encoding="utf-8"))
        except ExplorerError as error:
            raise SystemExit(f"{explorer}: {error}") from None
    builder, target = ("linkcheck", out.with_name(f"{out.name}-links")) if options.links else ("html", out)
    emptied(sources, target)
    stage(sources, out.with_name("gallery"), explorer)
    sphinx = [sys.executable, "-m", "sphinx", "-q", "-E", "-W", "--keep-going", "-b", builder, "-c", str(PARTS)]
    cache = out.with_name(f"{out.name}-cache")
    run = subprocess.run([*sphinx, "-d", str(cache), str(sources), str(target)], check=False)
    if run.returncode != 0:
        raise SystemExit(run.returncode)
    if options.links:
        print("Every link to the network works")
        return
    if explorer is not None:
        shutil.copyfile(explorer, out / "explorer.html")
    if broken := broken_links(out):
        raise SystemExit("\n".join(["Links that lead nowhere:", *broken]))
    if apart := pages_apart(out):
        raise SystemExit("\n".join(["Pages to which no link leads:", *apart]))
    if poor := poor_pages(out):
        raise SystemExit("\n".join(["Pages of the reference that are to be better:", *poor]))
    print(f"{len(list(out.rglob('*.html')))} pages; begin with {os.path.relpath(out / 'index.html')}")


if __name__ == "__main__":
    main()
