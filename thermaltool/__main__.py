"""The command line as ``python -m thermaltool``."""

from thermaltool.cli import main

main()
