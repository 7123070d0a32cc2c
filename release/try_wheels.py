"""Install wheels in new Debian systems without a compiler, and use them there: ``python release/try_wheels.py``.

Needs mmdebstrap and root's rights, and says so where they are missing. Systems and downloaded wheels stay
in ``build/systems``, so that the second time is quick.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import subprocess
import time
from pathlib import Path

from build_wheels import ROOT, run, tools

SYSTEMS = {"bookworm": "3.11", "trixie": "3.13"}  # Debian 12 and 13, and their Python
FOLDER = ROOT / "build" / "systems"
PROGRAMS = ("cc", "c++", "gcc", "g++", "clang", "cmake", "ninja", "make", "ld")
COMMANDS = (
    "hexservo version",
    "hexservo run paper --out /tmp/run --require-settled",
    "hexservo report paper --out /tmp/report.html",
    "hexservo export composite-30hz --fmu /tmp/plant.fmu --what plant",
)
EXPLORE = "hexservo explore paper --no-open --out /tmp/explorer.html"
EXTRAS = {
    "control": "python3 -c \"import hexservo as hs; hs.bridges.control(hs.load_scenario('composite-30hz')).poles()\"",
    "gymnasium": "python3 -c \"import hexservo as hs; hs.bridges.gymnasium(hs.load_scenario('paper'), 2).reset()\"",
    "cluster": "hexservo campaign campaign-paper --out /tmp/campaign --runs 200 --engine dask",
    "tune": "python3 -c 'import hexservo.campaigns.tuning, pymoo.algorithms.moo.nsga2'",
    "mcap": "python3 -c 'import hexservo.findings.identification.mcap_log, mcap.stream_reader, lz4.frame, zstandard'",
}


UP = (  # a command for the loopback interface of a new network, which is down
    "import fcntl,socket,struct;"
    'fcntl.ioctl(socket.socket(),0x8914,struct.pack("16sh",b"lo",1))'  # SIOCSIFFLAGS, IFF_UP
)


def used_by_children() -> float:
    """Return the processor time of all programs that were run [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


class System:
    """A Debian system in a folder, with nothing but Python."""

    def __init__(self, suite: str) -> None:
        self.root = FOLDER / suite
        if not (self.root / "usr" / "bin" / "python3").exists():
            shutil.rmtree(self.root, ignore_errors=True)
            self.root.parent.mkdir(parents=True, exist_ok=True)
            run("mmdebstrap", "--variant=minbase", "--include=python3,python3-venv", suite, self.root)
        for old in (
            "opt/hexservo",
            "wheels",
            "tmp/run",
            "tmp/campaign",
            "tmp/report.html",
            "tmp/plant.fmu",
            "tmp/explorer.html",
        ):
            path = self.root / old
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)

    def run(self, command: str) -> tuple[float, float]:
        """Run a command of the shell in it, without a network; return how long it took, and its processor time [s]."""
        print(f"{self.root.name}$ {command}", flush=True)
        alone = ["unshare", "--mount", "--pid", "--fork", "--net", f"--mount-proc={self.root / 'proc'}", "chroot"]
        places = {"PATH": "/opt/hexservo/bin:/usr/sbin:/usr/bin:/sbin:/bin", "HOME": "/tmp", "LC_ALL": "C.UTF-8"}
        start, used = time.monotonic(), used_by_children()
        script = f"python3 -c {UP!r} && {command}" if "dask" in command else command
        subprocess.run([*alone, str(self.root), "/bin/sh", "-c", script], env=places, check=True)
        return time.monotonic() - start, used_by_children() - used


def downloaded(wheel: Path, python: str, extras: bool) -> Path:
    """Return a folder with the wheel and all that it requires, for an interpreter."""
    house = FOLDER / f"wheels-{python}"
    house.mkdir(parents=True, exist_ok=True)
    for old in house.glob("hexservo-*"):
        old.unlink()
    shutil.copy(wheel, house)
    run(
        *(tools(python), "-m", "pip", "download", "--quiet", "--prefer-binary", "--find-links", house, "-d", house),
        f"{wheel}[{','.join(EXTRAS)}]" if extras else wheel,
    )
    return house


def try_in(suite: str, wheel: Path, python: str, extras: bool) -> tuple[float, float]:
    """Install and use a wheel; return how long the installation took, and its processor time [s]."""
    house = downloaded(wheel, python, extras)
    system = System(suite)
    for program in PROGRAMS:
        if shutil.which(program, path=f"{system.root}/usr/bin:{system.root}/usr/local/bin"):
            raise SystemExit(f"{suite}: expected a system without a compiler, got one with {program}")
    shutil.copytree(house, system.root / "wheels", copy_function=os.link)
    system.run("python3 -m venv /opt/hexservo")
    # Python compiles modules when they are first imported; that all of them are compiled here takes twice as long.
    seconds = system.run("pip install --quiet --no-compile --no-index --find-links /wheels hexservo")
    for command in COMMANDS:
        system.run(command)
    if (system.root / f"opt/hexservo/lib/python{python}/site-packages/hexservo/explorer.html").exists():
        system.run(EXPLORE)
    else:
        print("This wheel was built without the explorer (`make explorer`), which is not tried.")
    for extra, use in EXTRAS.items() if extras else ():
        system.run(f"pip install --quiet --no-index --find-links /wheels 'hexservo[{extra}]'")
        system.run(use)
    return seconds


def main() -> None:
    """Try each wheel in the system that has its Python."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wheels", type=Path, default=ROOT / "dist", help="folder of the wheels (dist)")
    parser.add_argument("--no-extras", action="store_true", help="leave the extras out")
    options = parser.parse_args()
    if os.geteuid() != 0 or not shutil.which("mmdebstrap"):
        print("The wheel is not tried in new systems: that needs root's rights and the package mmdebstrap.")
        return
    times = {}
    for suite, python in SYSTEMS.items():
        wheels = sorted(options.wheels.glob(f"hexservo-*-cp{python.replace('.', '')}-*.whl"))
        if wheels:
            times[suite] = try_in(suite, wheels[-1], python, not options.no_extras)
        else:
            print(f"{suite}: there is no wheel for Python {python} in {options.wheels}, which is not tried.")
    for suite, (seconds, used) in times.items():
        print(f"{suite}: installed in {seconds:.1f} s ({used:.1f} s of processor time), and works")


if __name__ == "__main__":
    main()
