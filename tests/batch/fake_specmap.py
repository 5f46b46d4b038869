"""A program in the place of specmap: quick, and it does what its log asks for.

A log is text: words that say what happens, and anything else. It is a process of its own, as the
real one is.
"""

import json
import os
import sys
import time
from pathlib import Path

OUT = "--out="


def fail(code: int, word: str, message: str) -> int:
    print(json.dumps({"error": {"code": word, "message": message}}))
    print(f"specmap: error: {message}", file=sys.stderr)
    return code


def build(log: Path) -> int:
    words = log.read_text().split()
    if "SPECMAP_PRESET" in os.environ or os.environ["SPECMAP_PROCESSES"] != "1":
        return fail(2, "setting", "of the environment")
    note = os.environ.get("FAKE_NOTE")
    if note:  # one line a build, for tests that count them
        with open(note, "a") as file:
            file.write(f"{os.getpid()} {log}\n")
    partial = Path(f".map.partial-{os.getpid():08x}")
    partial.mkdir()
    (partial / "half").write_text("half")
    if "slow" in words:
        time.sleep(60)
    if "hungry" in words:
        held = [bytes([number]) * 1_000_000 for number in range(150)]
        time.sleep(0.3)
        del held
    if "killed" in words:
        os.kill(os.getpid(), 9)
    if "bug" in words:
        print("Traceback ...\nValueError: no good", file=sys.stderr)
        return 1
    if "large" in words:
        return fail(3, "memory", "not enough memory; a shorter log needs less")
    if "full" in words:
        return fail(2, "machine", "temporary files cannot be written: No space left on device")
    if "damaged" in words:
        return fail(3, "log-damaged", f"{log}: cut off after 12 bytes; no message can be read")
    for number in range(8):  # long enough to be killed in the middle
        (partial / f"part-{number}").write_text(" ".join(words * 100))
        time.sleep(0.003)
    partial.rename("map")
    print(json.dumps({"out": "map", "quality": {"verdict": "doubtful"}}))
    return 5 if "doubtful" in words else 0


def check() -> int:
    broken = "broken" in Path("map/part-0").read_text().split()
    rules = [{"rule": "lost_share", "passed": not broken}, {"rule": "parts", "passed": True}]
    print(json.dumps({"rules": rules}))
    return 5 if broken else 0


def main(arguments: list[str]) -> int:
    command = arguments[0]
    if command == "build":
        return build(Path(arguments[-1]))
    if command == "check":
        return check()
    out = next(each.removeprefix(OUT) for each in arguments if each.startswith(OUT))
    Path(out).write_text(f"{command} of {arguments}")
    print("{}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
