"""`specmap localize` in scans per second, and how soon the first label is there.

    OMP_NUM_THREADS=1 python -m benchmarks.localizing [--quick]

Maps of the sample office and logs of another tour through it are simulated: lasers of 180 beams
over 180 degrees, of 720 all round and of 1,080 over 270. Each log is localised by the program, in a
process of its own: raw labels alone, with the filter, and with `--metric` besides. The rate is that
of processor time, without the seconds that a log of a single scan takes. These are the start.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from benchmarks.processes import measure
from specmap_cli.grids.map_server import read_grid
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.simulation.simulator import SimulationOptions

LASERS = {180: 180.0, 720: 360.0, 1080: 270.0}  # beams: degrees
MAP_S, LOG_S, RATE_HZ = 150.0, 80.0, 10.0
ROOT = Path(__file__).parent.parent
PROGRAM = [sys.executable, "-m", "specmap_cli"]
RAW = ["--set", "localization.virtual=false", "--set", "localization.unknown=false"]
MODES: dict[str, list[str]] = {"raw": RAW, "filter": [], "filter, --metric": ["--metric"]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="the laser of 180 beams only")
    quick = parser.parse_args().quick
    table(dict(list(LASERS.items())[:1] if quick else LASERS))


def table(lasers: Mapping[int, float]) -> None:
    """Print a row for each laser: its beams, and degrees of view."""
    print(f"{'':12}{'start s':>9}" + "".join(f"{mode:>18}" for mode in MODES) + "   scans a second")
    for beams in lasers:
        with tempfile.TemporaryDirectory() as name:
            print(f"{beams:5} beams " + _row(Path(name), beams), flush=True)


def _row(folder: Path, beams: int) -> str:
    """Seconds until the first label, and scans a second of processor time in every mode."""
    path = str(ROOT.resolve())
    _record(folder / "map.mcap", beams, MAP_S, 1)
    scans = _record(folder / "log.mcap", beams, LOG_S, 2)
    _record(folder / "one.mcap", beams, 0.5 / RATE_HZ, 2)
    measure([*PROGRAM, "build", "map.mcap", "-o", "map", "-q"], folder, PYTHONPATH=path)
    rates, starts = [], []
    for options in MODES.values():
        one, whole = (
            measure([*PROGRAM, "localize", log, "--map", "map", *options], folder, PYTHONPATH=path)
            for log in ("one.mcap", "log.mcap")
        )
        starts.append(one.processor_s)
        rates.append((scans - 1) / (whole.processor_s - one.processor_s))
    return f"{min(starts):9.2f}" + "".join(f"{rate:18.0f}" for rate in rates)


def _record(out: Path, beams: int, seconds: float, seed: int) -> int:
    """Write a tour of the sample office; the number of its scans."""
    options = SimulationOptions(
        field_of_view_deg=LASERS[beams],
        beams=beams,
        rate_hz=RATE_HZ,
        max_duration_s=seconds,
        seed=seed,
    )
    return simulate(read_grid(ROOT / "sample_logs" / "office.yaml"), options, out).scans


if __name__ == "__main__":
    main()
