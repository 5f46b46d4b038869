"""The options that all commands share: who has them, and that they mean the same everywhere."""

import json
from pathlib import Path
from typing import Any

import pytest

from specmap_cli.cli.options import LogSettings, Settings
from tests.cli.conftest import COMMANDS, QUICK, Run, standing_log

READERS = {"info", "build", "localize", "evaluate", "update"}
MAKE = {"segment", "simulate", "convert", "export", "compare", "merge", "edit", "report", "history"}
WRITERS = READERS - {"info"} | MAKE
SETTLED = READERS | MAKE | {"config", "check", "batch"}
ALL = SETTLED | {"schema"}
BOUNDED = {"simulate", "convert", "export", "edit", "report", "history", "check"}  # in their inputs
HAVE = {
    **dict.fromkeys(("--quiet", "-q", "--json", "--log-level"), ALL),
    **dict.fromkeys(("--config", "--set"), SETTLED),
    "--preset": SETTLED - BOUNDED,
    **dict.fromkeys(("--scan-topic", "--odom-topic", "--base-frame", "--no-odometry"), READERS),
    "--overwrite": WRITERS | {"check"},
    **dict.fromkeys(("--out", "-o"), WRITERS | {"batch"}),
}


@pytest.mark.parametrize("option", HAVE)
def test_who_has_a_common_option_that_says_the_same_everywhere(option: str) -> None:
    helps = {
        name: parameter.help
        for name, command in COMMANDS.items()
        for parameter in command.params
        if option in parameter.opts
    }
    assert helps.keys() == HAVE[option]
    assert len(set(helps.values())) == 1 or option in {"--out", "-o"}


def test_one_name_is_one_option_of_a_command() -> None:
    for command in COMMANDS.values():
        names = [name for parameter in command.params for name in parameter.opts]
        assert len(names) == len(set(names))


class TestOut:
    """`-o` is the output, whatever it is; the older names work, too."""

    @pytest.mark.parametrize("option", ["-o", "--out", "--confusion"])
    def test_of_evaluate(self, option: str, tmp_path: Path, run: Run) -> None:
        said = run("evaluate", "x.mcap", "--protocol", "holdout", option, tmp_path)
        said.fails(2)
        assert said.error == f"{tmp_path}: is a directory: name the file to write"

    def test_of_convert_is_an_option_or_the_last_argument(self, tmp_path: Path, run: Run) -> None:
        """With the option all arguments are logs."""
        log, other = (standing_log(tmp_path / f"{k}.mcap", 3.0 + k) for k in range(2))
        named, last = tmp_path / "named.mcap", tmp_path / "last.mcap"
        assert run("convert", log, "-o", named).code == 0
        assert run("convert", log, last, "--json").result["path"] == str(last)
        assert named.read_bytes() == last.read_bytes()
        said = run("convert", log, other, "-o", tmp_path / "both.mcap", "--json")
        written = {topic["name"]: topic["count"] for topic in said.result["written"]}
        assert written["/scan"] == 2 * 5
        told = "name the MCAP to write: specmap convert log.bag -o OUT.mcap"
        assert run("convert", "log.bag").error == told
        run("convert", log, tmp_path / "log.bag").fails(2, "log.bag: what is written is an MCAP")

    def test_convert_takes_the_bounds_of_what_is_unpacked(self, tmp_path: Path, run: Run) -> None:
        log, target = standing_log(tmp_path / "log.mcap", 3.0), tmp_path / "out.mcap"
        line = ("convert", log, "-o", target, "--set")
        run(*line, "log.chunk_max_mb=0.00001").fails(3, "beyond log.chunk_max_mb")
        assert not target.exists()
        assert run(*line, "log.chunk_max_mb=1").code == 0


def damaged(path: Path) -> Path:
    """A log that is cut off: every command that reads it warns."""
    log = standing_log(path, 3.0, scans=8)
    log.write_bytes(log.read_bytes()[:-600])
    return log


def test_quiet_leaves_warnings_to_the_result(tiny_map: Path, tmp_path: Path, run: Run) -> None:
    log = damaged(tmp_path / "cut.mcap")
    for name, *options in (
        ("build", "-o", tmp_path / "map", "--overwrite", *QUICK),
        ("localize", "--map", tiny_map),
    ):
        loud = run(name, log, *options, "--json")
        quiet = run(name, log, *options, "--json", "-q")
        assert "specmap: warning: " in loud.err
        assert (quiet.code, quiet.err) == (0, "")
        assert quiet.out == loud.out
        assert any("cut.mcap: cut off" in warning for warning in json.loads(quiet.out)["warnings"])
    run_record = json.loads((tmp_path / "map" / "run.json").read_text(encoding="utf-8"))
    assert any("cut.mcap: cut off" in warning for warning in run_record["warnings"])
    assert run_record["counts"]["damage"] == 1  # of which `check` has a rule


class TestEnvironment:
    """Variables that stand for options; an option goes over its variable."""

    def test_what_they_are_called(self) -> None:
        variables = {
            parameter.opts[0]: parameter.envvar
            for command in COMMANDS.values()
            for parameter in command.params
            if getattr(parameter, "envvar", None)
        }
        assert variables == {
            **{f"--{name}": f"SPECMAP_{name.upper()}" for name in ("quiet", "json", "config")},
            **{"--log-level": "SPECMAP_LOG_LEVEL", "--preset": "SPECMAP_PRESET"},
        }

    def test_settings(self, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
        settings, others = tmp_path / "a.toml", tmp_path / "b.toml"
        settings.write_text("seed = 5\n", encoding="utf-8")
        others.write_text("seed = 6\n", encoding="utf-8")
        monkeypatch.setenv("SPECMAP_CONFIG", str(settings))
        monkeypatch.setenv("SPECMAP_PRESET", "paper")
        found = run("config", "--json").result
        assert (found["preset"], found["seed"]) == ("paper", 5)
        assert run("config", "--config", others, "--json").result["seed"] == 6

    @pytest.mark.parametrize("yes", ["1", "true", "Yes"])
    def test_json_also_of_errors(self, yes: str, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("SPECMAP_JSON", yes)
        assert run("config").result["seed"] == 0
        assert json.loads(run("info", "none.mcap").out)["error"]["code"] == "log-missing"
        monkeypatch.setenv("SPECMAP_JSON", "0")
        assert run("info", "none.mcap").out == ""

    def test_levels(
        self, tiny_map: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        line = ("localize", damaged(tmp_path / "cut.mcap"), "--map", tiny_map)
        monkeypatch.setenv("SPECMAP_LOG_LEVEL", "warning")
        said = run(*line).err.splitlines()
        assert said
        assert all(text.startswith("specmap: warning: ") for text in said)
        assert "debug: localising" in run(*line, "--log-level", "debug").err
        monkeypatch.setenv("SPECMAP_QUIET", "1")
        assert run(*line, "--log-level", "debug").err == ""

    def test_a_wrong_value_is_named(self, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("SPECMAP_LOG_LEVEL", "loud")
        assert "env var: 'SPECMAP_LOG_LEVEL'" in run("config").error


class TestInfo:
    """`info` looks at a log as `build` would with the same options."""

    def test_a_chosen_topic(self, tmp_path: Path, run: Run) -> None:
        log = standing_log(tmp_path / "two.mcap", 3.0, topics=("/front", "/the rear"))
        assert run("info", log, "--json").result["chosen"] is None
        said = run("info", log, "--scan-topic", "/the rear")
        assert "build would read: scans from /the rear" in said.out
        assert said.out.endswith(f"next: specmap build {log} --scan-topic '/the rear'\n")
        none = run("info", log, "--odom-topic", "/odom", "--no-odometry")
        none.fails(2, "--odom-topic and --no-odometry do not go together")

    def test_a_log_without_scans_is_shown_and_no_error(self, tmp_path: Path, run: Run) -> None:
        found = run("info", standing_log(tmp_path / "log.mcap", 3.0, topics=()), "--json").result
        assert "no LaserScan, MultiEchoLaserScan or PointCloud2 in it" in found["problem"]

    def test_topics_and_frames_given_or_settings_of_a_file(self, tmp_path: Path, run: Run) -> None:
        log = standing_log(tmp_path / "one.mcap", 3.0)
        options = ["--odom-topic", "/odom", "--base-frame", "base_link"]
        for flags in (options, ["--no-odometry"], []):
            found = run("info", log, *flags, "--json").result
            assert found["next_command"] == " ".join(["specmap", "build", str(log), *flags])
        assert "/odom" in found["chosen"]
        settings = tmp_path / "specmap.toml"
        settings.write_text("[log]\nuse_odometry = false\n", encoding="utf-8")
        found = run("info", log, "--config", settings, "--json").result
        assert "no odometry" in found["chosen"]


class TestWhatTheFlagsStandFor:
    """Options as nested settings."""

    def test_topics_and_frames(self) -> None:
        assert LogSettings().overrides() == Settings().overrides({"seed": None}) == {}
        said: dict[str, Any] = {"scan_topic": "/a", "scan_frame": "f"}
        said |= {"odom_topic": "/b", "base_frame": "c"}
        assert LogSettings(**said).overrides({"seed": 0}) == {"log": said, "seed": 0}
        assert LogSettings(no_odometry=True).overrides() == {"log": {"use_odometry": False}}

    def test_a_flag_goes_over_an_assignment_and_the_last_of_two_assignments_holds(self) -> None:
        twice = Settings(assignments=["grid.resolution_m=1", "grid.resolution_m=0.2"])
        assert twice.load().grid.resolution_m == 0.2
        given = LogSettings(scan_topic="/flag", assignments=["log.scan_topic=/set", "seed=1"])
        assert given.overrides({"seed": 2}) == {"log": {"scan_topic": "/flag"}, "seed": 2}

    @pytest.mark.parametrize(
        ("text", "value"),
        [
            ("3", 3),
            ("0.5", 0.5),
            ("true", True),
            ("'3'", "3"),
            ("/scan", "/scan"),
            ("[1, 2]", [1, 2]),
            ("a = b", "a = b"),
            ("", ""),
            ("1\nother = 2", "1\nother = 2"),
        ],
    )
    def test_a_value_is_toml_or_else_a_string(self, text: str, value: object) -> None:
        assert Settings(assignments=[f"x.y={text}"]).overrides() == {"x": {"y": value}}
