"""Text files that are written whole or not at all."""

import os
from pathlib import Path


def write_whole(path: Path, text: str) -> None:
    """Write text to a file; the folder is made if need be, and whoever reads the file never sees half of it.

    The bytes are the same on every platform, since certificates are known by their digest.

    Raises:
        OSError: where the file cannot be written; what stood there before stands there still.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    try:
        partial.write_bytes(text.encode())
        os.replace(partial, path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise
