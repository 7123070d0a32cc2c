"""Compiles the core to WebAssembly, through its C interface: ``python explorer/wasm.py OUT.wasm``.

Compiler and libraries are those of ziglang from PyPI. The kernels of batches and what needs threads stay out.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OBJECTS = ROOT / "build" / "explorer"
LEFT_OUT = ("kernel", "fmi", "batch", "workers", "probe", "sampled_run", "tick_benchmark", "tick_record", "run_request")
FLAGS = [
    "-std=c++20", "-O2", "-g0", "-DNDEBUG", "-target", "wasm32-wasi", "-fexceptions", "-msimd128", "-ffp-contract=off",
    "-fno-math-errno", "-ffunction-sections", "-fdata-sections", "-fvisibility=hidden", "-Wno-psabi",
]  # fmt: skip
OURS = "hexservo_"


def eigen() -> str:
    """Return the folder of Eigen's headers."""
    for folder in ("/usr/include/eigen3", "/usr/local/include/eigen3"):
        if Path(folder).is_dir():
            return folder
    raise SystemExit("Eigen 3.4 was not found: install the package libeigen3-dev")


def exported() -> list[str]:
    """Return the functions of hexservo.h, and the memory's."""
    header = (ROOT / "cpp" / "include" / "hexservo.h").read_text(encoding="utf-8")
    names = re.findall(rf"^HEXSERVO_API [^(]*?\b({OURS}\w+)\(", header, re.MULTILINE)
    return [*names, "malloc", "free", "__stack_pointer"]


def zig(*arguments: str) -> None:
    """Run the compiler."""
    subprocess.run([sys.executable, "-m", "ziglang", "c++", *arguments], check=True)


def is_old(target: Path, flags: list[str]) -> bool:
    """Return whether an object is older than what it was made of, as the compiler listed it, or of other flags."""
    made_of, made_with = target.with_suffix(".d"), target.with_suffix(".flags")
    if not target.exists() or not made_of.exists() or not made_with.exists():
        return True
    if made_with.read_text(encoding="utf-8") != "\n".join(flags):
        return True
    files = made_of.read_text(encoding="utf-8").partition(":")[2].replace("\\\n", " ").split()
    return any(not Path(file).exists() or Path(file).stat().st_mtime > target.stat().st_mtime for file in files)


def build(out: Path) -> None:
    """Compile what has changed, one file at a time, and link."""
    OBJECTS.mkdir(parents=True, exist_ok=True)
    sources = [
        *(file for file in sorted((ROOT / "cpp" / "src").rglob("*.cpp")) if not file.stem.startswith(LEFT_OUT)),
        ROOT / "explorer" / "wasm" / "exceptions.cpp",
    ]
    version = next(
        line.split("VERSION")[1].split()[0]
        for line in (ROOT / "CMakeLists.txt").read_text(encoding="utf-8").splitlines()
        if line.startswith("project(")
    )
    include = ["-I", str(ROOT / "cpp/include"), "-I", str(ROOT / "cpp/src"), "-isystem", eigen()]
    flags = [*FLAGS, f'-DHEXSERVO_VERSION="{version}"', *include]
    objects = []
    for source in sources:
        target = OBJECTS / (source.stem + ".o")
        objects.append(str(target))
        if is_old(target, flags):
            print(f"  {source.relative_to(ROOT)}", flush=True)
            target.with_suffix(".flags").unlink(missing_ok=True)
            zig(*flags, "-MMD", "-MF", str(target.with_suffix(".d")), "-c", str(source), "-o", str(target))
            target.with_suffix(".flags").write_text("\n".join(flags), encoding="utf-8")
    exports = [f"-Wl,--export={name}" for name in exported()]
    zig("-target", "wasm32-wasi", "-mexec-model=reactor", "-s", "-Wl,--gc-sections", "-O2",
        "-Wl,-z,stack-size=1048576", *exports, *objects, "-o", str(out))  # fmt: skip
    print(f"{out}: {out.stat().st_size} bytes")


if __name__ == "__main__":
    build(Path(sys.argv[1]))
