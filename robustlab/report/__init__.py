"""What a run shows: figures, a self-contained HTML page, a JUnit file."""

from importlib import import_module
from typing import Any

# Name -> the module that has it; imported when it is asked for.
_WORDS = {
    **dict.fromkeys(("COLOURS", "house_style", "logarithmic", "new_figure", "save_figure"), "figures"),
    **dict.fromkeys(("in_words", "junit_xml", "render", "verdict"), "html"),
    **dict.fromkeys(("drawings_of", "pictures_of"), "drawings"),
    **dict.fromkeys(("DRAWINGS", "SETS"), "drawing_table"),
    **dict.fromkeys(("distribution_figure", "influence_figure", "mu_figure", "response_figure"), "robustness_figures"),
    **dict.fromkeys(("blocks_figure", "cloud_figure", "cover_figures", "weight_figure"), "set_figures"),
    **dict.fromkeys(("discovery_figures", "write_page"), "discovery"),
}

__all__ = list(_WORDS)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _WORDS:
        return getattr(import_module(f"robustlab.report.{_WORDS[name]}"), name)
    raise AttributeError(f"module 'robustlab.report' has no attribute {name!r}")
