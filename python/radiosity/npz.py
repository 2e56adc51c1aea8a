"""Arrays in uncompressed ``.npz`` files, each at a multiple of 64 bytes: numpy reads them, and they can be mapped.

A ``.npz`` file is a zip archive of ``.npy`` members. Uncompressed, a member lies in the file as it is, and the
operating system can show it as memory (``numpy.memmap``): nothing is read before it is used, and all processes that use
a file share one copy. Only the place is left to chance, since the headers of a zip archive are of any length; here the
blanks that end the header of a ``.npy`` member make up for it.
"""

from __future__ import annotations

import errno
import io
import math
import os
import struct
import zipfile
from collections.abc import Container, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

AnyArray: TypeAlias = npt.NDArray[Any]

# Of the start of the numbers: a cache line, and what the widest registers load at once.
_ALIGNMENT = 64
# Read at once where a member is only to be checked.
_CHUNK = 1 << 20
# Of a member's own header: signature, versions, times and sizes, then the lengths of its name and of what follows it.
_LOCAL_HEADER = 30
_LENGTHS = struct.Struct("<HH")


class Entry(NamedTuple):
    """An array to be written, whole or part by part."""

    name: str
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    parts: Iterable[AnyArray]

    @classmethod
    def of(cls, name: str, array: AnyArray) -> Entry:
        """A whole array, little endian on any machine."""
        return cls(name, array.dtype.newbyteorder("<"), array.shape, (array,))


def write_arrays(path: str, entries: Iterable[Entry]) -> None:
    """Writes a file with the arrays, in their order, with the same bytes every time."""
    with open(path, "wb") as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, dtype, shape, parts in entries:
            # The size is not known beforehand to zipfile, which must leave room for a large one.
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                member.write(_header(dtype, shape, file.tell()))
                for part in parts:
                    member.write(np.ascontiguousarray(part, dtype).reshape(-1).view(np.uint8).data)


def _header(dtype: np.dtype[Any], shape: tuple[int, ...], start: int) -> bytes:
    """The header of a .npy member that starts at ``start``, padded so that the numbers are aligned in the file."""
    buffer = io.BytesIO()
    description = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, description)
    # Six bytes of magic, two of the version, two of the length; then the text, which ends with a line feed.
    header = buffer.getvalue()
    magic, text = header[:8], header[10:-1]
    text += b" " * (-(start + len(header)) % _ALIGNMENT) + b"\n"
    return magic + struct.pack("<H", len(text)) + text


def names_in(path: Path) -> frozenset[str]:
    """Names of the arrays of a file.

    Raises:
        ValueError: the file is no ``.npz`` file.
        FileNotFoundError: no such file.
    """
    with _opened(path) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                return frozenset(name.removesuffix(".npy") for name in archive.namelist())
        except Exception as error:  # zipfile raises its own kinds, and others where it is misled
            raise ValueError(f"{path}: no .npz file, or a damaged one ({error})") from error


def _opened(path: Path) -> BinaryIO:
    try:
        return path.open("rb")
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: no such file") from None


def read_arrays(path: Path, mapped: Container[str], check: bool) -> dict[str, AnyArray]:
    """The arrays of a file by name.

    Those whose names are in ``mapped`` stay in the file where they can, that is where they are aligned and in the byte
    order of this machine; ``check`` says whether they are compared with their checksums, for which they have to be read
    once. The others are read and compared in any case.

    Raises:
        ValueError: the file is damaged; it begins with ``path``.
        OSError: it cannot be opened.
        MemoryError: it cannot be read or mapped.
    """
    arrays: dict[str, AnyArray] = {}
    with _opened(path) as file, _damage_told(path), zipfile.ZipFile(file) as archive:
        size = os.fstat(file.fileno()).st_size
        for info in archive.infolist():
            name = info.filename.removesuffix(".npy")
            if info.compress_type != zipfile.ZIP_STORED or info.file_size > size or name in arrays:
                raise ValueError(f"{info.filename} is compressed, too long or there twice")
            with archive.open(info) as member:
                shape, order, dtype, start = _described(member)
                if info.file_size != start + dtype.itemsize * math.prod(shape) or order or dtype.hasobject:
                    raise ValueError(f"{info.filename} is no plain array of its size")
                if name not in mapped or not math.prod(shape):
                    data = member.read()
                    arrays[name] = np.frombuffer(data, dtype).reshape(shape)
                    continue
                while check and member.read(_CHUNK):
                    pass
            # Of the two headers of a member, the one before it says where it starts.
            file.seek(info.header_offset + _LOCAL_HEADER - _LENGTHS.size)
            start += info.header_offset + _LOCAL_HEADER + sum(_LENGTHS.unpack(file.read(_LENGTHS.size)))
            arrays[name] = np.memmap(file, dtype, "r", start, shape)
    return {name: _usable(array) for name, array in arrays.items()}


@contextmanager
def _damage_told(path: Path) -> Iterator[None]:
    """Errors of whatever kind, of a file that is there, as ``ValueError``."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:  # zipfile, struct and numpy raise their own kinds
        if isinstance(error, OSError) and error.errno == errno.ENOMEM:
            raise MemoryError(f"{path}: not enough addresses to map it") from error
        raise ValueError(f"{path}: damaged, {error}") from error


def _described(member: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Shape, order and type of the array of a .npy member, and where its numbers start in it."""
    version = np.lib.format.read_magic(member)
    if version != (1, 0):
        raise ValueError(f"a .npy member of version {version}")
    shape, order, dtype = np.lib.format.read_array_header_1_0(member)
    if not all(length >= 0 for length in shape):
        raise ValueError(f"an array of shape {shape}")
    return shape, order, dtype, member.tell()


def _usable(array: AnyArray) -> AnyArray:
    """The array if it is aligned and in this machine's byte order, else a copy that is; never to be written to."""
    if not (array.flags.aligned and array.dtype.isnative):
        array = array.astype(array.dtype.newbyteorder("="))
        array.flags.writeable = False
    return array
