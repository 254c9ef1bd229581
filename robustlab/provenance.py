"""The origin of results in all written files: versions, hashes, seeds, time."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any, ClassVar

from robustlab.errors import InputError

# In the note of a model whose derivatives are not exact, and of all files made from it.
BY_DIFFERENCES = "derivatives by differences, not exact"
# In the note of an object from a file without a content hash, and of all files made from it.
NOT_VERIFIED = "not verified by a content hash"
# Origin of a user's plant.
BY_PLANT_FILE, BY_UNIT = "plant file", "functional mock-up unit"

_LIBRARIES = ("numpy", "scipy", "cvxpy", "clarabel", "control", "h5py")
# Packages with the module of that name. If both are installed, metadata does not show which one was last and has the
# files: both versions are named.
_PACKAGES = {"cvxpy": ("cvxpy-base", "cvxpy")}


def robustlab_version() -> str:
    return metadata.version("robustlab")


def library_versions() -> dict[str, str]:
    """Return the versions of the numerical libraries, from their metadata, without an import."""
    versions = {"robustlab": robustlab_version(), "python": platform.python_version()}
    for name in _LIBRARIES:
        found: set[str] = set()
        for package in _PACKAGES.get(name, (name,)):
            with suppress(metadata.PackageNotFoundError):
                found.add(metadata.version(package))
        versions[name] = " or ".join(sorted(found)) or "not installed"
    return versions


def file_sha256(path: str | Path) -> str:
    """Return the SHA-256 of a file's bytes, as a hex string."""
    digest = hashlib.sha256()
    with Path(path).open("rb") as stream:
        for chunk in iter(lambda: stream.read(1 << 20), b""):
            digest.update(chunk)
    return digest.hexdigest()


@dataclass(frozen=True)
class Provenance:
    """Origin of an object: function, inputs, seed and versions."""

    created_by: str  # the function or command, for example `"elementwise"`
    created: str  # UTC time in ISO 8601
    inputs: Mapping[str, str] = field(default_factory=dict)  # name of each input -> its SHA-256
    seed: int | None = None  # seed of the random numbers, or None where none were drawn
    versions: Mapping[str, str] = field(default_factory=dict)  # library -> version
    note: str = ""  # free text

    @classmethod
    def now(
        cls, created_by: str, inputs: Mapping[str, str] | None = None, seed: int | None = None, note: str = ""
    ) -> Provenance:
        """Return a provenance with the present time and the installed versions."""
        created = datetime.now(UTC).isoformat(timespec="seconds")
        return cls(created_by, created, dict(inputs or {}), seed, library_versions(), note)

    def to_json(self) -> dict[str, object]:
        """Return the fields as plain types."""
        return {**vars(self), "inputs": dict(self.inputs), "versions": dict(self.versions)}

    @classmethod
    def from_json(cls, data: Mapping[str, object]) -> Provenance:
        """Invert `to_json`; unknown keys are ignored, so that newer minor versions of the format can be read."""
        inputs, versions, seed = data.get("inputs", {}), data.get("versions", {}), data.get("seed")
        if not isinstance(inputs, Mapping) or not isinstance(versions, Mapping):
            raise InputError("provenance", "inputs or versions is not a table", "a mapping of names to texts")
        return cls(
            str(data.get("created_by", "")),
            str(data.get("created", "")),
            {str(k): str(v) for k, v in inputs.items()},
            seed if isinstance(seed, int) else None,
            {str(k): str(v) for k, v in versions.items()},
            str(data.get("note", "")),
        )


class Traced:
    """Base of objects that files hold, with the provenance of the file they were loaded from."""

    # None for an object made in this process. The note includes `NOT_VERIFIED` if the file has no content hash.
    provenance: ClassVar[Provenance | None] = None

    def traced(self, origin: Provenance | None) -> None:
        """Set the provenance, after reading the object or making it from one with a provenance."""
        if origin is not None:
            object.__setattr__(self, "provenance", origin)


def code_of(plant: Any) -> dict[str, str]:
    """Return file -> SHA-256 of the code of a plant; empty for plants that are not from a plant file or a unit."""
    origin = getattr(plant, "provenance", None)
    if not isinstance(origin, Provenance) or origin.created_by not in (BY_PLANT_FILE, BY_UNIT):
        return {}
    return dict(origin.inputs)
