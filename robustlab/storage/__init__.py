"""Storage: format 1 and plain files to models, records and results, and back."""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "interchange": "Loaded load load_pair read save",
        "controller_export": "c_source",
        "expression_files": "load_parametric",
        "matrices": "Problems",
        "pairs": "check_pair",
        "plants": "decode_plant encode_plant",
    },
)
