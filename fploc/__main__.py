"""``python -m fploc`` is the command ``fploc``."""

from fploc.cli import main

raise SystemExit(main())
