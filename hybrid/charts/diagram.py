"""The patch diagram: every component by its customary symbol, every cord, and the digital program.

What stands in the patch becomes boxes and cords (`sheet`), `layered` places them, and the sheet is
written as SVG (`drawing`). The same patch gives the same bytes, in whatever order its entries stand.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from hybrid.charts.drawing import svg
from hybrid.charts.layered import lay_out
from hybrid.charts.sheet import Sheet
from hybrid.errors import RunError
from hybrid.naming import stem_of
from hybrid.patch import Patch
from hybrid.storage import output_folder, write_whole


class Svg(str):
    """SVG text that a notebook shows as a picture."""

    def _repr_svg_(self) -> str:
        return str(self)


def draw(patch: Patch, parameters: Mapping[str, float] | None = None) -> Svg:
    """The diagram of a patch as SVG text; `parameters` (SI) replace the patch's own.

    Raises PatchError for a parameter that the patch does not have or a value not allowed.
    """
    sheet = Sheet(patch, patch.bind(parameters))
    return Svg(svg(sheet, lay_out(sheet.boxes, sheet.cords)))


def save_diagram(
    patch: Patch, parameters: Mapping[str, float] | None, path: str | Path | None
) -> str:
    """Write the diagram, by default to the patch's name with .svg; returns the file's name."""
    if path is not None and not str(path).strip():
        raise RunError("--out is empty; name an SVG file")
    target = Path(path or f"{stem_of(patch)}.svg")
    if target.suffix.lower() != ".svg":
        raise RunError(f"--out {target} must be an SVG file, ending in .svg")
    text = draw(patch, parameters)
    output_folder(target.parent)
    write_whole(target, lambda part: Path(part).write_text(text, encoding="utf-8", newline="\n"))
    return str(target)
