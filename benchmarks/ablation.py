"""Run the ablation study of skyherd: the same starts with one part taken away at a time.

    python benchmarks/ablation.py [--quick] [--out FOLDER] [--jobs N] [--retry] [--dry-run]

The study is `ablation.toml` beside this file. Options are those of `skyherd study FILE`.
"""

import sys
from pathlib import Path

from skyherd.cli import main

STUDY = Path(__file__).with_suffix(".toml")
"""The study that is run."""

if __name__ == "__main__":
    main(["study", str(STUDY), *sys.argv[1:]])
