"""Reports: figures, a self-contained HTML page, a JUnit file."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "style": "COLOURS house_style logarithmic new_figure save_figure",
        "html": "in_words junit_xml render verdict",
        "drawings": "DRAWINGS drawings_of pictures_of",
        "robustness_figures": (
            "cloud_figure distribution_figure influence_figure mu_figure response_figure weight_figure"
        ),
        "discovery": "write_page",
    },
)
