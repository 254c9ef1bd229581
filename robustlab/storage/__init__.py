"""Load and save models, records and results in format 1 and plain files."""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "interchange": "Loaded load read save",
        "controller_export": "back_calculation c_source",
        "expression_files": "load_parametric",
        "matrices": "Problems check_pair",
        "plants": "decode_plant encode_plant",
    },
)
