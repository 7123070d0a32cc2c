"""Build the source archive and a wheel for old systems: the same bytes in any folder, from the same commit and tools.

``python release/build_wheels.py --out dist`` (`make wheel`) makes the archive of the sources, builds the wheel from the
unpacked archive without a network, lets auditwheel name the oldest system that it runs on, and adds a bill of materials
(PEP 770). The C++ runtime is the system's, as the manylinux policies have it.
"""

from __future__ import annotations

import argparse
import base64
import csv
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from datetime import datetime, timezone
from email.parser import BytesParser
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PARTS = "compiled_in.json"  # of CMakeLists.txt: what the modules were compiled from
# Licence and home of each part that is compiled into the modules.
KNOWN_PARTS = {
    "eigen": ("MPL-2.0", "https://gitlab.com/libeigen/eigen"),
    "pybind11": ("BSD-3-Clause", "https://github.com/pybind/pybind11"),
}


def epoch() -> int:
    """Return SOURCE_DATE_EPOCH, or the time of the last commit: the time of every file in the archives."""
    given = os.environ.get("SOURCE_DATE_EPOCH")
    if given:
        return int(given)
    log = ["git", "-C", str(ROOT), "log", "-1", "--format=%ct"]
    return int(subprocess.run(log, check=True, capture_output=True, text=True).stdout)


def run(*command: str | Path) -> None:
    """Run a command; its failure ends this one."""
    print("+", *command, flush=True)
    subprocess.run([str(word) for word in command], check=True)


def only(files: list[Path], what: str) -> Path:
    """Return the one file of a list."""
    if len(files) != 1:
        raise SystemExit(f"{what}: expected one file, got {[file.name for file in files]}")
    return files[0]


def bill_of_materials(metadata: bytes, parts: dict[str, str], seconds: int) -> str:
    """Return the CycloneDX document of a wheel: what is compiled in, and what it needs at run time.

    Parameters
    ----------
    metadata
        METADATA of the wheel.
    parts
        Name and version of what was compiled in.
    seconds
        Time of the document, since 1970 [s].
    """
    fields = BytesParser().parsebytes(metadata)
    name, version = fields["Name"], fields["Version"]
    components: list[dict[str, Any]] = []
    for part, part_version in sorted(parts.items()):
        licence, home = KNOWN_PARTS[part]
        components.append(
            {
                "type": "library",
                "bom-ref": f"{part}@{part_version}",
                "name": part,
                "version": part_version,
                "scope": "required",
                "licenses": [{"license": {"id": licence}}],
                "externalReferences": [{"type": "website", "url": home}],
                "properties": [{"name": "hexservo:linked", "value": "compiled in"}],
            }
        )
    for requirement in sorted(fields.get_all("Requires-Dist") or []):
        needed = re.match(r"[\w.-]+", requirement)
        assert needed is not None
        components.append(
            {
                "type": "library",
                "bom-ref": f"requires:{requirement}",
                "name": needed[0],
                "purl": f"pkg:pypi/{needed[0].lower()}",
                "scope": "optional" if "extra ==" in requirement else "required",
                "properties": [{"name": "hexservo:requirement", "value": requirement}],
            }
        )
    document = {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "timestamp": datetime.fromtimestamp(seconds, timezone.utc).isoformat(),
            "component": {
                "type": "library",
                "bom-ref": f"{name}@{version}",
                "name": name,
                "version": version,
                "purl": f"pkg:pypi/{name}@{version}",
                "licenses": [{"license": {"id": fields["License-Expression"]}}],
            },
        },
        "components": components,
        "dependencies": [{"ref": f"{name}@{version}", "dependsOn": [part["bom-ref"] for part in components]}],
    }
    serial = uuid.uuid5(uuid.NAMESPACE_URL, json.dumps(document))
    return json.dumps({**document, "serialNumber": f"urn:uuid:{serial}"}, indent=2) + "\n"


def finish(wheel: Path, out: Path, seconds: int) -> Path:
    """Write a wheel again: with the bill of materials, entries sorted, one time, and its RECORD to match."""
    with zipfile.ZipFile(wheel) as archive:
        modes = {info.filename: info.external_attr >> 16 for info in archive.infolist() if not info.is_dir()}
        files = {name: archive.read(name) for name in modes}
    folder = only([Path(name).parent for name in files if re.fullmatch(r"[^/]+\.dist-info/METADATA", name)], "METADATA")
    parts = json.loads(files.pop(f"{folder}/{PARTS}"))
    document = bill_of_materials(files[f"{folder}/METADATA"], parts, seconds)
    files[f"{folder}/sboms/hexservo.cdx.json"] = document.encode()

    record = f"{folder}/RECORD"
    files.pop(record)
    table = io.StringIO()
    rows = csv.writer(table, lineterminator="\n")
    for name in sorted(files):
        digest = base64.urlsafe_b64encode(hashlib.sha256(files[name]).digest()).rstrip(b"=").decode()
        rows.writerow([name, f"sha256={digest}", len(files[name])])
    rows.writerow([record, "", ""])
    files[record] = table.getvalue().encode()

    time = datetime.fromtimestamp(seconds, timezone.utc).timetuple()[:6]
    finished = out / wheel.name
    with zipfile.ZipFile(finished, "w") as archive:
        for name in [*sorted(set(files) - {record}), record]:  # RECORD last, as the format advises
            info = zipfile.ZipInfo(name, time)
            info.compress_type = zipfile.ZIP_DEFLATED
            executable = modes.get(name, 0) & 0o111
            info.external_attr = (0o100755 if executable else 0o100644) << 16
            archive.writestr(info, files[name], compresslevel=9)
    return finished


def offline() -> list[str]:
    """Return what runs a command without a network, where the system allows that: a build fetches nothing."""
    alone = ["unshare", "--map-root-user", "--net"]
    try:
        allowed = subprocess.run([*alone, "true"], capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        allowed = False
    if not allowed:
        print("This system gives no network of their own to programs: the build is not cut off from it.")
    return alone if allowed else []


def version_of(python: str) -> str:
    """Return the version ("3.13") of an interpreter."""
    code = "import sys; print('%d.%d' % sys.version_info[:2])"
    return subprocess.run([python, "-c", code], check=True, capture_output=True, text=True).stdout.strip()


def build_group() -> str:
    """Return the list of the tools of a build, as it stands in pyproject.toml."""
    found = re.search(r"^build = (\[.*?\])$", (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.M | re.S)
    if found is None:
        raise SystemExit("pyproject.toml: expected the dependency group build, found none")
    return found[1]


def tools(version: str, python: str | None = None) -> Path:
    """Return an interpreter of a version with the tools of a build: this one, or that of an environment for it."""
    if version == f"{sys.version_info.major}.{sys.version_info.minor}":
        return Path(sys.executable)
    folder = ROOT / "build" / "release" / version
    interpreter = folder / "bin" / "python"
    complete, group = folder / "complete", build_group()  # what was installed last, and what has to be
    if not complete.exists() or complete.read_text(encoding="utf-8") != group:
        run(python or f"python{version}", "-m", "venv", "--clear", folder)
        run(interpreter, "-m", "pip", "install", "--quiet", "--upgrade", "pip>=25.1")
        run(interpreter, "-m", "pip", "install", "--quiet", "--group", f"{ROOT / 'pyproject.toml'}:build")
        complete.write_text(group, encoding="utf-8")
    return interpreter


def build(source: Path, out: Path, seconds: int, pythons: list[str]) -> list[Path]:
    """Build the archive of a tree's sources and from it, unpacked in a separate folder, a wheel per interpreter."""
    with tempfile.TemporaryDirectory(prefix="hexservo-wheel-") as temporary:
        raw = Path(temporary)
        run(*offline(), sys.executable, "-m", "build", "--no-isolation", "--sdist", "--outdir", raw, source)
        sources = only(list(raw.glob("*.tar.gz")), "archive of the sources")
        out.mkdir(parents=True, exist_ok=True)
        files = [Path(shutil.copyfile(sources, out / sources.name))]
        for python in pythons:
            version = version_of(python)
            made, repaired = raw / version, raw / f"{version}-repaired"
            pip = (tools(version, python), "-m", "pip", "wheel", "--no-index", "--no-deps", "--no-build-isolation")
            run(*offline(), *pip, "--wheel-dir", made, sources)
            wheel = only(list(made.glob("*.whl")), "wheel")
            run(sys.executable, "-m", "auditwheel", "repair", "--wheel-dir", repaired, wheel)
            files.append(finish(only(list(repaired.glob("*.whl")), "repaired wheel"), out, seconds))
        return files


def copy_of(source: Path, target: Path) -> Path:
    """Copy the files of a tree that git knows, and the page of the explorer, into a new folder."""
    listed = subprocess.run(["git", "-C", str(source), "ls-files", "-z"], check=True, capture_output=True, text=True)
    for name in [*filter(None, listed.stdout.split("\0")), "python/hexservo/explorer.html"]:
        if (source / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source / name, target / name)
    return target


def digest(file: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def main() -> None:
    """Build both archives and print their names, sizes and digests."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder of the archives (dist)")
    parser.add_argument(
        "--again", action="store_true", help="build a copy in another folder too, and compare the bytes"
    )
    parser.add_argument(
        "--python", action="append", metavar="COMMAND", help="wheel for that interpreter (this one); repeatable"
    )
    options = parser.parse_args()
    pythons = options.python or [sys.executable]
    seconds = epoch()
    os.environ |= {"SOURCE_DATE_EPOCH": str(seconds), "LC_ALL": "C.UTF-8", "PYTHONHASHSEED": "0"}
    # pip unpacks the sources in a folder of another name each time: with paths relative to it, ccache (where it is)
    # compiles what does not depend on the interpreter once for all wheels.
    os.environ |= {"CCACHE_BASEDIR": tempfile.gettempdir(), "CCACHE_NOHASHDIR": "true"}
    os.umask(0o022)
    for old in [*options.out.glob("hexservo-*.tar.gz"), *options.out.glob("hexservo-*.whl")]:
        old.unlink()
    with tempfile.TemporaryDirectory(prefix="hexservo-again-in-a-longer-path-") as temporary:
        folder = Path(temporary)
        copy = copy_of(ROOT, folder / "copy") if options.again else None
        files = build(ROOT, options.out.resolve(), seconds, pythons)
        for wheel in files[1:]:
            run(sys.executable, "-m", "auditwheel", "show", wheel)
        if copy:
            os.environ["CCACHE_DISABLE"] = "1"  # which would answer with the first build's objects
            again = build(copy, folder / "out", seconds, pythons)
            different = [file.name for file, other in zip(files, again, strict=True) if digest(file) != digest(other)]
            if different:
                raise SystemExit(f"expected the same bytes from another folder, got others of {', '.join(different)}")
            print("A copy in another folder gave the same bytes.")
    for file in files:
        print(digest(file), f"{file.stat().st_size / 1e6:.1f} MB", file)


if __name__ == "__main__":
    main()
