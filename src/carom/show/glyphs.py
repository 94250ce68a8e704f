"""The characters that the viewer can draw with its own font, Inter, as Rerun 0.41 ships it."""

from __future__ import annotations

import re

from carom.recording.read.body_lookup import names_of
from carom.recording.read.recording import Recording

# Latin, Greek, Cyrillic, punctuation, currencies, fractions, arrows and some signs of mathematics
_DRAWN = re.compile(
    r"[\s\x20-\x7e\xa0-\u0148\u014a-\u01c3\u01c5-\u031e\u038e-\u03a1\u03a3-\u03e1\u03f0-\u049d\u04a0-\u04ff"
    r"\u2010-\u2027\u2030-\u205e\u2070-\u2071\u2074-\u208e\u20a0-\u20bf\u2153\u215a-\u2188\u2190-\u2199"
    r"\u2202\u2205-\u2206\u220f\u2211-\u2212\u221a\u221e\u222b\u2248\u2260\u2264-\u2265\u25a0-\u25a2"
    r"\u2605-\u2606]*"
)


def drawable(text: str) -> bool:
    """Tell whether the font has all characters of a text."""
    return _DRAWN.fullmatch(text) is not None


def has_all_glyphs(recording: Recording) -> bool:
    """Tell whether the font has all characters of the names that a picture shows.

    These are the names of bodies and planes, in labels and events, and that of the file; of an overlay, those of files.
    """
    if not drawable(recording.path.name):
        return False
    if recording.is_overlay:
        return all(drawable(str(text)) for text in recording.overlaid.values())
    names = names_of(recording)
    return all(map(drawable, (*names.bodies, *names.planes)))
