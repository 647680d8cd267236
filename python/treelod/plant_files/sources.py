"""
Where bytes come from: the plant file itself, and files that it names in its own folder or below.

A plant file comes from strangers. What it names is read only if it stays under the file's folder
after percent-decoding and after following links; nothing else on the disk or in the network is.
"""

import base64
import binascii
import re
import urllib.parse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from treelod.errors import PlantFileError
from treelod.plant_files import images
from treelod.plant_files.model import MAX_FILE_BYTES

__all__ = ["Source"]


MAX_TOTAL_TEXEL_COUNT = 1 << 28
"""Texels that all pictures of one file may hold together: 1 GiB as RGBA."""


class Source:
    """
    A plant file and its folder.

    Parameters
    ----------
    path : pathlib.Path
        The file.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    PlantFileError
        If it is a folder, no plain file, or too large.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        size = path.stat().st_size  # FileNotFoundError names the file
        if not path.is_file():
            msg = f"{path}: not a file"
            raise PlantFileError(msg)
        if size > MAX_FILE_BYTES:
            msg = f"{path}: {size} bytes, the limit is {MAX_FILE_BYTES}"
            raise PlantFileError(msg)
        self._root = path.parent.resolve()
        self._texel_count = 0
        self._byte_count = 0
        self._pictures: dict[Path, NDArray[np.uint8]] = {}

    def charge_texels(self, count: int) -> None:
        """
        Count texels against what all pictures of a file may hold together.

        Raises
        ------
        PlantFileError
            If there are more than 2**28: 1 GiB as RGBA.
        """
        self._texel_count += count
        if self._texel_count > MAX_TOTAL_TEXEL_COUNT:
            msg = (
                f"{self.path}: its pictures hold more than {MAX_TOTAL_TEXEL_COUNT} texels together"
            )
            raise PlantFileError(msg)

    def read(self) -> bytes:
        """Bytes of the plant file."""
        return self.path.read_bytes()

    def read_uri(
        self, uri: object, what: str, byte_count: int | None = None, limit: int = MAX_FILE_BYTES
    ) -> bytes:
        """
        Bytes behind a glTF URI: base64 data or a percent-encoded relative path.

        Of a file no more than `byte_count` bytes are read: a file may be far larger than what a
        plant says that it needs of it. Where it must be read whole, `limit` is its largest size.
        """
        if not isinstance(uri, str):
            msg = f"the URI of {what} is no text"
            raise PlantFileError(msg)
        if uri[:5].lower() == "data:":
            return _data_bytes(uri, what)
        return self.read_name(urllib.parse.unquote(uri), what, byte_count, limit)

    def read_name(
        self, name: str, what: str, byte_count: int | None = None, limit: int = MAX_FILE_BYTES
    ) -> bytes:
        """
        Bytes of the file at a relative path, in the folder of the plant file or below.

        `byte_count` and `limit` are those of `read_uri`.
        """
        path = self._file(name, what)
        size = path.stat().st_size
        wanted = size if byte_count is None else min(size, byte_count)
        if wanted > limit:
            msg = f"{what} refers to {name!r}: {wanted} bytes, the limit is {limit}"
            raise PlantFileError(msg)
        self._byte_count += wanted
        if self._byte_count > MAX_FILE_BYTES:
            msg = f"{what} refers to {name!r}, with which it is more than {MAX_FILE_BYTES} bytes"
            raise PlantFileError(msg)
        with path.open("rb") as file:
            return file.read(wanted)

    def read_picture(self, name: str, what: str, label: str) -> NDArray[np.uint8]:
        """Texels (H, W, 4) of a picture at a relative path: decoded once, and read-only."""
        path = self._file(name, what)
        if path not in self._pictures:
            data = self.read_name(name, what, limit=images.MAX_BYTES)
            texels = images.decode(data, label, self.charge_texels)
            texels.flags.writeable = False
            self._pictures[path] = texels
        return self._pictures[path]

    def _file(self, name: str, what: str) -> Path:
        path = self._inside(name, what)
        if not path.is_file():
            msg = f"{what} refers to {name!r}, which does not exist"
            raise PlantFileError(msg)
        return path

    def _inside(self, name: str, what: str) -> Path:
        parts = name.replace("\\", "/").split("/")
        # a scheme or a drive letter, the root, a way up, or a text that ends early in C
        outside = (
            re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", name) is not None
            or parts[0] == ""
            or ".." in parts
            or "\0" in name
        )
        if not outside:
            path = self._root.joinpath(*parts).resolve()
            outside = not path.is_relative_to(self._root)
        if outside:
            msg = f"{what} refers to {name!r}; only relative paths below the file's folder are read"
            raise PlantFileError(msg)
        return path


def _data_bytes(uri: str, what: str) -> bytes:
    head, comma, body = uri.partition(",")
    if not comma or not head.lower().endswith(";base64"):
        msg = f"the data URI of {what} is not base64"
        raise PlantFileError(msg)
    try:
        return base64.b64decode(urllib.parse.unquote(body), validate=True)
    except (binascii.Error, ValueError) as error:
        msg = f"the data URI of {what} is damaged: {error}"
        raise PlantFileError(msg) from error
