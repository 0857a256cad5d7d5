"""The hosted page: `python app.py`, or a Hugging Face Space (docs/guide/deploying.md)."""

import sys

from demo.__main__ import run

if __name__ == "__main__":
    sys.exit(run())
