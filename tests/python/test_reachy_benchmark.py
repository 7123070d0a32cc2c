"""The comparison on Reachy Mini's head (`benchmarks/reachy`), on hexservo's own model of it: no network is needed."""

from __future__ import annotations

import csv
import json
import math
import re
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from face_tracking import ours, picture, table
from face_tracking.__main__ import main
from face_tracking.machine import COUNT, MOTORS, PACKAGE, TICK, Head, exported_model, kinematics, package_model
from face_tracking.published import Frame, ImageFilter, PublishedLaw
from face_tracking.scene import CASES, EYE, FRONT, HEAD, LANDMARKS, NOSE, Camera, Case, Face, turns
from face_tracking.trial import Figures, Record, figures, run
from hexservo.scenario.arrays import Array

EXACT = Camera(noise=0.0)
NOTHING = Figures(**dict.fromkeys(table.FIGURES, math.nan))


@pytest.fixture(scope="module")
def model() -> Any:
    return exported_model()


def angles_of(attitude: Rotation) -> Array:
    """Crank angles (6,) of the head at its upright place."""
    quaternion = np.roll(attitude.as_quat(), 1) * [1.0, 1.0, -1.0, -1.0]
    return np.asarray(kinematics().leg_lengths(kinematics().home_position, quaternion))


# ---- What is seen ---------------------------------------------------------------------------------------------------


def test_the_image_of_the_face_is_that_of_opencv() -> None:
    attitude = turns(np.deg2rad([20.0, 9.0]))
    points, position, axes = (
        Face(CASES["both"], 0.93).points(0.0),
        HEAD + attitude.apply(EYE),
        attitude.as_matrix() @ FRONT,
    )
    seen = EXACT.image(points, position, axes, np.random.default_rng(0))
    assert seen is not None
    (fx, fy), (cx, cy) = EXACT.focal, EXACT.centre
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    rotation, _ = cv2.Rodrigues(axes.T)
    expected, _ = cv2.projectPoints(points, rotation, -axes.T @ position, matrix, np.zeros(5))
    np.testing.assert_allclose(seen, expected[:, 0], atol=1e-9)


def test_a_head_turned_by_the_angles_of_a_case_looks_at_the_face() -> None:
    for name in ("yaw", "pitch", "both"):
        face = Face(CASES[name])
        attitude = turns(face.angles(np.array(0.0)))
        seen = (face.aims(np.array([0.0])) - HEAD - attitude.apply(EYE)) @ (attitude.as_matrix() @ FRONT)
        np.testing.assert_allclose(seen[0], [0.0, 0.0, 1.0], atol=1e-12)
    degrees = np.rad2deg(Face(CASES["moving"]).angles(np.array([0.0, 1.0, 2.0, 3.5, 9.0])))
    np.testing.assert_allclose(degrees, [[0, 0], [0, 0], [10, 0], [25, 0], [25, 0]], atol=1e-12)  # 10 deg/s
    degrees = np.rad2deg(Face(CASES["jump"]).angles(np.array([0.0, 2.999, 3.0, 5.0])))
    np.testing.assert_allclose(degrees, [[15, 0], [15, 0], [-10, 10], [-10, 10]], atol=1e-12)


# ---- The published laws ---------------------------------------------------------------------------------------------


def test_the_image_filter_by_hand() -> None:
    smooth = ImageFilter()
    for raw, expected in (
        ([0.5, 0.0], [0.5, 0.0]),  # the first one counts
        ([0.4, 0.0], [0.47, 0.0]),  # 0.3 of the way
        ([0.0, 0.0], [0.188, 0.0]),  # 0.6 of it: moved by 0.4 since the frame before
        ([0.0, 0.0], [0.1316, 0.0]),  # 0.3
        ([0.12, 0.0], [0.1316, 0.0]),  # within 0.02
    ):
        np.testing.assert_allclose(smooth.update(np.array(raw)), expected, atol=1e-12)


@pytest.mark.parametrize("at_exposure", [False, True])
def test_a_late_frame_is_a_wrong_direction_of_the_shipped_law_alone(at_exposure: bool) -> None:
    """A head that turns at 1 rad/s and a frame 100 ms old: wrong by 0.1 rad in yaw, or right."""
    law, face = PublishedLaw(EXACT, at_exposure), Face(Case("front", (0.0,), ((10.0, 0.0),)))
    for tick in range(11):
        attitude = turns(np.array([TICK * tick, 0.0]))
        frame = None
        if tick == 10:
            old = turns(np.array([0.1, 0.0]))  # at 0.1 s
            pixels = EXACT.image(
                face.points(0.1), HEAD + old.apply(EYE), old.as_matrix() @ FRONT, np.random.default_rng(0)
            )
            assert pixels is not None
            frame = Frame(pixels, 0.1, 0.2, True)
        law.tick(TICK * tick, angles_of(attitude), frame)
    assert law._goal is not None
    yaw = law._goal.as_euler("ZYX")[0]
    camera = HEAD + turns(np.array([0.1, 0.0])).apply(EYE)
    x, y = (face.points(0.1)[NOSE] - camera)[:2]
    assert yaw == pytest.approx(math.atan2(y, x) + (0.0 if at_exposure else 0.1), abs=1e-6)


def test_the_shipped_law_eases_and_trims() -> None:
    """Of the way to its goal 0.15 a tick; with the trim its goal is 15 deg below the face."""
    face = Face(Case("front", (0.0,), ((12.0, 0.0),)))
    pixels = EXACT.image(face.points(0.0), HEAD + EYE, FRONT, np.random.default_rng(0))
    assert pixels is not None
    yaw = math.atan2(*(face.points(0.0)[NOSE] - HEAD - EYE)[[1, 0]])
    for trim in (0.0, math.radians(15.0)):
        law = PublishedLaw(EXACT, trim=trim)
        for tick in range(60):
            commands = law.tick(
                TICK * tick, angles_of(Rotation.identity()), Frame(pixels, 0.0, 0.0, True) if tick == 0 else None
            )
            if tick == 1 and trim == 0.0:
                np.testing.assert_allclose(commands, angles_of(turns(np.array([(1 - 0.85**2) * yaw, 0.0]))), atol=1e-9)
        np.testing.assert_allclose(commands, angles_of(turns(np.array([yaw, trim]))), atol=1e-3)  # 0.85^60


# ---- The head -------------------------------------------------------------------------------------------------------


def test_the_head_rests_upright_and_reads_whole_counts(model: Any) -> None:
    head = Head(model, MOTORS["freed"], 0.6)
    position, axes, torque = head.step()
    np.testing.assert_allclose(position, HEAD + EYE, atol=2e-4)  # friction and the weight of the head
    np.testing.assert_allclose(axes, FRONT, atol=2e-3)
    np.testing.assert_allclose(head.reading / COUNT, np.round(head.reading / COUNT), atol=1e-9)
    np.testing.assert_allclose(head.reading, kinematics().home_lengths, atol=5 * COUNT)
    assert torque < 0.1


def test_torques_are_limited_and_the_head_follows(model: Any) -> None:
    head = Head(model, MOTORS["freed"], 0.3)
    head.command(angles_of(turns(np.deg2rad([25.0, 0.0]))))
    torques = [head.step()[2] for _ in range(1000)]
    assert max(torques) == pytest.approx(0.3, rel=1e-9)
    _, axes, _ = head.step()
    looks = np.rad2deg(np.arctan2(axes[1, 2], axes[0, 2]))
    assert looks == pytest.approx(25.0, abs=2.0)  # Coulomb friction of 0.1 N m over 10 N m/rad, 3.4 deg of yaw per deg


def test_motors_with_friction_in_ball_joints_need_the_package(model: Any) -> None:
    with pytest.raises(ValueError, match="no friction in its ball joints"):
        Head(model, MOTORS["shipped"])


# ---- What is measured -----------------------------------------------------------------------------------------------


def made_up(errors: Array, case: Case, commands: Array | None = None) -> Record:
    times = 2e-3 * np.arange(len(errors), dtype=np.float64)
    if commands is None:
        commands = np.zeros((len(errors) // 10, 6))
    aims = np.rad2deg(Face(case).angles(times))
    return Record(times, errors, aims, np.zeros(len(errors)), commands, (9, 10))


def test_figures_of_a_damped_oscillation_in_closed_form() -> None:
    """20 deg exp(-t) cos(2 t) along u: beyond by the first minimum, within 1 deg for good after the last crossing."""
    case, times, way = Case("made up", (0.0,), ((0.0, 0.0),)), 2e-3 * np.arange(4000), np.array([0.6, -0.8])
    course = 20.0 * np.exp(-times) * np.cos(2.0 * times)
    found = figures(made_up(course[:, None] * way, case), case)
    lowest = (math.pi - math.atan(0.5)) / 2.0
    assert found.overshoot == pytest.approx(-20.0 * math.exp(-lowest) * math.cos(2.0 * lowest), abs=1e-4)
    last = times[np.flatnonzero(np.abs(course) > 1.0)[-1]]
    assert found.settled == pytest.approx(last, abs=2.1e-3)
    assert found.final < 20.0 * math.exp(-7.0)
    assert math.isnan(found.lag)
    assert found.lost == pytest.approx(0.1)
    assert math.isinf(figures(made_up(np.tile(1.01 * way, (4000, 1)), case), case).settled)


def test_lag_behind_a_moving_face_and_rates_of_commands() -> None:
    case = CASES["moving"]
    ramp = 0.05 * np.arange(400)[:, None] * np.ones(6) * TICK  # 0.05 rad/s
    found = figures(made_up(np.tile([-2.0, 0.5], (4000, 1)), case, ramp), case)
    assert found.lag == pytest.approx(2.0)  # a face that goes to the left is left of the axis
    assert (found.variation, found.rest) == pytest.approx((0.05, 0.05))


# ---- Trials ---------------------------------------------------------------------------------------------------------


def test_a_face_at_rest_is_at_one_place_however_the_camera_is_turned() -> None:
    """Of assumed depths: the point that the tracking law lifts may move by what the landmarks are apart in depth."""
    camera, random = Camera(noise=0.0), np.random.default_rng(5)
    scenario = ours.settings("tracking", 15.0, camera, True, {})
    points, places = Face(CASES["yaw"]).points(0.0), []
    for yaw in np.deg2rad([0.0, 10.0, 25.0, 35.0]):
        axes = turns(np.array([yaw, 0.0])).apply(FRONT.T).T
        pixels = camera.image(points, HEAD + EYE, axes, random)
        assert pixels is not None
        depth = -ours.depths_of(Frame(pixels, 0.0, 0.0, True), scenario.camera).mean()
        ray = np.append((pixels.mean(axis=0) - camera.centre) / camera.focal, 1.0)
        places.append(axes @ ray * depth)
    assert np.ptp(places, axis=0).max() < 0.005
    assert np.linalg.norm(places[0]) == pytest.approx(1.0, abs=0.005)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_order_of_the_laws(seed: int) -> None:
    """A latency that is not known: the shipped law overshoots more than the fix, and that more than hexservo."""
    print(f"seed {seed}")
    found = {
        law: table.of_trial(table.Trial(law, "freed", "yaw", 15.0, "unknown", 0.6, seed))
        for law in ("shipped", "fix", "resolved_rate", "tracking")
    }
    assert found["shipped"].overshoot > 10.0 > found["fix"].overshoot > 5.0 > 3.0 > found["resolved_rate"].overshoot
    assert found["resolved_rate"].settled < 2.0 < found["fix"].settled
    assert found["tracking"].overshoot < 1.0
    assert found["tracking"].settled < 0.8
    assert all(one.lost == 0.0 for one in found.values())


def test_a_trial_is_repeatable_and_commands_act_one_tick_late(model: Any) -> None:
    class Steps:
        """Commands a new angle at every tick."""

        def __init__(self) -> None:
            self.seen: list[tuple[float, Array]] = []

        def tick(self, now: float, reading: Array, frame: Frame | None) -> Array:
            """Return angles that grow."""
            self.seen.append((now, head.data.ctrl.copy()))
            return np.asarray(kinematics().home_lengths + 1e-3 * len(self.seen))

    case = Case("short", (0.0,), ((5.0, 0.0),), duration=0.2)
    head, law = Head(model, MOTORS["freed"]), Steps()
    run(head, law, case, Camera(), 30.0, "50", 0)
    for k in range(2, 10):  # at tick k the command of k - 2 is in force, that of k - 1 is about to be
        np.testing.assert_allclose(law.seen[k][1], kinematics().home_lengths + 1e-3 * (k - 1), atol=1e-15)
    one, other = (table.of_trial(table.Trial("fix", "freed", "yaw", 10.0, "scattered", None, 3)) for _ in range(2))
    np.testing.assert_equal(one.mapping(), other.mapping())


def test_a_record_of_the_head_for_identification(model: Any) -> None:
    """It has what `hs.identify` takes; joints follow commands, which leave one tick late."""
    log = table.recorded(Head(model, MOTORS["freed"], 0.6))
    assert log.commands.shape == log.joints.shape == (1200, 6)
    moved = log.joints - log.joints[0]
    for leg in range(6):
        shares = [np.corrcoef(moved[lag:, leg], log.commands[: len(moved) - lag, leg])[0, 1] for lag in range(6)]
        assert max(shares) > 0.95
        assert 2 <= int(np.argmax(shares)) <= 4  # a tick, and 31 ms of the motors


# ---- The program ----------------------------------------------------------------------------------------------------


def program(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["reachy", *arguments])
    return main()


@pytest.mark.slow
def test_without_the_package_it_runs_on_hexservos_model(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def no_network(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        return subprocess.CompletedProcess(command, 1, "", "a\nERROR: no network\n")

    monkeypatch.setattr(subprocess, "run", no_network)
    folders = "--out", str(tmp_path / "out"), "--package", str(tmp_path / "package")
    small = "--quick", "--laws", "fix,resolved_rate", "--cases", "yaw", "--seeds", "0-1", "--jobs", "1"
    assert program(monkeypatch, *small, *folders, "--no-identification") == 0
    printed = capsys.readouterr().out
    assert f"{PACKAGE} cannot be had (pip download {PACKAGE}: ERROR: no network)" in printed
    assert "4 trials; seeds 0 to 1; medians (worst)" in printed
    with (tmp_path / "out" / "reachy.csv").open() as file:
        rows = list(csv.DictReader(file))
    written = json.loads((tmp_path / "out" / "reachy.json").read_text())
    assert [row["law"] for row in rows] == [row["law"] for row in written["rows"]] == ["fix", "resolved_rate"]
    assert {row["model"] for row in rows} == {"hexservo"}
    trials = [table.of_trial(table.Trial("fix", "freed", "yaw", 15.0, "unknown", 0.6, seed)) for seed in (0, 1)]
    assert float(rows[0]["overshoot_median"]) == pytest.approx(np.mean([one.overshoot for one in trials]))
    assert float(rows[0]["overshoot_worst"]) == pytest.approx(max(one.overshoot for one in trials))
    assert written["rows"][0]["lag_median"] is None
    assert (tmp_path / "out" / "reachy.png").stat().st_size > 10_000


def test_arguments_that_do_not_exist_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        program(monkeypatch, "--motors", "steam")
    assert "expected some of shipped, freed, xc330, xl330, got steam" in capsys.readouterr().err


def test_a_package_that_is_no_model_is_an_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(subprocess, "run", lambda command, **_: subprocess.CompletedProcess(command, 1, "", ""))
    with pytest.raises(OSError, match=f"pip download {PACKAGE}: no wheel"):
        package_model(tmp_path)


def test_a_package_that_was_unpacked_in_part_is_unpacked_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = "reachy_mini/descriptions/reachy_mini/mjcf"
    with zipfile.ZipFile(tmp_path / "reachy_mini-1.13.0-py3-none-any.whl", "w") as wheel:
        wheel.writestr(f"{folder}/reachy_mini.xml", '<mujoco><include file="body.xml"/></mujoco>')
        wheel.writestr(f"{folder}/body.xml", '<mujoco><worldbody><geom size="1"/></worldbody></mujoco>')

    def interrupted(wheel: zipfile.ZipFile, path: Path) -> None:
        wheel.extract(f"{folder}/reachy_mini.xml", path)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(zipfile.ZipFile, "extractall", interrupted)
        with pytest.raises(KeyboardInterrupt):
            package_model(tmp_path)
    assert package_model(tmp_path).ngeom == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["reachy_mini-1.13.0-py3-none-any.whl", "unpacked"]


def test_the_library_of_an_exported_header_is_built_each_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its headers are today's; CMake compiles what has changed."""
    commands: list[list[str]] = []
    monkeypatch.setattr(subprocess, "run", lambda command, **_: commands.append(command))
    scenario = ours.settings("resolved_rate", 15.0, Camera(), False, {})
    library = tmp_path / "core" / "libhexservo_core.a"
    library.parent.mkdir()
    library.write_bytes(b"of yesterday")
    for _ in range(2):
        ours.compiled(scenario, tmp_path)
    assert [command[:2] for command in commands[:3]] == [["cmake", "-S"], ["cmake", "--build"], ["g++", "-std=c++20"]]
    assert commands[3:] == commands[:3]
    assert str(library) in commands[2]


def test_a_header_that_does_not_compile_is_a_failure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(table, "trials", lambda todo, _: ((one, NOTHING) for one in todo))
    folders = "--out", str(tmp_path / "out"), "--package", str(tmp_path / "package")
    small = "--quick", "--own", "--header", "--laws", "tracking", "--cases", "yaw", "--seeds", "0", "--no-picture"
    for problem, code, words in (
        (OSError("g++ was not found"), 0, "The exported header was not compiled: g++ was not found."),
        (subprocess.CalledProcessError(2, ["cmake", "--build"]), 1, "not compiled: cmake gave code 2; see above."),
    ):
        monkeypatch.setattr(ours, "compiled", Mock(side_effect=problem))
        assert program(monkeypatch, *small, *folders, "--no-identification") == code
        assert words in capsys.readouterr().out


@pytest.mark.parametrize("count", [5, 20])
def test_medians_have_one_definition_with_and_without_never(count: int) -> None:
    """The middle of the sorted values, or the mean of the two there; that of a number and "never" is "never"."""
    trial = table.Trial("fix", "freed", "yaw", 15.0, "unknown", 0.6, 0)
    for never in range(count + 1):
        settled = [1.0 + index**2 for index in range(count - never)] + [math.inf] * never
        (row,) = table.medians((trial, replace(NOTHING, settled=value)) for value in settled)
        below, above = settled[(count - 1) // 2], settled[count // 2]
        assert row.values["settled"] == ((below + above) / 2, settled[-1])
        assert math.isnan(row.values["lag"][0])


def test_landmarks_are_around_the_point_to_look_at() -> None:
    assert LANDMARKS.shape == (5, 3)
    np.testing.assert_allclose(LANDMARKS[:, 0].sum(), 0.0, atol=1e-15)
    np.testing.assert_allclose(LANDMARKS[NOSE], [0.0, 0.0, -0.02])


def test_rows_with_another_focal_length_are_told_apart() -> None:
    trial = table.Trial("fix", "freed", "yaw", 15.0, "unknown", 0.6, 0)
    rows = [replace(trial, focal_error=error) for error in (0.0, 0.17)]
    exact, long = (table.line(table.Row(row, dict.fromkeys(table.FIGURES, (0.0, 0.0)), (0,))) for row in rows)
    column = slice(table.heading().index("f error"), table.heading().index("f error") + len("f error"))
    assert (exact[column].strip(), long[column].strip()) == ("0%", "17%")


def test_lines_of_the_picture_differ_without_colour_and_have_one_legend(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    times = np.linspace(0.0, 7.0, 8)
    still = Record(times, np.ones((8, 2)), np.ones((8, 2)), np.zeros(8), np.zeros((8, 6)), (1, 1))
    monkeypatch.setattr(picture, "record_of", lambda trial: still)
    saved: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, dpi: saved.append(figure))
    laws = ["shipped", "fix", "resolved_rate", "tracking"]
    like = table.Trial("fix", "freed", "yaw", 15.0, "unknown", 0.6, 0)
    picture.draw(tmp_path / "p.png", laws, ["shipped", "freed"], list(CASES), [0], like, {})
    panels = saved[0].axes
    assert len(panels) == 2 * len(picture.SHOWN)
    assert len(saved[0].legends) == 1
    assert not any(panel.get_legend() for panel in panels)
    lines = panels[0].get_lines()
    assert len({line.get_color() for line in lines}) == len(laws)
    assert len({line.get_linewidth() for line in lines if line.get_linestyle() == "-"}) == 2  # the others have dashes


def test_the_readme_has_the_numbers_of_the_page() -> None:
    """Of motors as shipped and 25 deg of yaw: overshoot and time of all laws."""
    root = Path(__file__).parents[2]
    page = (root / "docs" / "reachy-mini.md").read_text(encoding="utf-8")
    (row,) = (line for line in (root / "README.md").read_text(encoding="utf-8").splitlines() if "Face tracking" in line)
    rows = [line for line in page.splitlines() if line.startswith("| shipped | yaw |")]
    (_, _, *overshoot), (_, _, *settled) = (line.strip("| ").split(" | ") for line in rows[:2])
    assert f"law `tracking`: {overshoot[3][:-1]}°), within 1° after {settled[3][:-1]} s)" in row
    shipped, fix = ([float(number) for number in re.findall(r"[0-9.]+", cell)] for cell in overshoot[:2])
    assert f"overshoots {shipped[0]:.0f}° ({shipped[1]:.0f}°)" in row
    assert f"proposed for it {fix[0]:.1f}° ({fix[1]:.1f}°)" in row
    others = " s and ".join(f"{float(cell.split()[0]):.3g}" for cell in settled[:2])
    assert f"the two others {others} s" in row
