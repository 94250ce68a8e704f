"""The application id: names the schema version and, by a hash, the layout that a viewer keeps."""

from __future__ import annotations

import hashlib
import re
from typing import TYPE_CHECKING

from carom.recording.schema.paths import SCHEMA_VERSION

if TYPE_CHECKING:
    from carom.recording.schema.header import Header

_PATTERN = re.compile(r"carom-([0-9]{1,9})-[0-9a-f]+")


def application_id(header: Header) -> str:
    """``carom-<schema>-<layout>``.

    A viewer keeps one layout, with its camera, per application id. The id therefore includes a hash of the scene.
    Rerun replaces slashes, so it has none.
    """
    layout = hashlib.sha256(f"{header.scene_toml}\n{header.bodies} {header.spins}".encode()).hexdigest()
    return f"carom-{SCHEMA_VERSION}-{layout[:12]}"


def schema_version(identity: str) -> int | None:
    """Read the schema version from an application id; None if carom did not make the recording."""
    match = _PATTERN.fullmatch(identity)
    return None if match is None else int(match.group(1))
