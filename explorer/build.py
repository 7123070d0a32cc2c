"""Builds the explorer, one HTML file: ``python explorer/build.py OUT.html``, with hexservo, ziglang and npm."""

from __future__ import annotations

import base64
import gzip
import html
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import data
import wasm
from hexservo.report.explorer import built_for

HERE = Path(__file__).resolve().parent
LICENCES = ("LICENSE", *(f"licenses/{name}.txt" for name in ("uplot", "three", "eigen", "musl", "cloudlibc", "zig")))
MODULES = wasm.OBJECTS / "npm"
MOST_BYTES = 1_000_000


def tools() -> Path:
    """Install the page's libraries and esbuild below build/, and return their folder."""
    MODULES.mkdir(parents=True, exist_ok=True)
    wanted = [HERE / "package.json", HERE / "package-lock.json"]
    text = b"".join(file.read_bytes() for file in wanted)
    installed = MODULES / "installed"  # for what the folder is complete
    if not installed.exists() or installed.read_bytes() != text:
        installed.unlink(missing_ok=True)
        for file in wanted:
            shutil.copy(file, MODULES)
        subprocess.run(["npm", "ci", "--silent", "--no-audit", "--no-fund"], cwd=MODULES, check=True)
        installed.write_bytes(text)
    return MODULES / "node_modules"


def bundled(name: str, form: str, modules: Path) -> str:
    """Return a script and all it imports as one; of three not WebGL, which esbuild would not find to be unused."""
    form_and_rest = [f"--format={form}", "--bundle", "--minify", "--target=es2022", "--legal-comments=none"]
    three, addons = modules / "three" / "src" / "Three.Core.js", modules / "three" / "examples" / "jsm"
    names = [f"--alias:three={three}", f"--alias:three/addons={addons}"]
    command = [str(modules / ".bin" / "esbuild"), str(HERE / "src" / name), *form_and_rest, *names]
    environment = {**os.environ, "NODE_PATH": str(modules)}
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    return str(done.stdout)


def packed(part: str | bytes) -> str:
    """Return what the page unpacks (src/unpack.js)."""
    return base64.b64encode(gzip.compress(part if isinstance(part, bytes) else part.encode(), 9, mtime=0)).decode()


def licences() -> str:
    """Return the notices of all that is in the page."""
    texts = [(HERE.parent / name).read_text(encoding="utf-8").strip() for name in LICENCES]
    return "\n".join(f"<pre>{html.escape(text)}</pre>" for text in texts)


def build(out: Path) -> None:
    """Compile, bundle, and write the page."""
    module = wasm.OBJECTS / "hexservo.wasm"
    wasm.build(module)
    modules = tools()
    known = data.data()
    parts = {
        "style": (modules / "uplot" / "dist" / "uPlot.min.css").read_text(encoding="utf-8")
        + (HERE / "src" / "style.css").read_text(encoding="utf-8"),
        "version": known["version"],
        "built_for": built_for(),
        "licences": licences(),
        "core": packed(module.read_bytes()),
        "data": packed(json.dumps(known, separators=(",", ":"), allow_nan=False)),
        "worker": packed(bundled("worker.js", "iife", modules)),
        "main": packed(bundled("main.js", "esm", modules)),
        "start": bundled("start.js", "esm", modules),
    }
    page = (HERE / "src" / "page.html").read_text(encoding="utf-8")
    for name, text in parts.items():
        page = page.replace("{{" + name + "}}", text)
    size = len(page.encode())
    if size > MOST_BYTES:
        raise SystemExit(f"{out}: expected at most {MOST_BYTES} bytes, got {size}")
    draft = out.with_suffix(".draft")
    draft.write_text(page, encoding="utf-8")
    draft.replace(out)
    print(f"{out}: {size} bytes (" + ", ".join(f"{name} {len(text)}" for name, text in parts.items()) + ")")


if __name__ == "__main__":
    build(Path(sys.argv[1]).resolve())
