"""Runs in chromacal's own environment: python chromacal_worker.py CARD.npy STORED.npy MADE.npy.

Knows nothing of calichrome. CARD is a BGR picture, STORED (n, 3) stored RGB values 0..1; MADE is
their linear sRGB (n, 3).
"""

import importlib
import sys

import numpy as np


def main(card: str, stored: str, made: str) -> None:
    """Find the card, solve, apply."""
    chromacal = importlib.import_module("chromacal")
    patches = chromacal.detect(np.load(card))
    if not patches:
        sys.exit("no card found")
    solver = chromacal.Solver()
    solver.solve(patches)
    values = np.load(stored)
    np.save(made, solver.infer(np.ascontiguousarray(values[None]))[0])


if __name__ == "__main__":
    main(*sys.argv[1:])
