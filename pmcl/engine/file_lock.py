"""A lock between processes that the operating system releases when a process dies."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from types import TracebackType

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment,unused-ignore]

__all__ = ["FileLock"]


class FileLock:
    """A lock on a file of its own, which is made when it is asked for and removed when it is given back.

    Parameters
    ----------
    path : Path
        The file. Where it cannot be made or locked, the lock is granted: nothing can be kept from others there.
    owner : str
        Text that the file holds while the lock is taken; others can read who has it.
    """

    def __init__(self, path: Path, owner: str = "") -> None:
        self._path, self._owner = path, owner
        self._handle: int | None = None

    def __enter__(self) -> FileLock:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def acquire(self) -> bool:
        """Try to take the lock at once; return False while another process or thread has it."""
        while True:
            try:
                handle = os.open(self._path, os.O_RDWR | os.O_CREAT)
            except OSError:
                return True
            try:
                _lock(handle)
            except BlockingIOError:
                os.close(handle)
                return False
            except OSError:
                # A file system without locks.
                os.close(handle)
                return True
            if self._is_the_file(handle):
                break
            # The owner before removed the file after it was opened here; a third process would not see this lock.
            os.close(handle)
        self._handle = handle
        if self._owner:
            with contextlib.suppress(OSError):
                os.truncate(handle, 0)
                os.write(handle, self._owner.encode())
        return True

    def owner(self) -> str:
        """Return who has the lock, as far as the file tells; empty where it does not."""
        try:
            return self._path.read_text(errors="replace").strip()
        except OSError:
            return ""

    def release(self) -> None:
        """Give the lock back, if it was taken."""
        if self._handle is not None:
            with contextlib.suppress(OSError):  # Windows removes no file that another process has open
                self._path.unlink()
            os.close(self._handle)
            self._handle = None

    def _is_the_file(self, handle: int) -> bool:
        try:
            return os.path.samestat(os.fstat(handle), os.stat(self._path))
        except OSError:
            return False


def _lock(handle: int) -> None:
    """Lock a file, or raise BlockingIOError when another has it."""
    if fcntl is not None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return
    import msvcrt

    try:
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
    except PermissionError as error:
        raise BlockingIOError(str(error)) from error
