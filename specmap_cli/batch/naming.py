"""Names of jobs: safe as folders anywhere, each only once, and the same in the next batch."""

from __future__ import annotations

import hashlib
import re

from specmap_cli.core.errors import UsageError

_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,99}")
_LONGEST = 80
# Files that a batch writes beside the folders of its jobs.
BESIDE_JOBS = frozenset(
    {"index.html", "events.jsonl", "junit.xml", "summary.csv", "summary.md", "summary.parquet"}
)
_TAG = 8  # hexadecimal digits


class Names:
    """The names that are taken. Upper and lower case count as the same, as on some systems."""

    def __init__(self) -> None:
        self._taken: set[str] = set(BESIDE_JOBS)

    def of_person(self, name: object, where: str) -> str:
        """A name that a person chose. Raises UsageError when it is unsafe or taken."""
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise UsageError(
                f"{where}name is {name!r:.60}: expected letters, digits, dots, dashes and "
                "underscores, a letter or digit first: it names a folder"
            )
        if name.lower() in self._taken:
            whose = "a file of the batch's" if name.lower() in BESIDE_JOBS else "another job's"
            raise UsageError(f"{where}name: {name} is {whose}, too: choose another")
        self._taken.add(name.lower())
        return name

    def of_log(self, name: str, log: str) -> str:
        """A name made of that of a log, which is `a/b` for one in a directory.

        A second one of the same name gets a tag made of its path, so that it is the same in the
        next batch, whichever logs came to it.
        """
        safe = _UNSAFE.sub("_", name.replace("/", "-")).strip(".-_")[:_LONGEST] or "log"
        if safe.lower() in self._taken:
            safe = f"{safe}-{hashlib.sha256(log.encode('utf-8', 'replace')).hexdigest()[:_TAG]}"
        number, unique = 2, safe
        while unique.lower() in self._taken:
            unique, number = f"{safe}-{number}", number + 1
        self._taken.add(unique.lower())
        return unique
