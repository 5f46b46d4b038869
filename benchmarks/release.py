"""What `make release` checks beside the tests: the tree, the wheel on each Python, the image.

`python -m benchmarks.release check` holds before anything is built, `... try` tries the wheel of
dist/ and tells what was tried and what was not. Nothing is uploaded.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import specmap_cli

ROOT = Path(__file__).parent.parent
PYTHONS = ("python3.11", "python3.12", "python3.13", "python3.14")
SAMPLE = ROOT / "sample_logs" / "office_again.mcap"
STEPS = (
    ("build", SAMPLE, "-o", "map"),
    ("localize", SAMPLE, "--map", "map", "--out", "where.csv"),
    ("check", "map"),
)
WITHOUT_KISS_ICP = (
    ("segment", SAMPLE.with_name("office.yaml"), "-o", "map"),
    ("info", SAMPLE),
    ("report", "map", "-o", "map.html"),
    ("export", "map", "--format", "nav2", "-o", "map.geojson"),
)


def faults(changes: str, changelog: str, version: str) -> list[str]:
    """Why a tree is not to be released: what git says of it, and its changelog."""
    headings = re.findall(r"^## (.*)$", changelog, flags=re.MULTILINE)
    found = []
    if changes:
        found.append(f"the tree is not clean: {changes.splitlines()[0].strip()}")
    if not re.fullmatch(rf"{re.escape(version)} \(\d{{4}}-\d\d-\d\d\)", next(iter(headings), "")):
        found.append(f"CHANGELOG.md does not begin with '## {version} (date)'")
    return found


def works(*command: object, cwd: Path = ROOT) -> bool:
    """Whether a command ends well; what it says is shown where it does not."""
    done = subprocess.run([*map(str, command)], cwd=cwd, capture_output=True, text=True)
    if done.returncode:
        print("\n".join((done.stdout + done.stderr).splitlines()[-5:]))
    return done.returncode == 0


def tried_on(python: str, wheel: Path) -> str:
    """What became of the wheel on one Python: the first map in two commands, and a second log."""
    has_venv = [python, "-c", "import ensurepip"]
    if shutil.which(python) is None or subprocess.run(has_venv, capture_output=True).returncode:
        return "not tried: it is not on this machine"
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        binary = place / "venv" / "bin"
        if not works(python, "-m", "venv", place / "venv"):
            return "FAILED: no environment"
        pins = ROOT / "constraints.txt"
        pip = (binary / "python", "-m", "pip", "install", "--quiet", "--constraint", pins)
        if not works(*pip, "--only-binary", "kiss-icp", wheel):
            return "FAILED: it cannot be installed"
        site = next((place / "venv" / "lib").glob("python*/site-packages"))
        parts = [path for path in site.iterdir() if path.name.split("-")[0] not in {"pip"}]
        files = [file for part in parts for file in [part, *part.rglob("*")] if file.is_file()]
        size = sum(file.stat().st_size for file in files) / 1e6
        steps = STEPS if (site / "kiss_icp").exists() else WITHOUT_KISS_ICP
        for arguments in steps:
            if not works(binary / "specmap", *arguments, cwd=place):
                return f"FAILED: specmap {arguments[0]}"
        told = ", ".join(str(arguments[0]) for arguments in steps)
        return f"installed ({size:.0f} MB), these work: {told}"


def image() -> str:
    """What became of the container image."""
    for tool in ("podman", "docker"):
        if (
            shutil.which(tool)
            and not subprocess.run([tool, "info"], capture_output=True).returncode
        ):
            build = (tool, "build", "-q", "-t", "specmap", "-f", "Containerfile", ".")
            if works(*build) and works(tool, "run", "--rm", "specmap", "--version"):
                return f"built and run with {tool}"
            return f"FAILED with {tool}"
    return "not tried: neither podman nor docker answers"


def main(step: str) -> int:
    """Run a step; 1 when something is wrong."""
    if step == "check":
        git = ["git", "status", "--porcelain"]
        changes = subprocess.run(git, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
        found = faults(changes, changelog, specmap_cli.__version__)
        print("\n".join(f"not to be released: {fault}" for fault in found))
        return int(bool(found))
    (wheel,) = (ROOT / "dist").glob(f"*-{specmap_cli.__version__}-*.whl")
    told = {python: tried_on(python, wheel) for python in PYTHONS} | {"container image": image()}
    print(f"specmap {specmap_cli.__version__}: {wheel.name}, nothing was uploaded")
    for what, became in told.items():
        print(f"  {what}: {became}")
    return int(any(became.startswith("FAILED") for became in told.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
