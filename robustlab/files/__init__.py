"""Read untrusted HDF5, MATLAB and text files into plain arrays; write files atomically."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "file_types": "Limits MAX_DEPTH content_of parse_document size_text",
        "isolation": "ReaderServer",
        "text_table": "read_response read_table",
        "hdf5": "read_tree write_tree",
        "tree": "Dataset KINDS Tree Unread content_sha256 link_name signal_name stamp",
        "atomic": "atomic_write",
        "records": "Channel Source choose",
    },
)
