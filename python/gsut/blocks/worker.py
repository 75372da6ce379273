"""Runs a process of `Workers`: `python -m gsut.blocks.worker THREADS`."""

from __future__ import annotations

import sys

from gsut.blocks.workers import serve_forever

if __name__ == "__main__":
    serve_forever(int(sys.argv[1]))
