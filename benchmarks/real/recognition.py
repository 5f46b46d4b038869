"""Recognition on fr079 and mit_csail: Table II of the paper, calibration, and loop closures.

A fifth of the keyframes is held out of the whole build, one by one or in blocks of 100, and
labelled. One draw of them says little: the recall is the mean over submaps, and of a small one a
few scans are drawn; so there are several. Closures are the build's merges and transforms against
poses of others' full SLAM (good to 5 cm, each steadied by its neighbours): see closure_truth.py.
"""

from __future__ import annotations

from benchmarks.data import recording, truth_file
from benchmarks.paper.cases import Case, Cases
from benchmarks.paper.workshop import OURS, Workshop
from benchmarks.real.closure_truth import STEADY, judged, true_poses
from benchmarks.real.reliability import diagram, line, of_held_out, reliability
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.rows import Figure, Figures, Row
from specmap_cli.evaluation.protocols import HoldOut, HoldOutResult

DRAWS = {"fr079": 2, "mit_csail": 3}
_SHORT = {"fr079": "fr079", "mit_csail": "csail"}

ROWS = (
    Row("fr079_recall", "fr079, test recall of single scans", 0.97, None, others="the paper .909"),
    Row("fr079_precision", "fr079, test precision", others="the paper .921"),
    Row("fr079_filtered", "fr079, filtered labels"),
    Row("fr079_blocks", "fr079, blocks of 100, filtered labels", 0.90, 0.93),
    Row("fr079_sure", "fr079, calibration error of filtered labels", 0.05, None, "less"),
    Row("fr079_sure_blocks", "the same in blocks of 100", 0.05, None, "less"),
    Row("fr079_merges", "fr079, merges that are right", 1.0, 1.0),
    Row("fr079_revisits", "fr079, revisits found", 0.9, 1.0),
    Row("fr079_closure", "fr079, median error of closures", 3.0, None, "less", ".1f", "cm"),
    Row(
        "csail_recall",
        "mit_csail, test recall of single scans",
        0.93,
        None,
        others="the paper .830",
    ),
    Row("csail_precision", "mit_csail, test precision", others="the paper .846"),
    Row("csail_filtered", "mit_csail, filtered labels"),
    Row("csail_blocks", "mit_csail, blocks of 100, filtered labels"),
    Row("csail_sure", "mit_csail, calibration error of filtered labels", 0.05, None, "less"),
    Row("csail_sure_blocks", "the same in blocks of 100", 0.05, None, "less"),
    Row("csail_merges", "mit_csail, merges that are right", 1.0, 1.0),
    Row("csail_revisits", "mit_csail, revisits found", 0.9, 1.0),
    Row("csail_closure", "mit_csail, median error of closures", 3.0, None, "less", ".1f", "cm"),
)


def measure(_: Bench) -> Figures:
    """Both recordings, each registered once."""
    figures: dict[str, Figure | float] = {}
    for name, draws in DRAWS.items():
        case = Case(
            name=name,
            manner=name,
            log=recording(name),
            truth=truth_file(f"{name}_corrected.tum"),
        )
        with Workshop(Cases((case,))) as workshop:
            found = _of(case, workshop, draws)
        figures |= {f"{_SHORT[name]}_{key}": value for key, value in found.items()}
    return figures


def _of(case: Case, workshop: Workshop, draws: int) -> dict[str, Figure | float]:
    """The figures of one recording."""
    built = [workshop.built(case, OURS, HoldOut("random", seed=seed)) for seed in range(draws)]
    single = [each.scores() for each in built]
    blocks = workshop.built(case, OURS, HoldOut("blocks", seed=0))
    print(f"{'Table II':24} | training recall precision | test recall precision | filtered")
    for result in single:
        print(f"{case.name:24} | {one_draw(result)}")
    print(f"{case.name + ', blocks of 100':24} | {one_draw(blocks.scores())}")
    told = {"": of_held_out(built[0]), "_blocks": of_held_out(blocks)}
    for key, each in told.items():
        print(f"{line(case.name + key, each)}\n{diagram(each)}")
    closed = workshop.built(case, OURS)
    truth = true_poses(case.truth, closed.store)
    judgement = judged(closed.explored, closed.store, truth, STEADY)
    print(f"{case.name}, closures: {judgement}", flush=True)
    metres, degrees = judgement.median
    return {
        "recall": Figure.of([one.test.recall for one in single]),
        "precision": Figure.of([one.test.precision for one in single]),
        "filtered": Figure.of([one.filtered.accuracy for one in single]),
        "blocks": blocks.scores().filtered.accuracy,
        **{
            f"sure{key}": reliability(each.filtered, each.filtered_right).error
            for key, each in told.items()
        },
        "merges": _share(judgement.right, judgement.merges),
        "revisits": _share(judgement.found, judgement.revisits),
        "closure": Figure(
            100 * metres,
            note=f"{degrees:.2f} degrees; {judgement.wrong} wrong",
        ),
    }


def _share(some: int, of: int) -> Figure:
    return Figure(some / of if of else None, note=f"{some} of {of}")


def one_draw(result: HoldOutResult) -> str:
    """Table II of one draw, for reading."""
    return (
        f"{result.train.recall:.3f} {result.train.precision:.3f} | "
        f"{result.test.recall:.3f} {result.test.precision:.3f} | {result.filtered.accuracy:.3f} "
        f"({len(result.test.ids)} submaps, {result.test.scans} scans)"
    )
