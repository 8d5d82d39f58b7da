"""The figures of this package: matplotlib's, which notebooks show without a backend."""

from __future__ import annotations

import io

from matplotlib import figure

_DOTS_PER_INCH = 110  # on a screen


class Figure(figure.Figure):
    """A figure, independent of pyplot, that is the picture of a notebook's cell."""

    def _repr_png_(self) -> bytes:
        picture = io.BytesIO()
        self.savefig(picture, format="png", dpi=_DOTS_PER_INCH)
        return picture.getvalue()
