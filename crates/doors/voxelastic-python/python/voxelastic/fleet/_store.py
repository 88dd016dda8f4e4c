"""Where a fleet keeps what its tasks make: a folder or a prefix of an object store, by fsspec."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from ._needs import needed

fsspec = needed("fsspec")

T = TypeVar("T")

ATTEMPTS = 6
"""How often a read or a write that fails is tried."""
PAUSE = 0.05
"""Pause before the second attempt, seconds; it doubles with each."""


class StoreError(OSError):
    """The store cannot be read or written; the message names the file."""


class ManifestError(StoreError):
    """Another fleet has written to the store meanwhile."""


def hash_of(content: bytes) -> str:
    """A hash of bytes, as 24 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()[:24]


def digest(*parts: object) -> str:
    """A hash of anything that JSON can represent, as 24 hexadecimal digits."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"))
    return hash_of(text.encode())


@dataclass(frozen=True)
class Store:
    """A folder or a prefix, such as `/maps/city` or `s3://maps/city`. Files appear under their names whole or not at all."""

    url: str
    """The folder or prefix."""
    options: dict[str, Any] = field(default_factory=dict)
    """Arguments of the fsspec file system, such as `{"endpoint_url": ..}`."""

    def _fs(self) -> tuple[Any, str]:
        fs, root = fsspec.core.url_to_fs(self.url, **self.options)
        return fs, root.rstrip("/")

    def _try(self, what: str, name: str, work: Callable[[Any, str], T]) -> T:
        for attempt in range(ATTEMPTS):
            try:
                fs, root = self._fs()
                return work(fs, f"{root}/{name}")
            except FileNotFoundError:
                raise
            except OSError as error:
                # A full disk does not become empty by waiting.
                if attempt + 1 == ATTEMPTS or error.errno == 28:
                    raise StoreError(f"{self.url}/{name}: cannot {what}: {error}") from error
                time.sleep(PAUSE * 2**attempt)
        raise AssertionError("unreachable")

    def read(self, name: str) -> bytes:
        """The content of a file.

        Raises:
            FileNotFoundError: There is none.
            StoreError: It cannot be read.
        """
        return self._try("read", name, lambda fs, path: bytes(fs.cat_file(path)))

    def write(self, name: str, content: bytes) -> None:
        """Writes a file, durably and at once.

        Raises:
            StoreError: It cannot be written; what was there before is there still.
        """
        self._try("write", name, lambda fs, path: _put(fs, path, content))

    def keep(self, folder: str, content: bytes) -> str:
        """Writes a file whose name is a hash of its content. Returns its name."""
        name = f"{folder}/{hash_of(content)}"
        self.write(name, content)
        return name

    def remove(self, name: str) -> None:
        """Removes a file that may be there. One that cannot be removed only takes space."""
        with contextlib.suppress(OSError):
            self._try("remove", name, lambda fs, path: fs.rm_file(path))

    def read_json(self, name: str) -> Any:
        """The content of a JSON file; none if there is none, or if it is not whole."""
        try:
            return json.loads(self.read(name))
        except (FileNotFoundError, ValueError):
            return None

    def write_json(self, name: str, value: object) -> None:
        """Writes a JSON file."""
        self.write(name, json.dumps(value, sort_keys=True, indent=1).encode())

    def replace(self, name: str, content: bytes, expected: str | None) -> str:
        """Replaces a file that only one fleet may write, if its content has the hash `expected` still (none: if there is no file). Returns the new hash.

        Raises:
            ManifestError: Another fleet has replaced it.
        """
        if (found := self.hash(name)) != expected:
            raise ManifestError(f"{self.url}/{name}: another fleet has written it meanwhile ({found} instead of {expected}); run one at a time")
        self.write(name, content)
        return hash_of(content)

    def hash(self, name: str) -> str | None:
        """A hash of the content of a file; none if there is none."""
        try:
            return hash_of(self.read(name))
        except FileNotFoundError:
            return None

    def local(self, name: str, folder: Path) -> Path:
        """The path of a file on this machine: its own one, or that of a copy in `folder`."""
        fs, root = self._fs()
        if _is_local(fs):
            return Path(root) / name
        path = folder / name.replace("/", "-")
        if not path.exists():
            path.write_bytes(self.read(name))
        return path


def _is_local(fs: Any) -> bool:
    return "file" in (fs.protocol if isinstance(fs.protocol, tuple) else (fs.protocol,))


def _put(fs: Any, path: str, content: bytes) -> None:
    if not _is_local(fs):
        # Object stores show an object when all of it is there.
        fs.pipe_file(path, content)
        return
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    own = target.with_name(f".{target.name}.{uuid.uuid4().hex}.tmp")
    try:
        with own.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        own.replace(target)
    finally:
        own.unlink(missing_ok=True)


def fingerprint(url: str, options: dict[str, Any]) -> str:
    """A hash of the names, sizes and times of the files at a path or URL.

    Raises:
        FileNotFoundError: There is nothing.
    """
    fs, root = fsspec.core.url_to_fs(url, **options)
    found = fs.find(root, detail=True)
    if not found and fs.isfile(root):
        found = {root: fs.info(root)}
    if not found:
        raise FileNotFoundError(f"{url}: there is nothing of this name")

    def row(path: str, info: dict[str, Any]) -> list[Any]:
        return [path.removeprefix(root), info.get("size"), str(info.get("ETag") or info.get("mtime") or info.get("LastModified"))]

    return digest(sorted(row(path, info) for path, info in found.items()))


@contextlib.contextmanager
def at_hand(url: str, options: dict[str, Any], folder: Path) -> Any:
    """The path of the files at a path or URL: their own, or that of copies in `folder`, which are removed afterwards."""
    fs, root = fsspec.core.url_to_fs(url, **options)
    if _is_local(fs):
        yield Path(root)
        return
    path = folder / Path(root).name
    fs.get(root, str(path), recursive=fs.isdir(root))
    yield path
