"""Files that are replaced only once the new one is whole."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[str]:
    """A temporary file beside ``path``, with the same ending, that takes its place when the block ends without error.

    Raises:
        FileNotFoundError: no such folder.
        OSError: the folder cannot be written to.
    """
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path.parent}: no such folder")
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a folder")
    try:
        handle, temporary = tempfile.mkstemp(suffix=path.suffix.lower(), dir=path.parent)
    except OSError as error:
        # It would name the temporary file, of which the user knows nothing.
        raise type(error)(error.errno, error.strerror, str(path)) from None
    os.close(handle)
    try:
        yield temporary
        # mkstemp makes files that only their owner may read; others get the usual permissions.
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, path)
    except BaseException as error:
        with suppress(FileNotFoundError):
            os.unlink(temporary)
        # What Ctrl-C has left open zipfile cannot close, and that is what it says then.
        if isinstance(error, ValueError) and isinstance(error.__context__, KeyboardInterrupt):
            raise error.__context__ from None
        raise
