"""Groups of processes that tests start."""

import os
import time


def none_is_left(group: int, within: float = 60.0) -> bool:
    """Whether every process of a group has ended, within so many seconds."""
    end = time.monotonic() + within
    while time.monotonic() < end:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False
