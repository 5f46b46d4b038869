"""`python -m specmap_cli` is `specmap`."""

import sys

from specmap_cli.cli import main

if __name__ == "__main__":
    sys.exit(main())
