"""Lets the tests import `reference`: other people's numbers, and simulators of our own."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
