"""Load and save models, records and results in format 1 and plain files."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "interchange": "Loaded load load_parametric read save",
        "controller_export": "back_calculation c_source",
        "matrices": "Problems check_pair",
        "plants": "decode_plant encode_plant",
    },
)
