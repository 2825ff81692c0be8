"""Locks of the operating system on open files, which end with their process, however it ends."""

from __future__ import annotations

import errno
import os
import sys

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

_TAKEN = {errno.EACCES, errno.EAGAIN, errno.EDEADLK}
"""Errors of a lock that another process has."""
_FAR = 2**20
"""Byte that is locked where locks are of bytes, so that the others can be read."""


def lock(file: int, wait: bool = False) -> bool:
    """Lock an open file; return whether it is locked now, or False if another process has it.

    Args:
        file: its descriptor. Closing it ends the lock.
        wait: until the file is free.

    Raises:
        OSError: the file system knows no locks.
    """
    try:
        if sys.platform == "win32":
            os.lseek(file, _FAR, os.SEEK_SET)
            msvcrt.locking(file, msvcrt.LK_LOCK if wait else msvcrt.LK_NBLCK, 1)
            os.lseek(file, 0, os.SEEK_SET)
        else:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError as error:
        if error.errno in _TAKEN:
            return False
        raise
    return True
