"""Run the study of gains: each controller at several gains, on starts of its own.

    python benchmarks/gains.py [--quick] [--out FOLDER] [--jobs N] [--retry] [--dry-run]

The study is `gains.toml` beside this file. Options are those of `skyherd study FILE`.
"""

import sys
from pathlib import Path

from skyherd.cli import main

STUDY = Path(__file__).with_suffix(".toml")
"""The study that is run."""

if __name__ == "__main__":
    main(["study", str(STUDY), *sys.argv[1:]])
