"""Speeds of the worlds in one run, as ratios to highway-env's own step.

The same as ``hmi-marl bench``; see its --help for the options. Run: python benchmarks/worlds.py
"""

import sys

from hmi_marl.cli import main

if __name__ == "__main__":
    sys.exit(main(["bench", *sys.argv[1:]]))
