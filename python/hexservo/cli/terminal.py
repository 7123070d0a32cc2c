"""Common parts of all commands: exit codes, options, loading a scenario, and writing to the terminal."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

import hexservo as hs
from hexservo.scenario.block import SAMPLED_MODE

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

    from hexservo.scenario.scenario import Document

BAD_INPUT = 2
ENDED_EARLY = 3
NOT_SETTLED = 4
INTERRUPTED = 130  # 128 + SIGINT, as shells count
READER_LEFT = 141  # 128 + SIGPIPE

_ANY_WIDTH = 10_000  # for files and pipes: lines are not wrapped or cut
GAP = 2  # between two columns of a table
_HEIGHT = 25  # lines, which cut nothing; without them rich takes 80 columns for the width where TERM is dumb


def no_dash(parameter: typer.CallbackParam, value: str | None) -> str | None:
    """Refuse "-" for a file or folder: it stands for standard input or output elsewhere (a callback of a parameter)."""
    if value == "-":
        name = parameter.opts[0] if parameter.param_type_name == "option" else parameter.metavar
        with errors_as_messages():
            raise hs.ScenarioError([f'{name}: expected a path, got "-"; one of that name is "./-"'])
    return value


def path_option(meaning: str, metavar: str = "FOLDER", names: tuple[str, ...] = ("--out", "-o")) -> Any:
    """Return an option that is a file or a folder."""
    return typer.Option(*names, metavar=metavar, callback=no_dash, help=meaning)


ScenarioArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO", help='Name of a packaged scenario, path of a YAML file, or "-" for standard input.'
    ),
]
RequireSettledOption = Annotated[
    bool,
    typer.Option(
        "--require-settled",
        help="End with exit code 4 if the image error of a run does not settle. Exceeded limits do not count, nor does "
        "a settling band that has the start in it.",
    ),
]
CameraOption = Annotated[
    str | None,
    path_option(
        "Take the camera's intrinsics from a calibration file of OpenCV (YAML); target features are its pixels.",
        "FILE",
        ("--camera",),
    ),
]
ForceOption = Annotated[
    bool, typer.Option("--force", "-f", help="Replace the results of an earlier run in the folder.")
]
SettingsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change one key of the scenario, as uncertainty.gravity=0.075; the value is YAML. May be repeated.",
    ),
]


def load(scenario: str, settings: list[str], camera: str | None = None, *, one_of_several: bool = False) -> hs.Scenario:
    """Load a scenario with the changes of --camera and --set in its file; all errors of them are reported together.

    A key that both change is that of --set. Of a scenario that is one of several, errors name it.
    """
    return _read(scenario, settings, camera, one_of_several=one_of_several)[0]


def load_as_written(
    scenario: str, settings: list[str], camera: str | None = None
) -> tuple[hs.Scenario, dict[str, object]]:
    """Load a scenario as `load`, and return tag, grid and goal pose that were read into its points and features."""
    loaded, document, changes = _read(scenario, settings, camera)
    return loaded, _read_into_others(document, changes, loaded)


def _read(
    scenario: str, settings: list[str], camera: str | None, *, one_of_several: bool = False
) -> tuple[hs.Scenario, Document, dict[str, object]]:
    """Return a scenario, the document that it is of, and the changes of its keys."""
    from hexservo.scenario.scenario import read_document

    document = _read_standard_input() if scenario == "-" else read_document(scenario)
    changes, problems = _changes_of(settings)
    options, of_scenario = ["--set"] if settings else [], ""
    if camera is not None:
        changes = {**_calibrated(camera, document, changes), **changes}
        options.insert(0, "--camera")
    try:
        loaded = document.scenario(changes)
    except hs.ScenarioError as error:
        if error.source is not None:  # of the file, whatever is changed in it
            raise
        problems += error.problems
        of_scenario = f"{document.source}: " if one_of_several else ""
    if problems:
        raise hs.ScenarioError(problems, of_scenario + " and ".join(options))
    if camera is not None:
        _warn_of_border(camera, document, loaded)
    return loaded, document, changes


def _read_into_others(document: Document, changes: dict[str, object], loaded: hs.Scenario) -> dict[str, object]:
    """Return the written keys of the target, by dotted key, that a loaded scenario has as points and features."""
    from hexservo.scenario.plain import plain, put

    written = plain(document.keys) if isinstance(document.keys, dict) else {}
    for key, value in changes.items():
        put(written, key, plain(value))
    target = written.get("target")
    held = target if isinstance(target, dict) else {}
    names = ("tag", "grid", "desired_pose")
    return {
        f"target.{name}": held[name]
        for name in names
        if held.get(name) is not None and getattr(loaded.target, name) is None
    }


def _warn_of_border(camera: str, document: Document, loaded: hs.Scenario) -> None:
    """Warn where the file of a scenario has a border of the image, and a calibration without a size took it away."""
    block = document.keys.get("camera") if isinstance(document.keys, dict) else None
    border = block.get("image_size") if isinstance(block, dict) else None
    if border is not None and loaded.camera.image_size is None:
        complain(
            f"{camera} has no image_width and image_height: the image of {border} px in the scenario has no border "
            "now; --set camera.image_size=[WIDTH,HEIGHT] gives one",
            head="Warning",
        )


def _calibrated(camera: str, document: Document, changes: dict[str, object]) -> dict[str, object]:
    """Return the keys of a calibration file; without the border of the image in continuous mode, where it is none."""
    from hexservo.scenario.calibration import camera_from_file
    from hexservo.scenario.plain import plain, put

    keys = camera_from_file(camera)
    written = plain(document.keys) if isinstance(document.keys, dict) else {}
    for key, value in changes.items():
        put(written, key, value)  # its errors come later
    simulation = written.get("simulation")
    if not isinstance(simulation, dict) or simulation.get("mode") != SAMPLED_MODE:
        keys.pop("image_size", None)
    return {f"camera.{key}": value for key, value in keys.items()}


def changes_of(settings: list[str]) -> dict[str, object]:
    """Return the changes of --set, by dotted key.

    Raises
    ------
    ScenarioError
        A setting is no ``KEY=VALUE``, or its value is no YAML.
    """
    changes, problems = _changes_of(settings)
    if problems:
        raise hs.ScenarioError(problems, "--set")
    return changes


def _changes_of(settings: list[str]) -> tuple[dict[str, object], list[str]]:
    from hexservo.scenario.yaml import load_yaml

    problems: list[str] = []
    changes: dict[str, object] = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        key = key.strip()
        if not equals or not key:
            problems.append(f'expected KEY=VALUE, as uncertainty.gravity=0.075, got "{setting}"')
            continue
        changes.pop(key, None)  # of a key that is set twice the last value counts, in its place
        try:
            changes[key] = load_yaml(value)
        except hs.ScenarioError as error:
            problems += [f"{key}: {problem}" for problem in error.problems]
    return changes, problems


def split(names: str) -> list[str]:
    """Return the names of a list with commas."""
    return [name.strip() for name in names.split(",") if name.strip()]


def expanded(names: str) -> list[str]:
    """Return the names of a list, with patterns replaced by the matching packaged scenarios."""
    from fnmatch import fnmatchcase

    chosen: list[str] = []
    for name in split(names):
        fitting = [known for known in hs.scenario_names() if fnmatchcase(known, name)]
        if not fitting and any(character in name for character in "*?"):
            raise hs.ScenarioError(
                f'--scenarios: expected a pattern that matches one of {", ".join(hs.scenario_names())}; got "{name}"'
            )
        chosen += [known for known in fitting or [name] if known not in chosen]
    if not chosen:
        raise hs.ScenarioError(f'--scenarios: expected names with commas between, got "{names}"')
    return chosen


def _read_standard_input() -> Document:
    from hexservo.scenario.scenario import Document
    from hexservo.scenario.yaml import MAX_BYTES, decoded, load_yaml

    source = "standard input"
    content = b"" if sys.stdin is None else sys.stdin.buffer.read(MAX_BYTES + 1)
    return Document(load_yaml(decoded(content, "YAML", source), source), source)


@contextlib.contextmanager
def errors_as_messages() -> Iterator[None]:
    """Convert bad input and Ctrl-C to a message and an exit code; all other exceptions are bugs with a traceback."""
    from hexservo.run.publish import OutputError

    try:
        yield
    except (hs.ScenarioError, hs.ResultError, hs.VariantError, OutputError) as error:
        complain(*str(error).splitlines())
        raise typer.Exit(BAD_INPUT) from None
    except KeyboardInterrupt:
        interrupted("no further files were written")


def interrupted(consequence: str) -> NoReturn:
    """Exit after Ctrl-C."""
    complain(consequence, head="Interrupted")
    raise typer.Exit(INTERRUPTED) from None


def exit_as(result: hs.Result, consequence: str = "") -> None:
    """Exit where a run ended early; `consequence` follows its outcome."""
    if result.outcome != "completed":
        complain(f"{result.scenario.name}: {ending(result)}{consequence}", head="Ended early")
        raise typer.Exit(INTERRUPTED if result.outcome == "interrupted" else ENDED_EARLY)


@contextlib.contextmanager
def refusals(
    source: str | None = None, of: type[Exception] | tuple[type[Exception], ...] = ValueError
) -> Iterator[None]:
    """Convert a ValueError, as of an option, to bad input of a source; what already is one of the messages stays."""
    from hexservo.run.publish import OutputError

    try:
        yield
    except (hs.ScenarioError, hs.ResultError, OutputError):
        raise
    except of as error:
        raise hs.ScenarioError(str(error).splitlines(), source) from error


def ending(result: hs.Result) -> str:
    """Return the outcome of a run as one line, with one time: that of its end."""
    from hexservo.run.summary import ending as how

    return f"{result.outcome.replace('_', ' ')}: {how(result)}"


def spell_time(seconds: float) -> str:
    """Return a duration in s, ms or less."""
    from hexservo.scenario.wording import quantity

    return quantity(seconds, "s")


def width() -> int:
    """Return the width of the terminal; unlimited if standard output is not a terminal."""
    import shutil

    return shutil.get_terminal_size().columns if sys.stdout is not None and sys.stdout.isatty() else _ANY_WIDTH


def plain_table(**options: Any) -> Table:
    """Return a table without lines, to be filled."""
    from rich.table import Table

    return Table(box=None, pad_edge=False, padding=(0, GAP, 0, 0), **options)


def show_parts(*parts: RenderableType) -> None:
    """Print with colours and line breaks for the terminal; plain and without line breaks into files and pipes."""
    from rich.console import Console

    text = io.StringIO()  # written in one place, with its errors, which rich would handle differently
    console = Console(
        file=text,
        force_terminal=True if sys.stdout is not None and sys.stdout.isatty() else None,
        width=width(),
        height=_HEIGHT,
        color_system=None if os.environ.get("NO_COLOR") else "auto",
        highlight=False,
        markup=False,
        emoji=False,
    )
    for part in parts:
        console.print(part)
    write("".join(f"{line.rstrip()}\n" for line in text.getvalue().splitlines()))


def write(text: str, encoding: str | None = None) -> None:
    """Write to standard output at once, so that a broken pipe and a full disk are distinguished from bugs."""
    if sys.stdout is None:
        complain("standard output: cannot be written: it is closed")
        raise typer.Exit(BAD_INPUT)
    try:
        if encoding is None:
            sys.stdout.write(text)
        else:
            sys.stdout.buffer.write(text.encode(encoding))
        sys.stdout.flush()
    except BrokenPipeError:
        _give_up_output(READER_LEFT)
    except OSError as error:
        complain(f"standard output: cannot be written: {error.strerror}")
        _give_up_output(BAD_INPUT)


def write_then_show(out: str | None, write_into: Callable[[str], object], show: Callable[[str | None], None]) -> None:
    """Write results into a folder, if one is named, then show them and where they are, and last what kept them away.

    Nothing is shown before, so that results are not lost to a broken pipe.
    """
    from hexservo.run.publish import OutputError

    failure = None
    if out is not None:
        try:
            write_into(out)
        except OutputError as error:
            failure = error
    show(None if failure is not None else out)
    if failure is not None:
        raise failure


def watched() -> bool:
    """Return whether standard error is a terminal, where a user sees how far a command has come."""
    return sys.stderr is not None and sys.stderr.isatty()


def whisper(text: str) -> None:
    """Print the current activity, on terminals only."""
    if watched():
        print(f"measuring: {text}", file=sys.stderr, flush=True)


def _give_up_output(code: int) -> NoReturn:
    """Exit, and discard buffered standard output, which would otherwise raise an error at shutdown."""
    with contextlib.suppress(OSError, io.UnsupportedOperation):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    raise typer.Exit(code)


def complain(*lines: str, head: str = "Error") -> None:
    """Write each line to standard error, after its head."""
    with contextlib.suppress(OSError):  # standard error is closed too
        for line in lines:
            print(f"{head}: {line}", file=sys.stderr)
