"""`python -m plugd`."""

import sys

from plugd.cli import main

sys.exit(main())
