"""Names that come from files and become files: labels of filters and policies, names of cells and scenarios."""

from __future__ import annotations

import re

_LABEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]*")


def require_label(what: str, label: object, longest: int = 100) -> None:
    """Refuse what cannot be a part of a file name everywhere; raises a `ValueError` that names `what`."""
    if not isinstance(label, str) or not _LABEL.fullmatch(label) or len(label) > longest:
        raise ValueError(f"{what} must be up to {longest} letters, digits, '.', '_', '+' or '-', got {label!r}")
