"""`python -m fuzz`: run cases, and repeat one.

python -m fuzz --cases 20000 --seed 7 --jobs 2
python -m fuzz --seed 7 --case 1234 --keep DIR
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read when numpy is loaded
    os.environ.setdefault(_variable, "1")

from fuzz.report import Tally, case_lines  # noqa: E402
from fuzz.seeds import make_seeds  # noqa: E402
from fuzz.workers import Limits, Pool  # noqa: E402

_TOLD_EVERY = 1000


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases asked for; 0 when all pass, 1 when one fails."""
    options = _parser().parse_args(arguments)
    limits = Limits(time_s=options.seconds, memory_bytes=options.megabytes << 20)
    seeds = make_seeds()
    numbers = range(options.cases) if options.case is None else [options.case]
    pool = Pool(seeds, options.seed, limits, min(options.jobs, len(numbers)))
    tally, started = Tally(options.seed), time.monotonic()
    for outcome in pool.run(numbers):
        tally.add(outcome)
        if tally.cases % _TOLD_EVERY == 0:
            print(tally.progress(time.monotonic() - started), file=sys.stderr, flush=True)
    if options.case is not None:
        print("\n".join(case_lines(seeds, options.seed, options.case, options.keep)))
    print("\n".join(tally.lines(time.monotonic() - started)))
    return int(tally.failed > 0)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--cases", type=int, default=2000, help="how many (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="which cases (%(default)s)")
    parser.add_argument("--jobs", type=int, default=2, help="worker processes (%(default)s)")
    parser.add_argument("--case", type=int, help="run the case of this number alone")
    parser.add_argument("--keep", type=Path, help="with --case: a folder for its damaged input")
    parser.add_argument("--seconds", type=float, default=20.0, help="a case (%(default)s)")
    parser.add_argument("--megabytes", type=int, default=1024, help="a case (%(default)s)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
