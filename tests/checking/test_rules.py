"""Files of rules: what they say goes over the defaults, and what is wrong in them is told."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from specmap_cli.checking.rules import BOUNDED, DEFAULTS, FINDINGS, GOLDEN, MEANINGS, read_rules
from specmap_cli.core.errors import UsageError
from specmap_cli.core.findings import INPUT
from specmap_cli.quality import laid_out, recording

DOCUMENT = Path(__file__).parents[2] / "docs" / "check.md"


def written(folder: Path, text: str) -> Path:
    path = folder / "rules.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_without_a_file_the_defaults_hold() -> None:
    assert read_rules(None, against=True) == DEFAULTS
    alone = read_rules(None, against=False)
    assert set(alone.most) == {name for name in DEFAULTS.most if not name.startswith(GOLDEN)}
    assert set(alone.least) == {"submaps"}


def test_every_default_is_of_a_figure_and_every_doubt_has_one() -> None:
    assert {name for name, _, _ in DEFAULTS.each()} <= set(BOUNDED)
    codes = {
        code
        for module in (laid_out, recording)
        for name, code in vars(module).items()
        if name.isupper() and isinstance(code, str) and not name.startswith("_")
    }
    only_notes = {recording.BREAK, laid_out.REFUTED}
    assert len(codes) >= 12
    known = {name for name in BOUNDED if name.startswith(FINDINGS)}
    assert known == {FINDINGS + code for code in codes | {INPUT}}
    assert {f"{FINDINGS}{code}" for code in codes - only_notes} == {
        name for name in DEFAULTS.most if name.startswith(FINDINGS)
    }


def test_a_file_goes_over_the_defaults_or_does_without_them(tmp_path: Path) -> None:
    text = 'verdict = "good"\n[most]\nlost_share = 0.2\nparts = inf\nfindings.tracking-break = 3\n'
    text += "[least]\nsubmaps = 5\nscans_per_s = 20"
    rules = read_rules(written(tmp_path, text), against=False)
    assert rules.verdict == "good"
    assert (rules.most["lost_share"], rules.most["findings.tracking-break"]) == (0.2, 3)
    assert "parts" not in rules.most
    assert rules.most["findings.walls-disagree"] == 0
    assert rules.least == {"submaps": 5, "scans_per_s": 20}
    rules = read_rules(written(tmp_path, "defaults = false\n[most]\nparts = 2"), against=True)
    assert (rules.verdict, rules.most, rules.least) == ("poor", {"parts": 2}, {})


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[most]\nlost_shar = 1", "most.lost_shar: no such figure: did you mean lost_share?"),
        (
            "[most]\nfindings.walls-disagre = 0",
            "most.findings.walls-disagre: no such figure: did you mean findings.walls-disagree?",
        ),
        ("[most]\nzebra = 1", "most.zebra: no such figure: choose from scans, lost_share"),
        ("[least]\nsubmaps = true", "least.submaps is True: expected a number"),
        ("[least]\nsubmaps = nan", "least.submaps is nan: expected a number"),
        ('[most]\nparts = "two"', "most.parts is 'two': expected a number"),
        ("most = 3", "most is 3: expected a table [most]"),
        ("[atmost]\nparts = 3", "atmost: no such key, did you mean most?"),
        ("[zebra]", "zebra: no such key, expected defaults, verdict, most, least"),
        ('verdict = "fine"', "verdict is 'fine': choose from good, doubtful, poor"),
        ("verdict = []", "verdict is []: choose from good, doubtful, poor"),
        ("defaults = 0", "defaults is 0: expected true or false"),
        ("[most]\ngolden.gone = 2", "most.golden.gone: needs another map: give --against"),
        ("[most", "not valid TOML"),
        ("x = " + "[" * 3000, "nested too deeply"),
    ],
)
def test_what_is_wrong_in_a_file_is_told(tmp_path: Path, text: str, told: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(UsageError) as raised:
        read_rules(path, against=False)
    assert str(raised.value).startswith(f"{path}: {told}")


def test_the_document_lists_every_figure_and_every_default() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    for name, meaning in MEANINGS.items():
        assert f"| `{name}` | {meaning} |" in text, name
    for name, bound, limit in DEFAULTS.each():
        assert f"`{name}` at {bound} {limit:g}" in text, name
    assert not any(math.isinf(limit) for _, _, limit in DEFAULTS.each())
