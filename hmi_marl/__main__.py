"""``python -m hmi_marl`` is ``hmi-marl``."""

import sys

from hmi_marl.cli import main

if __name__ == "__main__":
    sys.exit(main())
