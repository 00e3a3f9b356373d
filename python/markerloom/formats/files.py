"""Files that appear whole or not at all, and text that is read with a clear error."""

from __future__ import annotations

import gzip
import os
import tempfile
from pathlib import Path

from markerloom.errors import FormatError, InputError

MAX_BYTES = 8 << 30


def read_bytes(path: str | Path) -> bytes:
    """All bytes of a file; ``.gz`` is unpacked."""
    path = Path(path)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"there is no file {path}") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a folder, not a file") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    if not data:
        raise FormatError(path, "the file is empty")
    if path.suffix == ".gz":
        try:
            data = gzip.decompress(data)
        except (OSError, EOFError) as error:
            raise FormatError(path, f"the compression is damaged: {error}") from None
        if not data:
            raise FormatError(path, "the file is empty")
    return data


def read_text(path: str | Path) -> str:
    """All text of a file in UTF-8, UTF-16 with a mark, or Latin-1."""
    data = read_bytes(path)
    for mark, encoding in ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"\xef\xbb\xbf", "utf-8-sig")):
        if data.startswith(mark):
            try:
                return data.decode(encoding)
            except UnicodeDecodeError:
                raise FormatError(path, "the text is damaged: it does not decode") from None
    if b"\0" in data:
        raise FormatError(path, "a binary file where text is expected")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file so that it appears whole or not at all."""
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(f"the folder {path.parent} does not exist: make it first")
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        umask = os.umask(0)
        os.umask(umask)
        Path(temporary).chmod(0o666 & ~umask)
        Path(temporary).replace(path)
    except OSError as error:
        Path(temporary).unlink(missing_ok=True)
        raise InputError(f"{path} cannot be written: {error.strerror}") from None


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8 text so that it appears whole or not at all."""
    write_bytes(path, text.encode("utf-8"))
