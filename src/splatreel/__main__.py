"""Entry point of `python -m splatreel`, the same as the `splatreel` command."""

import sys

from splatreel.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
