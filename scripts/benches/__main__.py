"""Starts the harness with `scripts/` as the only import root of this folder."""

from __future__ import annotations

import sys
from pathlib import Path

# the folder of this file would make `config` and `core` top-level modules
sys.path[0] = str(Path(__file__).resolve().parents[1])

from benches.harness import main  # noqa: E402  # the path comes first

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
