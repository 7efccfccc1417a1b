"""`python -m pmpm` is the command line."""

import sys

from pmpm.cli import main

if __name__ == "__main__":
    sys.exit(main())
