"""Reference and feed-forward files, read for flying and uploading."""

from __future__ import annotations

from pathlib import Path

from trimtab.host.base import bounds
from trimtab.host.base.errors import UsageError
from trimtab.protocol.blobs import Blob, BlobError, FeedForward, Reference, from_bytes


def read_blob(path: str | Path) -> Blob:
    """Return the blob in a file. Raises UsageError naming the file and what is wrong in it."""
    try:
        data = bounds.read_bounded(Path(path), bounds.BLOB_BYTES)
    except bounds.TooLarge as error:
        raise UsageError(f"{path}: not a reference or feed-forward: {error}") from None
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); check the file") from error
    try:
        return from_bytes(data)
    except BlobError as error:
        raise UsageError(
            f"{path}: not a reference or feed-forward ({error}); make one with `trimtab plan` or "
            "`trimtab correct`"
        ) from error


def read_reference(path: str | Path) -> Reference:
    """Return the reference in a file.

    Parameters
    ----------
    path
        Reference, .ref.

    Returns
    -------
    Reference
        Nodes with times in us, and position, velocity, acceleration and jerk relative to its origin, NED, SI.

    Raises
    ------
    UsageError
        If the file cannot be read or is no reference.
    """
    blob = read_blob(path)
    if not isinstance(blob, Reference):
        raise UsageError(f"{path}: this is a feed-forward; give a reference (.ref)")
    return blob


def read_feedforward(path: str | Path) -> FeedForward:
    """Return the feed-forward in a file. Raises UsageError."""
    blob = read_blob(path)
    if not isinstance(blob, FeedForward):
        raise UsageError(f"{path}: this is a reference; give a feed-forward (.ff)")
    return blob


def model_of(path: str | Path) -> str | None:
    """Return the id of the model behind the plan in `path`, from its provenance file; None if it has none."""
    provenance_path = Path(f"{path}.json")
    try:
        content = bounds.read_json(provenance_path)
        model = content.get("provenance", content)["parents"]["model"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    return model if isinstance(model, str) else None
