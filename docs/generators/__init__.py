"""What docs/generate.py writes, by subject."""

from pathlib import Path

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
NOTE = "<!-- Made by docs/generate.py from the code. -->\n"
