"""Characters that control a terminal."""

from __future__ import annotations

import unicodedata


def controls(text: str) -> list[str]:
    """Return what a terminal would obey, by Unicode's categories."""
    obeyed = {"Cc", "Cs", "Zl", "Zp"}
    bidi = {"LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"}
    return [
        item
        for item in text
        if unicodedata.category(item) in obeyed or unicodedata.bidirectional(item) in bidi
    ]
