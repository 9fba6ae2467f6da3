"""`python -m splatreel` is the `splatreel` command."""

import sys

from splatreel.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
