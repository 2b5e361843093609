"""Recordings in folders and behind fsspec URLs."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from ik_node.errors import MissingPackageError, RecordingError
from ik_node.recording.mcap.metadata import METADATA_FILE
from ik_node.report.ground_truth import GROUND_TRUTH_FILE

SUFFIXES = (".mcap", ".db3", ".bag")
"""Of the files of recordings; those of other programs become rows that say so."""


class FoundBag(NamedTuple):
    """A recording in an archive."""

    name: str
    """Path or URL of its folder, or of its file."""
    fingerprint: str
    """Digest of names, sizes and times of its files: another one means another recording."""
    error: str = ""
    """Why there is nothing to replay: a folder that cannot be read, or a link to nothing."""


def is_url(name: str) -> bool:
    """Whether a name is an fsspec URL such as ``s3://fleet/monday`` or ``file:///archive``."""
    return "://" in name


def is_archive(names: Sequence[str]) -> bool:
    """Whether these names are an archive: several names, a URL, or a folder that is no recording but has some."""
    if len(names) != 1 or is_url(names[0]):
        return True
    path = Path(names[0])
    first = next(_local_bags(path), None) if path.is_dir() else None
    return first is not None and first.name != str(path)


def find_bags(names: Sequence[str]) -> tuple[FoundBag, ...]:
    """All recordings, in the order of the names, then of their paths; each once.

    Folders that cannot be read and links to nothing are among them, with the reason.

    Args:
        names: Folders, recordings, files of recordings, or fsspec URLs of these.

    Raises:
        RecordingError: A name does not exist, or there is no recording below it.
        MissingPackageError: A name is a URL, and fsspec or the package of its protocol is not installed.
    """
    found: dict[str, FoundBag] = {}
    for name in names:
        bags = list(_url_bags(name)) if is_url(name) else list(_local_bags(Path(name)))
        if not bags:
            exists = is_url(name) or Path(name).exists()
            raise RecordingError(f"'{name}' " + ("contains no recording" if exists else "does not exist"))
        found |= {bag.name: bag for bag in bags if bag.name not in found}
    return tuple(found.values())


@contextmanager
def local_copy(name: str) -> Iterator[Path]:
    """Context with the path of a recording; that of a URL is a copy, with the trajectory beside it.

    Raises:
        RecordingError: The files behind the URL cannot be read.
        MissingPackageError: fsspec or the package of the protocol is not installed.
    """
    if not is_url(name):
        yield Path(name)
        return
    with tempfile.TemporaryDirectory(prefix="ik_replay_") as scratch:
        files, place = _filesystem(name)
        target = Path(scratch) / "run" / place.rstrip("/").rpartition("/")[2]
        try:
            for path in files.find(place) or [place]:
                copy = target / path[len(place) :].strip("/") if path != place else target
                copy.parent.mkdir(parents=True, exist_ok=True)
                files.get_file(path, str(copy))
            folder = place if files.isdir(place) else place.rpartition("/")[0]
            truth = f"{folder.rstrip('/').rpartition('/')[0]}/{GROUND_TRUTH_FILE}"
            if files.exists(truth):
                beside = target if target.is_dir() else target.parent
                files.get_file(truth, str(beside.parent / GROUND_TRUTH_FILE))
        except (OSError, ValueError) as error:
            raise RecordingError(f"'{name}' cannot be read: {error}") from error
        yield target


def _local_bags(path: Path) -> Iterator[FoundBag]:
    if path.is_file() and path.suffix in SUFFIXES:
        yield FoundBag(str(path), _fingerprint([path]))
        return
    seen: set[str] = set()
    unreadable: list[OSError] = []
    for folder, folders, files in os.walk(path, onerror=unreadable.append, followlinks=True):
        real = os.path.realpath(folder)
        if real in seen:  # linked twice, or a loop
            folders.clear()
            continue
        seen.add(real)
        folders.sort()
        try:
            if _is_bag_folder(Path(folder)):
                folders.clear()
                yield FoundBag(folder, _fingerprint(sorted(Path(folder).iterdir())))
                continue
        except OSError as error:
            folders.clear()
            yield _unreadable(error, folder)
            continue
        for link in (Path(folder) / name for name in sorted(files)):
            if link.is_symlink() and not link.exists():
                yield FoundBag(str(link), "", f"a link to '{link.readlink()}', which does not exist")
    yield from (_unreadable(error) for error in unreadable if not isinstance(error, FileNotFoundError))


def _unreadable(error: OSError, folder: str = "") -> FoundBag:
    return FoundBag(folder or str(error.filename), "", f"the folder cannot be read: {error.strerror}")


def _is_bag_folder(folder: Path) -> bool:
    return (folder / METADATA_FILE).is_file() or any(entry.suffix in SUFFIXES for entry in folder.iterdir())


def _fingerprint(files: Sequence[Path]) -> str:
    known = [
        (path.name, path.stat().st_size, path.stat().st_mtime_ns, os.access(path, os.R_OK, effective_ids=True))
        for path in files
        if path.is_file()
    ]
    return hashlib.sha256(repr(known).encode()).hexdigest()[:16]


def _url_bags(name: str) -> Iterator[FoundBag]:
    files, place = _filesystem(name)
    try:
        listed: dict[str, dict[str, Any]] = files.find(place, detail=True)
    except (OSError, ValueError) as error:
        raise RecordingError(f"'{name}' cannot be listed: {error}") from error
    folders: dict[str, list[tuple[str, object, object]]] = {}
    for path, about in sorted(listed.items()):
        if path.endswith((*SUFFIXES, METADATA_FILE)):
            alone = path == place
            folder = path if alone else path.rpartition("/")[0]
            changed = next((about[key] for key in ("mtime", "LastModified", "ETag", "updated") if key in about), "")
            folders.setdefault(folder, []).append((path, about.get("size"), str(changed)))
    protocol = name.partition("://")[0]
    for folder, known in folders.items():
        url = f"{protocol}://{folder}"
        yield FoundBag(url, hashlib.sha256(repr(known).encode()).hexdigest()[:16])


def _filesystem(name: str) -> tuple[Any, str]:
    """The fsspec file system of a URL, and the path in it."""
    try:
        import fsspec
    except ImportError as error:
        raise MissingPackageError(error) from error
    try:
        files, place = fsspec.core.url_to_fs(name)
    except ImportError as error:  # the package of the protocol, such as s3fs
        raise RecordingError(f"'{name}': {error}") from error
    except ValueError as error:  # an unknown protocol
        raise RecordingError(f"'{name}': {error}") from error
    return files, place
