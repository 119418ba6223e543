"""The command line as ``python -m thermaltool``."""

from thermaltool.cli import main

if __name__ == "__main__":
    main()
