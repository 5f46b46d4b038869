"""Which jobs there are: of logs, directories, patterns, stores, TOML files; their summaries."""

import csv
import io
import pickle
import re
import typing
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from specmap_cli.batch import jobs
from specmap_cli.batch.jobs import SUFFIXES, arguments_of
from specmap_cli.batch.records import COMMANDS, Job, JobRecord, Plan, Step
from specmap_cli.batch.summaries import (
    COLUMNS,
    SUMMARIES,
    Row,
    as_csv,
    as_html,
    as_junit,
    as_markdown,
    as_parquet,
    headline,
    rows_of,
)
from specmap_cli.cli.making import known_options
from specmap_cli.core.errors import SETTING, LogError, UsageError
from specmap_cli.exports.table import exporters
from specmap_cli.logs.readers.mcap import McapFile
from tests.batch.results import failed, result, warned
from tests.report.browser import Browser, installed

DEFAULT = (Step("build"), Step("report"), Step("check"))
KNOWN = known_options()
Lay = Callable[..., Path]


@pytest.fixture
def lay(tmp_path: Path) -> Lay:
    """Write files that begin as a recording does, or hold the text given; returns the directory."""

    def lay(*names: str, **texts: str) -> Path:
        for name in names:
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(McapFile.magic)
        for name, text in texts.items():
            (tmp_path / name.replace("__", ".")).write_text(text)
        return tmp_path

    return lay


def jobs_of(inputs: list[str], plan: Plan = Plan()) -> tuple[Job, ...]:
    """The jobs of some inputs, with the options of the command line."""
    return jobs.jobs_of(inputs, replace(plan, known=KNOWN))


def names(found: tuple[Job, ...]) -> list[str]:
    return [job.name for job in found]


def test_a_directory_gives_every_recording_below_it_once(lay: Lay) -> None:
    where = lay("b.mcap", "a/b.mcap", "a/without suffix", ".hidden/c.mcap", "a/.d.mcap")
    lay("maps/map/keyframes.mcap", "maps/map/topology.json", "old/job/job.json", "old/job/e.mcap")
    lay("bag/metadata.yaml", "bag/bag_0.mcap", "bag/bag_1.mcap", note__txt="not a recording")
    # a damaged beginning does not hide a recording
    lay(empty__mcap="", rubbish__bag="rubbish", some__log="some text")
    found = jobs_of([str(where), str(where / "b.mcap")])
    assert {job.name: Path(job.logs[0]).relative_to(where).as_posix() for job in found} == {
        **{"b": "b.mcap", "a-b": "a/b.mcap", "a-without_suffix": "a/without suffix"},
        **{"bag": "bag", "empty": "empty.mcap", "rubbish": "rubbish.bag"},
    }


def test_a_pattern_gives_what_matches(lay: Lay) -> None:
    where = lay("may/1/run.mcap", "may/2/run.mcap", "june/run.mcap")
    assert names(jobs_of([f"{where}/may/*/run.mcap"])) == ["1-run", "2-run"]
    assert names(jobs_of([f"{where}/**/run.mcap"])) == ["june-run", "may-1-run", "may-2-run"]
    (where / "empty").mkdir()
    for place in ("none.mcap", "none/*.mcap", "empty"):
        with pytest.raises(LogError, match=r"no recording there|no such file"):
            jobs_of([str(where / place)])


def test_names_are_safe_none_of_the_batch_s_and_stay_when_other_logs_come(lay: Lay) -> None:
    where = lay("x/run one.mcap", "y/run one.mcap", "y/Run_One.bag")
    several = [str(where / "x" / "run one.mcap"), str(where / "y")]
    assert names(jobs_of([str(where / "y" / "run one.mcap")])) == ["run_one"]
    first, second, third = names(jobs_of(several))
    assert first == "run_one"
    assert second.startswith("Run_One-")
    assert third.startswith("run_one-")
    assert second[-8:] != third[-8:]
    assert [first, second, third] == names(jobs_of(several))
    beside = {"events.jsonl", *SUMMARIES}
    assert beside == jobs.BESIDE_JOBS
    lay(*(f"z/{name}.mcap" for name in beside))
    assert beside.isdisjoint(names(jobs_of([str(where / "z")])))


def test_a_log_is_a_job_called_as_it_with_the_default_steps_or_those_asked_for(lay: Lay) -> None:
    log = str(lay("monday.bag.zst") / "monday.bag.zst")
    (job,) = jobs_of([log])
    assert job == Job("monday", (log,), DEFAULT)
    assert pickle.loads(pickle.dumps(job)) == job
    plan = Plan(("build",), {"build": {"set": ["seed=1", "grid.resolution_m=0.1"], "seed": 3}})
    (job,) = jobs_of([log], plan)
    asked = ("--set=seed=1", "--set=grid.resolution_m=0.1", "--seed=3")
    assert job.steps == (Step("build", asked),)
    with pytest.raises(UsageError, match="steps: empty: choose from build"):
        jobs_of([log], Plan(()))


TOML = """
steps = ["build", "export", "check"]
logs = ["fleet/*.mcap"]

[options.build]
preset = "paper"
set = ["grid.resolution_m=0.1"]

[options.check]
rules = "rules.toml"

[options.export]
format = ["nav2", "csv"]

[[job]]
name = "lobby"
logs = ["lobby/part_*.mcap"]
steps = ["build"]
[job.options.build]
set = []
no-relax = true

[[job]]
logs = "cellar.mcap"
"""


def test_a_file_of_jobs_says_which_logs_steps_and_options(lay: Lay) -> None:
    where = lay("fleet/1.mcap", "fleet/2.mcap", "lobby/part_1.mcap", "lobby/part_2.mcap")
    lay("cellar.mcap", rules__toml="", jobs__toml=TOML)
    one, two, lobby, cellar = jobs_of([str(where / "jobs.toml")])
    assert names((one, two, cellar)) == ["1", "2", "cellar"]
    assert one.steps == (
        Step("build", ("--preset=paper", "--set=grid.resolution_m=0.1")),
        Step("export", ("--format=nav2",)),
        Step("export", ("--format=csv",)),
        Step("check", (rules := f"--rules={where / 'rules.toml'}",), (rules,)),
    )
    assert one.steps == two.steps == cellar.steps
    parts = tuple(str(where / "lobby" / f"part_{number}.mcap") for number in (1, 2))
    assert lobby == Job("lobby", parts, (Step("build", ("--preset=paper", "--no-relax")),))


def test_a_step_without_a_map_of_the_job_takes_another_one(lay: Lay) -> None:
    where = lay("a.mcap", "golden/topology.json")
    lay(
        jobs__toml='logs = "a.mcap"\nsteps = ["localize", "evaluate"]\n'
        '[options.localize]\nmap = "golden"\n[options.evaluate]\nprotocol = "holdout"'
    )
    (job,) = jobs_of([str(where / "jobs.toml")])
    localize, evaluate = (arguments_of(step, job.logs) for step in job.steps)
    assert localize[1:] == [f"--map={where}/golden", "--json", "--out=labels.csv", "--", *job.logs]
    assert evaluate[-3:] == ["--out=confusion.png", "--", *job.logs]


LOGS, NAMED = 'logs = "a.mcap"\n', "[[job]]\nname = "


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "jobs.toml: no jobs"),
        ("logs = [", "jobs.toml: not valid TOML"),
        (LOGS + "stepz = []", "jobs.toml: stepz: no such key, did you mean steps?"),
        (LOGS + 'steps = ["biuld"]', "jobs.toml: 'biuld': no such step: choose from build"),
        (LOGS + "steps = []", "jobs.toml: steps: empty"),
        (LOGS + 'steps = "build, check"', "jobs.toml: 'build, check': no such step"),
        (LOGS + 'steps = ["check"]', "jobs.toml: steps: check needs a map: put build before it"),
        (LOGS + 'steps = ["build", "build"]', "build is given twice"),
        (LOGS + "[options.biuld]", "jobs.toml: 'biuld': no such step"),
        (LOGS + "[options.build]\nsett = 1", "build.sett: no such option: did you mean set"),
        (LOGS + '[options.build]\nout = "/etc"', "options.build.out: the batch says that itself"),
        (LOGS + "[options.check]\njson = true", "options.check.json: the batch says that itself"),
        (LOGS + '[options.check]\njunit = "../x"', "options.check.junit is '../x': expected the"),
        (LOGS + '[options.check]\njunit = "job.json"', "job.json is written twice"),
        (LOGS + '[options.check]\nrules = "none.toml"', "none.toml: no such file"),
        (LOGS + "[options.build]\nno-relax = 1", "options.build.no-relax is 1: expected true"),
        (LOGS + "[options.build]\nseed = [1]", "options.build.seed is [1]: expected a text or a"),
        (LOGS + "[options]\nbuild = 3", "options.build is 3: expected a table"),
        (LOGS + 'steps = ["build", "export"]', "options.export.format: missing"),
        ("logs = 3", "jobs.toml: logs is 3: expected a list"),
        ("job = 3", "jobs.toml: job is 3: expected tables"),
        ('[[job]]\nname = "x"', "jobs.toml: job 1 (x): logs: missing"),
        ('[[job]]\nname = "../x"\n' + LOGS, "job 1 (../x): name is '../x': expected letters"),
        (f'{NAMED}"x"\n{LOGS}{NAMED}"X"\n{LOGS}', "job 2 (X): name: X is another"),
        (f'{NAMED}"Index.html"\n{LOGS}', "a file of the batch's, too: choose another"),
        (f'[[job]]\n{LOGS}log = "b"', "jobs.toml: job 1: log: no such key, did you mean logs?"),
        (f"[[job]]\n{LOGS}[job.options.build]\nseeed = 1", "job 1: options.build.seeed: no such"),
    ],
)
def test_what_a_file_of_jobs_says_wrong_has_its_place(lay: Lay, text: str, complaint: str) -> None:
    where = lay("a.mcap", jobs__toml=text)
    with pytest.raises(UsageError) as told:
        jobs_of([str(where / "jobs.toml")])
    assert complaint in str(told.value)
    assert told.value.code == SETTING
    assert told.value.where == str(where / "jobs.toml"), "whatever is wrong, and wherever in it"
    assert "\n" not in str(told.value).split("TOML")[0]
    assert str(told.value).startswith(str(where))


def test_the_command_line_says_what_options_take() -> None:
    assert set(KNOWN) == set(COMMANDS)
    assert KNOWN["localize"]["output"].names == ("out", "output")
    said = {"out", "output", "confusion", "trajectory"}  # by the batch itself
    found = {
        f"{command} {name}": option.meaning
        for command in COMMANDS
        for name, option in KNOWN[command].items()
        if option.meaning in ("input", "output") and name not in said
    }
    inputs = [
        *("build like", "build config", "localize map", "localize config", "export config"),
        *(f"evaluate {name}" for name in ("relations", "reference", "rooms", "config")),
        *("report compare", "report config", "check rules", "check against", "check config"),
    ]
    outputs = ("build explain", "localize plot", "check junit", "check markdown")
    assert found == {**dict.fromkeys(inputs, "input"), **dict.fromkeys(outputs, "output")}
    several = {name for known in KNOWN.values() for name in known if known[name].several}
    assert several == {"set", "reference", "rooms"}
    flags = {name for name, option in KNOWN["build"].items() if option.meaning == "flag"}
    assert flags == {"no-relax", "overwrite", "no-odometry", "quiet", "json"}


def test_every_export_of_ours_has_the_suffix_that_its_programs_know() -> None:
    assert set(SUFFIXES) == set(exporters())
    assert set(typing.get_args(typing.get_type_hints(Step)["command"])) == set(COMMANDS)


def rows_for(*records: JobRecord, waiting: str = "") -> list[Row]:
    known = {one.name: one for one in records}
    return rows_of([*known, *waiting], known)


@pytest.fixture
def rows() -> list[Row]:
    poor = result("c", figures={"verdict": "poor", "scans": 10, "lost_share": 0.64})
    bad = failed("b", reason='no scans | in "b"\x1b, <none>')
    return rows_for(result("a"), bad, poor, waiting="d")


def test_csv_says_what_is_known(rows: list[Row]) -> None:
    read = list(csv.DictReader(io.StringIO(as_csv(rows).decode())))
    assert list(read[0]) == list(COLUMNS)
    assert [row["state"] for row in read] == ["done", "failed", "done", "waiting"]
    assert read[0] == {
        **dict.fromkeys(("kind", "reason", "warnings"), ""),
        **{"name": "a", "state": "done", "verdict": "good", "lost_share": "0.0125"},
        **{"submaps": "7", "area_m2": "123.46", "path_m": "45.68", "scans": "900"},
        **{"scans_per_s": "50.0", "wall_s": "18.0", "memory_mb": "300.5", "attempts": "1"},
        "digest": "d" * 64,
    }


def test_parquet_says_the_same_with_types(rows: list[Row]) -> None:
    table = pytest.importorskip("pyarrow.parquet").read_table(io.BytesIO(as_parquet(rows)))
    assert table.to_pylist() == [dict(row) for row in rows]
    assert str(table.schema.field("scans").type) == "int64"
    assert str(table.schema.field("lost_share").type) == "double"


def test_markdown_names_what_failed_what_is_doubtful_and_warnings(rows: list[Row]) -> None:
    text = as_markdown(rows).decode()
    assert text.startswith("### 2 of 4 jobs done, 1 failed, 1 waiting\n")
    assert "- 910 scans over 46 m in 54 s of work\n- maps: 1 good, 1 poor\n" in text
    assert '| b | log | no scans \\| in "b"\\\\x1b, \\<none\\> | 1 |' in text
    assert "| c | poor | 0.64 |  |" in text
    assert "\n| d |" not in text, "a job that waits took no time"
    text = as_markdown(rows_for(*(failed(f"{k:03}") for k in range(100)))).decode()
    assert "... and 80 more: see summary.csv" in text
    assert text.count("holds no scans") == 20
    text = as_markdown(rows_for(warned("a", "cut | off"), result("b"))).decode()
    assert "#### Warnings\n\n| name | warnings |\n|---|---|\n| a | cut \\| off |\n" in text
    good = rows_for(*map(result, "abc"))
    assert [headline(good), headline(good[:1])] == ["All 3 jobs done", "1 job done"]


def test_junit_is_a_test_a_job(rows: list[Row]) -> None:
    suite = ElementTree.fromstring(as_junit(rows)).find("testsuite")
    assert suite is not None
    assert [suite.get(name) for name in ("tests", "failures", "skipped")] == ["4", "1", "1"]
    failure = suite.find("testcase[@name='b']/failure")
    assert failure is not None
    assert failure.get("type") == "log"


def page(*records: JobRecord, waiting: str = "") -> str:
    return as_html(rows_for(*records, waiting=waiting), {one.name: one for one in records}).decode()


def links(text: str) -> set[str]:
    return set(re.findall(r'<[^>]* (?:href|src)="([^"]*)"', text))


def test_the_page_links_what_there_is_and_what_needs_somebody_stands_first() -> None:
    """With what to do; and it needs no other file."""
    text = page(result("a"), failed("z"), waiting="b")
    of_a = {f"a/{name}" for name in ("map/overview.png", "report.html", "log.txt", "map/")}
    assert links(text) == of_a | {"z/log.txt"}
    assert "default-src 'none'" in text
    assert re.findall('<tr data-name="(.)"', text) == ["z", "a", "b"]
    assert text.count("What to do:") == 1
    assert "see what `specmap info --check` says of the recording" in text


def test_names_reasons_and_warnings_are_text() -> None:
    text = page(result("50% #1?"), failed("b", reason="<script>alert(1)</script>"))
    assert "<script>alert" not in text
    assert "50%25%20%231%3F/report.html" in links(text)
    assert '<p class="reason">cut &lt;off&gt;; late</p>' in page(warned("a", "cut <off>", "late"))
    assert 'class="reason"' not in page(result("a"))
    assert len(page(*(result(f"{k:04}") for k in range(1000)))) < 3e6, "few megabytes of many jobs"


@pytest.mark.skipif(installed() is None, reason="needs a Chromium")
def test_in_a_browser_the_page_is_searched_and_sorted(tmp_path: Path) -> None:
    file = tmp_path / "index.html"
    slow = result("corridor", wall_s=99.0)
    file.write_text(page(slow, result("lobby"), failed("lab")), encoding="utf-8")
    program = installed()
    assert program is not None
    rows = "[...document.querySelectorAll('#jobs tbody tr:not([hidden])')].map(r => r.dataset.name)"
    with Browser(program) as browser:
        browser.open(file)
        browser.run(
            "const s = document.querySelector('#sought'); s.value = 'L';"
            "s.dispatchEvent(new Event('input'))"
        )
        assert browser.run(rows) == ["lab", "lobby"]
        browser.run("s.value = ''; s.dispatchEvent(new Event('input'))")
        browser.run("document.querySelectorAll('#jobs thead button')[7].click()")
        assert browser.run(rows) == ["lab", "lobby", "corridor"]
        missing = "ERR_FILE_NOT_FOUND"  # the pictures of these jobs
        assert [error for error in browser.errors if missing not in error] == []
